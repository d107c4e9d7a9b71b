"""Fig. 6c and d: how PSFs and dots change with the field angle."""

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from nolens.errors import NolensError
from nolens.evaluate import Dot
from nolens.experiments.dot_grid import dot_grid
from nolens.experiments.off_axis import falls_to, off_axis, ray_curves
from nolens.files.plot_measurements import write_angles_plot, write_dots_plot
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.reproduction.draft import Draft, Drawn, empty, refusal
from nolens.reproduction.paper import PAPER
from nolens.reproduction.rows import Row
from nolens.reproduction.steps import Found, Step, Tick, within
from nolens.reproduction.workbench import PINHOLE_UM, SCREEN_UM, Workbench

PAPERS_PITCH_UM = 2300.0
_PAPERS_REACH_DEG = 10.0
PITCH_DEG = 3.0
_STEP_DEG = 2.5
_LARGEST_DEG = 50.0
_LEVELS = {"correlation 0.6": 0.6, "correlation 0.3": 0.3}
_OVERLAP_DEG = 10.0


def steps(work: Workbench) -> tuple[Step, ...]:
    """Correlation by angle, and the dots."""
    angles = angles_deg(work)
    side = round(2 * _reach_cells(work))
    region = Region.centred(side, side, work.preview.shape)
    scene = work.scene_work(work.size.dot_field_points)
    return (
        Step(
            "off-axis",
            "fig. 6c: PSFs from the side",
            work.parameters(angles_deg=angles),
            (len(angles) + 1) * work.psf_work(),
            lambda tick: _correlated(work, tick),
        ),
        Step(
            "dots",
            "fig. 6d: a grid of dots",
            work.parameters(pitch_deg=PITCH_DEG),
            1.3 * (scene + work.solve_work(region, work.size.iterations)),
            lambda tick: _dots(work, tick),
        ),
    )


def angles_deg(work: Workbench) -> list[float]:
    """To the right, up to where the model ends."""
    step = _STEP_DEG * work.size.angle_steps
    return [number * step for number in range(1, int(_LARGEST_DEG / step) + 1)]


def _reach_cells(work: Workbench) -> float:
    twin = work.preview
    return math.tan(math.radians(work.size.dot_reach_deg)) * twin.stack().reduced_um / twin.pixel_um


def _correlated(work: Workbench, tick: Tick) -> Found:
    """Correlation, overlap and light of a point source at every angle."""
    found = off_axis(
        work.bench,
        angles_deg(work),
        distance_um=SCREEN_UM,
        diameter_um=PINHOLE_UM,
        seed=work.seed,
        tick=tick,
    )
    return Found({"off_axis": [asdict(each) for each in found]})


def _dots(work: Workbench, tick: Tick) -> Found:
    """A grid as far as the model goes; and the paper's own, fine one in the middle of the field."""
    bench = replace(work.bench, field_points=work.size.dot_field_points)
    pitch_um = math.tan(math.radians(PITCH_DEG)) * SCREEN_UM
    wide = dot_grid(
        bench,
        pitch_um=pitch_um,
        distance_um=SCREEN_UM,
        reach_deg=work.size.dot_reach_deg,
        iterations=work.size.iterations,
        seed=work.seed,
        tick=within(tick, 0.0, 0.8),
    )
    figures: dict[str, Any] = {
        "good_deg": wide.good_deg,
        "distorted_deg": wide.distorted_deg,
        "lost_deg": wide.lost_deg,
        "cell_deg": wide.cell_deg,
        "pitch_mm": pitch_um * 1e-3,
        "dots": [asdict(each) for each in wide.dots],
    }
    try:
        fine = dot_grid(
            replace(bench, field_points=3),
            pitch_um=PAPERS_PITCH_UM,
            distance_um=SCREEN_UM,
            reach_deg=min(_PAPERS_REACH_DEG, work.size.dot_reach_deg),
            iterations=work.size.iterations,
            seed=work.seed,
            tick=within(tick, 0.8, 0.2),
        )
        grades = [each.grade for each in fine.dots]
        figures["papers_pitch"] = {
            grade: grades.count(grade) for grade in ("good", "distorted", "lost")
        }
    except NolensError as error:
        figures["papers_pitch"] = {"refused": str(error)}
    return Found(figures, {"picture": wide.picture[None].float()})


def angles(work: Workbench, found: Mapping[str, Found]) -> Draft:
    """Likeness of PSFs from the side to the central one."""
    title = "Fig. 6c: PSFs from the side"
    keys = (*_LEVELS, "overlap")
    reason = refusal(found, ("off-axis",))
    if reason is not None:
        return empty("off-axis", title, keys, reason)
    measured = found["off-axis"].figures["off_axis"]
    curves = {name: [each[name] for each in measured] for name in measured[0]}
    at = [0.0, *curves["angle_deg"]]
    names = ("correlation", "correlation_one_exposure", "correlation_overlap")
    frames, exposed, shared = ([1.0, *curves[name]] for name in names)
    rows = []
    for (key, level), why in zip(_LEVELS.items(), _reasons(at, shared), strict=True):
        papers_deg = PAPER[key].value or 0.0
        text = (
            f"{_where(level, at, exposed, papers_deg)} at one exposure; "
            f"{_where(level, at, frames, papers_deg)} by each frame's own norm"
        )
        rows.append(Row(key, falls_to(level, at, exposed), text, why, sized=True))
    rows.append(_overlap(work))
    caption = (
        "Peak of the cross-correlation with the central PSF by angle: of the frames, each by its "
        "own norm; of frames of one exposure, over the peak of the central one with itself; and of "
        "their overlap alone. Beside them the overlap by rays, and the light that is left."
    )
    draw = partial(
        write_angles_plot,
        curves=curves,
        rays=ray_curves(work.preview, at[-1], SCREEN_UM),
        levels=tuple(_LEVELS.values()),
    )
    return Draft("off-axis", title, (), (Drawn("off-axis", caption, draw, 165.0),), tuple(rows))


def _where(level: float, at: list[float], values: list[float], papers_deg: float) -> str:
    angle = falls_to(level, at, values)
    text = f"beyond {at[-1]:g}°" if angle is None else f"{angle:.1f}°"
    return f"{text} ({float(np.interp(papers_deg, at, values)):.2f} at {papers_deg:g}°)"


def _reasons(at: list[float], shared: list[float]) -> tuple[str, str]:
    """What the two measures count."""
    return (
        "The paper does not write its measure down, but names vignetting as the first cause of the "
        "fall. Frames of one exposure, compared by the norm of the central one, count it; by each "
        "frame's own norm brightness does not matter, and the values fall by what leaves the frame "
        f"and by aberration alone. Over the part that both frames share they are {shared[-1]:.2f} "
        f"even at {at[-1]:g}°, so that is mostly the cropping, of which a smaller sensor has more. "
        "That the paper's measure is the first is the likely reason of its steep fall.",
        "As above. The ratio is that at one exposure; it goes with the pixels' acceptance, whose "
        "curve is a placeholder. Lenslets that are spread evenly, as here, change least of all "
        "masks with the angle; features of a real diffuser are finer and less even.",
    )


def _overlap(work: Workbench) -> Row:
    """By the chief ray over the whole sensor, whatever part of it is read."""
    sensor = work.opened.camera.sensor
    tangent = math.tan(math.radians(_OVERLAP_DEG))
    moved_mm = work.preview.shift_um(PointSource((0.0, tangent)))[1] * 1e-3
    width_mm, height_mm = (count * sensor.pitch.mm for count in (sensor.columns, sensor.rows))
    wide, high = 100 * moved_mm / width_mm, 100 * moved_mm / height_mm
    printed = (PAPER["overlap"].value or 0.0) / 100
    return Row(
        "overlap",
        wide,
        f"{wide:.1f} % of the width, {high:.1f} % of the height",
        f"The chief ray at 10° moves by {moved_mm:.3f} mm on the sensor of {width_mm:.2f}×"
        f"{height_mm:.2f} mm, through the layers by Snell's law; moved both ways at once, "
        f"{wide + high - wide * high / 100:.1f} % are lost. The paper's {100 * printed:.1f} % "
        f"would be {printed * width_mm:.2f} mm across or {printed * height_mm:.2f} mm up, which "
        "no ray does in its stack; it does not say how it counts.",
    )


def dots(work: Workbench, found: Mapping[str, Found]) -> Draft:
    """Up to which angle dots are clear, and from which they are lost."""
    title = "Fig. 6d: a grid of dots"
    keys = ("dots clear", "dots lost")
    reason = refusal(found, ("dots",))
    if reason is not None:
        return empty("dots", title, keys, reason)
    figures = found["dots"].figures
    listed = [Dot(**each) for each in figures["dots"]]
    reach = work.size.dot_reach_deg
    good, lost = figures["good_deg"], figures["lost_deg"]
    rows = (
        Row(
            "dots clear",
            None if good is None else 2 * good,
            "none" if good is None else f"{2 * good:.0f}°",
            "Full angle up to which dots are less than √2 as wide as in the middle, less than "
            "half a width off the place where Snell's law puts them, and have more than half of "
            "the light expected there. The paper judges by eye.",
            sized=True,
        ),
        Row(
            "dots lost",
            None if lost is None else 2 * lost,
            f"beyond {2 * reach:.0f}°" if lost is None else f"{2 * lost:.0f}°",
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
        f"Dots {figures['pitch_mm']:.1f} mm ({PITCH_DEG:g}°) apart at "
        f"{SCREEN_UM * 1e-3:g} mm, up to a half angle of {reach:g}°, "
        "reconstructed with the central PSF; each ring is where Snell's law puts a dot."
    )
    draw = partial(
        write_dots_plot,
        dots=listed,
        picture=found["dots"].arrays["picture"][0],
        good_deg=good,
        lost_deg=lost,
    )
    return Draft(
        "dots",
        title,
        (_pitch_text(figures["papers_pitch"]),),
        (Drawn("dots", caption, draw),),
        rows,
    )


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
    pitch_deg = math.degrees(math.atan(PAPERS_PITCH_UM / SCREEN_UM))
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
