"""A design as the studio's page shows it while sliders move."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

from pydantic import Field
from torch import Tensor

from nolens.camera import OpenCamera, RandomLenslets, SpectralCurve
from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.design.focus import depth_of_focus_um, lenslet_aperture
from nolens.design.thickness import LensletStack
from nolens.errors import DataError, NolensError, OptionError
from nolens.evaluate import PsfFigures, psf_figures
from nolens.files import camera_files, read_camera, readable, write_png
from nolens.jobs.fields import CAMERAS, FilePath, Name, Word
from nolens.jobs.measuring.rounded import rounded
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.optics import PointSource
from nolens.quantities import Length
from nolens.twin import REFERENCE_NM, Light, Twin, distance_um, point_spread

_CELLS = 224
"""Sides of the PSF's window: ten pitches of the paper's lenslets."""


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
    opened = read_camera(options.camera)
    run.reads(camera_files(options.camera, opened.camera))
    opened = with_thickness(opened, options.thickness)
    source_um = distance_um(options.distance, opened)
    twin = _patch(opened)
    psf = point_spread(
        twin,
        PointSource(distance_um=source_um),
        (_CELLS, _CELLS),
        superpixel=_pixels(opened),
        light=Light(f"{REFERENCE_NM:g}nm"),
        wavelengths=1,
        progress=partial(run.reporter.advance, "PSF"),
    )
    plane = psf[0]
    if not float(plane.max()) > 0:
        raise DataError(
            "no light of a point straight ahead reaches the sensor through these layers"
        )
    cell_um = opened.camera.sensor.pitch.um * _pixels(opened)
    stack = _stack(opened, source_um)
    reduced_um = float(stack.behind_um)
    summary = {
        "camera": opened.camera.name,
        "layers": _layers(opened),
        "mask_surface": opened.camera.mask.surface,
        **_focus(opened, stack),
        "reduced_mm": rounded(reduced_um * 1e-3),
        "cell_um": cell_um,
        **_told(_figures(plane, cell_um, reduced_um, run)),
        "psf": readable(options.output),
    }
    return Product(plane, summary, {options.output: partial(write_png, radiance=psf)})


def with_thickness(opened: OpenCamera, thickness: Mapping[str, Length]) -> OpenCamera:
    """A camera with layers of other thickness.

    Parameters
    ----------
    opened
        The camera.
    thickness
        By the layer's name, or its number from 0.

    Raises
    ------
    OptionError
        If it has no such layer.
    """
    layers = list(opened.camera.layers)
    names = [each.name or str(number) for number, each in enumerate(layers)]
    for name, length in thickness.items():
        if name not in names:
            raise OptionError(
                f"{opened.camera.name!r} has no layer {name!r}: its layers are {', '.join(names)}"
            )
        place = names.index(name)
        layers[place] = layers[place].model_copy(update={"thickness": length})
    camera = opened.camera.model_copy(update={"layers": tuple(layers)})
    return replace(opened, camera=camera)


def _pixels(opened: OpenCamera) -> int:
    """Pixels along a cell of the reconstruction."""
    return 1 if opened.camera.sensor.mosaic == "none" else 2


def _patch(opened: OpenCamera) -> Twin:
    """A grey camera of the window's size: one wavelength is worked out, and a piece of the mask."""
    sensor = opened.camera.sensor
    side = _CELLS * _pixels(opened)
    channel = "G" if "G" in sensor.channels else sensor.channels[0]
    curve = opened.quantum_efficiency
    grey = SpectralCurve(
        source=curve.source,
        wavelength_nm=curve.wavelength_nm,
        values={"grey": curve.values[channel]},
    )
    small = sensor.model_copy(update={"rows": side, "columns": side, "mosaic": "none"})
    camera = opened.camera.model_copy(update={"sensor": small})
    return Twin.of(replace(opened, camera=camera, quantum_efficiency=grey))


def _stack(opened: OpenCamera, source_um: float) -> LensletStack:
    camera = opened.camera
    relief = camera.mask.relief
    radius_um = relief.radius.um if isinstance(relief, RandomLenslets) else math.inf
    return LensletStack(
        tuple(layer.thickness.um for layer in camera.layers),
        camera.indices(REFERENCE_NM),
        camera.mask.surface,
        radius_um,
        source_um,
    )


def _layers(opened: OpenCamera) -> list[dict[str, Any]]:
    camera = opened.camera
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


def _focus(opened: OpenCamera, stack: LensletStack) -> dict[str, Any]:
    """Where lenslets are in focus, by ray matrices; nothing of masks that have none."""
    relief, surface = opened.camera.mask.relief, opened.camera.mask.surface
    found: dict[str, Any] = {
        "radius_mm": None,
        "pitch_um": None,
        "mask_layer": surface,
        "best_thickness_mm": None,
        "aperture": None,
        "depth_of_focus_mm": None,
    }
    if not isinstance(relief, RandomLenslets):
        return found
    best_um = float(stack.focused_thickness_um(surface))
    layers = (*stack.thicknesses_um[:surface], best_um, *stack.thicknesses_um[surface + 1 :])
    focused = replace(stack, thicknesses_um=layers)
    found |= {"radius_mm": relief.radius.mm, "pitch_um": relief.pitch.um}
    if best_um <= 0:
        return found
    aperture = float(lenslet_aperture(relief.pitch.um, focused.behind_um))
    depth_um = float(depth_of_focus_um(REFERENCE_NM * 1e-3, aperture))
    index = float(stack.indices[surface])
    return found | {
        "best_thickness_mm": rounded(best_um * 1e-3),
        "aperture": rounded(aperture),
        "depth_of_focus_mm": rounded(depth_um * 1e-3),
        "depth_of_focus_in_layer_mm": rounded(index * depth_um * 1e-3),
    }


def _figures(
    plane: Tensor, cell_um: float, reduced_um: float, run: Run[LookOptions]
) -> PsfFigures | None:
    try:
        return psf_figures(plane, cell_um, reduced_um=reduced_um, noise=0.0)
    except NolensError as error:
        # A flat mask, or far out of focus: there is a picture all the same.
        run.warn(str(error))
        return None


def _told(figures: PsfFigures | None) -> dict[str, Any]:
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
