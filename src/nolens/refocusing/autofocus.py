"""The depth at which a scene, or a place in it, is sharpest, and the picture of a depth."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from nolens.camera.measurement import bin_mean
from nolens.refocusing.depth import depth_mm, depth_um, line_pixels, per_m
from nolens.refocusing.focal_stack import DepthReconstructor, gradient_energy, sharpness
from nolens.refocusing.psf_between import DepthPsfs
from nolens.solvers import Progress, Result

Step = Callable[[int, int], bool]
"""Sees how many iterations are done, of how many; True ends the search."""

_ITERATIONS = 60
_LEAST_STEPS = 4
_FINE = 0.05
"""Fraction of the depth of focus to which the depth is refined."""
_GOLDEN = (math.sqrt(5) - 1) / 2
_LINES, _FRACTION = 3.0, 1 / 16
"""The window around a place: so many lines wide, and this much of the picture's shorter side."""


@dataclass(frozen=True)
class _AutofocusTrial:
    """A depth that was tried; it may be infinite.

    The objective ½‖b − CMv‖² + τ R(v) of the reconstruction, in normalised units, says how badly it
    explains the measurement; the sharpness is the energy of the gradient around the place, or of
    the whole picture.
    """

    depth_um: float
    objective: float
    sharpness: float


@dataclass(frozen=True)
class AutofocusResult:
    """Where a scene is sharpest.

    Parameters
    ----------
    depth_um
        May be infinite.
    tried
        All depths that were tried, the nearest first.
    at_end
        Whether it is the first or last depth that was allowed: the true one may lie beyond.
    finished
        False where the search was ended before.
    """

    depth_um: float
    tried: tuple[_AutofocusTrial, ...]
    at_end: bool
    finished: bool

    @property
    def warnings(self) -> list[str]:
        """About a depth at the end of those that were allowed."""
        if not (self.finished and self.at_end and math.isfinite(self.depth_um)):
            return []
        return [
            f"the best depth lies at the end of the search, "
            f"{depth_mm(self.depth_um)} mm: the true one may lie beyond (--search)"
        ]


@dataclass(frozen=True)
class Autofocus:
    """Search for the sharpest depth.

    Depths one depth of focus apart come first. Of these the best is the one whose PSF explains the
    measurement best, by the objective of the reconstruction, which noise does not mislead; or, at a
    place, the one that is sharpest there for what it leaves unexplained, as edges come of that,
    too. Between its neighbours golden sections follow the sharpness, of the whole picture over the
    objective. All on pixels as coarse as the PSF's lines allow.

    Parameters
    ----------
    reconstructor
        Of the measurement.
    psf_at
        PSF of a depth in um, (channels, rows, columns).
    near_um, far_um
        Depths between which it lies; the far one may be infinite.
    depth_of_focus_per_m
        See `nolens.refocusing.depth_of_focus_per_m`.
    """

    reconstructor: DepthReconstructor
    psf_at: Callable[[float], Tensor]
    near_um: float
    far_um: float
    depth_of_focus_per_m: float

    @property
    def _coarse(self) -> int:
        """Depths that are tried first."""
        span = per_m(self.near_um) - per_m(self.far_um)
        return max(_LEAST_STEPS, math.ceil(span / self.depth_of_focus_per_m)) + 1

    @property
    def _step_per_m(self) -> float:
        """From one of them to the next."""
        return (per_m(self.near_um) - per_m(self.far_um)) / (self._coarse - 1)

    @property
    def _fine(self) -> int:
        """Depths that are tried then, at most."""
        fraction = _FINE * self.depth_of_focus_per_m / (2 * self._step_per_m)
        return 1 + max(1, math.ceil(math.log(min(fraction, 0.5)) / math.log(_GOLDEN)))

    @property
    def iterations(self) -> int:
        """Of all depths, at most."""
        return (self._coarse + self._fine) * min(_ITERATIONS, self.reconstructor.iterations)

    def run(
        self, place: tuple[float, float] | None = None, step: Step | None = None
    ) -> AutofocusResult:
        """Find the sharpest depth.

        Parameters
        ----------
        place
            Row and column in the picture (`Result.photograph`); None for all of it.
        step
            Called after every convergence check.
        """
        trials = _Trials(self, place, step)
        low, high = per_m(self.far_um), per_m(self.near_um)
        first = [low + number * self._step_per_m for number in range(self._coarse)]
        first[-1] = high
        finished = all(trials.add(each) for each in first)
        best = trials.best_coarse()
        if finished:
            best, finished = self._refined(trials, best)
        at_end = min(best - low, high - best) <= 2 * _FINE * self.depth_of_focus_per_m
        nearest_first = sorted(trials.tried.values(), key=lambda each: each.depth_um)
        depth = trials.tried[best].depth_um
        return AutofocusResult(depth, tuple(nearest_first), at_end, finished)

    def _refined(self, trials: "_Trials", best: float) -> tuple[float, bool]:
        """Golden sections between the neighbours of a depth; False if they were ended."""
        ends = per_m(self.far_um), per_m(self.near_um)
        low, high = max(ends[0], best - self._step_per_m), min(ends[1], best + self._step_per_m)
        bounds = low, high
        inner = [high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)]
        if not all(trials.add(each) for each in inner):
            return best, False
        finished = True
        for _ in range(self._fine - 2):
            if trials.focus(inner[0]) > trials.focus(inner[1]):
                high, inner = inner[1], [inner[1] - _GOLDEN * (inner[1] - low), inner[0]]
                new = inner[0]
            else:
                low, inner = inner[0], [inner[1], inner[0] + _GOLDEN * (high - inner[0])]
                new = inner[1]
            if not trials.add(new):
                finished = False
                break
        within = [each for each in trials.tried if bounds[0] <= each <= bounds[1]]
        peak = max(within, key=trials.focus)
        edge = 2 * _FINE * self.depth_of_focus_per_m
        # Where it only rises towards a neighbour that is worse, it is noise that rises.
        inside = [abs(peak - end) > edge or end in ends for end in bounds]
        return (peak if all(inside) else best), finished


@dataclass(frozen=True)
class Focused:
    """A measurement focused at one depth.

    Parameters
    ----------
    result
        The reconstruction.
    depth_um
        Depth that is in focus; may be infinite.
    sharp_um
        Nearest and farthest depth within the depth of focus.
    search
        How the depth was found; None where it was stated.
    finished
        Whether the search, if there was one, and the picture came to their end.
    """

    result: Result
    depth_um: float
    sharp_um: tuple[float, float]
    search: AutofocusResult | None
    finished: bool

    def figures(self) -> dict[str, Any]:
        """Depth, what is sharp around it, and the depths that were tried."""
        near, far = self.sharp_um
        figures: dict[str, Any] = {
            "depth_mm": depth_mm(self.depth_um),
            "sharp_from_mm": depth_mm(near),
            "sharp_to_mm": depth_mm(far),
        }
        if self.search is not None:
            figures["tried"] = [
                {
                    "depth_mm": depth_mm(each.depth_um),
                    "objective": each.objective,
                    "sharpness": each.sharpness,
                }
                for each in self.search.tried
            ]
        return figures


def focus(
    reconstructor: DepthReconstructor,
    psfs: DepthPsfs,
    depth: float | tuple[float, float],
    place: tuple[float, float] | None = None,
    *,
    search_step: Step | None = None,
    step: Step | None = None,
) -> Focused:
    """Reconstruct a measurement at a depth, or at the sharpest one.

    Parameters
    ----------
    reconstructor
        Of the measurement.
    psfs
        For the depths of the measurement.
    depth
        In um, may be infinite; or two between which the sharpest is sought (`Autofocus`).
    place
        Row and column of the picture that is to be sharp; None for all of it.
    search_step
        Called after every convergence check of the search; True ends it, and the picture at the
        best depth so far follows.
    step
        Called after every convergence check of the picture; True ends it.
    """
    search = None
    if isinstance(depth, tuple):
        autofocus = Autofocus(reconstructor, psfs.at, *depth, psfs.depth_of_focus_per_m)
        search = autofocus.run(place, search_step)
        depth = search.depth_um

    finished = search is None or search.finished

    def advance(progress: Progress) -> bool:
        nonlocal finished
        ended = step is not None and step(progress.iteration, reconstructor.iterations)
        # After a search that was ended, the picture at its depth is still to be made.
        ended = ended and finished
        finished = finished and not ended
        return ended

    result = reconstructor.solve(psfs.at(depth), advance, psfs.field_at(depth))
    half = psfs.depth_of_focus_per_m / 2
    sharp = depth_um(per_m(depth) + half), depth_um(max(0, per_m(depth) - half))
    return Focused(result, depth, sharp, search, finished)


class _Trials:
    """Depths that have been tried so far."""

    def __init__(
        self, search: Autofocus, place: tuple[float, float] | None, step: Step | None
    ) -> None:
        # Two binned pixels are still less than a line.
        self.bin_by = max(1, int(line_pixels(search.psf_at(search.far_um)) / 2))
        self.search = search
        self.reconstructor = search.reconstructor.coarser(self.bin_by, _ITERATIONS)
        self.place, self.step = place, step
        self.tried: dict[float, _AutofocusTrial] = {}
        self.done = 0

    def add(self, vergence_per_m: float) -> bool:
        """Try a depth; False if the search is to end."""
        depth = depth_um(vergence_per_m)
        psf = bin_mean(self.search.psf_at(depth), self.bin_by)
        ended = False

        def advance(progress: Progress) -> bool:
            nonlocal ended
            done = self.done + progress.iteration
            ended = self.step is not None and self.step(done, self.search.iterations)
            return ended

        result = self.reconstructor.solve(psf, advance)
        if ended and self.tried:
            return False
        self.done += self.reconstructor.iterations
        picture = result.photograph
        rows, columns = picture.shape[-2:]
        if self.place is None:
            sharp = float(gradient_energy(picture).mean())
        else:
            width = max(_LINES * line_pixels(psf), _FRACTION * min(rows, columns))
            row, column = (
                min(int(at / self.bin_by), count - 1)
                for at, count in zip(self.place, (rows, columns), strict=True)
            )
            sharp = float(sharpness(picture, width)[row, column])
        self.tried[vergence_per_m] = _AutofocusTrial(depth, result.objective, sharp)
        return not ended

    def best_coarse(self) -> float:
        """The best 1/z of all depths so far: see `Autofocus`."""
        if self.place is None:
            return min(self.tried, key=lambda each: self.tried[each].objective)
        # Edges that come of what is not explained have energy in proportion to it.
        tried = self.tried.items()
        return max(tried, key=lambda each: each[1].sharpness / each[1].objective)[0]

    def focus(self, vergence_per_m: float) -> float:
        """How sharp a depth is that was tried: see `Autofocus`."""
        tried = self.tried[vergence_per_m]
        # At a place the objective would follow what is brighter elsewhere.
        return tried.sharpness / (tried.objective if self.place is None else 1.0)
