"""Resolution targets as pictures, to show on a screen or to print."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from nolens.errors import OptionError
from nolens.evaluate.targets import siemens_star, slanted_edge
from nolens.files import check_output, write_png
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions, Written
from nolens.quantities import Angle
from nolens.ranges import Between

_TILT = "5 deg"


class TargetOptions(JobOptions):
    """Options of `nolens measure target`.

    Attributes
    ----------
    kind
        siemens or edge.
    output
        Picture to write.
    pixels
        Pixels along its sides.
    spokes
        Bright spokes of the star.
    tilt
        Of the edge from upright.
    """

    kind: Literal["siemens", "edge"]
    output: FilePath
    pixels: Annotated[int, Between(100, 8000)] = 2000
    spokes: Annotated[int, Between(4, 200)] = 36
    tilt: Annotated[Angle, Between("1 deg", "20 deg")] = Angle.parse(_TILT)

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, does not belong to the target, or cannot be used.
        """
        if not given.get("kind"):
            raise OptionError("no target is given: nolens measure target siemens -o star.png")
        if not given.get("output"):
            raise OptionError("no output is given; name the picture to write (-o star.png)")
        options = cls.checked(given)
        other = {"siemens": "tilt", "edge": "spokes"}[options.kind]
        if other in given:
            raise OptionError(f"--{other} is none of a target of kind {options.kind}: leave it out")
        return options

    @property
    def inputs(self) -> dict[str, Path]:
        """None."""
        return {}

    @property
    def written(self) -> tuple[Written, ...]:
        """The picture."""
        return (Written("target", self.output),)


def make_target(options: TargetOptions) -> Path:
    """Write a target as PNG: black and white, smooth edges, the sRGB curve of a screen.

    Parameters
    ----------
    options
        Which one, and where to write it.

    Raises
    ------
    NolensError
        If the file cannot be written.
    """
    check_output(options.output, (".png",))
    if options.kind == "siemens":
        picture = siemens_star(options.pixels, options.spokes)
    else:
        picture = slanted_edge(options.pixels, options.tilt.deg)
    write_png(options.output, picture[None], white=1.0)
    return options.output
