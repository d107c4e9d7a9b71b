"""A Siemens star as a resolution target."""

from functools import partial
from typing import Annotated, Any

from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import StarResolution, siemens_star, star_square_deg
from nolens.files.plot_measurements import draw_star
from nolens.jobs.fields import Files
from nolens.jobs.measuring.resolution import (
    TARGET,
    OneFrameOptions,
    ResolutionTarget,
    ScreenPicture,
    TargetAngle,
    Threshold,
    frames_option,
    resolution_product,
    solver_line,
    target_picture,
)
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Angle, Percentage
from nolens.ranges import Between

_Spokes = Annotated[int, Between(4, 200)]
_SPOKES = 36
_ANGLE = Angle("20", "deg")
_SIZE_TOLERANCE = 0.1


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
        Option(
            "Bright spokes of the star.", default="from the picture; 36 to simulate", label="Spokes"
        ),
    ] = None
    angle: Annotated[
        TargetAngle | None,
        Option(
            "Field angle of the star from side to side; a picture of another one is refused.",
            default="from the picture; 20deg to simulate",
            label="Field angle that it fills",
        ),
    ] = None
    threshold: Annotated[
        Threshold,
        Option(
            "Fraction of the contrast of the widest spokes at which others count as just "
            "resolved. 15.3% is the contrast of lines that dip by Rayleigh's 26.5 %.",
            TARGET,
            label="Contrast that counts as resolved",
        ),
    ] = Percentage("10", "%")


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
            "the finest spokes that the pixels can show are resolved in some directions: a star of "
            "more spokes may show finer ones"
        )
    return resolution_product(run, "siemens", star, star.figures, draw_star)


def _check_size(star: StarResolution, options: SiemensOptions) -> None:
    """Refuse a star that is not as large as it was said to be."""
    if options.angle is None:
        return
    if abs(star.diameter_deg / options.angle.deg - 1) > _SIZE_TOLERANCE:
        raise DataError(
            f"the star in {options.frames[0]} is {star.diameter_deg:.3g} deg wide, not "
            f"{options.angle.deg:g} deg: check the angle of a pixel (--camera, --pixel-angle), the "
            "star's size and its distance"
        )


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
    limit = " or less" if summary["finest_of_the_pixels"] else ""
    lines.append(
        f"resolved in all directions: {summary['resolved_deg']:.3f} deg ± "
        f"{summary['plus_minus_deg']:.3f} deg a pair of lines{limit}, "
        f"{summary['spoke_deg']:.3f} deg a line (contrast of {summary['contrast_needed']:.3f})"
    )
    return [*lines, *solver_line(summary)]


SIEMENS = ResolutionTarget(measure_siemens, _lines, StarPicture)
