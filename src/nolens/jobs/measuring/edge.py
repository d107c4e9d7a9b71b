"""A slanted edge as a resolution target."""

from functools import partial
from typing import Annotated, Any

from torch import Tensor

from nolens.evaluate import EdgeResolution, slanted_edge
from nolens.files.plot_measurements import draw_edge
from nolens.jobs.fields import Files
from nolens.jobs.measuring.resolution import (
    OneFrameOptions,
    ResolutionTarget,
    ScreenPicture,
    TargetAngle,
    frames_option,
    resolution_product,
    solver_line,
    target_picture,
)
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Angle
from nolens.ranges import Between

_TILT_DEG = 5.0


class EdgeOptions(OneFrameOptions):
    """Measure the contrast by angular frequency across a slanted edge (ISO 12233).

    nolens measure resolution edge edge.dng --psf psf.dng --camera paper --support 80x80

    nolens measure resolution edge --simulate paper --distance 300mm
    """

    usage = "measure resolution edge FRAME --psf PSF --camera FOLDER"

    frames: Annotated[
        Files,
        frames_option(
            "One raw frame of an edge, about 5 deg from upright or level, or a picture of it that "
            "nolens reconstruct wrote (.tif, .npy). It must show the edge from end to end."
        ),
    ] = ()
    angle: Annotated[
        TargetAngle,
        Option(
            "Field angle of the simulated edge's picture.",
            label="Field angle that it fills",
        ),
    ] = Angle("10", "deg")

    @classmethod
    def only(cls, simulated: bool) -> tuple[str, ...]:
        """Options that only simulations take, or only frames."""
        return (*super().only(simulated), *(("angle",) if simulated else ()))


class EdgePicture(ScreenPicture):
    """An edge, dark at the left."""

    about = "a slanted edge, dark at the left"

    tilt: Annotated[
        Angle, Between("1 deg", "20 deg"), Option("Angle of the edge from upright.")
    ] = Angle("5", "deg")

    def draw(self, side: int) -> Tensor:
        """Give it, (side, side) from 0 to 1, for a side in pixels."""
        return slanted_edge(side, self.tilt.deg)


@job
def measure_edge(run: Run[EdgeOptions]) -> Product[EdgeResolution]:
    """Measure the contrast by frequency across a slanted edge.

    Raises
    ------
    NolensError
        If a file, an option or an output cannot be used, or the frame shows no such edge; then
        nothing is written.
    """
    target = partial(slanted_edge, tilt_deg=_TILT_DEG)
    picture = target_picture(run, target, run.options.angle.deg, "slanted edge")
    edge = EdgeResolution.of(picture)
    return resolution_product(run, "edge", edge, edge.figures, draw_edge)


def _lines(summary: dict[str, Any]) -> list[str]:
    def frequency(value: float | None) -> str:
        if value is None:
            return "nowhere up to the pixels' limit"
        return f"{value:.2f} cycles/deg ({1 / value:.3f} deg a pair of lines)"

    return [
        f"edge at {summary['tilt_deg']:.2f} deg; contrast along {summary['direction_deg']:.1f} deg",
        f"contrast of one half at {frequency(summary['half_contrast_per_deg'])}",
        f"contrast of a tenth at {frequency(summary['tenth_contrast_per_deg'])}",
        *solver_line(summary),
    ]


EDGE = ResolutionTarget(measure_edge, _lines, EdgePicture)
