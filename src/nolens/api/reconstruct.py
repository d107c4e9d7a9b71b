"""Photographs from measurements: at the distance of a PSF, or refocused."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple

import torch

from nolens.api.image import Image
from nolens.api.inputs import Progress, Raw, distance_um, frame_of, reported
from nolens.api.simulate import Psf, SimulatedMeasurement
from nolens.calibrate.distances import Layers
from nolens.camera import BlackLevel, FieldPsf, Flip, Frame, black_level
from nolens.camera.field_psf import spread
from nolens.errors import OptionError
from nolens.files.psf_folder import PsfFolder
from nolens.files.weights import trained_prior
from nolens.jobs.reconstruction.acceptance import acceptance_of, camera_of
from nolens.jobs.run import mapped_where_needed
from nolens.operators import PixelRectangle
from nolens.progress import Clock
from nolens.quantities import Length
from nolens.refocusing import (
    DepthField,
    DepthPsfs,
    DepthReconstructor,
    PsfAt,
    focus,
    measured_reduced_um,
)
from nolens.solvers import (
    Developed,
    Development,
    FieldPoint,
    Method,
    Prior,
    PsfSettings,
    Quality,
    Reconstructor,
    Result,
    choose_psf,
    stop_of,
)
from nolens.solvers import Progress as Iteration
from nolens.solvers.explanation import (
    FieldChoice,
    SupportBy,
    choose_field,
    explain,
    picture_warnings,
)
from nolens.solvers.inputs import Support, one_of, support_of, tensor_of
from nolens.solvers.plug_and_play import PlugAndPlay
from nolens.solvers.psf_choice import Extent
from nolens.solvers.reconstructor import SPARE
from nolens.solvers.report import Report
from nolens.solvers.result import window_of
from nolens.solvers.scene_prior import PHOTO_PRIOR, SLOW_PRIOR, ScenePrior, by_total_variation
from nolens.solvers.uncertainty import detail_warning
from nolens.solvers.uncertainty import uncertainty as measure_uncertainty

_CHOICE = 0.2
"""Fraction of the work that the choice of a weight is."""


@dataclass(frozen=True, repr=False)
class Photograph(Image):
    """A reconstruction. `values` are radiance, (channels, height, width).

    Parameters
    ----------
    result
        What the solver gave: objective, iterations, stop_reason, history.
    tau
        Weight of the prior that was used.
    report
        Noise, unexplained part, resolution, support and the run, in five lines; None of a
        refocused one.
    notes, warnings
        What was done to the data, and what may make the picture worse than it could be.
    distance_um
        That it is focused at, where it was refocused.
    spread
        Standard deviation of each value under the noise, like `values`; None where it was not asked
        for.
    disagreement
        How far each value is from that of total variation, like `values`; None where `spread` is,
        or where they are that.
    """

    result: Result = field(repr=False)
    tau: float
    report: Report | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    distance_um: float | None = None
    spread: torch.Tensor | None = field(default=None, repr=False)
    disagreement: torch.Tensor | None = field(default=None, repr=False)


def reconstruct(
    measurement: Raw,
    psf: Raw,
    *,
    distance: str | Length | None = None,
    field_points: int | None = None,
    support: Support | Literal["auto", "full"] = "auto",
    dark: Raw | None = None,
    flat: Raw | None = None,
    black: BlackLevel = None,
    white: float | None = None,
    bin_by: int | None = None,
    channels: str = "all",
    psf_scale: int | None = None,
    psf_extended: bool | None = None,
    psf_flip: Flip | None = None,
    method: Method | str | None = None,
    quality: Quality | str | None = None,
    tau: float | None = None,
    detail: float = 1.0,
    prior: Prior | str | Path | ScenePrior | PlugAndPlay = Prior.AUTO,
    iterations: int | None = None,
    tolerance: float | None = None,
    uncertainty: int | None = None,
    device: torch.device | str = "cpu",
    progress: Progress = False,
) -> Photograph:
    r"""Reconstruct a photograph: minimise ½‖b − CMv‖² + τ R(v) over v ≥ 0 (`uvimprint`, eq. 7).

    Parameters
    ----------
    measurement, psf
        Files, frames of `load`, pictures of `simulate` and `psf`, or linear values without black
        level, (channels, height, width). A PSF may be the folder of a camera, whose PSFs at several
        angles are used together.
    distance
        Of the scene, where the PSF is a folder with those of several distances.
    field_points
        How many PSFs of a folder, or of one that was computed at several field points, to use at
        most; 1 takes the one straight ahead for all of the scene. None takes all there are, or one
        where it explains the measurement clearly better.
    support
        Pixels of the sensor's frame that light can come from: (height, width) around the middle,
        (top, left, height, width), or a `PixelRectangle`. ``"auto"`` takes that of a simulated
        measurement, else the smallest rectangle beside which the measurement shows no light; the
        photograph is then dark around it. ``"full"`` sets no limit.
    dark, flat
        Frames without light and of even light.
    black
        Black level in counts, or ``"auto"``: read off the PSF's darkest corner. None takes what
        the frames say.
    white
        Count from which a pixel is saturated; None takes what the frames say.
    bin_by
        Pixels along a superpixel; None makes them no finer than the PSF carries.
    channels
        ``"all"``, ``"grey"``, or letters such as ``"g"``.
    psf_scale, psf_extended
        Of a PSF that is larger than the measurement: so many times finer, or extended beyond the
        sensor; None takes what explains the measurement.
    psf_flip
        Turn the PSF over first: ``"horizontal"``, ``"vertical"`` or ``"both"``; ``"none"`` keeps
        it. None turns it only where that explains the measurement clearly better.
    method
        ``"admm"``, ``"fista"`` or ``"wiener"``; None takes ADMM.
    quality
        ``"draft"`` (Wiener filter), ``"photo"`` or ``"exact"``, in place of a method.
    tau
        Weight of the prior, which means the same at any binning, support and number of channels;
        None chooses it by pixels that are left out of the fit.
    detail
        What the automatic `tau`, and the weight of a prior that follows it, are divided by: 2
        shows more detail and more noise.
    prior
        ``"tv"``, ``"colour-tv"``, ``"isotropic-tv"``, ``"l1"`` or ``"none"``. ``"ridge"``,
        ``"denoiser"`` and ``"unrolled"`` are trained, and the path of an .npz is one that you
        trained. ``"auto"`` is ``"denoiser"`` for a photo; with another method or quality, and with
        `tau`, `iterations` or `tolerance`, total variation, of the colours together where the scene
        fills the view. Or one of your own: a function from a first photograph, by total variation
        with a white of 1, to the functional −ln p(v), or the name that a package adds.
    iterations, tolerance
        Limits in place of the method's own.
    uncertainty
        Number of samples by which `Photograph.spread` is measured, such as 8; each takes as long as
        the picture. `Photograph.disagreement` is measured, too.
    device
        Where to compute.
    progress
        Whether to show a bar, or a function for the fraction that is done.

    Raises
    ------
    NolensError
        If the data do not fit together or a parameter cannot be used.
    """
    if not 0 < detail < math.inf:
        raise OptionError(f"detail is {detail}; it must be a number above 0, such as 2")
    if tau is not None and detail != 1:
        raise OptionError(
            f"detail {detail:g} is a factor on the automatic tau, and tau {tau:g} is a number: "
            "leave one out"
        )
    solver, spare, of_prior = _solver(
        method, quality, tau, trained_prior(prior), iterations, tolerance, device
    )
    frame, own = _measured(measurement, bin_by)
    pixel_rad = measurement.pixel_rad if isinstance(measurement, SimulatedMeasurement) else None
    folder = PsfFolder(Path(psf)) if isinstance(psf, (str, Path)) and Path(psf).is_dir() else None
    psfs = _psfs_of(psf, folder, distance, field_points)
    point = psfs.ahead
    development = Development(
        point,
        None if dark is None else frame_of(dark, "dark frame"),
        None if flat is None else frame_of(flat, "flat field"),
        black_level(black, point),
        white,
        1 if bin_by is None else bin_by,
        channels,
        field_points=psfs.field_points,
        alone=psfs.alone,
    )
    extent: Extent = "auto" if psf_extended is None else ("wide" if psf_extended else "sensor")
    choice = choose_psf(development, frame, PsfSettings(psf_scale, extent, psf_flip or "auto"))
    stated = own if support == "auto" else None if support == "full" else support
    developed = choice.development.fitted(frame, spare, coarsen=bin_by is None and stated is None)
    data, prepared = developed.measurement, developed.prepared
    solver = replace(solver, psf=prepared.values, support=support_of(stated, data.size))
    solver = replace(solver, field_psf=developed.development.field_psf(data))
    chosen_support, everywhere = support == "auto" and own is None, False
    if chosen_support:
        acceptance = _acceptance(psf, distance, developed)
        light = solver.choose_support(data, acceptance=acceptance)
        solver, everywhere = replace(solver, support=light.support), light.is_acceptance
    over_field = FieldChoice(solver)
    if field_points is None:
        over_field = choose_field(solver, data, developed.development.psf_alone(data))
    solver = over_field.reconstructor
    slow = prior == Prior.AUTO and solver.takes_minutes(len(data.channels), data.size)
    if slow:
        solver = replace(solver, prior=Prior.AUTO)
    remedy, of_memory = "a smaller support or larger pixels (bin_by) need less", list[str]()
    solver = mapped_where_needed(solver, data, remedy, of_memory.append)
    limit = solver.limits.iterations
    chosen = _CHOICE if tau is None else 0.0
    clock = Clock()
    weight = None
    uncovered: list[str] = []
    if folder is not None:
        scene = None if everywhere else support_of(solver.support, data.size)
        merged = developed.development.merged
        asked = [
            *([] if support in ("auto", "full") else [f"support {support}"]),
            *([] if field_points is None else [f"field_points {field_points}"]),
        ]
        uncovered = folder.coverage_warnings(
            solver.field_psf, scene, data.size, merged, " and ".join(asked)
        )
    with reported(progress, "photograph") as advance:
        if tau is None:

            def choosing(fraction: float) -> None:
                advance(chosen * fraction)

            weight = solver.choose_weight(data, progress=choosing)
            solver = solver.with_detail(weight, detail)
        support_by: SupportBy = "measurement" if support == "auto" else "person"
        support_by = "camera" if everywhere else support_by
        explanation = explain(solver, data, weight, point.source, support_by=support_by)
        problem = solver.problem(data)

        def watch(step: Iteration) -> None:
            advance(min(chosen + (1 - chosen) * step.iteration / limit, 1.0))

        result = solver.solve(problem, callback=watch)
        advance(1.0)
    report = Report.of(
        problem,
        result,
        tensor_of(solver.psf, "PSF"),
        # Held-out pixels were predicted by total variation.
        prediction=None if result.first is not None else explanation.prediction,
        method=solver.method_name,
        automatic_tau=tau is None,
        automatic_support=chosen_support,
        acceptance=everywhere,
        seconds=clock.seconds,
        left_out=over_field.left_out,
        pixel_rad=None if pixel_rad is None else developed.development.bin_by * pixel_rad,
    )
    picture = window_of(result.scene, problem.sensor_frame) if chosen_support else result.photograph
    notes = (
        *psfs.notes,
        *choice.notes,
        *(developed.notes if bin_by is None else ()),
        *prepared.notes,
        *of_memory,
        *([SLOW_PRIOR] if slow else []),
        *([] if of_prior is None else [of_prior]),
    )
    doubt = detail_warning(result, report.frequency)
    warnings = (
        *prepared.warnings,
        *([] if doubt is None else [doubt]),
        *over_field.warnings,
        *uncovered,
        *explanation.warnings,
        *picture_warnings(problem, result, prepared.values, iterations),
    )
    photograph = Photograph(
        picture.cpu(), data.channels, result, problem.weight, report, notes, warnings
    )
    if uncertainty is None:
        return photograph
    with reported(progress, "samples of the uncertainty") as advance:
        samples = measure_uncertainty(solver, problem, result, uncertainty, progress=advance)
    assert samples is not None
    window = problem.sensor_frame if chosen_support else problem.frame

    def written(scene: torch.Tensor) -> torch.Tensor:
        return window_of(scene, window).cpu()

    other = samples.disagreement
    return replace(
        photograph,
        spread=written(samples.spread),
        disagreement=None if other is None else written(other),
    )


def refocus(
    measurement: Raw,
    psfs: Mapping[str | Length, Raw],
    distance: str | Length | None = None,
    *,
    at: tuple[int, int] | None = None,
    support: Support | None = None,
    dark: Raw | None = None,
    tau: float | None = None,
    prior: Prior | str = Prior.TV,
    iterations: int = 100,
    device: torch.device | str = "cpu",
    progress: Progress = False,
) -> Photograph:
    """Focus one measurement at any distance, from the PSFs of a few (`asif2017`).

    Parameters
    ----------
    measurement
        As `reconstruct` takes it.
    psfs
        By the distance of their point sources, such as ``{"8cm": near, "50cm": far}``; two at the
        least. Those of several field points are used together once the distance is known.
    distance
        To focus at, or ``"infinity"``; None finds the sharpest between those of the PSFs.
    at
        Row and column of the photograph that is to be sharp; None for all of it.
    support, dark, tau, prior, iterations, device, progress
        As `reconstruct` takes them.

    Raises
    ------
    NolensError
        If the data do not fit together or a parameter cannot be used.
    """
    if len(psfs) < 2:
        raise OptionError("give PSFs of two distances or more, such as {'8cm': near, '50cm': far}")
    frame, own = _measured(measurement)
    dark_frame = None if dark is None else frame_of(dark, "dark frame")
    known: list[PsfAt] = []
    over_field: dict[float, FieldPsf | None] = {}
    warnings, notes = list[str](), list[str]()
    data = None
    for each, psf in psfs.items():
        point = frame_of(psf, f"PSF of {each}")
        development = Development(point, dark_frame, field_points=_field_points(psf, None))
        development = choose_psf(development, frame).development
        data = development.measurement(frame) if data is None else data
        prepared = development.prepared(data)
        warnings += prepared.warnings
        known.append(PsfAt(prepared.values, distance_um(each)))
        over_field[known[-1].distance_um] = development.field_psf(data)
    assert data is not None
    reduced_um = measured_reduced_um(known)
    if reduced_um is None:
        raise OptionError(
            "the PSFs are as large as each other, so they do not show how the PSF changes with the "
            "distance: give one of a much nearer point source"
        )
    depth_psfs = DepthPsfs.of(known, reduced_um, data, warnings=warnings)
    if distance is not None:
        depth_psfs.check_depths([distance_um(distance)], f"distance {distance}")
    if any(over_field.values()):
        # In air a PSF is magnified alike at all angles, whatever the pixels' pitch.
        of_depths = DepthField(over_field, Layers.of_air(reduced_um), 1.0)
        depth_psfs = replace(depth_psfs, field=of_depths)
    support = support_of(own if support is None else support, data.size)
    reconstructor = DepthReconstructor(
        data, support, tau, one_of(Prior, prior, "prior"), iterations, device=device
    )
    farthest_um = depth_psfs.distances_um[-1]
    largest = reconstructor.at(depth_psfs.at(farthest_um), depth_psfs.field_at(farthest_um))
    largest = mapped_where_needed(largest, data, "a smaller support needs less", notes.append)
    reconstructor = replace(reconstructor, mapped=largest.mapped)
    weighed_um = depth_psfs.middle_um if distance is None else distance_um(distance)
    reconstructor = reconstructor.weighted(depth_psfs.at(weighed_um))
    assert reconstructor.tau is not None
    distances = depth_psfs.distances_um
    searching = 0.8 if distance is None else 0.0
    with reported(progress, "photograph") as advance:

        def watch_search(done: int, limit: int) -> bool:
            advance(searching * done / limit)
            return False

        def watch(done: int, limit: int) -> bool:
            advance(searching + (1 - searching) * done / limit)
            return False

        focused = focus(
            reconstructor,
            depth_psfs,
            (distances[0], distances[-1]) if distance is None else distance_um(distance),
            None if at is None else (float(at[0]), float(at[1])),
            search_step=watch_search,
            step=watch,
        )
        advance(1.0)
    result = focused.result
    return Photograph(
        result.photograph.cpu(),
        data.channels,
        result,
        reconstructor.tau,
        notes=tuple(notes),
        warnings=depth_psfs.warnings,
        distance_um=focused.depth_um,
    )


class _Psfs(NamedTuple):
    """The PSF straight ahead, those over the field, what is left out, the one in their place."""

    ahead: Frame
    field_points: tuple[FieldPoint, ...] = ()
    notes: tuple[str, ...] = ()
    alone: Frame | None = None


def _psfs_of(
    psf: Raw, folder: PsfFolder | None, distance: str | Length | None, most: int | None
) -> _Psfs:
    """What a PSF holds: a file or an array one, a folder or a computed one perhaps several."""
    if most is not None and most < 1:
        raise OptionError(f"field_points is {most}: give a whole number from 1 on")
    if folder is not None:
        found = folder.for_scene(None if distance is None else distance_um(distance), most)
        notes = (found.note,) if found.note else ()
        return _Psfs(found.ahead, found.field_points, notes, found.alone)
    single = not isinstance(psf, Psf) or psf.field_psf is None
    if distance is not None or (single and most not in (None, 1)):
        raise OptionError(
            "distance and field_points choose from a camera's folder, field_points also from the "
            "PSFs of psf(field_points=3) or stitch_psfs; this is a single PSF: leave them out"
        )
    return _Psfs(frame_of(psf, "PSF"), _field_points(psf, most))


def _field_points(psf: Raw, most: int | None) -> tuple[FieldPoint, ...]:
    """Those of a computed PSF, at most so many; none where there is one, or one is to be used."""
    field_psf = psf.field_psf if isinstance(psf, Psf) else None
    if field_psf is None or most == 1:
        return ()
    places = [(float(row), float(column)) for row, column in field_psf.places]
    chosen = spread(places, len(places) if most is None else most)
    frames = [frame_of(field_psf.values[number], "PSF") for number in chosen]
    return tuple(map(FieldPoint, frames, [places[number] for number in chosen]))


def _acceptance(
    psf: Raw, distance: str | Length | None, developed: Developed
) -> PixelRectangle | None:
    """Pixels whose light the camera accepts, where its description lies beside the PSF."""
    if not isinstance(psf, (str, Path)):
        return None
    path, by, size = Path(psf), developed.development.bin_by, developed.measurement.size
    loaded = camera_of(None, path if path.is_dir() else path.parent, by, size)
    if loaded is None:
        return None
    nearest_um = None if distance is None else distance_um(distance)
    return acceptance_of(loaded, by, size, developed.prepared.values, nearest_um)


def _measured(measurement: Raw, bin_by: int | None = None) -> tuple[Frame, Support | None]:
    """The frame of a measurement, and the support where it is a simulated one."""
    if isinstance(measurement, SimulatedMeasurement):
        return measurement.frame, measurement.binned_support(bin_by or 1)
    return frame_of(measurement, "measurement"), None


def _solver(
    method: Method | str | None,
    quality: Quality | str | None,
    tau: float | None,
    prior: Prior | str | ScenePrior | PlugAndPlay,
    iterations: int | None,
    tolerance: float | None,
    device: torch.device | str,
) -> tuple[Reconstructor, int, str | None]:
    """The solver, still without a PSF; how much finer than the PSF pixels are worth to be; and what
    is said of its prior.
    """
    if method is not None and quality is not None:
        raise OptionError(
            f"method {method} and quality {quality} both choose how to solve: leave one out"
        )
    preset = None if quality is None else one_of(Quality, quality, "quality")
    if preset is not None:
        solver = Method.WIENER if preset is Quality.DRAFT else Method.ADMM
    else:
        solver = Method.ADMM if method is None else one_of(Method, method, "method")
    stop = stop_of(solver, preset, iterations=iterations, tolerance=tolerance)
    note = None
    if prior == Prior.AUTO:
        minimiser = {
            "method": solver is not Method.ADMM and preset is None,
            "quality": preset not in (None, Quality.PHOTO),
            "tau": tau is not None,
            "iterations": iterations is not None,
            "tolerance": tolerance is not None,
        }
        note = by_total_variation([name for name, stated in minimiser.items() if stated])
        prior = PHOTO_PRIOR if note is None else prior
    empty = torch.empty(0)
    reconstructor = Reconstructor(empty, None, tau, prior, solver, stop, device=device)
    return reconstructor, SPARE[solver], None if solver is Method.WIENER else note
