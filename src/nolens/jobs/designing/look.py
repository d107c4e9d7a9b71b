"""A design as the studio's page shows it while sliders move."""

from functools import partial
from typing import Annotated

from pydantic import Field
from torch import Tensor

from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.design.preview import DesignPreview, with_thickness
from nolens.files import readable, write_png
from nolens.jobs.fields import CAMERAS, FilePath, Name, Word
from nolens.jobs.options import JobOptions, Option
from nolens.jobs.run import Product, Run, job
from nolens.twin import distance_um


class Thicknesses(JobOptions):
    """Thickness of some layers of a camera."""

    thickness: Annotated[
        dict[Word, PositiveLength],
        Field(max_length=20),
        Option(
            "Of layers in place of the camera's, by name, or by number from 0 for one without a "
            "name.",
            label="Layers",
        ),
    ] = Field(default_factory=dict)


class LookOptions(Thicknesses):
    """See the focus and the PSF of a design."""

    camera: Annotated[Name, Option(f"{CAMERAS}.", role="camera", label="Description")] = "paper"
    distance: Annotated[
        Depth | None,
        Option(
            "From the camera to the point source, or infinity.",
            default="the camera's reference_distance",
        ),
    ] = None
    output: Annotated[
        FilePath,
        Option(
            "Picture of the PSF to write (.png).",
            needed="the picture of the PSF (-o psf.png)",
            role="output",
            what="picture",
            suffixes=(".png",),
            flag="-o",
        ),
    ]


@job
def look_at_design(run: Run[LookOptions]) -> Product[Tensor]:
    """Work out focus and PSF of a camera, with other layers if they are given.

    The focus is that of ray matrices; the PSF is the twin's at 550 nm, of a window as large as
    some pitches, which stands for the rest.

    Raises
    ------
    NolensError
        If the camera, an option or an output cannot be used.
    """
    options = run.options
    loaded = with_thickness(run.camera(options.camera), options.thickness)
    source_um = distance_um(options.distance, loaded)
    preview = DesignPreview.of(loaded, source_um, partial(run.reporter.advance, "PSF"))
    if isinstance(preview.figures, str):
        run.warn(preview.figures)
    return Product(
        preview.psf[0],
        preview.summary() | {"psf": readable(options.output)},
        {options.output: partial(write_png, radiance=preview.psf)},
    )
