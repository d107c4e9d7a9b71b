"""A whole camera as one unchangeable description: sensor, layers above it, and mask."""

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from nolens.camera.materials import material
from nolens.camera.part import Part, PositiveLength, Text, TiffFile, refusal
from nolens.camera.sensor import Sensor
from nolens.errors import OptionError
from nolens.quantities import Length


class Layer(Part):
    """A flat layer between the scene and the sensor.

    Attributes
    ----------
    name
        What it is, for people.
    thickness
        More than zero.
    material
        Name of a known material; or else
    index
        its refractive index from 1 to 4, the same at all wavelengths.
    """

    name: str | None = None
    thickness: Length
    material: str | None = None
    index: Annotated[float, Field(strict=True, ge=1, le=4)] | None = None

    @field_validator("thickness", mode="wrap")
    @classmethod
    def _check_thickness(cls, given: Any, read: Callable[[Any], Length]) -> Length:
        # Without a unit, 0 or -1 is impossible too, and a unit would not mend it.
        bare = isinstance(given, int | float) and given <= 0
        if bare or (thickness := read(given)).exact <= 0:
            raise refusal(
                "a layer of zero or negative thickness is impossible: leave the layer out, or give "
                "a length such as 0.5 mm"
            )
        return thickness

    @field_validator("material")
    @classmethod
    def _check_material(cls, name: str | None) -> str | None:
        try:
            if name is not None:
                material(name)
        except OptionError as error:
            raise refusal(str(error)) from None
        return name

    @model_validator(mode="after")
    def _check_one(self) -> "Layer":
        if (self.material is None) == (self.index is None):
            given = (
                "neither material nor index is"
                if self.index is None
                else "material and index are both"
            )
            raise refusal(
                f'{given} given: give one of the two, such as material = "pdms" or index = 1.43'
            )
        return self

    def refractive_index(self, wavelength_nm: float) -> float:
        """Refractive index at a wavelength in nm."""
        if self.material is not None:
            return material(self.material).index(wavelength_nm)
        assert self.index is not None
        return self.index


class RandomLenslets(Part):
    """A relief of convex lenslets at random places.

    Attributes
    ----------
    radius
        Radius of curvature of every lenslet.
    pitch
        Mean distance from one lenslet to the next.
    smoothing
        Width of the Gaussian that rounds the valleys between lenslets.
    seed
        Number that the places are drawn from, 0 or more.
    grid
        Distance of the points at which the relief is computed.
    overhang
        How far the relief reaches beyond the sensor's edges, on every side.
    """

    kind: Literal["random-lenslets"]
    radius: PositiveLength
    pitch: PositiveLength
    smoothing: PositiveLength
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)]
    grid: PositiveLength
    overhang: PositiveLength


class ReliefFile(Part):
    """A relief from a file.

    Attributes
    ----------
    file
        TIFF of heights in um, in the camera's folder; its centre lies over the sensor's.
    grid
        Distance of its points.
    """

    kind: Literal["file"]
    file: TiffFile
    grid: PositiveLength


class Flat(Part):
    """No relief: a flat surface."""

    kind: Literal["flat"]


class Aperture(Part):
    """An opening in an opaque film on the mask's surface, centred over the sensor.

    Attributes
    ----------
    shape
        "rectangle" or "ellipse".
    width, height
        Along the sensor's rows and columns.
    """

    shape: Literal["rectangle", "ellipse"]
    width: PositiveLength
    height: PositiveLength


class Mask(Part):
    """What bends the light on its way to the sensor.

    Attributes
    ----------
    surface
        Index of the layer on whose scene-facing side the relief lies.
    relief
        Shape of that surface.
    aperture
        Opening in front of it; None lets light through everywhere.
    """

    surface: Annotated[int, Field(strict=True, ge=0)]
    relief: Annotated[RandomLenslets | ReliefFile | Flat, Field(discriminator="kind")]
    aperture: Aperture | None = None


class Camera(Part):
    """A lensless camera.

    Attributes
    ----------
    schema_version
        Version of this format, 1.
    name
        What it is called.
    note
        What else is to be said.
    reference_distance
        From the camera to the scene it is described for.
    sensor
        The sensor.
    layers
        From the scene to the sensor, 1 to 20.
    mask
        The mask.
    """

    schema_version: Literal[1]
    name: Text
    note: str = ""
    reference_distance: PositiveLength
    sensor: Sensor
    layers: tuple[Layer, ...] = Field(min_length=1, max_length=20)
    mask: Mask

    @model_validator(mode="after")
    def _check_surface(self) -> "Camera":
        if self.mask.surface >= len(self.layers):
            raise refusal(
                f"mask.surface is {self.mask.surface}, but there are {len(self.layers)} layers: "
                f"give the index of a layer, 0 to {len(self.layers) - 1}"
            )
        return self
