"""The PSF that explains measurements of known scenes best, within a given support."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from nolens.calibrate.many_scenes import ManyScenesAslant
from nolens.calibrate.pairs_model import KnownScenes
from nolens.calibrate.pairs_weights import Weights
from nolens.errors import DataError
from nolens.kernels import irfft2, rfft2
from nolens.operators import FiniteDifference

TAU = 8e-5
"""Weight of the total variation: of the largest gradient of the misfit at p = 0, for each cell
that the support would be wide as a square. So the same pattern on finer cells comes out the same.
"""
_PENALTY = 3.0
_INNER = 3
_BETWEEN_GAINS = 4


class PsfSolver:
    r"""Minimise ½ Σ_k ‖b_k − g_k C Σ_j p_j * φ_j x_k‖²_W + τ Σ_j TV(p_j), p₀ ≥ 0.

    All measurements b_k have the PSFs p_j in common, and each a gain g_k of its own, as exposures
    differ; the mean gain is 1. `ManyScenesAslant` is the model, W `Weights`. Without the isotropic
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
        φ, (terms, rows, columns) of a scene; the first is 1.
    support
        1 where the PSF may have light, 0 elsewhere, (rows, columns) of the PSF.
    tau
        Weight of the total variation, as `TAU`.
    """

    def __init__(
        self, known: KnownScenes, terms: Tensor, support: Tensor, tau: float = TAU
    ) -> None:  # fmt: skip
        self._support = support
        size = (support.shape[0], support.shape[1])
        light = known.measured.mean(dim=(-2, -1), keepdim=True)
        shown = known.scenes.mean(dim=(-2, -1), keepdim=True)
        self._scale = light / shown
        self._data = known.measured / light
        self._model = ManyScenesAslant(
            known.scenes / shown, known.region, known.sensor, size, terms
        )
        self._weights = Weights.of(self._data, known.valid)
        self._difference = FiniteDifference(size)
        self._steepness = self._spectrum_of_differences()
        self.gains = torch.ones_like(light)
        wide = math.sqrt(float(support.sum()))
        self._tau = tau * wide * float(self._back(self._data)[0].abs().max())

    def solve(
        self, steps: int, *, start: Tensor | None = None,
        tick: Callable[[float], None] | None = None,
    ) -> Tensor:  # fmt: skip
        """Do so many steps of ADMM.

        Parameters
        ----------
        steps
            How many.
        start
            p₀ to start from, (rows, columns); zero without one.
        tick
            Called with the share that is done.

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
                seen = self._back(self._data)
            pull = light - light_dual + self._difference.adjoint(edges - edges_dual)
            p = self._conjugate(p, seen + rho * self._support * pull, rho, spectrum)
            light = p + light_dual
            light[0].clamp_min_(0)
            light_dual = light_dual + p - light
            steep = self._difference(p) + edges_dual
            length = torch.linalg.vector_norm(steep, dim=-3, keepdim=True).clamp_min(1e-30)
            edges = steep * (1 - self._tau / rho / length).clamp_min(0)
            edges_dual = steep - edges
            if tick is not None:
                tick((step + 1) / steps)
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
                "no PSF explains these measurements: their pictures are not what the camera saw, "
                "or lie elsewhere in its frame"
            )
        self.gains = (gains / mean).clamp_min(0)
        return mean

    def misfit(self, psfs: Tensor) -> Tensor:
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
        period = self._model.geometry.period
        power = self._model.spectra.abs().square() * self._weights.on_period(period)
        return (self.gains.square() * power).sum(dim=1)

    def _spectrum_of_differences(self) -> Tensor:
        period = self._model.geometry.period
        point = torch.zeros(period)
        point[0, 0] = 1
        spectrum: Tensor = rfft2(FiniteDifference(period)(point)).abs().square().sum(dim=0)
        return spectrum

    def _conjugate(self, p: Tensor, aim: Tensor, rho: float, spectrum: Tensor) -> Tensor:
        """A few steps towards the PSFs whose normal equation has this right side."""
        residual = aim - self._normal(p, rho)
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
        period = irfft2(rfft2(self._model.embed(residual)) / spectrum, geometry.period)
        top, left, height, width = geometry.scene
        return self._support * period[..., top : top + height, left : left + width]


def _dot(one: Tensor, other: Tensor) -> float:
    return float((one.double() * other).sum())
