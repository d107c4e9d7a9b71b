"""Two points as a resolution target."""

import math
from functools import partial
from typing import Annotated, Any

from pydantic import Field

from nolens.camera.part import PositiveLength
from nolens.errors import OptionError
from nolens.evaluate import ObservedPair, TwoPoints, point_pair
from nolens.experiments.resolution import POINT_ITERATIONS, TwoPointTarget
from nolens.files.plot_measurements import draw_two_points
from nolens.jobs.fields import Files
from nolens.jobs.measuring.resolution import (
    SIMULATION,
    TARGET,
    ResolutionOptions,
    ResolutionTarget,
    Threshold,
    frames_option,
    measure_simulated,
    resolution_product,
    solver_line,
    target_pictures,
)
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Angle, Percentage
from nolens.ranges import Between


class TwoPointOptions(ResolutionOptions):
    """Find the smallest angle between two point sources that is resolved.

    nolens measure resolution two-points a.dng b.dng --separation 1.5mm --separation 1.9mm
    --distance 180mm --psf psf.dng --camera paper

    nolens measure resolution two-points --simulate paper --distance 180mm

    Two points are resolved where the light between them dips by 26.5 %, as Rayleigh's criterion
    has it. As in every camera that reconstructs its pictures, the dip depends on scene, noise and
    solver; the result lists them. A simulation searches for the smallest separation.
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
        ),
    ] = ()
    dip: Annotated[
        Threshold,
        Option(
            "Dip of the light between the points that counts as resolved.",
            TARGET,
            label="Dip that counts as resolved",
        ),
    ] = Percentage("26.5", "%")
    direction: Annotated[
        Angle,
        Between("-360 deg", "360 deg"),
        Option(
            "Of the line through the points, from the right towards up.",
            SIMULATION,
            label="Direction of the line",
        ),
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
    options = run.options
    if options.simulate is None:
        assert options.distance is not None and options.distance != "infinity"
        pairs = []
        for separation, each in zip(options.separation, target_pictures(run), strict=True):
            angle = math.degrees(2 * math.atan(separation.um / options.distance.um / 2))
            pair = point_pair(each.picture, each.scale.pixels(angle))
            pairs.append(ObservedPair(angle, pair, each.picture))
        points = TwoPoints.of(pairs, options.dip.value)
    else:
        target_at = partial(
            TwoPointTarget,
            direction_deg=options.direction.deg,
            draws=options.draws,
            threshold=options.dip.value,
        )
        points = measure_simulated(run, target_at, "two points")
    resolved = points.resolved
    if resolved.value is None:
        run.warn(
            f"all separations are resolved: the smallest resolved angle is {resolved.resolved:.3g} "
            "deg or less"
            if resolved.unresolved is None
            else f"the largest separation, {resolved.unresolved:.3g} deg, is not resolved: take "
            "frames at larger ones"
        )
    return resolution_product(run, "two-points", points, points.figures, draw_two_points)


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


TWO_POINTS = ResolutionTarget(measure_two_points, _lines)
