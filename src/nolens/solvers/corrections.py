"""What ADMM is slowest at in a scene that fills the view: its gain and its low frequencies."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.kernels import irfft2
from nolens.operators import CroppedConvolution, FiniteDifference, PixelRectangle
from nolens.solvers.problem import Prior, Problem

_MODES = 8
"""Cosines along each side of the scene."""
_PIXELS_PER_HALF_WAVE = 3
_STEPS = 2
_SHORTEST = 0.2
_FLAT = 0.1
"""Differences below this fraction of their mean count as it, in the weights of the variation."""


def gain_corrected(problem: Problem, scene: Tensor) -> tuple[Tensor, float]:
    """Every channel times the factor f that minimises the objective, and the objective.

    The iterate's mean is held by all pixels that it lights, and comes to rest last: it can
    be some per cent off, each channel in its own way, when the picture has long been there. As all
    priors are homogeneous, R(fv) = f R(v), the best factor is f = (⟨b, CMv⟩ − τR(v)) / ‖CMv‖²
    where that is above zero.

    Parameters
    ----------
    problem
        In normalised units.
    scene
        `(channels, height, width)` in normalised units, non-negative.
    """
    fit = torch.where(problem.valid, problem.data - problem.residual(scene), 0).double()
    priors = [problem.tau * problem.regulariser(channel[None]) for channel in scene]
    prior = torch.stack(priors)
    power = fit.square().sum(dim=(-2, -1)).clamp_min(1e-300)
    factor = ((fit * problem.data).sum(dim=(-2, -1)) - prior) / power
    if not bool((factor > 0).all()):
        factor = torch.ones_like(factor)
    residual = (problem.data - factor[:, None, None] * fit).square().sum(dim=(-2, -1))
    objective = float((0.5 * residual + factor * prior).mean())
    return factor.to(scene.dtype)[:, None, None] * scene, objective


class LowFrequencyCorrection:
    r"""Minimises the objective of a problem over the low-frequency part of the scene.

    A scene that fills the view of a camera without aperture gives a glow that hardly depends on
    where its light comes from: the eigenvalues of AᵀA, A = CM, for slow cosines of the scene are a
    million times below that of the mean, and ADMM needs thousands of iterations for them. There
    are few of them, so they are solved for directly. Over v + Bc, with the cosines as columns of
    B, each step minimises the quadratic majoriser of the objective

    ½‖r − ABc‖² + τ/2 Σ (Ψ(v + Bc))² / max(|Ψv|, ε),   r = b − Av,

    (`hunter2004`; the weights are those of iteratively reweighted least squares) and goes as far
    along it as the true objective falls, with v ≥ 0. AB is computed on blocks of f×f pixels.

    Parameters
    ----------
    problem
        In normalised units, with a support or a scene of its own.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        height, width = problem.scene_shape[1:]
        self._rows = _cosines(height).to(problem.data)
        self._columns = _cosines(width).to(problem.data)
        self._bin = max(1, min(height, width) // (_PIXELS_PER_HALF_WAVE * _MODES))
        self._responses = [
            _responses(problem, channel, self._bin) for channel in range(problem.forward.channels)
        ]
        self._grams = [each @ each.T for each in self._responses]

    def improved(self, scene: Tensor) -> tuple[Tensor, bool]:
        """Scene with a better low-frequency part, and whether the objective fell.

        Parameters
        ----------
        scene
            `(channels, height, width)` in normalised units, non-negative.
        """
        best = _Point.of(self._problem, scene)
        fell = False
        for _ in range(_STEPS):
            direction = self._direction(best)
            length = 1.0
            while length > _SHORTEST:
                moved = (best.scene + length * direction).clamp_min(0)
                trial = _Point.of(self._problem, moved)
                if trial.objective < best.objective:
                    break
                length /= 2
            else:
                break
            best, fell = trial, True
        return best.scene, fell

    def _direction(self, point: "_Point") -> Tensor:
        parts = []
        for channel, residual in enumerate(point.residual):
            which = channel % len(self._responses)
            binned = _binned(residual, self._bin).flatten().double() * self._bin
            curvature, slope = self._prior(point.scene[channel])
            # A trace of the identity, for cosines that neither data nor prior know.
            matrix = self._grams[which] + curvature
            matrix += 1e-12 * matrix.trace() * torch.eye(len(matrix)).to(matrix)
            target = self._responses[which] @ binned - slope
            amounts = torch.linalg.solve(matrix, target).to(residual.dtype)
            parts.append(self._rows.T @ amounts.view(_MODES, _MODES) @ self._columns)
        return torch.stack(parts)

    def _prior(self, scene: Tensor) -> tuple[Tensor, Tensor]:
        """Curvature and slope of the prior along the cosines; float64."""
        prior, tau = self._problem.prior, self._problem.tau
        none = torch.zeros(_MODES * _MODES, dtype=torch.float64, device=scene.device)
        if prior is Prior.NONE or tau == 0:
            return torch.outer(none, none), none
        if prior is Prior.L1:
            return torch.outer(none, none), tau * self._along(torch.ones_like(scene)).double()
        difference = FiniteDifference((scene.shape[0], scene.shape[1]))
        step = difference(scene)
        step[0, -1], step[1, :, -1] = 0, 0  # No wrap-around: the scene ends there.
        size = step.abs()
        if prior is Prior.ISOTROPIC_TV:
            size = torch.linalg.vector_norm(step, dim=0).expand(2, -1, -1)
        floor = (_FLAT * size.mean()).clamp_min(torch.finfo(scene.dtype).tiny)
        weight = tau / size.maximum(floor)
        slope = self._along(difference.adjoint(weight * step)).double()
        return self._curvature(weight), slope

    def _along(self, values: Tensor) -> Tensor:
        return (self._rows @ values @ self._columns.T).flatten()

    def _curvature(self, weight: Tensor) -> Tensor:
        """Σ w (ΨB)(ΨB)ᵀ, with the weights of a few pixels taken together."""
        side = max(1, self._bin // 2)
        pooled = nnf.avg_pool2d(weight[None], side)[0].double() * side**2
        rows, columns = (_pooled(each, side) for each in (self._rows, self._columns))
        steep_rows, steep_columns = (
            _pooled(nnf.pad(each.diff(), (0, 1)), side) for each in (self._rows, self._columns)
        )
        total = torch.zeros(_MODES**2, _MODES**2, dtype=torch.float64, device=weight.device)
        for each, across, along in (
            (pooled[0], steep_rows, columns),
            (pooled[1], rows, steep_columns),
        ):
            modes = torch.einsum("ai,bj->abij", across, along).flatten(0, 1).flatten(1)
            total += (modes * each.flatten()) @ modes.T
        return total


@dataclass(frozen=True)
class _Point:
    """A scene, what it leaves of the measurement, and its objective."""

    scene: Tensor
    residual: Tensor
    objective: float

    @classmethod
    def of(cls, problem: Problem, scene: Tensor) -> "_Point":
        residual = problem.residual(scene)
        return cls(scene, residual, problem.objective(scene, residual))


def _cosines(count: int) -> Tensor:
    """(_MODES, count) cosines of 0, 1, … half waves along `count` pixels, of unit norm."""
    place = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    waves = torch.cos(math.pi * torch.arange(_MODES, dtype=torch.float64)[:, None] * place)
    unit: Tensor = waves / torch.linalg.vector_norm(waves, dim=1, keepdim=True)
    return unit


def _pooled(waves: Tensor, pixels: int) -> Tensor:
    means: Tensor = nnf.avg_pool1d(waves[None], pixels)[0]
    return means.double()


def _binned(values: Tensor, bin_by: int) -> Tensor:
    """Means over blocks, without the rows and columns that fill none."""
    means: Tensor = nnf.avg_pool2d(values[None], bin_by)[0]
    return means


def _responses(problem: Problem, channel: int, bin_by: int) -> Tensor:
    """AB of a channel on blocks of the sensor, times the block's side: (MODES², blocks); float64.

    The cosines are taken as constant over blocks of the scene. The PSF between blocks is then its
    mean over all pairs of their pixels, a triangle of f pixels to either side.
    """
    forward = problem.forward
    rows, columns = forward.sensor[0] // bin_by, forward.sensor[1] // bin_by
    top, left, height, width = (*forward.geometry.origin, *problem.scene_shape[1:])
    support = PixelRectangle(
        top // bin_by,
        left // bin_by,
        -(-(top + height) // bin_by) - top // bin_by,
        -(-(left + width) // bin_by) - left // bin_by,
    )
    extent = (rows + support.height + 1, columns + support.width + 1)
    psf = _between_blocks(
        irfft2(forward.transfer[channel], forward.geometry.padded), bin_by, extent
    )
    coarse = CroppedConvolution(psf[None] * bin_by**2, (rows, columns), support)
    vertical = _on_blocks(_cosines(height), top - support.top * bin_by, support.height, bin_by)
    horizontal = _on_blocks(_cosines(width), left - support.left * bin_by, support.width, bin_by)
    modes = torch.einsum("ai,bj->abij", vertical, horizontal).flatten(0, 1).to(psf)
    responses: Tensor = coarse(modes).flatten(1).double() * bin_by
    return responses


def _on_blocks(waves: Tensor, start: int, blocks: int, bin_by: int) -> Tensor:
    """Means over blocks of waves that begin at pixel `start` of the first, zero beside them."""
    padded = nnf.pad(waves, (start, blocks * bin_by - start - waves.shape[1]))
    means: Tensor = nnf.avg_pool1d(padded[None], bin_by)[0]
    return means


def _between_blocks(kernel: Tensor, bin_by: int, extent: tuple[int, int]) -> Tensor:
    """Mean PSF from block to block, at offsets of up to `reach` blocks from the middle.

    `kernel` is the PSF over the padded shape, with zero shift at its first pixel.
    """
    for axis, blocks in zip((-2, -1), extent, strict=True):
        padded = kernel.shape[axis]
        offsets = torch.arange(-blocks, blocks + 1, device=kernel.device) * bin_by
        mean = torch.zeros_like(kernel.narrow(axis, 0, 1)).repeat_interleave(len(offsets), axis)
        for shift in range(1 - bin_by, bin_by):
            fraction = (bin_by - abs(shift)) / bin_by**2
            # Beyond half the padded shape it is another offset's pixel: nothing is there.
            place = offsets + shift
            there = (place >= -(padded // 2)) & (place < padded - padded // 2)
            pixels = kernel.index_select(axis, place % padded)
            mask = there.to(kernel).reshape((-1, 1) if axis == -2 else (1, -1))
            mean += fraction * pixels * mask
        kernel = mean
    return kernel
