"""The passes of ADMM fused for CUDA, as Triton kernels.

They are bound by memory traffic, which is, in bytes per pixel of the padded shape:

- `solve_normal_equation_`: 20. Spectrum read and written, half spectrum of the PSF read.
- `update_splits_`: 37 without total variation (pair and two states read and written, data and
  valid pixels read), 69 with it. The split u then has a kernel of its own, which reads v and
  updates its two states (24), before the one that updates x and w reads them (8 more) to add
  Ψᵀq_u. Neither kernel writes what a neighbouring pixel reads of it, so all is in place. One
  kernel for all would move 53, but needs a second copy of the pair and of u's states, and 16
  more to bring those back where a CUDA graph expects them.

The second kernel has q_u from the state alone: as x = prox(a), q = 2x − a holds at any time, and
for the penalties that the state is written for.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

from nolens.kernels.admm import SplitState

_BLOCK = 512
"""Pixels of one program."""

_OPTIONS = {"enable_fp_fusion": True}
"""a·b + c in one operation: said outright, as Triton's default changes with its version."""

_SUMS = tl.constexpr(15)
"""Sums of a program, in the order of `nolens.kernels.admm.PassSums.of`."""


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, constants: Tensor) -> Tensor:
    """See `nolens.kernels.admm_torch.solve_normal_equation_`."""
    height, width = spectrum.shape
    with torch.cuda.device_of(spectrum):  # type: ignore[no-untyped-call]
        _solve[(triton.cdiv(height * (width // 2 + 1), _BLOCK),)](
            _floats(spectrum), _floats(transfer), constants, height, width, _BLOCK, **_OPTIONS
        )
    return spectrum


def update_splits_(
    pair: Tensor, state: SplitState, constants: Tensor, *, counted: bool, out: Tensor
) -> list[float] | None:
    """See `nolens.kernels.admm_torch.update_splits_`."""
    height, width = pair.shape
    tv, isotropic = state.tv > 0, state.isotropic
    rows, columns = state.rows.view(-1), state.columns.view(-1)
    programs = triton.cdiv(height * width, _BLOCK)
    sums = torch.zeros(programs, _SUMS.value, device=pair.device) if counted else None
    with torch.cuda.device_of(pair):  # type: ignore[no-untyped-call]
        if tv:
            _update_gradient[(programs,)](
                _floats(pair),
                rows,
                columns,
                constants,
                sums,
                height,
                width,
                isotropic,
                _BLOCK,
                **_OPTIONS,
            )
        _update_pixels[(programs,)](
            _floats(pair),
            _floats(out),
            state.data.view(-1),
            state.valid.view(-1),
            state.measured.view(-1),
            state.scene.view(-1),
            rows if tv else None,
            columns if tv else None,
            constants,
            sums,
            height,
            width,
            *state.sensor,
            *state.support,
            isotropic,
            _BLOCK,
            **_OPTIONS,
        )
    return None if sums is None else sums.double().sum(dim=0).tolist()


def _floats(field: Tensor) -> Tensor:
    """Complex field as real, imaginary, real, …: the same memory, for lack of a complex type."""
    return torch.view_as_real(field).view(-1)


@triton.jit
def _load_complex(field, place, mask):  # type: ignore[no-untyped-def]
    at = 2 * place[:, None] + tl.arange(0, 2)[None, :]
    return tl.split(tl.load(field + at, mask[:, None], 0.0))


@triton.jit
def _store_complex(field, place, real, imaginary, mask):  # type: ignore[no-untyped-def]
    at = 2 * place[:, None] + tl.arange(0, 2)[None, :]
    tl.store(field + at, tl.join(real, imaginary), mask[:, None])


@triton.jit
def _laplacian(k, length):  # type: ignore[no-untyped-def]
    """Spectrum of one direction's ΨᵀΨ: 4 sin²(πk/length)."""
    x = 3.14159265358979 * tl.minimum(k, length - k).to(tl.float32) / length
    y = x * x
    # Taylor series to x¹¹, below 6e-8 for x ≤ π/2: a GPU's own sine is off by more near zero.
    sine = 2.7557319e-06 - y * 2.5052108e-08
    sine = 1.0 + y * (-0.16666667 + y * (0.0083333333 + y * (-0.00019841270 + y * sine)))
    return 4.0 * y * sine * sine


@triton.jit  # type: ignore[untyped-decorator]
def _solve(spectrum, transfer, penalties, height, width, BLOCK: tl.constexpr):  # type: ignore[no-untyped-def]
    """Solve for v + i Mv at k and −k, for a block of the half spectrum's pixels k."""
    columns = width // 2 + 1
    place = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    i = place // columns
    j = place - i * columns
    here = i * width + j
    there = tl.where(i == 0, 0, height - i) * width + tl.where(j == 0, 0, width - j)
    # Columns 0 and width/2 hold both ends of a pair: the first of the two acts.
    both = (j == 0) | (2 * j == width)
    acts = (place < height * columns) & ((here <= there) | ~both)
    x_re, x_im = _load_complex(spectrum, here, acts)
    y_re, y_im = _load_complex(spectrum, there, acts)
    h_re, h_im = _load_complex(transfer, place, acts)
    mu_x = tl.load(penalties)
    mu_u = tl.load(penalties + 1)
    mu_w = tl.load(penalties + 2)
    a_re = 0.5 * (x_re + y_re)
    a_im = 0.5 * (x_im - y_im)
    b_re = 0.5 * (x_im + y_im)
    b_im = 0.5 * (y_re - x_re)
    rest = mu_u * (_laplacian(i, height) + _laplacian(j, width)) + mu_w
    scale = 1.0 / (mu_x * (h_re * h_re + h_im * h_im) + rest)
    v_re = (mu_x * (h_re * a_re + h_im * a_im) + b_re) * scale
    v_im = (mu_x * (h_re * a_im - h_im * a_re) + b_im) * scale
    m_re = h_re * v_re - h_im * v_im
    m_im = h_re * v_im + h_im * v_re
    _store_complex(spectrum, here, v_re - m_im, v_im + m_re, acts)
    _store_complex(spectrum, there, v_re + m_im, m_re - v_im, acts & (here != there))


@triton.jit  # type: ignore[untyped-decorator]
def _shrink(rows, columns, threshold, ISOTROPIC: tl.constexpr):  # type: ignore[no-untyped-def]
    """Proximal map of the total variation."""
    if ISOTROPIC:
        size = tl.sqrt(rows * rows + columns * columns)
        scale = tl.maximum(size - threshold, 0.0) / tl.maximum(size, 1e-30)
        rows = scale * rows
        columns = scale * columns
    else:
        rows = tl.maximum(rows - threshold, 0.0) - tl.maximum(-rows - threshold, 0.0)
        columns = tl.maximum(columns - threshold, 0.0) - tl.maximum(-columns - threshold, 0.0)
    return rows, columns


@triton.jit  # type: ignore[untyped-decorator]
def _load_shrunk(rows, columns, place, mask, threshold, ISOTROPIC: tl.constexpr):  # type: ignore[no-untyped-def]
    """Q = 2u − a of both directions."""
    a_y = tl.load(rows + place, mask, 0.0)
    a_x = tl.load(columns + place, mask, 0.0)
    u_y, u_x = _shrink(a_y, a_x, threshold, ISOTROPIC)
    return 2.0 * u_y - a_y, 2.0 * u_x - a_x


@triton.jit
def _store_sums(sums, field, split, split_old, turned):  # type: ignore[no-untyped-def]
    """Primal, split, change and multiplier change of a program's pixels, three apart."""
    step = split - split_old
    tl.store(sums, tl.sum((field - split) * (field - split)))
    tl.store(sums + 3, tl.sum(split * split))
    tl.store(sums + 6, tl.sum(step * step))
    tl.store(sums + 9, tl.sum(turned * turned))


@triton.jit  # type: ignore[untyped-decorator]
def _update_gradient(  # type: ignore[no-untyped-def]
    pair,
    rows,
    columns,
    constants,
    sums,
    height,
    width,
    ISOTROPIC: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Split u = Ψv; v is the pair's real part."""
    place = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    mask = place < height * width
    i = place // width
    j = place - i * width
    below = tl.where(i == height - 1, j, place + width)
    right = tl.where(j == width - 1, place - j, place + 1)
    threshold = tl.load(constants + 10) / tl.load(constants + 1)
    rescale = tl.load(constants + 7)
    alpha = tl.load(constants + 9)
    v = tl.load(pair + 2 * place, mask, 0.0)
    g_y = tl.load(pair + 2 * below, mask, 0.0) - v
    g_x = tl.load(pair + 2 * right, mask, 0.0) - v
    a_y = tl.load(rows + place, mask, 0.0)
    a_x = tl.load(columns + place, mask, 0.0)
    old_y, old_x = _shrink(a_y, a_x, threshold, ISOTROPIC)
    new_y = a_y + alpha * (g_y - old_y)
    new_x = a_x + alpha * (g_x - old_x)
    u_y, u_x = _shrink(new_y, new_x, threshold, ISOTROPIC)
    d_y = new_y - u_y
    d_x = new_x - u_x
    tl.store(rows + place, u_y + rescale * d_y, mask)
    tl.store(columns + place, u_x + rescale * d_x, mask)
    if sums is not None:
        at = sums + tl.program_id(0) * _SUMS
        field = tl.join(g_y, g_x)
        turned = tl.join(d_y - (a_y - old_y), d_x - (a_x - old_x))
        _store_sums(at + 1, field, tl.join(u_y, u_x), tl.join(old_y, old_x), turned)
        size = tl.sqrt(g_y * g_y + g_x * g_x) if ISOTROPIC else tl.abs(g_y) + tl.abs(g_x)
        tl.store(at + 13, tl.sum(size))


@triton.jit  # type: ignore[untyped-decorator]
def _update_pixels(  # type: ignore[no-untyped-def]
    pair,
    out,
    data,
    valid,
    measured,
    scene,
    rows,
    columns,
    constants,
    sums,
    height,
    width,
    sensor_top,
    sensor_left,
    sensor_height,
    sensor_width,
    support_top,
    support_left,
    support_height,
    support_width,
    ISOTROPIC: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Splits x = Mv and w = v; then (q_x, μ₂Ψᵀq_u + μ₃q_w) in the place of (v, Mv)."""
    place = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    mask = place < height * width
    i = place // width
    j = place - i * width
    alpha = tl.load(constants + 9)
    v, mv = _load_complex(pair, place, mask)

    row = i - sensor_top
    column = j - sensor_left
    on_sensor = (row >= 0) & (row < sensor_height) & (column >= 0) & (column < sensor_width)
    pixel = row * sensor_width + column
    counts = tl.load(valid + pixel, on_sensor, 0) != 0
    b = tl.where(counts, tl.load(data + pixel, on_sensor, 0.0), 0.0)
    mu = tl.load(constants)
    a = tl.load(measured + place, mask, 0.0)
    old = tl.where(counts, (b + mu * a) / (1.0 + mu), a)
    new = a + alpha * (mv - old)
    x = tl.where(counts, (b + mu * new) / (1.0 + mu), new)
    stored = x + tl.load(constants + 6) * (new - x)
    tl.store(measured + place, stored, mask)
    q = 2.0 * x - stored
    if sums is not None:
        at = sums + tl.program_id(0) * _SUMS
        _store_sums(at, mv, x, old, (new - x) - (a - old))
        miss = tl.where(counts, mv - b, 0.0)
        tl.store(at + 12, tl.sum(miss * miss))

    row = i - support_top
    column = j - support_left
    lit = (row >= 0) & (row < support_height) & (column >= 0) & (column < support_width)
    shift = tl.load(constants + 11) / tl.load(constants + 2)
    a = tl.load(scene + place, mask, 0.0)
    old = tl.where(lit, tl.maximum(a - shift, 0.0), 0.0)
    new = a + alpha * (v - old)
    w = tl.where(lit, tl.maximum(new - shift, 0.0), 0.0)
    stored = w + tl.load(constants + 8) * (new - w)
    tl.store(scene + place, stored, mask)
    r = tl.load(constants + 5) * (2.0 * w - stored)
    if sums is not None:
        at = sums + tl.program_id(0) * _SUMS
        _store_sums(at + 2, v, w, old, (new - w) - (a - old))
        tl.store(at + 14, tl.sum(tl.abs(v)))

    if rows is not None:
        later = tl.load(constants + 4)
        threshold = tl.load(constants + 10) / later
        above = tl.where(i == 0, place + (height - 1) * width, place - width)
        left = tl.where(j == 0, place + width - 1, place - 1)
        q_y, q_x = _load_shrunk(rows, columns, place, mask, threshold, ISOTROPIC)
        from_above, _x = _load_shrunk(rows, columns, above, mask, threshold, ISOTROPIC)
        _y, from_left = _load_shrunk(rows, columns, left, mask, threshold, ISOTROPIC)
        r += later * (from_above - q_y + from_left - q_x)
    _store_complex(out, place, q, r, mask)
