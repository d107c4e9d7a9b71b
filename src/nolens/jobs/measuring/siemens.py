"""A Siemens star as a resolution target."""

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from scipy import ndimage
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import StarResolution, siemens_star, star_square_deg
from nolens.files.plots import (
    ACCENT,
    GUIDE,
    WORST,
    plot_figure,
    show_picture,
    white_level,
)
from nolens.jobs.fields import Files
from nolens.jobs.measuring.resolution import resolution_product, solver_line, target_picture
from nolens.jobs.measuring.resolution_options import (
    TARGET,
    OneFrameOptions,
    TargetAngle,
    Threshold,
    frames_option,
)
from nolens.jobs.measuring.resolution_targets import ResolutionTarget, ScreenPicture
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Angle, Share
from nolens.ranges import Between

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_Spokes = Annotated[int, Between(4, 200)]
_SPOKES = 36
_ANGLE = Angle("20", "deg")
_SIZE_OFF = 0.1
_ARC_STEP = 1.15
_ARC_PERIODS = 4
_ARC_RADII = (1.0, 1.2, 1.5)


class SiemensOptions(OneFrameOptions):
    """Measure the contrast of a Siemens star by angular frequency in every direction.

    nolens measure resolution siemens star.dng --psf psf.dng --camera paper --spokes 36

    nolens measure resolution siemens --simulate paper --distance 300mm --plot star.png

    The star is found in the picture by itself. The result is the angle of one bright spoke and
    one dark gap (a line pair, the distance of two bright lines) at which their contrast has
    fallen to the threshold in the worst of eight directions; a spoke alone is half as wide.
    """

    usage = "measure resolution siemens FRAME --psf PSF --camera FOLDER"

    frames: Annotated[
        Files,
        frames_option(
            "One raw frame of a star, or a picture of it that nolens reconstruct wrote (.tif, "
            ".npy)."
        ),
    ] = ()
    spokes: Annotated[
        _Spokes | None,
        Option("Bright spokes of the star.", TARGET, default="as found; 36 to simulate"),
    ] = None
    angle: Annotated[
        TargetAngle | None,
        Option(
            "Field angle of the star from side to side; a picture of another one is refused.",
            TARGET,
            default="as found; 20deg to simulate",
            label="Field angle that it fills",
        ),
    ] = None
    threshold: Annotated[
        Threshold,
        Option(
            "Fraction of the contrast of the widest spokes at which others count as just "
            "resolved. 15.3% is the contrast of lines that dip by Rayleigh's 26.5 %.",
            TARGET,
        ),
    ] = Share("10", "%")


class StarPicture(ScreenPicture):
    """A star, dark beside it."""

    about = "a star of bright spokes"

    spokes: Annotated[_Spokes, Option("Bright spokes of the star.")] = _SPOKES

    def draw(self, side: int) -> Tensor:
        """Give it, (side, side) from 0 to 1, for a side in pixels."""
        return siemens_star(side, self.spokes)


@job
def measure_siemens(run: Run[SiemensOptions]) -> Product[StarResolution]:
    """Measure the contrast of a Siemens star in every direction.

    Raises
    ------
    NolensError
        If a file, an option or an output cannot be used, or the frame shows no such star; then
        nothing is written.
    """
    options = run.options
    spokes, angle = options.spokes or _SPOKES, options.angle or _ANGLE
    target = partial(siemens_star, periods=spokes)
    picture = target_picture(run, target, star_square_deg(angle.deg), "Siemens star")
    periods = options.spokes if options.simulate is None else spokes
    star = StarResolution.of(picture, periods=periods, threshold=options.threshold.value)
    if options.simulate is None:
        _check_size(star, options)
    if any(star.at_limit):
        run.warn(
            "the finest spokes that the cells can show are resolved in some directions: a star of "
            "more spokes may show finer ones"
        )
    return resolution_product(run, star, _figures(star), draw_star)


def _check_size(star: StarResolution, options: SiemensOptions) -> None:
    """Refuse a star that is not as large as it was said to be."""
    if options.angle is None:
        return
    if abs(star.diameter_deg / options.angle.deg - 1) > _SIZE_OFF:
        raise DataError(
            f"the star in {options.frames[0]} is {star.diameter_deg:.3g} deg wide, not "
            f"{options.angle.deg:g} deg: check the angle of a cell (--camera, --cell-angle), the "
            "star's size and its distance"
        )


def _figures(resolution: StarResolution) -> dict[str, Any]:
    """Contrast by frequency and direction, and what is resolved."""
    star, worst = resolution.star, resolution.worst
    return {
        "target": "siemens",
        "resolved_deg": resolution.resolved_everywhere_deg,
        "plus_minus_deg": resolution.plus_minus_deg[worst],
        "spoke_deg": resolution.resolved_everywhere_deg / 2,
        "worst_direction_deg": float(star.directions_deg[worst]),
        "finest_of_the_cells": resolution.at_limit[worst],
        "contrast_needed": resolution.threshold * star.wide,
        "contrast_of_wide_spokes": star.wide,
        "spokes": star.place.periods,
        "centre": star.place.centre,
        "diameter_deg": resolution.diameter_deg,
        "directions": [
            {
                "direction_deg": float(star.directions_deg[number]),
                "resolved_deg": resolution.resolved_deg[number],
                "plus_minus_deg": resolution.plus_minus_deg[number],
                "cycles_per_deg": [1 / each for each in resolution.pairs_deg[number].tolist()],
                "contrast": star.contrast[number].tolist(),
            }
            for number in range(len(resolution.resolved_deg))
        ],
    }


def draw_star(resolution: StarResolution, path: Path) -> None:
    """Draw the star, its contrast by frequency and direction, and the light along arcs.

    Parameters
    ----------
    resolution
        What to draw.
    path
        PNG to be written.
    """
    star, worst = resolution.star, resolution.worst
    with plot_figure(path, (10.5, 8.4)) as figure:
        from matplotlib.patches import Circle

        places = figure.subplot_mosaic(
            [["picture", "contrast"], ["arc", "round"]], per_subplot_kw={"round": {"polar": True}}
        )
        show_picture(places["picture"], resolution.picture.values.numpy())
        row, column = star.place.centre
        radius = _resolved_radius(resolution)
        places["picture"].add_patch(
            Circle((column, row), radius, fill=False, color=WORST, linewidth=1.2)
        )
        places["picture"].set_title(
            f"circle: spokes of {resolution.resolved_everywhere_deg:.3f}° a pair, resolved from "
            "there on"
        )
        axes = places["contrast"]
        directions = star.directions_deg.tolist()
        for number, direction in enumerate(directions):
            is_worst = number == worst
            axes.plot(
                (1 / resolution.pairs_deg[number]).numpy(),
                star.contrast[number].numpy(),
                color=WORST if is_worst else ACCENT,
                linewidth=1.6 if is_worst else 0.8,
                alpha=1.0 if is_worst else 0.5,
                zorder=3 if is_worst else 2,
                label=f"spokes at {direction:g}° (worst)"
                if is_worst
                else "other directions"
                if number == (worst + 1) % len(directions)
                else None,
            )
        needed = resolution.threshold * star.wide
        axes.axhline(needed, color=GUIDE, linewidth=0.8, linestyle=":")
        axes.set_xlabel("cycles to the degree")
        axes.set_ylabel("contrast")
        axes.set_ylim(bottom=0)
        axes.set_title(f"dotted: {needed:.3g}, that counts as resolved")
        axes.legend(frameon=False)
        _arcs(places["arc"], resolution)
        _round(places["round"], resolution)


def _resolved_radius(resolution: StarResolution) -> float:
    """In cells, from which on all is resolved."""
    pairs = resolution.pairs_deg[resolution.worst].numpy()
    radii = resolution.star.radii.numpy()
    return float(np.interp(resolution.resolved_everywhere_deg, pairs, radii))


def _arcs(axes: "Axes", resolution: StarResolution) -> None:
    """Light along arcs of the worst direction, one below the other."""
    star, picture = resolution.star, resolution.picture.values.numpy()
    direction_deg = float(star.directions_deg[resolution.worst])
    pairs, radii = resolution.pairs_deg[resolution.worst].numpy(), star.radii.numpy()
    periods = np.linspace(-_ARC_PERIODS / 2, _ARC_PERIODS / 2, 241)
    turns = math.radians(direction_deg) + periods * (2 * math.pi / star.place.periods)
    white = white_level(picture)
    labels: dict[float, str] = {}
    for number, times in enumerate(_ARC_RADII):
        radius = times * _resolved_radius(resolution)
        if radius > float(radii[-1]):
            continue
        row, column = star.place.centre
        places = [row - radius * np.sin(turns), column + radius * np.cos(turns)]
        light = ndimage.map_coordinates(picture, places, order=3)
        level = -_ARC_STEP * number
        labels[level] = f"{float(np.interp(radius, radii, pairs)):.3f}°"
        axes.axhline(level, color=GUIDE, linewidth=0.5)
        axes.plot(periods, light / white + level, color=WORST if number == 0 else ACCENT)
    axes.set_xlabel("pairs of spokes")
    axes.set_yticks(list(labels), list(labels.values()))
    axes.set_ylabel("light, by the angle of a pair")
    axes.set_title(f"light along arcs about {direction_deg:g}°, each above its line")


def _round(axes: "Axes", resolution: StarResolution) -> None:
    """The smallest resolved pair of spokes around the circle."""
    from matplotlib.projections.polar import PolarAxes
    from matplotlib.ticker import MaxNLocator

    directions, worst = resolution.star.directions_deg.numpy(), resolution.worst
    turns = np.radians(np.append(directions, directions[0]))
    angles = np.append(resolution.resolved_deg, resolution.resolved_deg[0])
    axes.plot(turns, angles, color=ACCENT, marker="o", markersize=4)
    axes.plot(turns[worst], angles[worst], "o", color=WORST, markersize=7)
    axes.set_ylim(0, 1.2 * float(angles.max()))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    assert isinstance(axes, PolarAxes)
    axes.set_rlabel_position(22.5)
    axes.set_title("smallest resolved pair by direction of the spokes, degrees")


def _lines(summary: dict[str, Any]) -> list[str]:
    lines = [
        f"star of {summary['spokes']} bright spokes, {summary['diameter_deg']:.1f} deg wide; "
        f"contrast of its widest spokes {summary['contrast_of_wide_spokes']:.2f}"
    ]
    lines += [
        f"spokes at {each['direction_deg']:3.0f} deg: resolved from {each['resolved_deg']:.3f} deg "
        f"± {each['plus_minus_deg']:.3f} deg a pair"
        for each in summary["directions"]
    ]
    limit = " or less" if summary["finest_of_the_cells"] else ""
    lines.append(
        f"resolved in all directions: {summary['resolved_deg']:.3f} deg ± "
        f"{summary['plus_minus_deg']:.3f} deg a pair of lines{limit}, "
        f"{summary['spoke_deg']:.3f} deg a line (contrast of {summary['contrast_needed']:.3f})"
    )
    return [*lines, *solver_line(summary)]


SIEMENS = ResolutionTarget(SiemensOptions, measure_siemens, _lines, StarPicture)
