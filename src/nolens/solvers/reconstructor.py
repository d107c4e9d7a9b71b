"""From the measurements of one camera to scenes: a PSF, what is assumed of the scene, a solver."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import FieldPsf, Measurement
from nolens.errors import OptionError
from nolens.operators import TRANSFER_BYTES, Geometry, PixelRectangle, mean_psf
from nolens.process import release_memory
from nolens.solvers.admm import admm, admm_bytes
from nolens.solvers.admm_state import AdmmState, Balance, Penalties
from nolens.solvers.coarse import Coarse, lost_detail, stop_after_larger, stop_on_larger
from nolens.solvers.data_step import data_step_start
from nolens.solvers.fista import fista, fista_bytes
from nolens.solvers.held_out import (
    COARSEN_FROM,
    Prediction,
    Weight,
    choose_weight,
    predict,
    weight_by_noise,
)
from nolens.solvers.inputs import (
    Plane,
    Support,
    channels_of,
    mask_of,
    support_of,
    tensor_of,
    weight_of,
)
from nolens.solvers.plug_and_play import (
    PlugAndPlay,
    plug_and_play_bytes,
    takes_few_turns,
    takes_minutes,
)
from nolens.solvers.problem import BASIS_ERROR, Prior, Problem
from nolens.solvers.result import STOPS, Callback, Progress, Quality, Result, Stop
from nolens.solvers.ridge import RidgePrior
from nolens.solvers.scene_edges import NO_EDGES
from nolens.solvers.scene_prior import ScenePrior, WeakerPrior, scene_prior, solve_with
from nolens.solvers.scene_support import SupportChoice, choose_support, first_fit
from nolens.solvers.stream import FOLLOWING, Stream
from nolens.solvers.trained_stream import TURNS, TrainedStream
from nolens.solvers.wiener import squares_unit, wiener, wiener_bytes
from nolens.solvers.wiener_weight import choose_wiener_weight, likely_scene


class Method(StrEnum):
    """How the problem is solved."""

    ADMM = "admm"
    FISTA = "fista"
    WIENER = "wiener"


SPARE = {Method.ADMM: 4, Method.FISTA: 4, Method.WIENER: 2}
"""How many times finer than what the PSF carries the pixels of the scene are worth to be: what is
assumed of a scene finds edges between what the PSF carries, and squares hardly do."""
_WEIGHT_FROM = 2_000_000
"""Sensor pixels from which on 3×3 of them are one while a weight is chosen for light from
everywhere."""
_SHARP = 0.45
"""Of a PSF's detail, how much is lost on larger pixels before these are too large for a weight:
masks of caustics lose 0.12 to 0.36, lenslets in focus 0.6 to 0.7."""
_JUDGED_PIXELS = 40_000
"""Sensor pixels at most with which a PSF is judged."""
_COARSE = 2
"""Pixels along each that become one where a photograph starts from one on larger pixels."""
_PHOTO_FROM = 3_000_000
"""`Problem.padded_pixels` from which on a photograph by total variation does."""
_LARGER_FROM = 600_000
"""The same of one that is on larger pixels itself, where light may come from everywhere."""
_BLURRED = 0.6
"""Of a PSF's detail, how much is lost on pixels that no photograph is worth on: lines through the
sensor's middle come of it."""
_BEFORE_TURNS = 3.0
"""What it is multiplied by where turns of a network on larger pixels follow, of many."""
_FIELD_BYTES = 10
"""Of a field point, per pixel of the padded shape: its PSF and its transfer."""
_COPIES_BYTES = 28
"""Of measurement and PSF as they were read and developed, per value of the measurement."""
_OWN_PRIOR_BYTES = 170
"""Held in a run with a prior of one's own, per pixel of the padded shape."""
_SUPPORT_PIXELS, _SUPPORT_BY = 130_000, 4
"""Pixels of all channels on which a support is chosen, about, and pixels along each that become one
at most: larger ones lose the PSF's lines, and scenes their edges (decision 16)."""
_ROUGH = 3.0
"""What a photo's tolerance is multiplied by where only the scene's edges are asked for."""
_STOP = {
    Method.ADMM: STOPS[Quality.PHOTO],
    Method.FISTA: Stop(300, tolerance=2e-5, scene_tolerance=0.0, low_frequency=False),
    Method.WIENER: Stop(1, tolerance=0.0, scene_tolerance=0.0, low_frequency=False),
}


def stop_of(
    method: Method,
    quality: Quality | None = None,
    *,
    iterations: int | None = None,
    tolerance: float | None = None,
    low_frequency: bool | None = None,
) -> Stop:
    """When a solver stops: its own limits or those of a quality, unless others are given.

    Parameters
    ----------
    method
        The solver.
    quality
        Of ADMM's picture; None takes the method's own limits.
    iterations, tolerance, low_frequency
        See `Stop`; a tolerance stands in place of both of its.
    """
    stop = _STOP[method]
    if method is Method.ADMM and quality is not None:
        stop = STOPS[quality]
    if tolerance is not None:
        stop = replace(stop, tolerance=tolerance, scene_tolerance=0.0)
    if iterations is not None:
        stop = replace(stop, iterations=iterations)
    if low_frequency is not None:
        stop = replace(stop, low_frequency=low_frequency)
    return stop


@dataclass(frozen=True)
class Reconstructor:
    r"""Minimises ½‖b − CMv‖² + τ R(v) over v ≥ 0 for measurements b of one camera.

    Equation 7 of `uvimprint`, by any of the solvers. The PSF and what is assumed of the scene stay;
    measurements change. Where one PSF stands for the whole field and the scene fills the view, b
    and CMv are those without the slowest parts of the light (`SlowLightRemoval`), if the solver
    has the measurement in its linear step: that light is where the model errs most.

    Parameters
    ----------
    psf
        ``(channels, height, width)``, of the sensor's size or larger, background removed.
    support
        Pixels of the sensor's frame that light can come from, as `Problem.build` takes it; None
        for no limit.
    tau
        Weight of the prior, ≥ 0, in a unit in which it means the same at any binning, support and
        number of channels (`Problem.weight`); None chooses it by pixels of the measurement that
        are left out of the fit (`choose_weight`).
    prior
        What the scene is assumed to be like: a `Prior` or its text; a trained one (`PlugAndPlay`)
        or its name; or a prior of one's own (`ScenePrior`), as a function or the name that a
        package adds to ``nolens.priors``. Trained ones and one's own follow a photograph by total
        variation, which `tau` is then the weight of. The Wiener filter has its own.
    method
        The solver.
    stop
        When it stops; None takes the method's own: for ADMM that of a photo (`STOPS`).
    penalties, balance, relaxation
        Of ADMM, as `admm` takes them.
    device
        Where to compute.
    field_psf
        PSFs at several field points, for the picture; `psf`, that of the axis, is enough to choose
        weight and support. None where the PSF is the same everywhere.
    basis_error
        With which fewer PSFs may take the places of those (`FieldConvolution`).
    mapped
        Whether transfer functions of those are in temporary files (`FieldConvolution`).
    """

    psf: Plane = field(repr=False)
    support: Support | None = None
    tau: float | None = None
    prior: Prior | str | ScenePrior | PlugAndPlay = Prior.AUTO
    method: Method = Method.ADMM
    stop: Stop | None = None
    penalties: Penalties | None = None
    balance: Balance | None = Balance()  # noqa: RUF009 (frozen)
    relaxation: float | None = None
    device: torch.device | str = "cpu"
    field_psf: FieldPsf | None = field(default=None, repr=False)
    basis_error: float = BASIS_ERROR
    mapped: bool = False

    def averaged(self, sensor: tuple[int, int]) -> "Reconstructor":
        """The same with one PSF: the mean of those over the field, if there are any.

        Parameters
        ----------
        sensor
            (height, width) of a measurement.
        """
        if self.field_psf is None:
            return self
        scene = support_of(self.support, sensor) or PixelRectangle(0, 0, *sensor)
        places = self.field_psf.places + torch.tensor([side // 2 for side in sensor])
        return replace(self, psf=mean_psf(self.field_psf.values, places, scene), field_psf=None)

    @property
    def limits(self) -> Stop:
        """When it stops: the parameter's value or the method's own."""
        return stop_of(self.method) if self.stop is None else self.stop

    @property
    def _prior(self) -> Prior | str | ScenePrior | PlugAndPlay:
        """Colours are taken together only where the low frequencies are fitted."""
        fitted = self.limits.low_frequency or self.field_psf is not None
        return Prior.TV if self.prior == Prior.AUTO and not fitted else self.prior

    @property
    def network(self) -> PlugAndPlay | None:
        """The prior, where it is a trained network."""
        prior = scene_prior(self.prior)
        return prior if isinstance(prior, PlugAndPlay) else None

    @property
    def prior_facts(self) -> dict[str, str]:
        """What a record says of a trained prior: its name, and the hash of its weights."""
        prior = scene_prior(self.prior)
        return prior.facts if isinstance(prior, (PlugAndPlay, RidgePrior)) else {}

    @property
    def method_name(self) -> str:
        """How it solves, for a report."""
        if self.network is None:
            return self.method.value
        return f"{self.method.value}, plug-and-play"

    def with_detail(self, chosen: Weight, detail: float) -> "Reconstructor":
        """The same with a weight that was chosen, and so much more detail than that shows.

        Parameters
        ----------
        chosen
            By `choose_weight`.
        detail
            What the weight is divided by, and that of a trained prior or one's own.
        """
        prior = scene_prior(self.prior)
        if isinstance(prior, (PlugAndPlay, RidgePrior, WeakerPrior)):
            prior = replace(prior, detail=detail)
        elif not isinstance(prior, Prior) and detail != 1:
            prior = WeakerPrior(prior, detail)
        own = self.prior if isinstance(prior, Prior) else prior
        return replace(self, tau=chosen.tau / detail, prior=own)

    def working_bytes(self, channels: int, sensor: tuple[int, int]) -> float:
        """Most memory that a solve holds at once, without files; before any of it is allocated.

        Parameters
        ----------
        channels, sensor
            Number of channels and (height, width) of a measurement.

        Raises
        ------
        OptionError
            If the support is none, or no light from it reaches the sensor.
        """
        pixels, points = self._padded_pixels(channels, sensor), self._field_points
        values = channels * math.prod(sensor)
        copies = _COPIES_BYTES * values
        if self.method is Method.WIENER:
            return wiener_bytes(pixels, channels, values) + copies
        each = _FIELD_BYTES - (TRANSFER_BYTES if self.mapped else 0)
        field = each * points * pixels + copies
        if self.method is Method.FISTA:
            return fista_bytes(pixels) + field
        stop = self.stop or _STOP[self.method]
        in_step = stop.low_frequency or points > 0
        fused = admm_bytes(pixels, channels, values, low_frequency=in_step)
        prior = scene_prior(self.prior)
        if isinstance(prior, PlugAndPlay):
            own = plug_and_play_bytes(pixels, prior.network)
        else:
            own = _OWN_PRIOR_BYTES * pixels if callable(prior) else 0.0
        return max(fused, own) + field

    def mapped_bytes(self, channels: int, sensor: tuple[int, int]) -> float:
        """Most that its temporary files hold if it is `mapped`; see `working_bytes`."""
        return TRANSFER_BYTES * self._field_points * self._padded_pixels(channels, sensor)

    @property
    def _field_points(self) -> int:
        filters = self.method is Method.WIENER
        return 0 if filters or self.field_psf is None else self.field_psf.points

    def _padded_pixels(self, channels: int, sensor: tuple[int, int]) -> int:
        return channels * math.prod(self._geometry(sensor).padded)

    def _geometry(self, sensor: tuple[int, int]) -> Geometry:
        height, width = tensor_of(self.psf, "PSF").shape[-2:]
        return Geometry.build(sensor, (height, width), support_of(self.support, sensor))

    def choose_weight(
        self,
        measured: Measurement | Plane,
        valid: Plane | None = None,
        progress: Callable[[float], bool | None] | None = None,
    ) -> Weight:
        """The weight of the prior, by pixels of a measurement that are left out of the fit.

        Of a measurement of many pixels 2×2 are taken as one, which takes a quarter of the time
        and finds the same weight, and of one of millions 3×3 where light may come from everywhere,
        or a network goes on from there; through a PSF that is too sharp for these, fewer (decision
        13).

        Parameters
        ----------
        measured, valid
            As `problem` takes them.
        progress
            Called with the fraction that is done; stops by returning True.

        Raises
        ------
        NolensError
            As `Problem.build`.
        """
        height, width = channels_of(_parts(measured, valid)[0], "measurement").shape[-2:]
        by = 2 if height * width >= COARSEN_FROM else 1
        many, follows = height * width >= _WEIGHT_FROM, self.network is not None
        filters = self.method is Method.WIENER
        everywhere = self.support is None or filters
        asked = by > 1 and (not follows or (many and not everywhere))
        sharp = asked and lost_detail(channels_of(self.psf, "PSF")) > _SHARP
        if many and (everywhere or (follows and not sharp)):
            by = 3
        if not follows:
            by -= sharp
        problem = replace(self, field_psf=None).coarse_problem(measured, valid, by)
        if filters:
            return choose_wiener_weight(problem, progress)
        return choose_weight(
            problem,
            penalties=self.penalties,
            balance=self.balance,
            relaxation=self.relaxation,
            progress=progress,
        )

    def choose_support(
        self,
        measured: Measurement | Plane,
        valid: Plane | None = None,
        progress: Callable[[float], bool | None] | None = None,
        acceptance: PixelRectangle | None = None,
    ) -> SupportChoice:
        """Pixels that a measurement's light comes from (decision 16).

        Chosen on means over at most 4×4 pixels, so that a hundred thousand or more are left, and
        then at the edges that a photograph on these shows (`scene_edges`). Where it shows some, and
        pixels are fewer than 4×4, one on the measurement's own tells them to the pixel. For the
        Wiener filter, which is quick, larger pixels of the brightest channel tell it; of all
        channels where that shows none.

        Parameters
        ----------
        measured, valid
            As `problem` takes them.
        progress
            Called with the fraction that is done; stops by returning True.
        acceptance
            Of the camera, in pixels of the measurement, less than all that the sensor can see. It
            is the support where no smaller one is chosen and no light shows beyond.

        Raises
        ------
        NolensError
            As `Problem.build`.
        """
        if self.method is not Method.WIENER:
            return self._support(measured, valid, progress, acceptance, _SUPPORT_PIXELS)
        pixels = _SUPPORT_PIXELS // 3
        psf, brightest, usable = _brightest(tensor_of(self.psf, "PSF"), measured, valid)
        alone = replace(self, psf=psf)._support(brightest, usable, progress, acceptance, pixels)
        channels = len(channels_of(_parts(measured, valid)[0], "measurement"))
        unclear = alone.support is None or alone.is_acceptance
        if channels == 1 or alone.interrupted or not unclear:
            return alone
        return self._support(measured, valid, progress, acceptance, pixels)

    def _support(
        self,
        measured: Measurement | Plane,
        valid: Plane | None,
        progress: Callable[[float], bool | None] | None,
        acceptance: PixelRectangle | None,
        pixels: int,
    ) -> SupportChoice:
        """The same, on so many pixels of all channels at least."""
        by = _support_by(measured, valid, pixels)
        photo = _STOP[Method.ADMM]
        watch = None if progress is None else lambda _: progress(1.0)

        def photograph(
            support: PixelRectangle, side: int = by, stop: Stop = photo
        ) -> Tensor | None:
            psf, data, usable = self._on_larger(measured, valid, side)
            solver = Reconstructor(psf, support, tau=0.0, stop=stop, device=self.device)
            problem = solver.problem(data, usable)
            problem = problem.weighted(weight_by_noise(problem.by_channel).tau)
            result = solver.solve(problem, callback=watch)
            return None if result.stop_reason == "callback" else result.scene

        psf, data, usable = self._on_larger(measured, valid, by)
        larger = None if acceptance is None else acceptance.coarser(by)
        choice = choose_support(psf, data, usable, photograph, progress, larger).finer(by)
        if acceptance is not None and choice.acceptance is not None:
            inside = (choice.support or acceptance).intersection(acceptance)
            choice = replace(choice, support=inside, acceptance=acceptance)
        shows_edges = choice.edges != NO_EDGES and not choice.noisy and not choice.interrupted
        if choice.support is None or not shows_edges or by == _SUPPORT_BY:
            return choice
        rough = replace(photo, scene_tolerance=_ROUGH * photo.scene_tolerance)
        scene = photograph(choice.support, 1, rough)
        if scene is None:
            return replace(choice, interrupted=True)
        return choice.at_fine_edges(scene, by + 1)

    def accept(
        self, measured: Measurement | Plane, acceptance: PixelRectangle, valid: Plane | None = None
    ) -> SupportChoice:
        """The camera's acceptance as the support, unless a measurement asks for light beyond.

        Parameters
        ----------
        measured, valid, acceptance
            As `choose_support` takes them.

        Raises
        ------
        NolensError
            As `Problem.build`.
        """
        by = _support_by(measured, valid)
        _, _, larger = first_fit(*self._on_larger(measured, valid, by), acceptance.coarser(by))
        own = None if larger is None else acceptance
        return SupportChoice(own, acceptance=own)

    def _on_larger(
        self, measured: Measurement | Plane, valid: Plane | None, by: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        """PSF, values and valid pixels, as means over by×by."""
        psf = _means(channels_of(self.psf, "PSF"), by)
        data, usable = _binned(measured, valid, by)
        return psf.to(self.device), data.to(self.device), usable.to(self.device)

    def coarse_problem(
        self, measured: Measurement | Plane, valid: Plane | None = None, by: int = 2
    ) -> Problem:
        """The problem on pixels that are means over by×by; its weight is zero.

        Parameters
        ----------
        measured, valid
            As `problem` takes them.
        by
            Pixels along each that become one.

        Raises
        ------
        NolensError
            As `Problem.build`.
        """
        data, mask = _binned(measured, valid, by)
        height, width = channels_of(_parts(measured, valid)[0], "measurement").shape[-2:]
        alike = replace(self.coarser((height, width), by), tau=0.0)
        return replace(alike.problem(data, mask).by_channel, slow_light=True)

    def coarser(self, sensor: tuple[int, int], by: int) -> "Reconstructor":
        """The same for measurements on pixels that are means over by×by.

        Parameters
        ----------
        sensor
            (height, width) of a measurement before.
        by
            Pixels along each that become one.
        """
        support = support_of(self.support, sensor)
        if support is not None and by > 1:
            support = support.coarser(by)
        field_psf = self.field_psf
        if field_psf is not None:
            planes = torch.stack([_means(each, by) for each in field_psf.values])
            field_psf = FieldPsf(planes, field_psf.places / by)
        psf = _means(channels_of(self.psf, "PSF"), by)
        return replace(self, psf=psf, support=support, field_psf=field_psf)

    def predict(
        self, measured: Measurement | Plane, valid: Plane | None = None
    ) -> Prediction | None:
        """How well pixels that are left out are predicted, where pixels are means over many.

        At most 40 000 are left; a PSF that is blurred by a pixel does no harm there. None of too
        few pixels.

        Parameters
        ----------
        measured, valid
            As `problem` takes them.

        Raises
        ------
        NolensError
            As `Problem.build`.
        """
        sensor = channels_of(_parts(measured, valid)[0], "measurement").shape[-2:]
        return predict(self.coarse_problem(measured, valid, judged_side((sensor[0], sensor[1]))))

    def problem(self, measured: Measurement | Plane, valid: Plane | None = None) -> Problem:
        """What is to be solved for a measurement, normalised (`Problem.build`).

        Without a `tau` its weight is chosen first (`choose_weight`).

        Parameters
        ----------
        measured
            A developed measurement, or its values, ``(channels, height, width)``.
        valid
            Pixels that take part in the fit; a `Measurement` has its own.

        Raises
        ------
        NolensError
            As `Problem.build`.
        """
        weight = (
            self.choose_weight(measured, valid).tau if self.tau is None else weight_of(self.tau)
        )
        values, usable = _parts(measured, valid)
        prior = scene_prior(self._prior)
        wiener_filter = self.method is Method.WIENER
        if isinstance(prior, PlugAndPlay) and self.stop == STOPS[Quality.EXACT]:
            raise OptionError(
                "quality exact goes near to a minimum, and a network has none: leave it out, or "
                "take another prior (ridge is trained and has one)"
            )
        if wiener_filter and isinstance(prior, PlugAndPlay):
            raise OptionError(
                "a trained prior follows a photograph by admm or fista, and the Wiener filter "
                "(method wiener, quality draft) has a prior of its own: leave one of them out"
            )
        varied = None if wiener_filter else self.field_psf
        problem = Problem.build(
            tensor_of(self.psf, "PSF").to(self.device),
            tensor_of(values, "measurement").to(self.device),
            valid=None if usable is None else tensor_of(usable, "mask").to(self.device),
            support=self.support,
            # The filter has a prior of its own: what it weighs are squares.
            prior=prior if isinstance(prior, Prior) and not wiener_filter else Prior.TV,
            field_psf=None if varied is None else varied.to(self.device),
            basis_error=self.basis_error,
            mapped=self.mapped,
        )
        if wiener_filter:
            problem = replace(problem, tau_unit=squares_unit(problem))
        problem = problem.weighted(weight_of(weight))
        return replace(problem, slow_light=not self._leaves_slow_light_out(problem))

    def _leaves_slow_light_out(self, problem: Problem) -> bool:
        """Whether the slowest parts of the light do not count: one PSF, and a scene that fills the
        view, with the measurement in the linear step (decision 25).
        """
        if self.method is Method.WIENER or self.field_psf is not None:
            return False
        stays = self.limits.low_frequency or problem.in_linear_step
        fitted = self.network is not None or (self.method is Method.ADMM and stays)
        return fitted and min(problem.uniform_levels()) > 0

    def solve(
        self,
        measured: Measurement | Plane | Problem,
        valid: Plane | None = None,
        *,
        state: AdmmState | None = None,
        callback: Callback | None = None,
    ) -> Result:
        """The scene of a measurement.

        Parameters
        ----------
        measured, valid
            As `problem` takes them, or what it gave.
        state
            Where ADMM starts from; None starts cold.
        callback
            Sees the run on its way, and stops it by returning True.

        Raises
        ------
        NolensError
            If the data cannot be used, or the iteration does not converge.
        """
        problem = measured if isinstance(measured, Problem) else self.problem(measured, valid)
        prior = scene_prior(self.prior)
        if self.method is Method.WIENER:
            return self._filtered(problem)
        if isinstance(prior, PlugAndPlay):
            return self._with_network(prior, problem, state, callback)
        if isinstance(prior, Prior):
            return self._minimum(problem, state, callback)
        stop = self.limits
        started = self
        if self.method is Method.ADMM and stop.tolerance > 0:  # A photo is enough to start from.
            photo = STOPS[Quality.PHOTO]
            started = replace(self, stop=replace(photo, low_frequency=stop.low_frequency))
        first = started._minimum(problem, state, callback)
        if first.stop_reason == "callback":
            return first
        return solve_with(prior, problem, first, stop, callback)

    def _filtered(self, problem: Problem) -> Result:
        """By the Wiener filter; of many pixels it goes on from the scene on larger ones."""
        if math.prod(problem.forward.sensor) < COARSEN_FROM:
            return wiener(problem)
        coarse = self._coarse(problem)
        first = self.coarser(problem.forward.sensor, coarse.by)._filtered(coarse.problem)
        return wiener(problem, coarse.finer(first.scene, problem) / problem.scale)

    def takes_minutes(self, channels: int, sensor: tuple[int, int]) -> bool:
        """Whether it has a network, and more pixels than that is quick with.

        Parameters
        ----------
        channels, sensor
            As `working_bytes` takes them.
        """
        return self.network is not None and takes_minutes(channels, self._geometry(sensor))

    def starts_coarse(self, problem: Problem) -> bool:
        """Whether it starts from a photograph on larger pixels: with a network, of many pixels."""
        many = math.prod(problem.forward.sensor) >= COARSEN_FROM
        return many and self.network is not None

    def _with_network(
        self,
        network: PlugAndPlay,
        problem: Problem,
        state: AdmmState | None,
        callback: Callback | None,
    ) -> Result:
        if not self.starts_coarse(problem):
            first = self._minimum(problem, state, callback)
            if first.stop_reason == "callback":
                return first
            return network.solve(problem, first, callback)
        coarse = self._coarse(problem)
        rougher = _BEFORE_TURNS if takes_few_turns(problem) else 1
        stop = replace(self.limits, scene_tolerance=rougher * self.limits.scene_tolerance)
        first = self._coarse_photograph(coarse, problem, stop, callback, _PHOTO_FROM)
        if first.stop_reason == "callback":
            return coarse.finer_result(first, problem)
        return network.solve(problem, first, callback, coarse)

    def _coarse(self, problem: Problem) -> Coarse:
        """A problem of this camera on 2×2 pixels."""
        measured = problem.data * problem.scale * problem.psf_norm
        coarse = self.coarse_problem(measured, problem.valid, _COARSE).weighted(problem.weight)
        return Coarse(replace(coarse, prior=problem.prior, slow_light=problem.slow_light), _COARSE)

    def _coarse_photograph(
        self,
        coarse: Coarse,
        problem: Problem,
        stop: Stop,
        callback: Callback | None,
        many: int,
    ) -> Result:
        """A photograph on larger pixels; the callback sees it on the problem's.

        From `many` padded pixels on it starts from still larger ones.
        """

        def seen(progress: Progress) -> bool | None:
            assert callback is not None

            def scene() -> Tensor:
                scene = coarse.problem.unscale(progress.scene())
                return coarse.finer(scene, problem) / problem.scale

            return callback(replace(progress, scene=scene))

        smaller = replace(self.coarser(problem.forward.sensor, coarse.by), stop=stop)
        watch = None if callback is None else seen
        if smaller._photo_starts_coarse(coarse.problem, many):
            state = AdmmState.cold(coarse.problem)
            return smaller._from_coarse(coarse.problem, state, watch, own=False)
        return smaller._minimum(coarse.problem, None, watch)

    def _minimum(
        self, problem: Problem, state: AdmmState | None, callback: Callback | None
    ) -> Result:
        """By admm or fista, with the `Prior` that the problem has."""
        stop = self.limits
        if self.method is Method.FISTA:
            return fista(
                problem,
                iterations=stop.iterations,
                tolerance=stop.tolerance,
                start=likely_scene(problem),
                callback=callback,
            )
        if self._photo_starts_coarse(problem, _PHOTO_FROM):
            return self._from_coarse(problem, state or AdmmState.cold(problem), callback)
        return self._admm(problem, state, callback)

    def _photo_starts_coarse(self, problem: Problem, many: int) -> bool:
        """Whether a photo by ADMM starts from one on larger pixels: of many pixels, where the scene
        fills the view and one PSF stands for all, and with nothing stated of how it goes.
        """
        limits, photo = self.limits, STOPS[Quality.PHOTO]
        usual = limits.scene_tolerance > 0 and limits == replace(
            photo, scene_tolerance=limits.scene_tolerance
        )
        stated = self.penalties is not None or self.balance is None
        large = problem.padded_pixels >= many
        return large and usual and not stated and not problem.slow_light

    def _from_coarse(
        self, problem: Problem, state: AdmmState, callback: Callback | None, *, own: bool = True
    ) -> Result:
        """A photo that starts from one on larger pixels, or goes on after that (decision 26).

        `own` says whether its pixels are the measurement's.
        """
        before = list[dict[str, float]]()
        if state.iteration == 0:
            first = self._start_from_coarse(problem, state, callback)
            if first.stop_reason == "callback":
                return first
            before = first.history
            del first  # Its scene.
        release_memory()
        stop = stop_after_larger(self.limits, problem, own=own)
        result = replace(self, stop=stop)._admm(problem, state, callback)
        return replace(result, history=[*before, *result.history])

    def _start_from_coarse(
        self, problem: Problem, state: AdmmState, callback: Callback | None
    ) -> Result:
        """Have a state start from a photo on larger pixels; that photo, on the problem's."""
        coarse, everywhere = self._coarse(problem), problem.forward.support is None
        smaller = self.coarser(problem.forward.sensor, coarse.by)
        further = everywhere and lost_detail(channels_of(smaller.psf, "PSF")) < _BLURRED
        many = _LARGER_FROM if further else _PHOTO_FROM
        largest = not smaller._photo_starts_coarse(coarse.problem, many)
        stop = stop_on_larger(self.limits, coarse.problem, largest=largest)
        first = self._coarse_photograph(coarse, problem, stop, callback, many)
        finer = coarse.finer_result(first, problem)
        if first.stop_reason != "callback":
            state.move(problem, finer.scene / problem.scale)
            state.restart(data_step_start(problem, state, refines=True))
            state.iteration = first.iterations
        return finer

    def _admm(self, problem: Problem, state: AdmmState | None, callback: Callback | None) -> Result:
        stop = self.limits
        return admm(
            problem,
            iterations=stop.iterations,
            tolerance=stop.tolerance,
            scene_tolerance=stop.scene_tolerance,
            low_frequency=stop.low_frequency,
            penalties=self.penalties,
            balance=self.balance,
            relaxation=self.relaxation,
            state=state,
            callback=callback,
        )

    def stream(
        self,
        first: Measurement | Plane | Problem,
        *,
        iterations: int | None = None,
        latency_s: float | None = None,
    ) -> Stream | TrainedStream:
        """Frame after frame, each from where the one before it ended: by ADMM, or by a network.

        Parameters
        ----------
        first
            A measurement like all that follow; it is not solved for yet.
        iterations, latency_s
            As `Stream` and `TrainedStream` take them; None for 8 iterations, or 4 turns.

        Raises
        ------
        OptionError
            If the prior is one's own, or the ridge.
        """
        problem = first if isinstance(first, Problem) else self.problem(first)
        network = self.network
        if network is not None:
            photo = replace(self, stop=None).solve
            turns = TURNS if iterations is None else iterations
            return TrainedStream(problem, network, photo, iterations=turns, latency_s=latency_s)
        if not isinstance(scene_prior(self.prior), Prior):
            raise OptionError(
                "a stream has no prior of one's own, and no ridge; give denoiser, unrolled, or one "
                f"of {', '.join(Prior)}"
            )
        count = FOLLOWING if iterations is None else iterations
        return Stream(problem, iterations=count, latency_s=latency_s)

    def for_iterations(self, count: int) -> "Reconstructor":
        """The same by ADMM with so many iterations, whatever comes of them."""
        return replace(self, stop=Stop(count, 0.0, 0.0, low_frequency=False))


def judged_side(sensor: tuple[int, int]) -> int:
    """Pixels along each that become one where `Reconstructor.predict` judges a PSF."""
    return math.ceil(math.sqrt(math.prod(sensor) / _JUDGED_PIXELS))


def _support_by(
    measured: Measurement | Plane, valid: Plane | None, pixels: int = _SUPPORT_PIXELS
) -> int:
    """Pixels along a larger one, of which about so many are left to choose a support on."""
    values, _ = _parts(measured, valid)
    own = channels_of(values, "measurement").numel()
    return min(max(1, round(math.sqrt(own / pixels))), _SUPPORT_BY)


def _brightest(
    psf: Plane, measured: Measurement | Plane, valid: Plane | None
) -> tuple[Tensor, Tensor, Tensor]:
    """PSF, values and valid pixels of the channel with most light."""
    values, usable = _parts(measured, valid)
    psf, data = channels_of(psf, "PSF"), channels_of(values, "measurement")
    valid = mask_of(usable, data)
    channel = int(torch.where(valid, data, 0).square().sum((-2, -1)).argmax())
    of_psf, own = channel % len(psf), slice(channel, channel + 1)
    return psf[of_psf : of_psf + 1], data[own], valid[own]


def _binned(measured: Measurement | Plane, valid: Plane | None, by: int) -> tuple[Tensor, Tensor]:
    """Values and valid pixels, as means over by×by pixels."""
    values, usable = _parts(measured, valid)
    data = channels_of(values, "measurement")
    return _means(data, by), _means(mask_of(usable, data).float(), by) == 1


def _means(plane: Tensor, by: int) -> Tensor:
    """Means over by×by pixels, without rows and columns that fill none."""
    means: Tensor = nnf.avg_pool2d(plane[None], by)[0]
    return means


def _parts(measured: Measurement | Plane, valid: Plane | None) -> tuple[Plane, Plane | None]:
    if isinstance(measured, Measurement):
        return measured.values, measured.valid
    return measured, valid
