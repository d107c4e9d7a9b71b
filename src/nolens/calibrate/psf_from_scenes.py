"""The PSF that explains measurements of known scenes best."""

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as nnf
from scipy import ndimage
from torch import Tensor

from nolens.calibrate.known_scenes import KnownScenes, ManyScenes, Weights, over_the_field
from nolens.errors import DataError
from nolens.kernels import irfft2, rfft2
from nolens.operators import FiniteDifference
from nolens.progress import ProgressCallback, part_of, within
from nolens.solvers.functionals import GroupSparsity

_TAU = 8e-5
"""Weight of the total variation: of the largest gradient of the residual at p = 0, for each pixel
that the support would be wide as a square. So the same PSF on finer pixels comes out the same.
"""
_PENALTY = 3.0
_INNER = 3
_BETWEEN_GAINS = 4
_STEPS = 24
_COARSE = 64
_COARSE_STEPS = 16
_COARSE_FRACTION = 0.2
_ROUNDS = 3
_BLUR = 16
_FAINT = 0.2
_SMALL = 0.05
_HALF = 0.5


class PsfSolver:
    r"""Minimise ½ Σ_k ‖b_k − g_k C Σ_j p_j * φ_j x_k‖²_W + τ Σ_j TV(p_j), p₀ ≥ 0.

    All measurements b_k have the PSFs p_j in common, and each a gain g_k of its own, as exposures
    differ; the mean gain is 1. `ManyScenes` is the model, W `Weights`. Without the isotropic
    total variation TV, what the pictures' falling spectra leave unknown would fill with noise.

    ADMM (`boyd2011`) splits off p₀ ≥ 0 and Ψp; its quadratic step is done by a few conjugate
    gradients, preconditioned by the periodic model in which crop and taper are their means
    (`nocedal2006`); gains are least squares in between. Measurements and scenes are taken relative
    to their means, so no constant factor matters.

    Parameters
    ----------
    known
        Scenes and measurements.
    terms
        φ, (terms, rows, columns) of a scene; the first is 1. None for one PSF everywhere.
    support
        1 where the PSF may have light, 0 elsewhere, (rows, columns) of the PSF.
    """

    def __init__(self, known: KnownScenes, terms: Tensor | None, support: Tensor) -> None:
        self._support = support
        size = (support.shape[0], support.shape[1])
        light = known.measured.mean(dim=(-2, -1), keepdim=True)
        radiance = known.scenes.mean(dim=(-2, -1), keepdim=True)
        self._scale = light / radiance
        self._data = known.measured / light
        self._model = ManyScenes(known.scenes / radiance, known.support, known.sensor, size, terms)
        self._weights = Weights.of(self._data, known.valid)
        self._difference = FiniteDifference(size)
        self._steepness = self._spectrum_of_differences()
        self.gains = torch.ones_like(light)
        wide = math.sqrt(float(support.sum()))
        self._tau = _TAU * wide * float(self._back(self._data)[0].abs().max())

    def solve(
        self,
        steps: int,
        *,
        start: Tensor | None = None,
        progress: ProgressCallback | None = None,
    ) -> Tensor:
        """Do so many steps of ADMM.

        Parameters
        ----------
        steps
            How many.
        start
            p₀ to start from, (rows, columns); zero without one.
        progress
            Called with the fraction that is done.

        Returns
        -------
        Tensor
            p, (terms, rows, columns), relative to the means.

        Raises
        ------
        DataError
            If no PSF explains the measurements at all.
        """
        p = self._support.new_zeros(self._model.domain_shape)
        if start is not None:
            p[0] = start * self._support
            p *= self.fit_gains(p)
        light, edges = p, self._difference(p)
        light_dual, edges_dual, rho = torch.zeros_like(p), torch.zeros_like(edges), 0.0
        for step in range(steps):
            if step % _BETWEEN_GAINS == 0:
                by = self.fit_gains(light) if step > 0 else 1.0
                spectrum = self._spectrum()
                rho, before = _PENALTY * float(spectrum[0].mean()), rho
                p, light, edges = by * p, by * light, by * edges
                light_dual = by * before / rho * light_dual
                edges_dual = by * before / rho * edges_dual
                spectrum += rho * (1 + self._steepness)
                data = self._back(self._data)
            pull = light - light_dual + self._difference.adjoint(edges - edges_dual)
            p = self._conjugate(p, data + rho * self._support * pull, rho, spectrum)
            light = p + light_dual
            light[0].clamp_min_(0)
            light_dual = light_dual + p - light
            steep = self._difference(p) + edges_dual
            edges = GroupSparsity(-3).prox(steep, self._tau / rho)
            edges_dual = steep - edges
            if progress is not None:
                progress((step + 1) / steps)
        self.fit_gains(light)
        return light

    def fit_gains(self, psfs: Tensor) -> float:
        """Find the gains by least squares; their mean, by which the PSFs are to grow.

        Raises
        ------
        DataError
            If the PSFs explain nothing of any measurement.
        """
        image = self._model(psfs)
        overlap = self._weights.product(image, self._data)
        gains = (overlap / self._weights.product(image, image)).float()
        mean = float(gains.clamp_min(0).mean())
        if not mean > 0:
            raise DataError(
                "no PSF explains these measurements: their pictures are not what the camera "
                "measured, or lie elsewhere in its frame"
            )
        self.gains = (gains / mean).clamp_min(0)
        return mean

    def residual(self, psfs: Tensor) -> Tensor:
        """‖b − g C Σ_j p_j * φ_j x‖ over ‖b‖ in the norm of W, of each measurement, (measurements).

        For the gains as they were fitted last.
        """
        off = self.gains * self._model(psfs) - self._data
        square = self._weights.product(off, off) / self._weights.product(self._data, self._data)
        return square.sqrt().float().flatten()

    def unscaled(self, psfs: Tensor) -> tuple[Tensor, Tensor]:
        """PSFs in units of measurement over scene, and each measurement's gain; their mean is 1."""
        gains = self.gains * self._scale
        mean = gains.mean()
        return psfs * mean, (gains / mean).flatten()

    def _back(self, values: Tensor) -> Tensor:
        return self._support * self._model.adjoint(self.gains * self._weights(values))

    def _normal(self, psfs: Tensor, rho: float) -> Tensor:
        smooth = psfs + self._difference.adjoint(self._difference(psfs))
        return self._back(self.gains * self._model(psfs)) + rho * self._support * smooth

    def _spectrum(self) -> Tensor:
        """Of the normal equation of each term in which crop and taper are their means."""
        grid = self._model.geometry.padded
        power = self._model.spectra.abs().square() * self._weights.on_grid(grid)
        return (self.gains.square() * power).sum(dim=1)

    def _spectrum_of_differences(self) -> Tensor:
        grid = self._model.geometry.padded
        point = torch.zeros(grid)
        point[0, 0] = 1
        spectrum: Tensor = rfft2(FiniteDifference(grid)(point)).abs().square().sum(dim=0)
        return spectrum

    def _conjugate(self, p: Tensor, right: Tensor, rho: float, spectrum: Tensor) -> Tensor:
        """A few steps towards the PSFs whose normal equation has this right side."""
        residual = right - self._normal(p, rho)
        near = self._nearly_solved(residual, spectrum)
        direction, size = near, _dot(residual, near)
        for _ in range(_INNER):
            if not size > 0:
                break
            image = self._normal(direction, rho)
            along = size / _dot(direction, image)
            p, residual = p + along * direction, residual - along * image
            near = self._nearly_solved(residual, spectrum)
            size, before = _dot(residual, near), size
            direction = near + size / before * direction
        return p

    def _nearly_solved(self, residual: Tensor, spectrum: Tensor) -> Tensor:
        geometry = self._model.geometry
        image = irfft2(rfft2(self._model.embed(residual)) / spectrum, geometry.padded)
        top, left, height, width = geometry.scene
        return self._support * image[..., top : top + height, left : left + width]


def _dot(one: Tensor, other: Tensor) -> float:
    return float((one.double() * other).sum())


@dataclass(frozen=True)
class SolvedPsf:
    """A PSF, and how well it explains what it was solved from.

    Attributes
    ----------
    psf
        (rows, columns), not negative, in units of measurement over scene; its middle,
        (rows // 2, columns // 2), is zero shift.
    gains
        Of each measurement: it is gain × (psf * scene); their mean is 1.
    residual
        Of each measurement, ‖b − gain C(psf * scene)‖ over ‖b‖, weighted as `Weights` says.
    residual_varying
        The same with the changes of the PSF over the scene that were solved with it.
    support
        bool, (rows, columns): where the PSF has light.
    """

    psf: Tensor
    gains: Tensor
    residual: Tensor
    residual_varying: Tensor
    support: Tensor


def psf_from_scenes(
    known: KnownScenes,
    *,
    support: Tensor | None = None,
    steps: int = _STEPS,
    progress: ProgressCallback | None = None,
) -> SolvedPsf:
    """Solve one PSF from all measurements together: crop-aware and non-negative.

    First on coarse pixels, for its support: solved without one, the PSF's light stands out of the
    haze that explains noise; where its local mean is more than a fifth of the largest, the PSF has
    light, and nowhere else. Without that, a PSF as wide as sensor and scene has more unknowns than
    the measurements have to say. Then within it on all pixels, by `PsfSolver`, together with how
    the PSF changes over the scene (`over_the_field`): what light from aslant does else would be
    taken for the PSF's. The result is the mean PSF.

    Parameters
    ----------
    known
        Scenes and measurements.
    support
        bool, (rows, columns) of the PSF: where it may have light. None finds it, with the PSF as
        large as `known.extent`.
    steps
        Of ADMM, on all pixels.
    progress
        Called with the fraction that is done.

    Raises
    ------
    DataError
        If no PSF explains the measurements.
    """
    start = None
    if support is None:
        support, start = _coarse_solution(known, progress)
    rows, columns = _around(support)
    inner = slice(*rows), slice(*columns)
    cropped = support[inner].float()
    solver = PsfSolver(known, over_the_field(known), cropped)
    psfs = solver.solve(
        steps,
        start=None if start is None else start[inner],
        progress=within(progress, _COARSE_FRACTION, 0.8),
    )
    varying = solver.residual(psfs)
    alone = PsfSolver(known, None, cropped)
    mean = psfs[:1] * alone.fit_gains(psfs[:1])
    residual = alone.residual(mean)
    mean, gains = alone.unscaled(mean)
    psf = mean.new_zeros(support.shape)
    psf[inner] = mean[0]
    return SolvedPsf(psf, gains, residual, varying, support)


def unexplained(known: KnownScenes, psf: Tensor) -> Tensor:
    """Residual of each measurement as `SolvedPsf` has it, for a PSF that was not solved from them.

    Each measurement has its own gain.
    """
    solver = PsfSolver(known, None, torch.ones_like(psf))
    return solver.residual(psf[None] * solver.fit_gains(psf[None]))


def _coarse_solution(
    known: KnownScenes, progress: ProgressCallback | None
) -> tuple[Tensor, Tensor]:
    """Where the PSF has light, and roughly how much, on the pixels of the scenes."""
    by = max(1, min(known.sensor) // _COARSE)
    coarse = known.binned(by)
    support, psf = torch.ones(coarse.extent), None
    for number in range(_ROUNDS):
        solver = PsfSolver(coarse, None, support)
        psf = solver.solve(_COARSE_STEPS, start=psf)[0]
        support = _lit(psf, min(coarse.sensor) / _BLUR)
        psf = psf * support
        part_of(within(progress, 0.0, _COARSE_FRACTION), number, _ROUNDS)(1.0)
    assert psf is not None
    fine = [_refined(each, by, known.extent) for each in (support, psf)]
    if not bool((fine[0] >= _HALF).any()):
        raise DataError("no PSF explains these measurements: check that each has its own picture")
    return fine[0] >= _HALF, fine[1]


def _lit(psf: Tensor, sigma: float) -> Tensor:
    """1 where its local mean is not faint, but for patches that have little light; else 0."""
    local = _blurred(psf, sigma)
    patches, count = ndimage.label((local > _FAINT * local.max()).numpy())
    light = ndimage.sum_labels(psf.numpy(), patches, range(1, count + 1))
    bright = [number + 1 for number in range(count) if light[number] > _SMALL * light.max()]
    return torch.from_numpy(np.isin(patches, bright)).to(psf.dtype)


def _refined(coarse: Tensor, by: int, size: tuple[int, int]) -> Tensor:
    """Between coarse pixels on straight lines; a shift of one of them is `by` pixels."""
    middles = [each // 2 - whole // 2 / by for whole, each in zip(size, coarse.shape, strict=True)]
    fine = ndimage.affine_transform(
        coarse.numpy(), [1 / by, 1 / by], offset=middles, output_shape=size, order=1
    )
    return torch.from_numpy(fine)


def _around(support: Tensor) -> tuple[tuple[int, int], tuple[int, int]]:
    """Rows and columns, from and to, of the smallest window around it with the same middle."""
    spans = []
    for axis in (1, 0):
        lit = support.any(dim=axis).nonzero().flatten()
        middle = support.shape[1 - axis] // 2
        extent = max(middle - int(lit[0]), int(lit[-1]) - middle)
        spans.append((middle - extent, min(support.shape[1 - axis], middle + extent + 1)))
    return spans[0], spans[1]


def _blurred(plane: Tensor, sigma: float) -> Tensor:
    """Local mean: convolved with a Gaussian, with nothing beyond the edges."""
    extent = max(1, round(3 * sigma))
    offsets = torch.arange(-extent, extent + 1, dtype=torch.float32)
    weights = torch.exp(-0.5 * (offsets / sigma).square())
    weights /= weights.sum()
    rows = nnf.conv2d(plane[None, None], weights[:, None][None, None], padding=(extent, 0))
    return nnf.conv2d(rows, weights[None, None, None], padding=(0, extent))[0, 0]
