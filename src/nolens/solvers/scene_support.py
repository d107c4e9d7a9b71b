"""The support of a scene, by where a measurement asks for light.

A first scene without a limit has its detail where the light comes from, and a smooth glow around.
The rectangle that holds the detail is the limit of a second fit, whose scene has less glow, and so
on until the rectangle stays. It grows to where the measurement asks for light outside, beyond noise
(`nolens.solvers.scene_light`), until it does so nowhere. Last, photographs of the rectangle, and of
more around it, show where the scene ends (`nolens.solvers.scene_edges`); where they do not, its
sides move inwards for as long as pixels that are left out of the fit are predicted better. Where no
rectangle comes out, and the PSF is of a scene, its likeliest part is taken
(`nolens.solvers.scene_evidence`); where nearly all is noise, it is asked before anything else.

Where the camera is known, all this is within its acceptance, unless the measurement asks for light
beyond.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

from torch import Tensor

from nolens.operators import PixelRectangle
from nolens.solvers.held_out import PartialFit, fit_partially
from nolens.solvers.problem import Problem
from nolens.solvers.scene_edges import NO_EDGES, Edges, at_edges, centred_edges, scene_edges
from nolens.solvers.scene_evidence import Evidence
from nolens.solvers.scene_light import CLEAR, CLEAR_AFAR, DETAIL_SIDE, Light, with_margin

_DETAIL = (0.04, 0.1, 0.25, 0.5)
"""Of the scene's detail where there is most, from which on light comes from there: as little as can
be told from what the glow has, which varies."""
_STAYS = 0.9
"""Fraction of a rectangle that the next one holds at least, where it is the last."""
_SURE = 4.0
"""Standard errors by which the smaller rectangle predicts better than the larger."""
_LIKELY = 2.0
"""The same where it is likely that it does."""
_ALL_SIDES = "tblr"
"""Top, bottom, left and right."""
_TIGHTENING = ((4, (_ALL_SIDES,)), (4, tuple(_ALL_SIDES)), (1, tuple(_ALL_SIDES)))
"""Pixels by which sides move inwards, and sides that move together."""
_SURELY_TIGHTER = 3.0
"""Standard errors by which the prediction is then better, or worse by a pixel less or centred."""
_UNEXPLAINED = 2.5
"""Of what stays unexplained beyond noise without a limit, that within the acceptance at most."""
_BURIED = 0.2
"""Fraction of the contrast that is noise, above which sides get a margin instead."""
_DROWNED = 0.8
"""The same, above which detail tells nothing: the likeliest part of the PSF's support is asked
first, and without one, a photograph of all of that is the only one."""
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
    noisy
        Whether noise hides more exact edges.
    steps
        Rectangles that were tried, one after the other.
    interrupted
        Whether the caller stopped it.
    acceptance
        The camera's acceptance, where the measurement asks for no light beyond; None else.
    """

    support: PixelRectangle | None
    edges: Edges = NO_EDGES
    noisy: bool = False
    steps: tuple[SupportStep, ...] = ()
    interrupted: bool = False
    acceptance: PixelRectangle | None = None

    @property
    def is_acceptance(self) -> bool:
        """Whether the support is all that the camera accepts light from."""
        return self.acceptance is not None and self.support == self.acceptance

    def finer(self, by: int) -> "SupportChoice":
        """Where by×by pixels stand for each of these, its sides half of one beside the edges."""
        support = self.support
        edges = tuple(None if edge is None else by * edge for edge in self.edges)
        if support is not None:
            support = at_edges(support.finer(by), edges, max(1, by // 2))
        steps = tuple(replace(step, support=step.support.finer(by)) for step in self.steps)
        return replace(self, support=support, edges=edges, steps=steps)

    def at_fine_edges(self, scene: Tensor, within: int) -> "SupportChoice":
        """With its sides at the edges that a photograph of its support shows, without a margin.

        Parameters
        ----------
        scene
            (channels, height, width), on the measurement's own pixels.
        within
            Lines of the support at each side that are left out at most.
        """
        support = self.support
        if support is None:
            return self
        sides = support.top, support.bottom, support.left, support.right
        edges = tuple(
            None if edge is None or abs(edge - side) > within else edge
            for edge, side in zip(scene_edges(scene, support, exact=True), sides, strict=True)
        )
        return replace(self, support=at_edges(support, edges, 0))


def choose_support(
    psf: Tensor,
    data: Tensor,
    valid: Tensor,
    photograph: Photograph,
    progress: Callable[[float], bool | None] | None = None,
    acceptance: PixelRectangle | None = None,
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
    acceptance
        Of the camera, less than all that the sensor can see; None where it is not known.
    """
    search = _Search(psf, data, valid, photograph, progress, acceptance)
    support, edges = search.run()
    return SupportChoice(
        support,
        edges,
        search.noisy,
        tuple(search.steps),
        interrupted=search.interrupted,
        acceptance=search.acceptance,
    )


def first_fit(
    psf: Tensor, data: Tensor, valid: Tensor, acceptance: PixelRectangle | None
) -> tuple[Problem, PartialFit | None, PixelRectangle | None]:
    """The problem within a camera's acceptance, a first fit of it, and the acceptance.

    The problem without a limit, and None, where the measurement asks for light beyond, where much
    more of it stays unexplained than without a limit, or where too few pixels can be left out to
    tell.

    Parameters
    ----------
    psf, data, valid, acceptance
        As `choose_support` takes them.
    """
    full = Problem.build(psf, data, valid=valid)
    free = fit_partially(full, _ITERATIONS)
    if acceptance is None or free is None:
        return full, free, None
    problem = Problem.build(psf, data, valid=valid, support=acceptance)
    fitted = fit_partially(problem, _ITERATIONS)
    assert fitted is not None  # As without a limit.
    own, noise = fitted.prediction, free.prediction.unexplained_by_noise
    excess, error = own.excess(free.prediction)
    least = max(0.0, free.prediction.unexplained - noise)
    if excess > _SURELY_TIGHTER * error and own.unexplained - noise > _UNEXPLAINED * least:
        return full, free, None
    beyond = Light(full, psf).signal(problem, fitted, acceptance)
    if float(beyond.max()) >= CLEAR_AFAR:
        return full, free, None
    return problem, fitted, acceptance


class _Search:
    """Rectangles that are tried for a measurement."""

    def __init__(
        self,
        psf: Tensor,
        data: Tensor,
        valid: Tensor,
        photograph: Photograph,
        progress: Callable[[float], bool | None] | None,
        acceptance: PixelRectangle | None,
    ) -> None:
        self._psf, self._data, self._valid, self._progress = psf, data, valid, progress
        self._photograph = photograph
        self._iterations = _ITERATIONS
        self._full, self._free, self.acceptance = first_fit(psf, data, valid, acceptance)
        self._light = Light(self._full, psf)
        self._tried: dict[tuple[PixelRectangle, int], tuple[Tensor, PartialFit]] = {}
        self._seen = set[PixelRectangle]()
        self.steps: list[SupportStep] = []
        self.noisy = self.interrupted = False

    def run(self) -> tuple[PixelRectangle | None, Edges]:
        """The rectangle that is chosen, and the scene's edges there; None for no limit."""
        if self._free is None:
            return None, NO_EDGES
        if self._free.prediction.unexplained_by_noise > _DROWNED and self._likeliest is not None:
            likely = self._of_psf(self._free)
            if likely is not None:
                self.noisy = True
                largest = self._psf_support(self._light.scene)
                edges = self._edges(largest, NO_EDGES, _WIDE)
                halfway = _halfway(likely, largest)
                return halfway, self._bounded(halfway, edges)
        support = self._with_detail(self._free)
        while support is not None and self._goes_on():
            outside, fitted = self._try(support)
            excess, error = fitted.prediction.excess(self._free.prediction)
            # A mask that repeats itself explains more by ghosts, without a limit.
            explained = excess <= (_LIKELY if self._light.has_ghosts else 1) * error
            place = self._light.place(support, outside, CLEAR_AFAR if explained else CLEAR)
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
        """The likeliest part of the scene that the PSF is of, and clear light beside; all of it
        where no part is likely.

        Where the PSF explains little, as it changes over the field, nothing else tells. None where
        that scene predicts surely worse than no limit (likely worse, without a likely part), or
        clear light lies beside it.
        """
        psf_support, likely = self._psf_support(self._light.scene), self._likeliest
        if not self._goes_on() or not self._is_part(psf_support):
            return None
        excess, error = self._try(psf_support)[1].prediction.excess(free.prediction)
        if excess > (_LIKELY if likely is None else _SURELY_TIGHTER) * error:
            return None
        support = psf_support if likely is None else likely
        while self._goes_on():
            outside, _ = self._try(support)
            if float(outside.max()) < CLEAR_AFAR:
                return support
            place = self._light.place(support, outside, CLEAR_AFAR)
            assert place is not None  # There is clear light.
            support = support.union(place)
            if support.union(psf_support) != psf_support:
                break
        return None

    def _is_part(self, psf_support: PixelRectangle) -> bool:
        """Whether the scene that the PSF is of is a part of what can be seen."""
        part = self._light.fraction(psf_support) <= _MOST
        return part and self._light.visible(psf_support) == psf_support

    @cached_property
    def _likeliest(self) -> PixelRectangle | None:
        """The likeliest part of the scene that the PSF is of, and a block around; None where no
        part is likely.
        """
        psf_support = self._psf_support(self._light.scene)
        if not self._is_part(psf_support):
            return None
        evidence = Evidence(self._psf, self._full, psf_support)
        sides = evidence.likeliest()
        if sides is None:
            return None
        return with_margin(evidence.support(sides), 0, evidence.side).intersection(psf_support)

    def _finished(
        self, support: PixelRectangle, fitted: PartialFit
    ) -> tuple[PixelRectangle, Edges]:
        """As its scene needs, and the edges that photographs show.

        A photograph of the rectangle that shows all edges is enough. Else one with much more around
        it is asked, as too little of a scene shows edges that are in it. Where that is not clear,
        sides move inwards by predictions, and more and more around them is looked at.
        """
        centred = self._centred(support, fitted)
        noise = fitted.prediction.unexplained_by_noise
        if noise > _BURIED:
            return self._finished_in_noise(centred, noise)
        support, edges = centred, self._edges(centred, NO_EDGES, 0.0)
        if None in edges:
            edges = _either(self._edges(centred, NO_EDGES, _WIDE), edges)
        if None in edges:
            support, fitted, unsure = self._tightened(centred, fitted)
            support = self._light.visible(_moved(self._centred(support, fitted), unsure, 1))
            edges = self._edges_around(support, edges)
        return support, self._bounded(support, edges)

    def _finished_in_noise(
        self, support: PixelRectangle, noise: float
    ) -> tuple[PixelRectangle, Edges]:
        """The same where predictions do not tell where the sides are.

        Those without a clear edge are halfway between the rectangle, with a margin, and the PSF's
        support.
        """
        self.noisy = True
        support = self._light.visible(with_margin(support, _MARGIN, _MARGIN_AT_LEAST))
        largest = support.union(self._bounds(support))
        if noise > _DROWNED:
            edges = self._edges(largest, NO_EDGES, _WIDE)
        else:
            edges = self._edges_around(support, self._edges(support, NO_EDGES, _WIDE))
        support = _halfway(support, largest)
        return support, self._bounded(support, edges)

    def _edges_around(self, support: PixelRectangle, edges: Edges) -> Edges:
        """Edges, and those that photographs of more and more around a rectangle show."""
        for share in _AROUND:
            if None in edges:
                edges = self._edges(support, edges, share)
        return edges

    def _bounded(self, support: PixelRectangle, edges: Edges) -> Edges:
        """Edges, and those of the PSF's support where another goes on beyond."""
        bounds = self._bounds(support)
        ends = (
            bounds.top if support.top < bounds.top else None,
            bounds.bottom if support.bottom > bounds.bottom else None,
            bounds.left if support.left < bounds.left else None,
            bounds.right if support.right > bounds.right else None,
        )
        bounded = _either(edges, ends)
        return bounded if self._may_replace(support, bounded, edges) else edges

    def _edges(self, support: PixelRectangle, edges: Edges, share: float) -> Edges:
        """Edges, and those that a photograph of a rectangle and a share of it around it shows.

        Two edges that lie as far from the frame's middle and leave something out are taken where
        predictions are not surely against them, and no clear light lies beyond.
        """
        support = at_edges(support, edges)
        psf_support = self._psf_support(support)
        wider = self._light.visible(with_margin(support, share, 1))
        wider = wider.intersection(psf_support).union(support)
        if wider in self._seen or self.interrupted:
            return edges
        self._seen.add(wider)
        scene = self._photograph(wider)
        if scene is None:
            self.interrupted = True
            return edges
        edges = _either(edges, scene_edges(scene, wider))
        sensor = self._full.forward.sensor
        pairs = centred_edges(scene, wider, edges, sensor, psf_support)
        for side, candidates in zip((0, 2), pairs, strict=True):
            for pair in candidates:
                new = (*edges[:side], *pair, *edges[side + 2 :])
                if self._may_replace(support, new, edges):
                    edges = new
                    break
        return edges

    def _bounds(self, support: PixelRectangle) -> PixelRectangle:
        """The PSF's support, and another where there is none."""
        psf_support, scene = self._psf_support(support), self._light.scene
        if psf_support.height == scene.height:
            psf_support = replace(psf_support, top=support.top, height=support.height)
        if psf_support.width == scene.width:
            psf_support = replace(psf_support, left=support.left, width=support.width)
        return psf_support

    def _psf_support(self, support: PixelRectangle) -> PixelRectangle:
        """Pixels whose light the PSF has on all of the sensor; of all that can be seen else.

        A PSF that is larger than the sensor is one of scenes so large. Where that is less than
        half of the scene's support and a quarter of the frame, it is larger by chance.
        """
        sensor, scene = self._full.forward.sensor, self._light.scene
        height, width = (
            of_psf - own + 1 for of_psf, own in zip(self._psf.shape[-2:], sensor, strict=True)
        )
        psf_support = PixelRectangle.centred(height, width, sensor)
        if height < min(support.height / 2, sensor[0] / 4):
            psf_support = replace(psf_support, top=scene.top, height=scene.height)
        if width < min(support.width / 2, sensor[1] / 4):
            psf_support = replace(psf_support, left=scene.left, width=scene.width)
        return psf_support

    def _may_replace(self, support: PixelRectangle, new: Edges, edges: Edges) -> bool:
        """Whether a rectangle has all of another, or predicts no worse and cuts off no light.

        The former has its sides at new edges, the latter at those that are known.
        """
        tried, support = at_edges(support, new), at_edges(support, edges)
        if self._light.visible(tried) != tried:
            return False
        if tried.union(support) == tried:
            return True
        fitted = self._try(support)[1]
        outside, own = self._try(tried)
        excess, error = own.prediction.excess(fitted.prediction)
        cuts = self._light.clearest(support, outside) >= CLEAR_AFAR
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
                spare_lines = DETAIL_SIDE // 2 - 1 if pixels == 1 else 0
                while self._goes_on():
                    smaller = _moved(support, sides, -pixels)
                    if min(smaller.height, smaller.width) < DETAIL_SIDE:
                        break
                    outside, own = self._try(smaller)
                    excess, error = own.prediction.excess(fitted.prediction)
                    cuts = self._light.clearest(support, outside) >= CLEAR_AFAR
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


def _either(edges: Edges, others: Edges) -> Edges:
    """Edges, and others where those are unclear."""
    return tuple(b if a is None else a for a, b in zip(edges, others, strict=True))


def _halfway(support: PixelRectangle, other: PixelRectangle) -> PixelRectangle:
    """A rectangle with each side in the middle between those of two."""
    top, left = (support.top + other.top) // 2, (support.left + other.left) // 2
    bottom, right = (support.bottom + other.bottom + 1) // 2, (support.right + other.right + 1) // 2
    return PixelRectangle(top, left, bottom - top, right - left)


def _area(support: PixelRectangle) -> int:
    return support.height * support.width
