"""Resolution targets as pictures, to show on a screen or to print."""

from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import create_model
from torch import Tensor

from nolens.errors import OptionError
from nolens.files import write_png
from nolens.jobs.fields import FilePath, Word
from nolens.jobs.measuring.resolution import ScreenPicture, screen_pictures
from nolens.jobs.options import JobOptions, Option
from nolens.jobs.run import Product, Run, job
from nolens.ranges import Between


class PictureOptions(JobOptions):
    """Make the picture of a resolution target, to show on a screen or to print.

    nolens measure target siemens -o star.png

    nolens measure target edge -o edge.png --tilt 5deg

    Show it filling the screen, without scaling it, and photograph it. nolens measure resolution
    siemens or edge takes the photograph.
    """

    usage = "measure target siemens -o star.png"

    kind: Annotated[
        Word,
        Option(
            "Which target.",
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
            what="target",
            suffixes=(".png",),
            flag="-o",
        ),
    ]
    pixels: Annotated[int, Between(100, 8000), Option("Pixels along its sides.")] = 2000

    def check_together(self) -> None:
        """Refuse what does not belong to the target."""
        own = {*PictureOptions.model_fields, *screen_pictures()[self.kind].model_fields}
        for other in sorted(self.model_fields_set - own):
            raise OptionError(
                f"{self.flag(other)} is none of a target of kind {self.kind}: leave it out"
            )

    @property
    def picture(self) -> ScreenPicture:
        """The target, with its own options."""
        kind = screen_pictures()[self.kind]
        own = self.model_fields_set & set(kind.model_fields)
        return kind.gather({name: getattr(self, name) for name in own})


def _with_pictures(model: type[PictureOptions]) -> type[PictureOptions]:
    """The options with every target as a kind, and with the options of their pictures."""
    pictures = screen_pictures()
    about = " ".join(f"{name}: {picture.about}." for name, picture in pictures.items())
    kinds: Any = Literal[tuple(pictures)]
    fields: dict[str, Any] = {
        "kind": (Annotated[kinds, replace(Option.of(model, "kind"), help=about)], ...)
    }
    for picture in pictures.values():
        for name, field in picture.model_fields.items():
            if name not in model.model_fields:
                fields.setdefault(name, (field.rebuild_annotation(), field))
    return create_model("TargetOptions", __base__=model, __doc__=model.__doc__, **fields)


TargetOptions = _with_pictures(PictureOptions)


@job
def make_target(run: Run[PictureOptions]) -> Product[Tensor]:
    """Write a target as PNG: black and white, smooth edges, the sRGB curve of a screen.

    Raises
    ------
    NolensError
        If the file cannot be written.
    """
    options = run.options
    picture = options.picture.draw(options.pixels)
    write = partial(write_png, radiance=picture[None], white=1.0)
    return Product(picture, {"target": options.kind}, {options.output: write})
