"""One measurement reconstructed at one depth and at many, and one picture of them all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import FieldPsf, Measurement
from nolens.camera.measurement import bin_mean
from nolens.operators import PixelRectangle
from nolens.refocusing.depth import per_m
from nolens.solvers import Prior, Problem, Progress, Reconstructor, Result, Stop
from nolens.solvers.result import Callback

_SCALES = (1.0, 2.0, 4.0)
"""Windows, one beside the other: where the smallest sees nothing, a wider one does."""
_SURE = 0.5


@dataclass(frozen=True)
class DepthReconstructor:
    """Reconstructs one measurement as if all of the scene lay at one depth.

    By eq. 7 and ADMM (`nolens.solvers.admm`); the PSF of a depth says which.

    Parameters
    ----------
    measurement
        What the sensor measured.
    support
        Pixels that light can come from; None for no limit.
    tau
        Weight of the prior (`Problem.weight`), the same for all depths; None leaves it to be chosen
        (`weighted`).
    prior, iterations, tolerance
        As `nolens reconstruct` takes them.
    device
        Where to compute.
    mapped
        As `Reconstructor` takes it.
    """

    measurement: Measurement
    support: PixelRectangle | None = None
    tau: float | None = None
    prior: Prior = Prior.TV
    iterations: int = 100
    tolerance: float = 3e-4
    device: torch.device | str = "cpu"
    mapped: bool = False

    @property
    def sensor(self) -> tuple[int, int]:
        """(rows, columns) of the measurement."""
        return self.measurement.size

    def problem(self, psf: Tensor) -> Problem:
        """The problem for the PSF of a depth."""
        return self.at(psf).problem(self.measurement)

    def solve(
        self,
        psf: Tensor,
        callback: Callback | None = None,
        field_psf: FieldPsf | None = None,
    ) -> Result:
        """The scene as it is if all of it lies at the depth of a PSF, or of PSFs over the field."""
        return self.at(psf, field_psf).solve(self.measurement, callback=callback)

    def weighted(
        self, psf: Tensor, progress: Callable[[float], bool | None] | None = None
    ) -> "DepthReconstructor":
        """The same with its weight, chosen for the PSF of a depth where none is stated.

        A weight of its own for each depth would make pictures of other smoothness, and objectives
        that cannot be compared.

        Parameters
        ----------
        psf
            Of a depth at which the scene may lie.
        progress
            As `choose_weight` takes it.
        """
        if self.tau is not None:
            return self
        return replace(self, tau=self.at(psf).choose_weight(self.measurement, None, progress).tau)

    def at(self, psf: Tensor, field_psf: FieldPsf | None = None) -> Reconstructor:
        """What reconstructs with the PSF of a depth."""
        stop = Stop(self.iterations, self.tolerance, scene_tolerance=0.0, low_frequency=False)
        return Reconstructor(
            psf,
            self.support,
            self.tau,
            self.prior,
            stop=stop,
            device=self.device,
            field_psf=field_psf,
            mapped=self.mapped,
        )

    def coarser(self, bin_by: int, iterations: int) -> "DepthReconstructor":
        """The same with `bin_by`² pixels made one, with fewer iterations."""
        measurement, support = self.measurement, self.support
        unusable = nnf.max_pool2d((~measurement.valid).float()[None], bin_by)[0] > 0
        if support is not None:
            bottom, right = support.top + support.height, support.left + support.width
            top, left = support.top // bin_by, support.left // bin_by
            support = PixelRectangle(
                top, left, -(-bottom // bin_by) - top, -(-right // bin_by) - left
            )
        return replace(
            self,
            measurement=replace(
                measurement, values=bin_mean(measurement.values, bin_by), valid=~unusable
            ),
            support=support,
            iterations=min(iterations, self.iterations),
            tolerance=0.0,
        )


def sharpness(picture: Tensor, width: float) -> Tensor:
    r"""Energy of the gradient around every pixel (`pertuz2013`, Tenengrad).

    :math:`G_σ * (v_x^2 + v_y^2)`, the mean over channels, with a Gaussian window.

    Parameters
    ----------
    picture
        (channels, rows, columns).
    width
        σ of the window in pixels.

    Returns
    -------
    Tensor
        (rows, columns).
    """
    return _smoothed(gradient_energy(picture), width)


def gradient_energy(picture: Tensor) -> Tensor:
    """Squared length of the gradient, mean over the channels, (rows, columns)."""
    rows = nnf.pad(picture.diff(dim=-2), (0, 0, 0, 1))
    columns = nnf.pad(picture.diff(dim=-1), (0, 1))
    return (rows.square() + columns.square()).mean(dim=0)


def _smoothed(values: Tensor, width: float) -> Tensor:
    """Weighted means under a Gaussian window of σ = `width` pixels; (rows, columns)."""
    for axis in (0, 1):
        count = values.shape[axis]
        place = torch.arange(count, dtype=values.dtype, device=values.device)
        weight = torch.exp(-((place[:, None] - place) ** 2) / (2 * width * width))
        weight = weight / weight.sum(dim=1, keepdim=True)
        values = weight @ values if axis == 0 else values @ weight.T
    return values


@dataclass(frozen=True)
class FocalStack:
    """Pictures at depths.

    Parameters
    ----------
    depths_um
        The nearest first; the last may be infinite.
    pages
        Radiance, (depths, channels, rows, columns).
    objectives
        Of each page: how badly it explains the measurement (`nolens.solvers.Result`).
    """

    depths_um: tuple[float, ...]
    pages: Tensor
    objectives: tuple[float, ...]

    @property
    def places(self) -> list[float]:
        """Where the depths lie between the first (0) and the last (1), in 1/z."""
        first, span = self._range_per_m
        return [(first - per_m(each)) / span for each in self.depths_um]

    def nearest_pages(self, vergence_per_m: Tensor) -> Tensor:
        """Numbers of the pages whose depths are next to some 1/z, in 1/m."""
        depths = [per_m(each) for each in self.depths_um]
        apart = vergence_per_m[None] - vergence_per_m.new_tensor(depths)[:, None, None]
        return apart.abs().argmin(dim=0)

    @property
    def _range_per_m(self) -> tuple[float, float]:
        first, last = per_m(self.depths_um[0]), per_m(self.depths_um[-1])
        return first, first - last or 1.0


def focal_stack(
    reconstructor: DepthReconstructor,
    psf_at: Callable[[float], Tensor],
    depths_um: Sequence[float],
    step: Callable[[int, int], bool] | None = None,
    *,
    field_at: Callable[[float], FieldPsf | None] | None = None,
) -> FocalStack:
    """Reconstruct one measurement at many depths, each as if the whole scene lay there.

    Parameters
    ----------
    reconstructor
        Of the measurement.
    psf_at
        PSF of a depth in um, (channels, rows, columns).
    depths_um
        From the nearest on.
    step
        Called after every convergence check with the iterations that are done and all there
        are; True ends the work, and the stack has the depths that are done.
    field_at
        PSFs over the field of a depth, in place of that one.
    """
    pages: list[Tensor] = []
    objectives: list[float] = []
    for number, depth in enumerate(depths_um):
        ended = False

        def advance(progress: Progress, number: int = number) -> bool:
            nonlocal ended
            done = number * reconstructor.iterations + progress.iteration
            ended = step is not None and step(done, len(depths_um) * reconstructor.iterations)
            return ended

        field_psf = None if field_at is None else field_at(depth)
        result = reconstructor.solve(psf_at(depth), advance, field_psf)
        if ended and pages:
            break
        pages.append(result.photograph.cpu())
        objectives.append(result.objective)
        if ended:
            break
    return FocalStack(tuple(depths_um[: len(pages)]), torch.stack(pages), tuple(objectives))


@dataclass(frozen=True)
class AllInFocus:
    """What a focal stack shows of a scene with depth.

    Parameters
    ----------
    picture
        Radiance, (channels, rows, columns).
    per_m
        1/z of every pixel, in 1/m, (rows, columns).
    confidence
        How far the sharpest depth stands out there, from 0 (not at all) to 1.
    """

    picture: Tensor
    per_m: Tensor
    confidence: Tensor


def all_in_focus(stack: FocalStack, width: float) -> AllInFocus:
    r"""Find the sharpest depth of every pixel, and take each pixel from there.

    The sharpness is the energy of the gradient (`pertuz2013`) over the page's objective, in
    Gaussian windows of σ, 2σ and 4σ, each divided by its mean over the picture and added up: a wide
    window decides only where a narrow one sees nothing. The peak over the depths is refined by a
    parabola. The map is the mean of its surroundings, weighted by the confidence; the picture
    blends the two depths next to it.

    Parameters
    ----------
    stack
        Of two depths or more, in equal steps of 1/z.
    width
        σ of the smallest window, in pixels.
    """
    sharp = torch.stack(
        [
            _sharpness_by_scale(page, width) / max(objective, 1e-30)
            for page, objective in zip(stack.pages, stack.objectives, strict=True)
        ]
    )
    typical = sharp.mean(dim=(0, 2, 3), keepdim=True).clamp_min(1e-30)
    focus = (sharp / typical).mean(dim=1)
    best = focus.argmax(dim=0)
    peak = _between(focus, best)
    top, floor = focus.amax(dim=0), focus.median(dim=0).values
    prominence = (top - floor) / top.clamp_min(1e-30)
    lit = top / (top + _SURE * top.median()).clamp_min(1e-30)
    confidence = (prominence * lit).clamp(0, 1)
    weight = confidence.square() + 1e-6
    place = _smoothed(peak * weight, width) / _smoothed(weight, width)
    return AllInFocus(_blended(stack.pages, place), _vergence(stack, place), confidence)


def _sharpness_by_scale(page: Tensor, width: float) -> Tensor:
    """Energy of the gradient in windows of all sizes, (sizes, rows, columns)."""
    narrow = sharpness(page, width * _SCALES[0])
    coarser = [
        _smoothed(narrow, width * (scale**2 - _SCALES[0] ** 2) ** 0.5) for scale in _SCALES[1:]
    ]
    return torch.stack([narrow, *coarser])


def _between(focus: Tensor, best: Tensor) -> Tensor:
    """Number of the sharpest depth, with the part between two by a parabola."""
    last = len(focus) - 1
    inner = best.clamp(1, max(1, last - 1))
    if last < 2:
        return best.to(focus.dtype)
    before, top, after = (focus.gather(0, (inner + step)[None])[0] for step in (-1, 0, 1))
    curve = before - 2 * top + after
    offset = torch.where(curve < 0, (before - after) / (2 * curve).clamp_max(-1e-30), 0.0)
    return torch.where(best == inner, inner + offset.clamp(-0.5, 0.5), best.to(focus.dtype))


def _vergence(stack: FocalStack, place: Tensor) -> Tensor:
    """1/z between the depths."""
    known = torch.tensor([per_m(depth) for depth in stack.depths_um], dtype=place.dtype)
    lower = place.floor().long().clamp(0, len(known) - 1)
    upper = (lower + 1).clamp_max(len(known) - 1)
    fraction = place - lower
    return (1 - fraction) * known[lower] + fraction * known[upper]


def _blended(pages: Tensor, place: Tensor) -> Tensor:
    """Every pixel from the two depths next to its own."""
    picture = torch.zeros_like(pages[0])
    for number, page in enumerate(pages):
        picture += page * (1 - (place - number).abs()).clamp_min(0)
    return picture
