"""Resolution targets as pictures, to show on a screen or to print."""

from functools import partial
from typing import Annotated, Literal

from torch import Tensor

from nolens.errors import OptionError
from nolens.evaluate.targets import siemens_star, slanted_edge
from nolens.files import write_png
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Angle
from nolens.ranges import Between


class TargetOptions(JobOptions):
    """Make the picture of a resolution target, to show on a screen or to print.

    nolens measure target siemens -o star.png

    nolens measure target edge -o edge.png --tilt 5deg

    Show it filling the screen, without scaling it, and photograph it. nolens measure resolution
    siemens or edge takes the photograph.
    """

    usage = "measure target siemens -o star.png"

    kind: Annotated[
        Literal["siemens", "edge"],
        Option(
            "siemens: a star of bright spokes. edge: a slanted edge, dark at the left.",
            needed="the target (nolens measure target siemens -o star.png)",
            positional=True,
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "Picture to write: .png.",
            needed="the picture to write (-o star.png)",
            role="output",
            flag="-o",
        ),
    ]
    pixels: Annotated[int, Between(100, 8000), Option("Pixels along its sides.")] = 2000
    spokes: Annotated[int, Between(4, 200), Option("Bright spokes of the star.")] = 36
    tilt: Annotated[
        Angle, Between("1 deg", "20 deg"), Option("Angle of the edge from upright.")
    ] = Angle("5", "deg")

    def check_together(self) -> None:
        """Refuse what does not belong to the target."""
        other = {"siemens": "tilt", "edge": "spokes"}[self.kind]
        if other in self.model_fields_set:
            raise OptionError(f"--{other} is none of a target of kind {self.kind}: leave it out")

    @property
    def written(self) -> tuple[Written, ...]:
        """The picture."""
        return (Written("target", self.output, suffixes=(".png",)),)


@job
def make_target(run: Run[TargetOptions]) -> Product[Tensor]:
    """Write a target as PNG: black and white, smooth edges, the sRGB curve of a screen.

    Raises
    ------
    NolensError
        If the file cannot be written.
    """
    options = run.options
    if options.kind == "siemens":
        picture = siemens_star(options.pixels, options.spokes)
    else:
        picture = slanted_edge(options.pixels, options.tilt.deg)
    write = partial(write_png, radiance=picture[None], white=1.0)
    return Product(picture, {"target": options.kind}, {options.output: write})
