"""Fig. 6: two points, a Siemens star, and how PSFs and dots change with the field angle."""

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from nolens.errors import NolensError
from nolens.evaluate import (
    Dot,
    FlatPicture,
    ObservedPair,
    PointPair,
    ResolvedSeparation,
    StarResolution,
    TwoPoints,
    siemens_star,
    star_square_deg,
)
from nolens.experiments.dot_grid import dot_grid
from nolens.experiments.off_axis import OffAxis, falls_to, off_axis, ray_curves
from nolens.experiments.resolution import ScreenTarget, SolverSettings, TwoPointTarget
from nolens.files.plot_measurements import (
    draw_star,
    draw_two_points,
    write_angles_plot,
    write_dots_plot,
)
from nolens.files.reports import ReportRow
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.progress import ProgressCallback, within
from nolens.reproduction.comparison import PAPER, Content, Picture, Results, paper_row, section
from nolens.reproduction.setup import PINHOLE_UM, SCREEN_UM, TAU, ExperimentSetup
from nolens.reproduction.steps import Step, StepResult

_POINTS_UM = 180e3
_PERIODS = 36
_STAR_DEG = 20.0
_EXPECTED_PAIRS = 8
_PAPERS_PITCH_UM = 2300.0
_PAPERS_EXTENT_DEG = 10.0
_PITCH_DEG = 3.0
_STEP_DEG = 2.5
_LARGEST_DEG = 50.0
_LEVELS = {"correlation 0.6": 0.6, "correlation 0.3": 0.3}
_OVERLAP_DEG = 10.0


def steps(setup: ExperimentSetup) -> tuple[Step, ...]:
    """Two points, a star, PSFs from the side and the dots."""
    return (*_target_steps(setup), *_field_steps(setup))


def _target_steps(setup: ExperimentSetup) -> tuple[Step, ...]:
    size = setup.size
    pairs = _EXPECTED_PAIRS * size.point_draws
    support = PixelRectangle.centred(64, 64, setup.preview.shape)
    channels = len(setup.loaded.camera.sensor.channels)
    one = setup.solve_work(support, size.point_iterations) / channels
    points = pairs * (2 * setup.psf_work() + one)
    star = setup.scene_work() + setup.solve_work(support, size.iterations) / channels
    return (
        Step(
            "two-points",
            "fig. 6a: two points",
            setup.parameters(distance_um=_POINTS_UM, tau=TAU),
            points,
            lambda progress: _points(setup, progress),
        ),
        Step(
            "siemens",
            "fig. 6b: a Siemens star",
            setup.parameters(periods=_PERIODS, angle_deg=_STAR_DEG, tau=TAU),
            star,
            lambda progress: _star(setup, progress),
        ),
    )


def _points(setup: ExperimentSetup, progress: ProgressCallback) -> StepResult:
    """Dips by separation, with a picture of each."""
    settings = SolverSettings(setup.size.point_iterations, TAU, seed=setup.seed)
    target = TwoPointTarget(_POINTS_UM, draws=setup.size.point_draws)
    points = target.measure(setup.experiment, settings, progress)
    figures: dict[str, Any] = {
        "separations_deg": points.separations_deg,
        "dips": points.dips,
        "noise": points.noise,
        "threshold": points.threshold,
        "resolved": asdict(points.resolved),
        "pairs": [
            {
                "separation_deg": each.separation_deg,
                **asdict(each.pair),
                "at": each.pair.at.tolist(),
                "trace": each.pair.trace.tolist(),
            }
            for each in points.pairs
        ],
    }
    return StepResult(
        figures, {f"pair-{n}": each.picture[None].float() for n, each in enumerate(points.pairs)}
    )


def _read_points(result: StepResult) -> TwoPoints:
    """The pictures of two points, from what is stored of them."""
    figures = result.figures
    pairs = tuple(
        ObservedPair(
            each["separation_deg"],
            PointPair(
                each["dip"],
                each["separation"],
                each["direction_deg"],
                torch.tensor(each["at"]),
                torch.tensor(each["trace"]),
            ),
            result.arrays[f"pair-{number}"][0],
        )
        for number, each in enumerate(figures["pairs"])
    )
    return TwoPoints(
        tuple(figures["separations_deg"]),
        tuple(figures["dips"]),
        tuple(figures["noise"]),
        ResolvedSeparation(**figures["resolved"]),
        figures["threshold"],
        pairs,
    )


def _star(setup: ExperimentSetup, progress: ProgressCallback) -> StepResult:
    """The picture of the star, and what is resolved in it."""
    settings = SolverSettings(setup.size.iterations, TAU, seed=setup.seed)
    # A star this small needs no more PSFs than change over it.
    experiment = replace(setup.experiment, field_points=3)
    drawing = partial(siemens_star, periods=_PERIODS)
    target = ScreenTarget(drawing, star_square_deg(_STAR_DEG), SCREEN_UM)
    picture = target.measure(experiment, settings, progress)
    star = StarResolution.of(picture, periods=_PERIODS)
    figures: dict[str, Any] = {
        "resolved_deg": star.resolved_everywhere_deg,
        "plus_minus_deg": star.plus_minus_deg[star.worst],
        "by_direction_deg": dict(
            zip(map(str, star.star.directions_deg.tolist()), star.resolved_deg, strict=True)
        ),
        "tangent": star.picture.tangent,
        "axis": list(star.picture.axis),
    }
    return StepResult(figures, {"picture": star.picture.values[None].float()})


def _read_star(result: StepResult) -> StarResolution:
    """The star, from what is stored of it."""
    row, column = result.figures["axis"]
    picture = FlatPicture(
        result.arrays["picture"][0].double(), result.figures["tangent"], (row, column)
    )
    return StarResolution.of(picture, periods=_PERIODS)


@section("two-points", "Fig. 6a: two points", ("two points",), ("two-points",))
def two_points(setup: ExperimentSetup, results: Results) -> Content:
    """The smallest angle between two points with a dip between them."""
    points = _read_points(results["two-points"])
    value = points.resolved.value
    off = points.resolved.plus_minus
    text = "–" if value is None else f"{value:.2f}°" + ("" if off is None else f" ± {off:.2f}°")
    twin = setup.preview
    pixel_deg = math.degrees(math.atan(twin.pixel_um / twin.stack().reduced_um))
    row = paper_row(
        "two points",
        value,
        text,
        f"Rayleigh's criterion, a dip of {100 * points.threshold:.1f} %, in pictures of two points "
        f"at {_POINTS_UM * 1e-3:g} mm, {setup.size.point_draws} of each separation with other "
        f"noise, {setup.size.point_iterations} iterations. A scene of two points is what a sparse, "
        "non-negative solver does best, and its model is exact here: a pixel of "
        f"{twin.pixel_um:g} µm sees {pixel_deg:.2f}°. The paper's LEDs have a size, its PSF is a "
        "captured one, and it moves LEDs in steps that it does not give.",
        sized=True,
    )
    caption = (
        "Reconstructions of two points, the light along the line through them, and the dip by "
        "separation."
    )
    picture = Picture("two-points", caption, partial(draw_two_points, points), 150.0)
    return Content((row,), (picture,))


@section("siemens", "Fig. 6b: a Siemens star", ("siemens",), ("siemens",))
def siemens(setup: ExperimentSetup, results: Results) -> Content:
    """The smallest pair of spokes that is resolved in all directions."""
    figures = results["siemens"].figures
    star = _read_star(results["siemens"])
    value = figures["resolved_deg"]
    best = min(figures["by_direction_deg"].values())
    row = paper_row(
        "siemens",
        value,
        f"{value:.2f}° ± {figures['plus_minus_deg']:.2f}°",
        f"Angle of a bright spoke and the dark one beside it where the contrast falls to "
        f"{100 * star.threshold:.0f} % of that of wide spokes, in the worst of all directions "
        f"(in the best, {best:.2f}°); one spoke alone is half of it. {_PERIODS} pairs of spokes "
        f"filling {_STAR_DEG:g}° at 300 mm. The paper says neither which of the two angles it "
        "means nor what contrast counts, so the ratio is no better than a factor of two. Flat "
        "bright and dark spokes are what total variation does best: a scene of fine texture is "
        "resolved less well.",
        sized=True,
    )
    caption = "The star as it is reconstructed, its contrast by frequency and direction."
    picture = Picture("siemens", caption, partial(draw_star, star), 165.0)
    return Content((row,), (picture,))


def _field_steps(setup: ExperimentSetup) -> tuple[Step, ...]:
    angles = _angles_deg(setup)
    side = round(2 * _extent_pixels(setup))
    support = PixelRectangle.centred(side, side, setup.preview.shape)
    scene = setup.scene_work(setup.size.dot_field_points)
    return (
        Step(
            "off-axis",
            "fig. 6c: PSFs from the side",
            setup.parameters(angles_deg=angles),
            (len(angles) + 1) * setup.psf_work(),
            lambda progress: _correlated(setup, progress),
        ),
        Step(
            "dots",
            "fig. 6d: a grid of dots",
            setup.parameters(pitch_deg=_PITCH_DEG),
            1.3 * (scene + setup.solve_work(support, setup.size.iterations)),
            lambda progress: _dots(setup, progress),
        ),
    )


def _angles_deg(setup: ExperimentSetup) -> list[float]:
    """To the right, up to where the model ends."""
    step = _STEP_DEG * setup.size.angle_steps
    return [number * step for number in range(1, int(_LARGEST_DEG / step) + 1)]


def _extent_pixels(setup: ExperimentSetup) -> float:
    twin = setup.preview
    return (
        math.tan(math.radians(setup.size.dot_extent_deg)) * twin.stack().reduced_um / twin.pixel_um
    )


def _correlated(setup: ExperimentSetup, progress: ProgressCallback) -> StepResult:
    """Correlation, overlap and light of a point source at every angle."""
    psfs = off_axis(
        setup.experiment,
        _angles_deg(setup),
        distance_um=SCREEN_UM,
        diameter_um=PINHOLE_UM,
        seed=setup.seed,
        progress=progress,
    )
    return StepResult({"off_axis": [asdict(each) for each in psfs]})


def _dots(setup: ExperimentSetup, progress: ProgressCallback) -> StepResult:
    """A grid as far as the model goes; and the paper's own, fine one in the middle of the field."""
    experiment = replace(setup.experiment, field_points=setup.size.dot_field_points)
    pitch_um = math.tan(math.radians(_PITCH_DEG)) * SCREEN_UM
    wide = dot_grid(
        experiment,
        pitch_um=pitch_um,
        distance_um=SCREEN_UM,
        extent_deg=setup.size.dot_extent_deg,
        iterations=setup.size.iterations,
        seed=setup.seed,
        progress=within(progress, 0.0, 0.8),
    )
    figures: dict[str, Any] = {
        "good_deg": wide.angles.good_deg,
        "distorted_deg": wide.angles.distorted_deg,
        "lost_deg": wide.angles.lost_deg,
        "pixel_deg": wide.pixel_deg,
        "pitch_mm": pitch_um * 1e-3,
        "dots": [asdict(each) for each in wide.dots],
    }
    try:
        fine = dot_grid(
            replace(experiment, field_points=3),
            pitch_um=_PAPERS_PITCH_UM,
            distance_um=SCREEN_UM,
            extent_deg=min(_PAPERS_EXTENT_DEG, setup.size.dot_extent_deg),
            iterations=setup.size.iterations,
            seed=setup.seed,
            progress=within(progress, 0.8, 0.2),
        )
        grades = [each.grade for each in fine.dots]
        figures["papers_pitch"] = {
            grade: grades.count(grade) for grade in ("good", "distorted", "lost")
        }
    except NolensError as error:
        figures["papers_pitch"] = {"refused": str(error)}
    return StepResult(figures, {"picture": wide.picture[None].float()})


@section("off-axis", "Fig. 6c: PSFs from the side", (*_LEVELS, "overlap"), ("off-axis",))
def off_axis_psfs(setup: ExperimentSetup, results: Results) -> Content:
    """How alike PSFs from the side are to the central one."""
    measured = results["off-axis"].figures["off_axis"]
    curves = {name: [each[name] for each in measured] for name in measured[0]}
    at = [0.0, *curves["angle_deg"]]
    names = ("correlation", "correlation_one_exposure", "correlation_overlap")
    frames, exposed, overlap = ([1.0, *curves[name]] for name in names)
    rows = []
    for (key, level), why in zip(_LEVELS.items(), _reasons(at, overlap), strict=True):
        papers_deg = PAPER[key].value or 0.0
        text = (
            f"{_where(level, at, exposed, papers_deg)} at one exposure; "
            f"{_where(level, at, frames, papers_deg)} by each frame's own norm"
        )
        rows.append(paper_row(key, falls_to(level, at, exposed), text, why, sized=True))
    rows.append(_overlap(setup))
    caption = (
        "Peak of the cross-correlation with the central PSF by angle: of the frames, each by its "
        "own norm; of frames of one exposure, over the peak of the central one with itself; and of "
        "their overlap alone. Beside them the overlap by rays, and the light that is left."
    )
    draw = partial(
        write_angles_plot,
        psfs=[OffAxis(**each) for each in measured],
        rays=ray_curves(setup.preview, at[-1], SCREEN_UM),
        levels=tuple(_LEVELS.values()),
    )
    return Content(tuple(rows), (Picture("off-axis", caption, draw, 165.0),))


def _where(level: float, at: list[float], values: list[float], papers_deg: float) -> str:
    angle = falls_to(level, at, values)
    text = f"beyond {at[-1]:g}°" if angle is None else f"{angle:.1f}°"
    return f"{text} ({float(np.interp(papers_deg, at, values)):.2f} at {papers_deg:g}°)"


def _reasons(at: list[float], overlap: list[float]) -> tuple[str, str]:
    """What the two measures count."""
    return (
        "The paper does not write its measure down, but names vignetting as the first cause of the "
        "fall. Frames of one exposure, compared by the norm of the central one, count it; by each "
        "frame's own norm brightness does not matter, and the values fall by what leaves the frame "
        f"and by aberration alone. Over the part that both frames share they are {overlap[-1]:.2f} "
        f"even at {at[-1]:g}°, so that is mostly the cropping, of which a smaller sensor has more. "
        "That the paper's measure is the first is the likely reason of its steep fall.",
        "As above. The ratio is that at one exposure; it goes with the pixels' acceptance, whose "
        "curve is a placeholder. Lenslets that are spread evenly, as here, change least of all "
        "masks with the angle; features of a real diffuser are finer and less even.",
    )


def _overlap(setup: ExperimentSetup) -> ReportRow:
    """By the chief ray over the whole sensor, whatever part of it is read."""
    sensor = setup.loaded.camera.sensor
    tangent = math.tan(math.radians(_OVERLAP_DEG))
    moved_mm = setup.preview.shift_um(PointSource((0.0, tangent)))[1] * 1e-3
    width_mm, height_mm = (count * sensor.pitch.mm for count in (sensor.columns, sensor.rows))
    wide, high = 100 * moved_mm / width_mm, 100 * moved_mm / height_mm
    printed = (PAPER["overlap"].value or 0.0) / 100
    return paper_row(
        "overlap",
        wide,
        f"{wide:.1f} % of the width, {high:.1f} % of the height",
        f"The chief ray at 10° moves by {moved_mm:.3f} mm on the sensor of {width_mm:.2f}×"
        f"{height_mm:.2f} mm, through the layers by Snell's law; moved both ways at once, "
        f"{wide + high - wide * high / 100:.1f} % are lost. The paper's {100 * printed:.1f} % "
        f"would be {printed * width_mm:.2f} mm across or {printed * height_mm:.2f} mm up, which "
        "no ray does in its stack; it does not say how it counts.",
    )


@section("dots", "Fig. 6d: a grid of dots", ("dots clear", "dots lost"), ("dots",))
def dots(setup: ExperimentSetup, results: Results) -> Content:
    """Up to which angle dots are clear, and from which they are lost."""
    figures = results["dots"].figures
    listed = [Dot(**each) for each in figures["dots"]]
    extent = setup.size.dot_extent_deg
    good, lost = figures["good_deg"], figures["lost_deg"]
    rows = (
        paper_row(
            "dots clear",
            None if good is None else 2 * good,
            "none" if good is None else f"{2 * good:.0f}°",
            "Full angle up to which dots are less than √2 as wide as in the middle, less than "
            "half a width off the place where Snell's law puts them, and have more than half of "
            "the light expected there. The paper judges by eye.",
            sized=True,
        ),
        paper_row(
            "dots lost",
            None if lost is None else 2 * lost,
            f"beyond {2 * extent:.0f}°" if lost is None else f"{2 * lost:.0f}°",
            "Full angle from which on dots do not stand five times the clutter above it, or have "
            f"less than a tenth of the light expected. {_left(listed, lost)} The clutter grows "
            "with the number of dots and the noise, so this limit belongs to this scene. Both "
            "angles are larger than the paper's: a PSF of evenly spread lenslets keeps its form "
            "with the angle (fig. 6c, by each frame's own norm), which that of a real diffuser "
            "does less.",
            sized=True,
        ),
    )
    caption = (
        f"Dots {figures['pitch_mm']:.1f} mm ({_PITCH_DEG:g}°) apart at "
        f"{SCREEN_UM * 1e-3:g} mm, up to a half angle of {extent:g}°, "
        "reconstructed with the central PSF; each ring is where Snell's law puts a dot."
    )
    draw = partial(
        write_dots_plot,
        dots=listed,
        picture=results["dots"].arrays["picture"][0],
        good_deg=good,
        lost_deg=lost,
    )
    texts = (_pitch_text(figures["papers_pitch"]),)
    return Content(rows, (Picture("dots", caption, draw),), texts)


def _left(dots: list[Dot], lost_deg: float | None) -> str:
    """Light where dots are lost."""
    if lost_deg is None:
        return ""
    nearest = min(dots, key=lambda dot: abs(dot.angle_deg - lost_deg))
    return (
        f"Where that is, dots have {100 * nearest.expected_light:.0f} % of the light of the middle "
        "ones (cos⁴, reflection and the pixels' acceptance, whose curve is a placeholder), and "
        "sink into the clutter of the brighter ones."
    )


def _pitch_text(fine: Mapping[str, object]) -> str:
    """What becomes of the paper's own pitch."""
    pitch_deg = math.degrees(math.atan(_PAPERS_PITCH_UM / SCREEN_UM))
    text = (
        f"The paper's dots are 2.3 mm apart at 300 mm: {pitch_deg:.2f}°, less than the "
        f"{PAPER['two points'].text} that it finds two points told apart at, and a grid of "
        "them up to 76° has more than 30 000. "
    )
    if "refused" in fine:
        return text + (
            "In the middle 20° of the field no such grid can be made out here either, so a "
            "coarser one stands for it."
        )
    total = sum(int(str(each)) for each in fine.values())
    return text + (
        f"In the middle 20° of the field, {fine['good']} of {total} such dots come out clear here, "
        f"{fine['distorted']} distorted and {fine['lost']} are lost; for the whole field a coarser "
        "grid stands for them."
    )
