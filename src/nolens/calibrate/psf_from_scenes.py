"""The PSF that explains measurements of known scenes best."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
import torch.nn.functional as nnf
from scipy import ndimage
from torch import Tensor

from nolens.calibrate.many_scenes import ManyScenesAslant
from nolens.errors import DataError
from nolens.kernels import irfft2, rfft2
from nolens.operators import FiniteDifference, Region

_MODEL_ERROR = 0.1
_FADED = 8
_BANDS = 24
_NOISE_FROM = 0.45
TAU = 8e-5
"""Weight of the total variation: of the largest gradient of the residual at p = 0, for each pixel
that the support would be wide as a square. So the same PSF on finer pixels comes out the same.
"""
_PENALTY = 3.0
_INNER = 3
_BETWEEN_GAINS = 4
STEPS = 24
_COARSE = 64
_COARSE_STEPS = 16
_COARSE_SHARE = 0.2
_ROUNDS = 3
_BLUR = 16
_FAINT = 0.2
_SMALL = 0.05
_HALF = 0.5
_BYTES_PER_CELL = 150
Tick = Callable[[float], None]


@dataclass(frozen=True)
class KnownScenes:
    """Measurements of scenes that are known; each channel of each pair is one of them.

    Attributes
    ----------
    scenes
        Radiance on the scene's pixels, (measurements, rows, columns), not negative.
    measured
        Linear values with 0 for no light, (measurements, rows, columns) of the sensor.
    valid
        bool, like `measured`: False where a pixel is saturated.
    region
        Where the scenes' pixels lie in the sensor's frame.
    """

    scenes: Tensor
    measured: Tensor
    valid: Tensor
    region: Region

    @classmethod
    def of(
        cls,
        scenes: Sequence[Tensor],
        measured: Sequence[Tensor],
        valid: Sequence[Tensor] | None = None,
        region: Region | None = None,
    ) -> Self:
        """Put pairs together, each of one or more channels.

        Parameters
        ----------
        scenes, measured, valid
            (channels, rows, columns) of each pair; without `valid` every pixel is.
        region
            None for scenes in the middle of the sensor's frame.

        Raises
        ------
        DataError
            If there is none, sizes do not fit together, or one shows nothing.
        """
        if not scenes or len(scenes) != len(measured):
            raise DataError(
                f"{len(scenes)} scenes and {len(measured)} measurements: give one of each, or more"
            )
        if valid is None:
            valid = [torch.ones_like(each, dtype=torch.bool) for each in measured]
        for name, given in (("scene", scenes), ("measurement", measured)):
            sizes = {tuple(each.shape[-2:]) for each in given}
            if len(sizes) > 1:
                raise DataError(f"the sizes of the {name}s differ: {sorted(sizes)}")
        for one, other in zip(scenes, measured, strict=True):
            if one.shape[0] != other.shape[0]:
                raise DataError(
                    f"a scene has {one.shape[0]} channels and its measurement {other.shape[0]}"
                )
        rows, columns = scenes[0].shape[-2:]
        sensor = (measured[0].shape[-2], measured[0].shape[-1])
        if region is None:
            region = Region.centred(rows, columns, sensor)
        if (region.height, region.width) != (rows, columns):
            raise DataError(
                f"the support has {region.height}×{region.width} pixels and the scenes "
                f"{rows}×{columns}"
            )
        found = cls(
            torch.cat([each.float() for each in scenes]),
            torch.cat([each.float() for each in measured]),
            torch.cat(list(valid)),
            region,
        )
        found._check_light()
        return found

    @property
    def sensor(self) -> tuple[int, int]:
        """(rows, columns) of the measurements."""
        return self.measured.shape[-2], self.measured.shape[-1]

    @property
    def reach(self) -> tuple[int, int]:
        """(rows, columns) of the PSF that light from every scene pixel to every pixel needs."""
        rows, columns = self.sensor
        return rows + self.region.height, columns + self.region.width

    def binned(self, by: int) -> Self:
        """The same on pixels binned by × by; what does not fill one is dropped at the far edges."""
        if by == 1:
            return self
        # Scene cells are binned from the sensor's first cell, so that both grids stay together.
        top, left = self.region.top, self.region.left
        skipped = -top % by, -left % by
        scenes = self.scenes[:, skipped[0] :, skipped[1] :]
        dark = nnf.max_pool2d((~self.valid).float()[None], by)[0] > 0
        scenes = nnf.avg_pool2d(scenes[None], by)[0]
        region = Region(
            (top + skipped[0]) // by, (left + skipped[1]) // by, scenes.shape[-2], scenes.shape[-1]
        )
        return replace(
            self,
            scenes=scenes,
            measured=nnf.avg_pool2d(self.measured[None], by)[0],
            valid=~dark,
            region=region,
        )

    def _check_light(self) -> None:
        for name, given in (("scene", self.scenes), ("measurement", self.measured)):
            if not bool(torch.isfinite(given).all()):
                raise DataError(f"a {name} holds NaN or infinity; give finite values")
            if not bool((given.double().mean(dim=(-2, -1)) > 0).all()):
                raise DataError(f"a {name} is dark: nothing can be learnt from it")
            if not bool((given.double().std(dim=(-2, -1)) > 0).all()):
                raise DataError(f"a {name} is the same everywhere: nothing can be learnt from it")


def over_the_field(known: KnownScenes) -> Tensor:
    """1, and how a PSF changes over a scene: φ of `ManyScenesAslant`, (4, rows, columns).

    With u and v the place along rows and columns, from −1 to 1 along the longer side: 1, u, v and
    u² + v², the field dependence of a camera's aberrations to second order (`welford1986`). All
    but the first are 0 in the mean over the scenes' light, so that its PSF is the mean one.
    """
    rows, columns = known.scenes.shape[-2:]
    half = max(rows, columns) / 2
    u = ((torch.arange(rows) + 0.5 - rows / 2) / half)[:, None].expand(rows, columns)
    v = ((torch.arange(columns) + 0.5 - columns / 2) / half)[None].expand(rows, columns)
    light = (known.scenes / known.scenes.mean(dim=(-2, -1), keepdim=True)).mean(dim=0)
    changing = torch.stack([u, v, u.square() + v.square()])
    changing -= (changing * light).mean(dim=(-2, -1), keepdim=True) / light.mean()
    return torch.cat([torch.ones(1, rows, columns), changing])


@dataclass(frozen=True)
class Weights:
    r"""Inverse covariance of what a measurement is off: W = T F* (1/P) F T.

    Noise is white; what the model leaves out (light that comes aslant, misregistration, light from
    beside the picture) is not: it is a small fraction of the light where there is much, at low
    spatial frequencies, and a large one where there is little. So P(f) = N + ε √(S(f) S₀), with
    the power S of the measurements by spatial frequency, S₀ its largest, the noise N at the
    highest frequencies, and ε a tenth: generalised least squares (`aitken1936`). Without it, ten
    low frequencies outweigh all of the PSF. T fades out towards the sensor's edges and is zero
    where a pixel is saturated.

    Attributes
    ----------
    taper
        T, (measurements, rows, columns).
    frequencies
        Mean of each band, in cycles per pixel.
    expected
        P, (measurements, bands).
    spectrum
        1/P on the half spectrum of the sensor, (measurements, rows, columns // 2 + 1).
    """

    taper: Tensor
    frequencies: Tensor
    expected: Tensor
    spectrum: Tensor

    @classmethod
    def of(cls, measured: Tensor, valid: Tensor) -> Self:
        """Find them of measurements of the same mean, (measurements, rows, columns)."""
        rows, columns = measured.shape[-2:]
        taper = torch.outer(_faded(rows), _faded(columns)) * valid
        frequency = _frequency(rows, columns)
        edges = torch.logspace(math.log10(0.75 / min(rows, columns)), math.log10(0.75), _BANDS)
        band = torch.bucketize(frequency, edges).flatten()
        filled = torch.bincount(band) > 0
        bands = (filled.cumsum(0) - 1)[band]
        count = torch.bincount(bands)
        middle = torch.bincount(bands, frequency.flatten()) / count
        spectrum = rfft2(measured * taper).abs().square()
        spectrum /= taper.square().sum(dim=(-2, -1), keepdim=True)
        power = torch.stack([torch.bincount(bands, each.flatten()) / count for each in spectrum])
        noise = power[:, middle >= _NOISE_FROM].amin(dim=1, keepdim=True)
        mean = power.mean(dim=0)
        expected = noise + _MODEL_ERROR * (mean * mean.max()).sqrt()
        return cls(taper, middle, expected, _spread(1 / expected, middle, frequency))

    def __call__(self, values: Tensor) -> Tensor:
        """Apply W to (measurements, rows, columns)."""
        spectrum = rfft2(values * self.taper) * self.spectrum
        return self.taper * irfft2(spectrum, (values.shape[-2], values.shape[-1]))

    def product(self, one: Tensor, other: Tensor) -> Tensor:
        """⟨one, W other⟩ of each measurement, (measurements, 1, 1), float64."""
        return (one.double() * self(other)).sum(dim=(-2, -1), keepdim=True)

    def on_period(self, period: tuple[int, int]) -> Tensor:
        """T² F* (1/P) F in the mean, on the half spectrum of a period that holds the sensor."""
        share = self.taper.square().sum(dim=(-2, -1), keepdim=True) / (period[0] * period[1])
        return share * _spread(1 / self.expected, self.frequencies, _frequency(*period))


def _faded(length: int) -> Tensor:
    """1, but for both ends, which rise as sin² over an eighth of the length."""
    edge = max(1, length // _FADED)
    rise = torch.sin((torch.arange(edge) + 0.5) / edge * (math.pi / 2)).square()
    return torch.cat([rise, torch.ones(length - 2 * edge), rise.flip(0)])


def _frequency(rows: int, columns: int) -> Tensor:
    """Cycles to the cell, on a half spectrum."""
    return torch.hypot(torch.fft.fftfreq(rows)[:, None], torch.fft.rfftfreq(columns)[None])


def _spread(values: Tensor, at: Tensor, frequency: Tensor) -> Tensor:
    """Values of bands at any frequency: straight lines between their logarithms."""
    least = float(at[at > 0].min()) / 2
    wanted, known = (np.log(each.clamp_min(least).numpy()) for each in (frequency, at))
    planes = [np.exp(np.interp(wanted, known, np.log(each.numpy()))) for each in values]
    return torch.from_numpy(np.stack(planes)).to(values.dtype)


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
    ) -> None:
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
        self,
        steps: int,
        *,
        start: Tensor | None = None,
        tick: Callable[[float], None] | None = None,
    ) -> Tensor:
        """Do so many steps of ADMM.

        Parameters
        ----------
        steps
            How many.
        start
            p₀ to start from, (rows, columns); zero without one.
        tick
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
    misfit
        Of each measurement, ‖b − gain C(psf * scene)‖ over ‖b‖, weighted as `Weights` says.
    misfit_varying
        The same with the changes of the PSF over the scene that were solved with it.
    support
        bool, (rows, columns): where the PSF was found to have light.
    """

    psf: Tensor
    gains: Tensor
    misfit: Tensor
    misfit_varying: Tensor
    support: Tensor


def psf_from_scenes(
    known: KnownScenes,
    *,
    support: Tensor | None = None,
    tau: float = TAU,
    steps: int = STEPS,
    tick: Tick | None = None,
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
        large as `known.reach`.
    tau
        Weight of the total variation, as `nolens.calibrate.psf_from_scenes.TAU`.
    steps
        Of ADMM, on all pixels.
    tick
        Called with the fraction that is done.

    Raises
    ------
    DataError
        If no PSF explains the measurements.
    """
    start = None
    if support is None:
        support, start = _found_support(known, tau, tick)
    rows, columns = _around(support)
    inner = slice(*rows), slice(*columns)
    within = support[inner].float()
    solver = PsfSolver(known, over_the_field(known), within, tau)
    found = solver.solve(
        steps,
        start=None if start is None else start[inner],
        tick=None if tick is None else lambda share: tick(_COARSE_SHARE + 0.8 * share),
    )
    varying = solver.misfit(found)
    alone = PsfSolver(known, torch.ones_like(known.scenes[:1]), within)
    found = found[:1] * alone.fit_gains(found[:1])
    misfit = alone.misfit(found)
    found, gains = alone.unscaled(found)
    psf = found.new_zeros(support.shape)
    psf[inner] = found[0]
    return SolvedPsf(psf, gains, misfit, varying, support)


def psf_from_scenes_bytes(reach: tuple[int, int], measurements: int) -> float:
    """Most memory that `psf_from_scenes` holds at once.

    Parameters
    ----------
    reach
        (rows, columns) of sensor and scene together, as `KnownScenes.reach`.
    measurements
        Each channel of each pair.
    """
    return math.prod(reach) * measurements * _BYTES_PER_CELL


def unexplained(known: KnownScenes, psf: Tensor) -> Tensor:
    """Residual of each measurement as `SolvedPsf` has it, for a PSF that was not solved from them.

    Parameters
    ----------
    known
        Scenes and measurements.
    psf
        (rows, columns); each measurement has its own gain.
    """
    solver = PsfSolver(known, torch.ones_like(known.scenes[:1]), torch.ones_like(psf))
    return solver.misfit(psf[None] * solver.fit_gains(psf[None]))


def _found_support(known: KnownScenes, tau: float, tick: Tick | None) -> tuple[Tensor, Tensor]:
    """Where the PSF has light, and roughly how much, on the cells of the scenes."""
    by = max(1, min(known.sensor) // _COARSE)
    coarse = known.binned(by)
    support, psf = torch.ones(coarse.reach), None
    for number in range(_ROUNDS):
        solver = PsfSolver(coarse, torch.ones_like(coarse.scenes[:1]), support, tau)
        psf = solver.solve(_COARSE_STEPS, start=psf)[0]
        support = _lit(psf, min(coarse.sensor) / _BLUR)
        psf = psf * support
        if tick is not None:
            tick(_COARSE_SHARE * (number + 1) / _ROUNDS)
    assert psf is not None
    fine = [_refined(each, by, known.reach) for each in (support, psf)]
    if not bool((fine[0] >= _HALF).any()):
        raise DataError("no PSF explains these measurements: check that each has its own picture")
    return fine[0] >= _HALF, fine[1]


def _lit(psf: Tensor, sigma: float) -> Tensor:
    """1 where its local mean is not faint, but for patches that have little light; else 0."""
    local = _blurred(psf, sigma)
    patches, count = ndimage.label((local > _FAINT * local.max()).numpy())
    light = ndimage.sum_labels(psf.numpy(), patches, range(1, count + 1))
    kept = [number + 1 for number in range(count) if light[number] > _SMALL * light.max()]
    return torch.from_numpy(np.isin(patches, kept)).to(psf.dtype)


def _refined(coarse: Tensor, by: int, size: tuple[int, int]) -> Tensor:
    """Between coarse cells on straight lines; a shift of one of them is `by` cells."""
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
        reach = max(middle - int(lit[0]), int(lit[-1]) - middle)
        spans.append((middle - reach, min(support.shape[1 - axis], middle + reach + 1)))
    return spans[0], spans[1]


def _blurred(plane: Tensor, sigma: float) -> Tensor:
    """Local mean: convolved with a Gaussian, with nothing beyond the edges."""
    reach = max(1, round(3 * sigma))
    offsets = torch.arange(-reach, reach + 1, dtype=torch.float32)
    weights = torch.exp(-0.5 * (offsets / sigma).square())
    weights /= weights.sum()
    rows = nnf.conv2d(plane[None, None], weights[:, None][None, None], padding=(reach, 0))
    return nnf.conv2d(rows, weights[None, None, None], padding=(0, reach))[0, 0]
