"""Transforms against numpy's, and the lengths chosen for them."""

import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st

from nolens.kernels import (
    fast_length,
    fft,
    fft2_,
    ifft2_,
    ifft2_window,
    irfft2,
    irfft2_window_,
    rfft2,
    rfft2_window,
)


@pytest.fixture(autouse=True, params=["MKL", "MKL along rows", "scipy"], scope="module")
def _library(request):
    """As for small and for large planes where torch has MKL, and as where it has none."""
    if request.param != "scipy" and not fft._MKL:
        pytest.skip("torch has no MKL on this processor")
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "MKL along rows":
            patch.setattr(fft, "_PLANES_BY_MKL", 0)
            patch.setattr(fft, "_COLUMNS_BY_MKL", 0)
        elif request.param == "scipy":
            patch.setattr(fft, "_MKL", False)
        yield


SIZES = [(6, 8), (7, 9), (5, 6), (8, 7), (1, 5), (4, 1)]
TOLERANCE = {
    torch.float32: 2e-6,
    torch.float64: 1e-14,
    torch.complex64: 2e-6,
    torch.complex128: 1e-14,
}


def _random(shape: tuple[int, ...], dtype: torch.dtype) -> torch.Tensor:
    generator = torch.Generator().manual_seed(5)
    return torch.randn(shape, generator=generator, dtype=torch.complex128).to(dtype)


def _real(shape: tuple[int, ...], dtype: torch.dtype) -> torch.Tensor:
    return _random(shape, torch.complex128).real.to(dtype).contiguous()


def _same(got: torch.Tensor, expected: np.ndarray, dtype: torch.dtype) -> None:
    assert got.dtype == dtype
    assert got.shape == expected.shape
    error = np.abs(got.numpy() - expected).max()
    assert error <= TOLERANCE[dtype] * np.abs(expected).max()


@pytest.mark.parametrize("lead", [(), (3,), (2, 3)])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
def test_complex(dtype, size, lead):
    field = _random((*lead, *size), dtype)
    before = field.numpy().copy()
    spectrum = fft2_(field)
    _same(spectrum, np.fft.fft2(before.astype(np.complex128)), dtype)
    _same(ifft2_(spectrum), before, dtype)


@pytest.mark.parametrize("lead", [(), (3,), (2, 3)])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    ("dtype", "of_spectrum"),
    [(torch.float32, torch.complex64), (torch.float64, torch.complex128)],
)
def test_real(dtype, of_spectrum, size, lead):
    field = _real((*lead, *size), dtype)
    before = field.clone()
    spectrum = rfft2(field)
    _same(spectrum, np.fft.rfft2(before.numpy().astype(np.float64)), of_spectrum)
    assert torch.equal(field, before)
    kept = spectrum.clone()
    _same(irfft2(spectrum, size), before.numpy(), dtype)
    assert torch.equal(spectrum, kept)


@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.tuples(st.integers(0, 5), st.integers(0, 5)),
    st.tuples(st.integers(-9, 20), st.integers(-9, 20)),
    st.sampled_from([(), (1,), (2, 3)]),
    st.sampled_from([torch.float32, torch.float64]),
)
@example((4, 6), (0, 0), (0, 0), (), torch.float32)
@example((4, 6), (0, 0), (3, -1), (2, 3), torch.float64)
def test_window_of_a_field(size, margin, corner, lead, dtype):
    period = (size[0] + margin[0], size[1] + margin[1])
    inside = _real((*lead, *size), dtype)
    field = np.zeros((*lead, *period))
    field[..., : size[0], : size[1]] = inside.numpy()
    expected = np.fft.rfft2(np.roll(field, corner, (-2, -1)))
    spectrum = rfft2_window(inside, corner, period)
    _same(spectrum, expected, spectrum.dtype)
    assert spectrum.dtype == dtype.to_complex()
    memory = torch.full_like(spectrum, 7)
    assert rfft2_window(inside, corner, period, memory) is memory
    assert torch.equal(memory, spectrum)
    window = (margin[0] // 2, margin[1], *size)
    rows, columns = (slice(at, at + n) for at, n in zip(window[:2], size, strict=True))
    wanted = np.roll(field, corner, (-2, -1))[..., rows, columns]
    got = irfft2_window_(spectrum, window, period)
    assert got.dtype == dtype
    assert np.abs(got.numpy() - wanted).max() <= TOLERANCE[dtype] * np.abs(field).max()


@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.integers(1, 4),
    st.tuples(*[st.floats(0, 1)] * 4),
    st.booleans(),
)
@example((6, 5), 3, (0.2, 0.1, 0.7, 0.6), True)
def test_window_of_a_finer_field(size, finer, parts, squared):
    """The sum of the waves, at samples between those that the spectrum stands for."""
    spectrum = _random(size, torch.complex128)
    counts = [finer * count for count in size]
    first = [int(part * (count - 1)) for part, count in zip(parts[:2], counts, strict=True)]
    last = [
        at + 1 + int(part * (count - 1 - at))
        for part, count, at in zip(parts[2:], counts, first, strict=True)
    ]
    waves = [
        np.exp(2j * np.pi / finer * np.outer(np.arange(*ends), np.fft.fftfreq(count))) / count
        for count, ends in zip(size, zip(first, last, strict=True), strict=True)
    ]
    field = waves[0] @ spectrum.numpy() @ waves[1].T
    window = (*first, *field.shape)
    got = ifft2_window(spectrum, window, finer, squared=squared).numpy()
    expected = np.abs(field) ** 2 if squared else field
    assert got.shape == expected.shape
    assert np.abs(got - expected).max() <= 1e-13 * max(1, np.abs(field).max()) ** 2


def test_views_with_other_strides():
    wide = _real((8, 12), torch.float32)
    view = wide[1:7, ::2].T
    _same(rfft2(view), np.fft.rfft2(view.numpy().astype(np.float64)), torch.complex64)


def _largest_factor(number: int) -> int:
    factor, largest = 2, 1
    while number > 1:
        while number % factor == 0:
            number, largest = number // factor, factor
        factor += 1
    return largest


@given(st.integers(1, 9000), st.booleans())
@example(1, True)
@example(256, True)
@example(256, False)
@example(2048, True)
@example(4096, True)
def test_fast_length(at_least, of_rows):
    length = fast_length(at_least, of_rows=of_rows)
    assert length >= at_least
    assert length % 2 == 0
    assert not of_rows or length % 256 != 0
    assert _largest_factor(length) <= 11
    # And the smallest such, so that no memory is wasted.
    for shorter in range(max(2, at_least), length):
        aliased = of_rows and shorter % 256 == 0
        assert shorter % 2 or aliased or _largest_factor(shorter) > 11


@pytest.mark.parametrize(
    ("at_least", "length"), [(1, 2), (13, 14), (256, 264), (599, 600), (799, 800), (2047, 2058)]
)
def test_fast_length_at_known_points(at_least, length):
    assert fast_length(at_least, of_rows=True) == length
