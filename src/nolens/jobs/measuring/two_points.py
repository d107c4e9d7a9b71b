"""Two points as a resolution target."""

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy import ndimage

from nolens.camera.part import PositiveLength
from nolens.errors import OptionError
from nolens.evaluate import ObservedPair, TwoPoints, point_pair
from nolens.experiments.resolution import POINT_ITERATIONS, POINTS_SUPPORT, two_point_resolution
from nolens.files.plots import ACCENT, GUIDE, plot_figure, show_picture
from nolens.jobs.fields import Files
from nolens.jobs.measuring.resolution import ReadyBench, resolution_product, solver_line
from nolens.jobs.measuring.resolution_options import (
    SIMULATION,
    TARGET,
    ResolutionOptions,
    Threshold,
    frames_option,
)
from nolens.jobs.measuring.resolution_pictures import target_pictures
from nolens.jobs.measuring.resolution_targets import ResolutionTarget
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Angle, Share
from nolens.ranges import Between

_MOST_PANELS = 6
_SIDE_CELLS = 24


class TwoPointOptions(ResolutionOptions):
    """Find the smallest angle between two point sources that is resolved.

    nolens measure resolution two-points a.dng b.dng --separation 1.5mm --separation 1.9mm
    --distance 180mm --psf psf.dng --camera paper

    nolens measure resolution two-points --simulate paper --distance 180mm

    Two points are resolved where the light between them dips by 26.5 %, as Rayleigh's criterion
    has it. How deep it dips depends on the scene, the noise and the solver, as in every camera
    that reconstructs its pictures: the result says with which. A simulation searches for the
    smallest separation.
    """

    usage = "measure resolution two-points --simulate CAMERA"
    default_iterations = POINT_ITERATIONS

    frames: Annotated[
        Files,
        frames_option(
            "Raw frames of two points at one separation each; or pictures of them that nolens "
            "reconstruct wrote (.tif, .npy)."
        ),
    ] = ()
    separation: Annotated[
        tuple[PositiveLength, ...],
        Field(max_length=100_000),
        Option(
            "Distance of the two points, such as 1.9mm; once for each frame, in their order.",
            TARGET,
        ),
    ] = ()
    dip: Annotated[
        Threshold,
        Option("Dip of the light between the points that counts as resolved.", TARGET),
    ] = Share("26.5", "%")
    direction: Annotated[
        Angle,
        Between("-360 deg", "360 deg"),
        Option("Of the line through the points, from the right towards up.", SIMULATION),
    ] = Angle("0", "deg")
    draws: Annotated[
        int,
        Between(1, 1000),
        Option(
            "Pictures of each separation, with other noise and at other places within a scene "
            "pixel; their dips are averaged.",
            SIMULATION,
            label="Repeats",
        ),
    ] = 3

    @classmethod
    def only(cls, simulated: bool) -> tuple[str, ...]:
        """Options that only simulations take, or only frames."""
        own = ("direction", "draws") if simulated else ("separation",)
        return (*super().only(simulated), *own)

    def check_frames(self) -> None:
        """Refuse options for frames that do not go together.

        Raises
        ------
        OptionError
            If not every frame has a separation, or the distance is missing.
        """
        super().check_frames()
        if len(self.separation) != len(self.frames):
            raise OptionError(
                f"--separation is given {len(self.separation)} times for {len(self.frames)} "
                "frames: give it once for each, in their order, such as --separation 1.9mm"
            )
        if self.distance is None or self.distance == "infinity":
            raise OptionError(
                "the distance of the two points is not given: --distance, such as 180mm, makes "
                "angles of their separations"
            )


@job
def measure_two_points(run: Run[TwoPointOptions]) -> Product[TwoPoints]:
    """Measure the dip between two points by separation, and the smallest resolved angle.

    Raises
    ------
    NolensError
        If a file, an option or an output cannot be used, or a frame shows no two points; then
        nothing is written.
    """
    options, settings = run.options, run.options.settings
    if options.simulate is None:
        assert options.distance is not None and options.distance != "infinity"
        seen = []
        pictures = target_pictures(run, settings.iterations)
        for separation, each in zip(options.separation, pictures, strict=True):
            angle = math.degrees(2 * math.atan(separation.um / options.distance.um / 2))
            pair = point_pair(each.picture, each.scale.pixels(angle))
            seen.append(ObservedPair(angle, pair, each.picture))
        points = TwoPoints.of(seen, options.dip.value)
    else:
        ready = ReadyBench.of(options)
        points = two_point_resolution(
            ready.experiment(run, (POINTS_SUPPORT, POINTS_SUPPORT)),
            ready.distance_um,
            direction_deg=options.direction.deg,
            draws=options.draws,
            threshold=options.dip.value,
            settings=settings,
            tick=partial(run.reporter.advance, "two points"),
        )
    resolved = points.resolved
    if resolved.value is None:
        run.warn(
            f"all separations are resolved: the smallest resolved angle is {resolved.resolved:.3g} "
            "deg or less"
            if resolved.unresolved is None
            else f"the largest separation, {resolved.unresolved:.3g} deg, is not resolved: take "
            "frames at larger ones"
        )
    return resolution_product(run, points, _figures(points), draw_two_points)


def _figures(points: TwoPoints) -> dict[str, Any]:
    """Dips by separation, and what is resolved."""
    resolved = points.resolved
    return {
        "target": "two-points",
        "resolved_deg": resolved.value,
        "plus_minus_deg": resolved.plus_minus,
        "largest_unresolved_deg": resolved.unresolved,
        "smallest_resolved_deg": resolved.resolved,
        "dip_needed": points.threshold,
        "separations": [
            {
                "separation_deg": angle,
                "dip": dip,
                "dip_noise": noise,
                "resolved": dip >= points.threshold,
            }
            for angle, dip, noise in zip(
                points.separations_deg, points.dips, points.noise, strict=True
            )
        ],
    }


def draw_two_points(points: TwoPoints, path: Path) -> None:
    """Draw the points with the light through them, and the dips by separation.

    Parameters
    ----------
    points
        What to draw.
    path
        PNG to be written.
    """
    order = sorted(range(len(points.pairs)), key=lambda n: abs(points.dips[n] - points.threshold))
    panels = sorted(order[:_MOST_PANELS])
    with plot_figure(path, (max(2.0 * len(panels), 6.0), 7.0)) as figure:
        grid = figure.add_gridspec(3, len(panels), height_ratios=[3, 2, 4])
        for place, number in enumerate(panels):
            above, below = (figure.add_subplot(grid[row, place]) for row in (0, 1))
            each = points.pairs[number]
            picture = each.picture.numpy()
            light = np.clip(picture, 0, None)
            middle = [round(at) for at in ndimage.center_of_mass(light**2)]
            top, left = (max(0, at - _SIDE_CELLS // 2) for at in middle)
            picture = picture[top : top + _SIDE_CELLS, left : left + _SIDE_CELLS]
            show_picture(above, picture, white=float(picture.max()))
            above.set_title(f"{each.separation_deg:.3g}°, dip {100 * points.dips[number]:.0f} %")
            below.plot(each.pair.at.numpy(), each.pair.trace.numpy(), color=ACCENT)
            below.axhline(1 - points.threshold, color=GUIDE, linewidth=0.8, linestyle=":")
            below.set_xlabel("cells")
            below.set_ylim(-0.05, 1.1)
            below.set_ylabel("light" if place == 0 else "")
        axes = figure.add_subplot(grid[2, :])
        axes.axhline(100 * points.threshold, color=GUIDE, linewidth=0.8, linestyle=":")
        title = "dip between the points"
        angle, off = points.resolved.value, points.resolved.plus_minus
        if angle is not None and off is not None:
            axes.axvspan(angle - off, angle + off, color=ACCENT, alpha=0.15, linewidth=0)
            axes.axvline(angle, color=ACCENT, linewidth=0.9)
            title = f"resolved from {angle:.3f}° ± {off:.3f}° on"
        axes.errorbar(
            points.separations_deg,
            [100 * dip for dip in points.dips],
            [100 * each for each in points.noise],
            color="black",
            marker="o",
            markersize=4,
            linewidth=1,
            capsize=2,
        )
        axes.set_xlabel("separation, degrees")
        axes.set_ylabel("dip, %")
        axes.set_ylim(-4, 104)
        axes.set_title(f"{title}; dotted: a dip of {100 * points.threshold:.1f} %")


def _lines(summary: dict[str, Any]) -> list[str]:
    lines = [
        f"{each['separation_deg']:.3f} deg: dip {100 * each['dip']:5.1f} %"
        + (f" ± {100 * each['dip_noise']:.1f} %" if each["dip_noise"] else "")
        + ("  resolved" if each["resolved"] else "")
        for each in summary["separations"]
    ]
    if summary["resolved_deg"] is not None:
        lines.append(
            f"smallest resolved angle: {summary['resolved_deg']:.3f} deg ± "
            f"{summary['plus_minus_deg']:.3f} deg (dip of {100 * summary['dip_needed']:.1f} %)"
        )
    return [*lines, *solver_line(summary)]


TWO_POINTS = ResolutionTarget(TwoPointOptions, measure_two_points, _lines)
