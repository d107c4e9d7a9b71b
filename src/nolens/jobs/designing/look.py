"""A design as the studio's page shows it while sliders move."""

from functools import partial
from typing import Annotated, Any

from pydantic import Field
from torch import Tensor

from nolens.amounts import rounded
from nolens.camera import LoadedCamera, RandomLenslets
from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.design.focus import LensletStack
from nolens.design.preview import BestThickness, lenslet_stack, preview_psf, with_thickness
from nolens.errors import NolensError
from nolens.evaluate import PsfFigures, psf_figures
from nolens.files import camera_files, read_camera, readable, write_png
from nolens.jobs.fields import CAMERAS, FilePath, Name, Word
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.twin import REFERENCE_NM, distance_um


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
            flag="-o",
        ),
    ]

    @property
    def written(self) -> tuple[Written, ...]:
        """The picture."""
        return (Written("picture", self.output, suffixes=(".png",)),)


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
    described = read_camera(options.camera)
    run.reads(camera_files(options.camera, described.camera))
    loaded = with_thickness(described, options.thickness)
    source_um = distance_um(options.distance, loaded)
    psf, pixel_um = preview_psf(loaded, source_um, partial(run.reporter.advance, "PSF"))
    stack = lenslet_stack(loaded, source_um)
    reduced_um = float(stack.behind_um)
    try:
        figures = psf_figures(psf[0], pixel_um, reduced_um=reduced_um, noise=0.0)
    except NolensError as error:
        # A flat mask, or far out of focus: there is a picture all the same.
        run.warn(str(error))
        figures = None
    summary = {
        "camera": loaded.camera.name,
        "layers": _layers(loaded),
        "mask_surface": loaded.camera.mask.surface,
        **_focus(loaded, stack),
        "reduced_mm": rounded(reduced_um * 1e-3),
        "cell_um": pixel_um,
        **_of_psf(figures),
        "psf": readable(options.output),
    }
    return Product(psf[0], summary, {options.output: partial(write_png, radiance=psf)})


def _layers(loaded: LoadedCamera) -> list[dict[str, Any]]:
    camera = loaded.camera
    return [
        {
            "name": layer.name or str(number),
            "material": layer.material,
            "thickness_mm": layer.thickness.mm,
            "index": round(index, 5),
        }
        for number, (layer, index) in enumerate(
            zip(camera.layers, camera.indices(REFERENCE_NM), strict=True)
        )
    ]


def _focus(loaded: LoadedCamera, stack: LensletStack) -> dict[str, Any]:
    """Where lenslets are in focus, by ray matrices; nothing of masks that have none."""
    relief = loaded.camera.mask.relief
    summary: dict[str, Any] = {
        "radius_mm": None,
        "pitch_um": None,
        "mask_layer": stack.surface,
        "best_thickness_mm": None,
        "aperture": None,
        "depth_of_focus_mm": None,
    }
    if not isinstance(relief, RandomLenslets):
        return summary
    summary |= {"radius_mm": relief.radius.mm, "pitch_um": relief.pitch.um}
    best = BestThickness.of(stack, relief.pitch.um)
    if best.thickness_um <= 0:
        return summary
    return summary | {
        "best_thickness_mm": rounded(best.thickness_um * 1e-3),
        "aperture": rounded(best.aperture),
        "depth_of_focus_mm": rounded(best.depth_of_focus_um * 1e-3),
        "depth_of_focus_in_layer_mm": rounded(best.index * best.depth_of_focus_um * 1e-3),
    }


def _of_psf(figures: PsfFigures | None) -> dict[str, Any]:
    if figures is None:
        empty: list[float] = []
        return {
            "fwhm_um": None,
            "line_width_um": None,
            "contrast": None,
            "autocorrelation": {"um": empty, "value": empty},
            "magnitude": {"per_mm": empty, "value": empty},
        }
    return {
        "fwhm_um": rounded(figures.fwhm_um),
        "line_width_um": rounded(figures.line_width_um),
        "contrast": rounded(figures.contrast),
        "autocorrelation": {
            "um": rounded(figures.lag_um),
            "value": rounded(figures.autocorrelation),
        },
        "magnitude": {"per_mm": rounded(figures.per_mm), "value": rounded(figures.magnitude)},
    }
