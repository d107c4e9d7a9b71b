r"""The support of a scene, by where a measurement asks for light.

A first scene without a limit has its detail where the light comes from, and a smooth glow around.
The rectangle that holds the detail is the limit of a second fit, whose scene has less glow, and so
on until the rectangle stays. What is left of the measurement, :math:`r`, is correlated with the PSF
at every pixel outside. With :math:`a_s` what a light at pixel s puts on the sensor, and white noise
of standard deviation σ,

.. math:: z_s = \frac{\langle a_s, r \rangle}{\sigma \|a_s\|}

is the light's signal-to-noise ratio (matched filter, `turin1960`): a normal number where no light
comes from. The rectangle grows to where it is far from that, until it is so nowhere. Then its sides
move inwards for as long as pixels that are left out of the fit are predicted better. Last,
photographs of the rectangle, and of more around it, show where the scene ends
(`nolens.solvers.scene_edges`).

Residual and PSF are taken without their local means, as in `nolens.solvers.held_out`: the glow of a
scene is what a few iterations are late with, and says little of where the light comes from.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import itemgetter

import torch
import torch.nn.functional as nnf
from scipy import ndimage
from torch import Tensor

from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers.held_out import PartialFit, box_mean, channel_noise, fit_partially, local_mean
from nolens.solvers.problem import Problem
from nolens.solvers.scene_edges import NO_EDGES, Edges, at_edges, centred_edges, scene_edges

_DETAIL = (0.04, 0.1, 0.25, 0.5)
"""Of the scene's detail where there is most, from which on light comes from there: as little as can
be told from what the glow has, which varies."""
_MOST_DETAIL = 0.995
"""Quantile that is the most."""
_APART = 0.04
"""Of the frame's shorter side, twice which lies between parts of a scene that are apart."""
_SPARSE = 0.4
"""Fraction of the largest that it is at least, where there is light on fewer pixels."""
_DETAIL_SIDE = 7
"""Pixels along the squares in which detail is summed."""
_STAYS = 0.9
"""Fraction of a rectangle that the next one holds at least, where it is the last."""
_SURE = 4.0
"""Standard errors by which the smaller rectangle predicts better than the larger."""
_LIKELY = 2.0
"""The same where it is likely that it does."""
_ALIKE, _PEAK = 0.2, 10
"""Autocorrelation of a PSF from which on its mask repeats itself, and pixels each way around no
shift, where it is that of the PSF's lines."""
_CLEAR = 5.5
"""Signal-to-noise ratio of light beside the rectangle; of 10⁵ normal numbers the largest is 4.3."""
_CLEAR_AFAR = 8.0
"""The same of light far from it: what a PSF leaves unexplained has longer tails."""
_SIDES = (1, 5)
"""Pixels along the squares of light that are looked for."""
_STRONG = 0.3
"""Fraction of the clearest signal from which on others count: side lobes are weaker."""
_GROWTH = 0.25
"""Of the rectangle's sides, by which it grows at most at once, to either side."""
_GROWTH_AT_LEAST = 4
_SEEN = 0.05
"""Of the most that a pixel's light puts on the sensor, below which it is not looked for."""
_ALL_SIDES = "tblr"
"""Top, bottom, left and right."""
_TIGHTENING = ((4, (_ALL_SIDES,)), (4, tuple(_ALL_SIDES)), (1, tuple(_ALL_SIDES)))
"""Pixels by which sides move inwards, and sides that move together."""
_SURELY_TIGHTER = 3.0
"""Standard errors by which the prediction is then better, or worse by a pixel less or centred."""
_BURIED = 0.2
"""Fraction of the contrast that is noise, above which sides get a margin instead."""
_DROWNED = 0.8
"""The same, above which a photograph of all that the PSF covers is the only one that tells."""
_NOISE = 0.98
"""The same, above which nothing tells that there is a scene."""
_MARGIN, _MARGIN_AT_LEAST = 0.02, 2
"""Of the rectangle's sides, added on either side, and in pixels."""
_AROUND = (0.0, 0.15, 0.3)
"""Of the rectangle's sides, around it that photographs show, one after the other; a pixel at
least."""
_WIDE = 0.5
"""The same, where the scene may be larger: a photograph of too little shows edges in it."""
_MOST = 0.5
"""Fraction of the pixels that can be seen from which on a support is none."""
_ITERATIONS, _ITERATIONS_TO_COMPARE = 28, 112
"""Of ADMM in a fit; more where the rectangle is not as good as no limit after the first."""
_STEPS_AT_MOST = 28


Photograph = Callable[[PixelRectangle], Tensor | None]
"""The scene in a support, by a fit that has converged; None where the caller stopped that."""


@dataclass(frozen=True)
class SupportStep:
    """A rectangle that was tried.

    Parameters
    ----------
    support
        In pixels of the sensor's frame.
    signal
        Signal-to-noise ratio of the clearest light outside.
    excess
        By how much more of the contrast of held-out pixels is unexplained than without a limit.
    error
        Standard error of that.
    """

    support: PixelRectangle
    signal: float
    excess: float
    error: float

    def row(self) -> dict[str, object]:
        """A row of the run's record."""
        return {
            "support": self.support.text,
            "light_outside": self.signal,
            "excess": self.excess,
            "standard_error": self.error,
        }


@dataclass(frozen=True)
class SupportChoice:
    """Pixels that light comes from.

    Parameters
    ----------
    support
        None where it comes from everywhere, or from no one can say where.
    edges
        Where photographs show that the scene ends.
    steps
        Rectangles that were tried, one after the other.
    interrupted
        Whether the caller stopped it.
    """

    support: PixelRectangle | None
    edges: Edges = NO_EDGES
    steps: tuple[SupportStep, ...] = ()
    interrupted: bool = False

    def finer(self, by: int) -> "SupportChoice":
        """Where by×by pixels stand for each of these, with its sides at the edges."""
        support = self.support
        if support is not None:
            support = at_edges(support.finer(by), self.edges, by)
        steps = tuple(replace(step, support=step.support.finer(by)) for step in self.steps)
        return replace(self, support=support, edges=NO_EDGES, steps=steps)


def choose_support(
    psf: Tensor,
    data: Tensor,
    valid: Tensor,
    photograph: Photograph,
    progress: Callable[[float], bool | None] | None = None,
) -> SupportChoice:
    """The smallest rectangle beside which a measurement asks for no light.

    Held-out pixels must be predicted as well as without a limit, but for one standard error, or two
    where a mask repeats itself.

    Parameters
    ----------
    psf, data, valid
        As `Problem.build` takes them, on coarse pixels: a hundred thousand or more.
    photograph
        Gives the scene in a support.
    progress
        Called with the fraction that is done; stops by returning True.
    """
    search = _Search(psf, data, valid, photograph, progress)
    support, edges = search.run()
    return SupportChoice(support, edges, tuple(search.steps), interrupted=search.interrupted)


class _Search:
    """Rectangles that are tried for a measurement."""

    def __init__(
        self,
        psf: Tensor,
        data: Tensor,
        valid: Tensor,
        photograph: Photograph,
        progress: Callable[[float], bool | None] | None,
    ) -> None:
        self._psf, self._data, self._valid, self._progress = psf, data, valid, progress
        self._photograph = photograph
        self._full = Problem.build(psf, data, valid=valid)
        self._light = _Light(self._full, psf)
        self._iterations = _ITERATIONS
        self._free = fit_partially(self._full, _ITERATIONS)
        self._tried: dict[tuple[PixelRectangle, int], tuple[Tensor, PartialFit]] = {}
        self._seen = set[PixelRectangle]()
        self.steps: list[SupportStep] = []
        self.interrupted = False

    def run(self) -> tuple[PixelRectangle | None, Edges]:
        """The rectangle that is chosen, and the scene's edges there; None for no limit."""
        if self._free is None:
            return None, NO_EDGES
        support = self._with_detail(self._free)
        while support is not None and self._goes_on():
            outside, fitted = self._try(support)
            excess, error = fitted.prediction.excess(self._free.prediction)
            # A mask that repeats itself explains more by ghosts, without a limit.
            explained = excess <= (_LIKELY if self._light.has_ghosts else 1) * error
            place = self._light.place(support, outside, _CLEAR_AFAR if explained else _CLEAR)
            if place is not None and self._is_light(place, support, fitted):
                support = support.union(place)
            elif explained:
                support, edges = self._finished(support, fitted)
                if self._light.fraction(support) <= _MOST:
                    return support, edges
                break
            elif self._iterations == _ITERATIONS:
                # Not yet, maybe: both are fitted for longer.
                self._iterations = _ITERATIONS_TO_COMPARE
                self._free = fit_partially(self._full, self._iterations)
                assert self._free is not None  # As before.
            else:
                break
        return self._of_psf(self._free), NO_EDGES

    def _of_psf(self, free: PartialFit) -> PixelRectangle | None:
        """The scene that the PSF is of, where that is not likely worse than no limit.

        Where the PSF explains little, as it changes over the field, nothing else tells.
        """
        covered = self._covered(self._light.scene)
        if free.prediction.unexplained_by_noise > _NOISE or not self._goes_on():
            return None
        if self._light.fraction(covered) > _MOST or self._light.visible(covered) != covered:
            return None
        outside, fitted = self._try(covered)
        excess, error = fitted.prediction.excess(free.prediction)
        clear = float(outside.max()) >= _CLEAR_AFAR
        return None if clear or excess > _LIKELY * error else covered

    def _finished(
        self, support: PixelRectangle, fitted: PartialFit
    ) -> tuple[PixelRectangle, Edges]:
        """As its scene needs, and the edges that photographs show.

        One that shows all edges is enough. Else one with much more around it is asked, as too
        little of a scene shows edges that are in it. Where that is not clear, sides move inwards by
        predictions, and more and more around them is looked at. In much noise predictions do not
        tell where the sides are, and there is a margin.
        """
        edges, centred = NO_EDGES, self._centred(support, fitted)
        noise = fitted.prediction.unexplained_by_noise
        support = centred
        if noise <= _BURIED:
            edges = self._edges(centred, edges, 0.0)
        else:
            support = self._light.visible(_wider(centred, _MARGIN, _MARGIN_AT_LEAST))
        if None in edges:
            all_known = support.union(self._known(support)) if noise > _DROWNED else support
            edges = _either(self._edges(all_known, NO_EDGES, _WIDE), edges)
        if None in edges and noise <= _BURIED:
            support, fitted, unsure = self._tightened(support, fitted)
            support = self._light.visible(_moved(self._centred(support, fitted), unsure, 1))
        if noise <= _DROWNED:
            for share in _AROUND:
                if None in edges:
                    edges = self._edges(support, edges, share)
        if noise > _BURIED:
            support = _halfway(support, support.union(self._known(support)))
        bounded = _either(edges, self._ends(support))
        return support, bounded if self._may_replace(support, bounded, edges) else edges

    def _edges(self, support: PixelRectangle, edges: Edges, share: float) -> Edges:
        """Edges, and those that a photograph of a rectangle and a share of it around it shows.

        Two edges that lie as far from the frame's middle and leave something out are taken where
        predictions are not surely against them, and no clear light lies beyond.
        """
        support = at_edges(support, edges, 1)
        covered = self._covered(support)
        wider = self._light.visible(_wider(support, share, 1))
        wider = wider.intersection(covered).union(support)
        if wider in self._seen or self.interrupted:
            return edges
        self._seen.add(wider)
        scene = self._photograph(wider)
        if scene is None:
            self.interrupted = True
            return edges
        new = scene_edges(scene, wider)
        edges = _either(edges, new)
        sensor = self._full.forward.sensor
        rows, columns = centred_edges(scene, wider, edges, sensor, covered)
        for pair in rows:
            if self._may_replace(support, (*pair, *edges[2:]), edges):
                edges = (*pair, *edges[2:])
                break
        for pair in columns:
            if self._may_replace(support, (*edges[:2], *pair), edges):
                edges = (*edges[:2], *pair)
                break
        return edges

    def _ends(self, support: PixelRectangle) -> Edges:
        """The last lines that the PSF covers, where a support goes on beyond."""
        known = self._known(support)
        return (
            known.top if support.top < known.top else None,
            known.bottom if support.bottom > known.bottom else None,
            known.left if support.left < known.left else None,
            known.right if support.right > known.right else None,
        )

    def _known(self, support: PixelRectangle) -> PixelRectangle:
        """What the PSF covers, and a support where that is not known."""
        covered, scene = self._covered(support), self._light.scene
        if covered.height == scene.height:
            covered = replace(covered, top=support.top, height=support.height)
        if covered.width == scene.width:
            covered = replace(covered, left=support.left, width=support.width)
        return covered

    def _covered(self, support: PixelRectangle) -> PixelRectangle:
        """Pixels whose light the PSF knows on all of the sensor.

        A PSF that is larger than the sensor is one of scenes so large. Where that is less than
        half of the support's side and a quarter of the frame's, it is larger by chance.
        """
        sensor, scene = self._full.forward.sensor, self._light.scene
        height, width = (
            known - own + 1 for known, own in zip(self._psf.shape[-2:], sensor, strict=True)
        )
        covered = PixelRectangle.centred(height, width, sensor)
        if height < min(support.height / 2, sensor[0] / 4):
            covered = replace(covered, top=scene.top, height=scene.height)
        if width < min(support.width / 2, sensor[1] / 4):
            covered = replace(covered, left=scene.left, width=scene.width)
        return covered

    def _may_replace(self, support: PixelRectangle, new: Edges, edges: Edges) -> bool:
        """Whether a rectangle has all of another, or predicts no worse and cuts off no light.

        The former has its sides at new edges, the latter at those that are known.
        """
        tried, support = at_edges(support, new, 1), at_edges(support, edges, 1)
        if self._light.visible(tried) != tried:
            return False
        if tried.union(support) == tried:
            return True
        fitted = self._try(support)[1]
        outside, own = self._try(tried)
        excess, error = own.prediction.excess(fitted.prediction)
        cuts = self._light.clearest(support, outside) >= _CLEAR_AFAR
        return not cuts and excess <= _SURELY_TIGHTER * error

    def _with_detail(self, free: PartialFit) -> PixelRectangle | None:
        """The rectangle with all detail, faint as it is, where that is not surely worse.

        Of parts that lie apart, the main one alone is taken where it is likely better, or where the
        others may be its ghosts and are not likely to be more. Where that is next to no limit, the
        one that predicts best is taken.
        """
        most = self._light.most_detail(free.scene)
        support, best, least = self._light.scene, free, 0.0
        limits = list[tuple[float, PixelRectangle]]()
        for fraction in _DETAIL:
            smaller, fitted = self._settled(free, fraction * most)
            if self._light.fraction(smaller) <= _MOST:
                limits.append((fitted.prediction.residual, smaller))
            excess, error = fitted.prediction.excess(best.prediction)
            if support == self._light.scene or excess < -_SURE * error:
                support, best, least = smaller, fitted, fraction * most
        main = self._light.main_part(support, best.scene, least)
        if main != support and self._goes_on():
            alone = self._try(main)[1].prediction
            if self._light.repeats(main, support):
                taken = not best.prediction.is_clearly_better(alone)
            else:
                taken = alone.is_likely_better(best.prediction)
            support = main if taken else support
        if self._light.fraction(support) <= _MOST:
            return support
        return min(limits, key=itemgetter(0))[1] if limits else None

    def _settled(self, free: PartialFit, least: float) -> tuple[PixelRectangle, PartialFit]:
        """A rectangle that the detail of its own scene fills, and its fit."""
        fitted, support = free, self._light.scene
        inner = self._light.with_detail(support, free.scene, least)
        while _area(inner) < _STAYS * _area(support) and self._goes_on():
            support, fitted = inner, self._try(inner)[1]
            inner = self._light.with_detail(support, fitted.scene, least)
        return support, fitted

    def _is_light(self, place: PixelRectangle, support: PixelRectangle, fitted: PartialFit) -> bool:
        """Whether a place that asks for light is no ghost of what the rectangle has."""
        if not self._light.repeats(support, place):
            return True
        with_it = self._try(support.union(place))[1].prediction
        return with_it.is_clearly_better(fitted.prediction)

    def _centred(self, support: PixelRectangle, fitted: PartialFit) -> PixelRectangle:
        """As far on the other side of the frame's middle, where that is not surely worse.

        Even parts of a scene, such as a night sky, show no detail, and predictions say little of
        them; cameras are pointed at what they photograph.
        """
        for mirrored in _mirrored(support, self._full.forward.sensor):
            wider = self._light.visible(support.union(mirrored))
            if wider == support or not self._goes_on():
                continue
            own = self._try(wider)[1]
            excess, error = own.prediction.excess(fitted.prediction)
            if excess <= _SURELY_TIGHTER * error:
                support, fitted = wider, own
        return support

    def _tightened(
        self, support: PixelRectangle, fitted: PartialFit
    ) -> tuple[PixelRectangle, PartialFit, str]:
        """Without lines at its sides that predictions are surely better without; its fit; and sides
        where they do not tell what a pixel less would cost.

        The squares that detail is summed in reach beyond it: a few lines go where predictions are
        as good.
        """
        unsure = set(_ALL_SIDES)
        for pixels, together in _TIGHTENING:
            for sides in together:
                spare_lines = _DETAIL_SIDE // 2 - 1 if pixels == 1 else 0
                while self._goes_on():
                    smaller = _moved(support, sides, -pixels)
                    if min(smaller.height, smaller.width) < _DETAIL_SIDE:
                        break
                    outside, own = self._try(smaller)
                    excess, error = own.prediction.excess(fitted.prediction)
                    cuts = self._light.clearest(support, outside) >= _CLEAR_AFAR
                    if cuts or excess > _SURELY_TIGHTER * error:
                        if pixels == 1:
                            unsure.discard(sides)
                        break
                    if excess > (0 if spare_lines > 0 else -_SURELY_TIGHTER * error):
                        break
                    support, fitted = smaller, own
                    spare_lines -= pixels
        return support, fitted, "".join(unsure)

    def _goes_on(self) -> bool:
        """Whether another rectangle may be tried."""
        done = len(self.steps) / _STEPS_AT_MOST
        if self._progress is not None and not self.interrupted:
            self.interrupted = bool(self._progress(min(done, 1.0)))
        return done < 1 and not self.interrupted

    def _try(self, support: PixelRectangle) -> tuple[Tensor, PartialFit]:
        """Signals beside a rectangle, and the fit with it; several steps ask for the same."""
        asked = support, self._iterations
        if asked not in self._tried:
            problem = Problem.build(self._psf, self._data, valid=self._valid, support=support)
            own = fit_partially(problem, self._iterations)
            assert own is not None  # As without a limit.
            self._tried[asked] = self._light.signal(problem, own, support), own
        outside, fitted = self._tried[asked]
        assert self._free is not None  # As `run` has seen.
        excess, error = fitted.prediction.excess(self._free.prediction)
        self.steps.append(SupportStep(support, float(outside.max()), excess, error))
        return outside, fitted


class _Light:
    """Where a measurement asks for light, in the pixels of the scene without a limit."""

    def __init__(self, full: Problem, psf: Tensor) -> None:
        self._full = full
        self.scene = PixelRectangle(*full.forward.geometry.origin, *full.scene_shape[1:])
        noise = channel_noise(full)
        self._weight = noise.square().reciprocal()[:, None, None]
        detail = (psf - local_mean(psf, torch.ones_like(psf, dtype=torch.bool))) / full.psf_norm
        self._correlation = CroppedConvolution(detail, full.forward.sensor, None)
        self._lengths = [self._length(detail, side) for side in _SIDES]
        self._seen = self._lengths[0] > _SEEN * self._lengths[0].max()
        self._alike = _autocorrelation(detail)
        self.has_ghosts = bool((self._alike > _ALIKE).any())

    def _length(self, detail: Tensor, side: int) -> Tensor:
        """‖a_s‖/σ of a square of light around each pixel."""
        square = _sums(detail, side).square()
        power = CroppedConvolution(square, self._full.forward.sensor, None)
        seen = power.adjoint(self._full.valid.to(detail.dtype)) * self._weight
        return seen.sum(0).clamp_min(0).sqrt()

    def _signals(self, residual: Tensor, fitted: Tensor) -> Tensor:
        """Signal-to-noise ratios, (squares, height, width)."""
        detail = torch.where(fitted, residual - local_mean(residual, fitted), 0)
        sums = (self._correlation.adjoint(detail) * self._weight).sum(0)
        signals = []
        for side, length in zip(_SIDES, self._lengths, strict=True):
            seen = length > _SEEN * length.max()
            signals.append(torch.where(seen, _sums(sums[None], side)[0] / length, 0))
        return torch.stack(signals)

    def most_detail(self, scene: Tensor) -> float:
        """Detail of a scene without a limit where it has most."""
        density = torch.where(self._seen, _detail(scene), 0).flatten()
        usual = density.kthvalue(math.ceil(_MOST_DETAIL * len(density))).values
        return max(float(usual), _SPARSE * float(density.max()))

    def with_detail(self, support: PixelRectangle, scene: Tensor, least: float) -> PixelRectangle:
        """The part of a scene that has so much detail, or all of it where none has."""
        density = torch.zeros_like(self._seen, dtype=scene.dtype)
        density[self._slices(support)] = _detail(scene)
        wanted = self._seen & (density >= least)
        return self._around(wanted) if bool(wanted.any()) else support

    def main_part(self, support: PixelRectangle, scene: Tensor, least: float) -> PixelRectangle:
        """The rectangle around the part that has most detail, of parts that lie apart."""
        inside = self._slices(support)
        density = torch.zeros_like(self._seen, dtype=scene.dtype)
        density[inside] = _detail(scene)
        density[~self._seen | (density < least)] = 0
        reach = 2 * max(1, round(_APART * min(self._full.forward.sensor))) + 1
        joined = nnf.max_pool2d(density[None], reach, 1, reach // 2)[0] > 0
        numbers, count = ndimage.label(joined.cpu().numpy())
        if count < 2:
            return support
        number = torch.from_numpy(numbers).long().to(density.device)
        sums = torch.bincount(number.flatten(), density.flatten())
        return self._around((density > 0) & (number == int(sums[1:].argmax()) + 1))

    def repeats(self, support: PixelRectangle, place: PixelRectangle) -> bool:
        """Whether light of one has a ghost at the other, as the PSF is alike a shift on."""
        middle = self._alike.shape[-2] // 2, self._alike.shape[-1] // 2
        rows = _shifts(support.top, support.height, place.top, place.height)
        columns = _shifts(support.left, support.width, place.left, place.width)
        least, most = zip(rows, columns, strict=True)
        top, left = (max(0, half + first) for half, first in zip(middle, least, strict=True))
        bottom, right = (max(0, half + last + 1) for half, last in zip(middle, most, strict=True))
        return bool((self._alike[top:bottom, left:right] > _ALIKE).any())

    def signal(self, problem: Problem, confined: PartialFit, support: PixelRectangle) -> Tensor:
        """The clearest signal of each pixel outside, over what is usual there, (height, width).

        A PSF that is not exactly the measurement's leaves more than noise, everywhere.
        """
        signals = self._signals(problem.residual(confined.scene), confined.fitted)
        inside = torch.zeros_like(signals[0], dtype=torch.bool)
        inside[self._slices(support)] = True
        for each in signals:
            each[inside] = 0
            usual = each[each != 0].abs()
            if usual.numel():
                each /= max(1.0, float(usual.median()) / 0.6745)
        return signals.amax(0)

    def place(
        self, support: PixelRectangle, outside: Tensor, clear_afar: float
    ) -> PixelRectangle | None:
        """Where clear signals are: near the rectangle, or else far from it; None without any."""
        near = torch.zeros_like(outside)
        beside = self._slices(_wider(support, _GROWTH, _GROWTH_AT_LEAST))
        near[beside] = outside[beside]
        if float(near.max()) >= _CLEAR:
            wanted = near >= max(_CLEAR, _STRONG * float(near.max()))
        elif float(outside.max()) >= clear_afar:
            wanted = outside == outside.max()
        else:
            return None
        return self._around(wanted)

    def clearest(self, support: PixelRectangle, outside: Tensor) -> float:
        """The clearest of signals beside a rectangle, of those that are in another."""
        return float(outside[self._slices(support)].max())

    def _around(self, wanted: Tensor) -> PixelRectangle:
        """The smallest rectangle that holds pixels."""
        rows, columns = wanted.any(1).nonzero(), wanted.any(0).nonzero()
        top, left = int(rows[0]), int(columns[0])
        return PixelRectangle(
            self.scene.top + top,
            self.scene.left + left,
            int(rows[-1]) + 1 - top,
            int(columns[-1]) + 1 - left,
        )

    def visible(self, support: PixelRectangle) -> PixelRectangle:
        """The part of it that the sensor can see."""
        rows, columns = self._slices(support)
        at = self.scene
        return PixelRectangle(
            at.top + rows.start,
            at.left + columns.start,
            rows.stop - rows.start,
            columns.stop - columns.start,
        )

    def fraction(self, support: PixelRectangle) -> float:
        """Fraction of the pixels that can be seen."""
        part = self.visible(support)
        return part.height * part.width / (self.scene.height * self.scene.width)

    def _slices(self, support: PixelRectangle) -> tuple[slice, slice]:
        at = self.scene
        top, left = max(0, support.top - at.top), max(0, support.left - at.left)
        bottom = min(at.height, support.top + support.height - at.top)
        right = min(at.width, support.left + support.width - at.left)
        return slice(top, max(top, bottom)), slice(left, max(left, right))


def _mirrored(
    support: PixelRectangle, sensor: tuple[int, int]
) -> tuple[PixelRectangle, PixelRectangle]:
    """Upside down around the middle of the sensor's frame, and left to right."""
    height, width = sensor
    down = replace(support, top=height - support.top - support.height)
    across = replace(support, left=width - support.left - support.width)
    return down, across


def _moved(support: PixelRectangle, sides: str, pixels: int) -> PixelRectangle:
    """With some of its sides moved outwards."""
    top, bottom, left, right = (pixels * (side in sides) for side in _ALL_SIDES)
    return PixelRectangle(
        support.top - top,
        support.left - left,
        support.height + top + bottom,
        support.width + left + right,
    )


def _wider(support: PixelRectangle, by: float, least: int) -> PixelRectangle:
    rows, columns = (max(least, math.ceil(by * side)) for side in (support.height, support.width))
    return PixelRectangle(
        support.top - rows,
        support.left - columns,
        support.height + 2 * rows,
        support.width + 2 * columns,
    )


def _either(edges: Edges, others: Edges) -> Edges:
    """Edges, and others where those are unclear."""
    return tuple(b if a is None else a for a, b in zip(edges, others, strict=True))


def _halfway(support: PixelRectangle, known: PixelRectangle) -> PixelRectangle:
    """A rectangle with each side in the middle between those of two."""
    top, left = (support.top + known.top) // 2, (support.left + known.left) // 2
    bottom, right = (support.bottom + known.bottom + 1) // 2, (support.right + known.right + 1) // 2
    return PixelRectangle(top, left, bottom - top, right - left)


def _shifts(first: int, size: int, other: int, other_size: int) -> tuple[int, int]:
    """The least and the greatest shift from a line of the first part to a line of the other."""
    return other - (first + size - 1), other + other_size - 1 - first


def _autocorrelation(detail: Tensor) -> Tensor:
    """Of all channels, over that of no shift, which is in the middle; zero around there."""
    height, width = (2 * side for side in detail.shape[-2:])
    power = torch.fft.rfft2(detail, s=(height, width)).abs().square().sum(0)
    alike: Tensor = torch.fft.fftshift(torch.fft.irfft2(power, s=(height, width)))
    row, column = height // 2, width // 2
    alike = alike / alike[row, column]
    top, left = max(0, row - _PEAK), max(0, column - _PEAK)
    alike[top : row + _PEAK + 1, left : column + _PEAK + 1] = 0
    return alike


def _sums(plane: Tensor, side: int) -> Tensor:
    """Sums over side×side pixels around each."""
    if side == 1:
        return plane
    return box_mean(plane, side) * side**2


def _detail(scene: Tensor) -> Tensor:
    """Total variation in squares around each pixel, of all channels."""
    down, right = scene.diff(dim=-2).abs(), scene.diff(dim=-1).abs()
    steps = nnf.pad(down, (0, 0, 0, 1)) + nnf.pad(right, (0, 1))
    return _sums(steps, _DETAIL_SIDE).sum(0)


def _area(support: PixelRectangle) -> int:
    return support.height * support.width
