"""A whole camera as one unchangeable description: sensor, layers above it, and mask."""

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator
from torch import Tensor

from nolens.camera.curves import AngularCurve, CurveFile, SpectralCurve
from nolens.camera.filters import Filters
from nolens.camera.materials import Material, check_own_name, material
from nolens.camera.part import Number, Part, PositiveLength, Text, TiffFile, refusal
from nolens.camera.psf_set import Distance
from nolens.camera.sensor import Sensor
from nolens.errors import DataError, OptionError
from nolens.quantities import Length
from nolens.ranges import Between

_IMPOSSIBLE = (
    "a layer of zero or negative thickness is impossible: leave the layer out, or give a length "
    "such as 0.5 mm"
)


class Layer(Part):
    """A flat layer between the scene and the sensor.

    Attributes
    ----------
    name
        What it is, for people.
    thickness
        More than zero.
    material
        Name of a material, one of the package's or of the camera's own; or else
    index
        its refractive index from 1 to 4, the same at all wavelengths.
    """

    name: Text | None = None
    thickness: Annotated[Length, Between("1 nm", "10 m", _IMPOSSIBLE)]
    material: Annotated[str, Field(max_length=1000)] | None = None
    index: Annotated[Number, Between(1, 4)] | None = None

    @field_validator("thickness", mode="before")
    @classmethod
    def _check_thickness(cls, value: Any) -> Any:
        # Without a unit, 0 or -1 is impossible too, and a unit would not mend it.
        if isinstance(value, int | float) and value <= 0:
            raise refusal(_IMPOSSIBLE)
        return value

    @model_validator(mode="after")
    def _check_one(self) -> "Layer":
        if (self.material is None) == (self.index is None):
            fault = (
                "neither material nor index is"
                if self.index is None
                else "material and index are both"
            )
            raise refusal(
                f'{fault} given: give one of the two, such as material = "pdms" or index = 1.43'
            )
        return self


class RandomLenslets(Part):
    """A relief of convex lenslets at random places.

    They bulge out of the denser of the two media that meet at the surface, so that they gather
    light: towards the scene on top of a resin, towards the sensor under a film that is turned
    over, where `Mask.surface` is the layer of air behind the film.

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
        How far the relief extends beyond the sensor's edges, on every side.
    """

    kind: Literal["random-lenslets"]
    radius: PositiveLength
    pitch: PositiveLength
    smoothing: PositiveLength
    seed: Annotated[int, Field(strict=True), Between(0, 2**63 - 1)]
    grid: PositiveLength
    overhang: PositiveLength


class ReliefFile(Part):
    """A relief from a file.

    Attributes
    ----------
    file
        TIFF of heights towards the scene in um, in the camera's folder; its centre lies over the
        sensor's, its rows and columns are those of the camera's picture (as the mask looks from
        the sensor, turned upright).
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

    surface: Annotated[int, Field(strict=True), Between(0, 19)]
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
    outside
        Refractive index of the space that the scene is in: 1 is air, 1.33 water.
    sensor
        The sensor.
    layers
        From the scene to the sensor, 1 to 20.
    materials
        Materials that layers may name besides those of the package.
    mask
        The mask.
    """

    schema_version: Literal[1]
    name: Text
    note: Annotated[str, Field(max_length=10_000)] = ""
    reference_distance: Distance
    outside: Annotated[Number, Between(1, 4)] = 1.0
    sensor: Sensor
    layers: tuple[Layer, ...] = Field(min_length=1, max_length=20)
    materials: tuple[Material, ...] = Field((), max_length=100)
    mask: Mask

    @model_validator(mode="after")
    def _check_materials(self) -> "Camera":
        for place, own in enumerate(self.materials):
            try:
                check_own_name(own)
            except OptionError as error:
                raise refusal(f"materials[{place}].name is {own.name!r}: {error}") from None
            if own.name in [other.name for other in self.materials[:place]]:
                raise refusal(
                    f"materials[{place}].name is {own.name!r}, as that of one before it: give "
                    "each its own name"
                )
        for place, layer in enumerate(self.layers):
            try:
                self.material_of(layer)
            except OptionError as error:
                raise refusal(f"layers[{place}].material is {layer.material!r}: {error}") from None
        return self

    @model_validator(mode="after")
    def _check_surface(self) -> "Camera":
        if self.mask.surface >= len(self.layers):
            raise refusal(
                f"mask.surface is {self.mask.surface}, but there are {len(self.layers)} layers: "
                f"give the index of a layer, 0 to {len(self.layers) - 1}"
            )
        return self

    def material_of(self, layer: Layer) -> Material | None:
        """Material of a layer of this camera; None where the layer has a bare index.

        Raises
        ------
        OptionError
            If neither the camera nor the package has the material that the layer names.
        """
        if layer.material is None:
            return None
        return material(layer.material, {own.name: own for own in self.materials})

    def indices(self, wavelength_nm: float) -> tuple[float, ...]:
        """Refractive indices of all layers, scene first, at a wavelength in vacuum.

        Raises
        ------
        OptionError
            If the index of a layer's material is not known at this wavelength.
        """
        return tuple(self._index_of(layer, wavelength_nm) for layer in self.layers)

    @property
    def files(self) -> list[str]:
        """Names of the files that it names, in its folder."""
        relief = self.mask.relief
        return [*self.sensor.files, *([relief.file] if isinstance(relief, ReliefFile) else [])]

    def media(self, wavelength_nm: float) -> tuple[float, ...]:
        """Index of the space that the scene is in, and `indices`."""
        return (self.outside, *self.indices(wavelength_nm))

    def _index_of(self, layer: Layer, wavelength_nm: float) -> float:
        substance = self.material_of(layer)
        if substance is not None:
            return substance.index(wavelength_nm)
        assert layer.index is not None
        return layer.index


@dataclass(frozen=True)
class LoadedCamera:
    """A camera with the contents of all files that its description names.

    Attributes
    ----------
    camera
        The description.
    quantum_efficiency
        Electrons per photon over wavelength.
    acceptance
        Response over the angle of incidence.
    relief_um
        Heights in um, float32, (rows, columns); None where the relief is not a file.
    filters
        On the sensor's pixels; None where all pixels are alike or it has a mosaic.
    """

    camera: Camera
    quantum_efficiency: SpectralCurve
    acceptance: AngularCurve
    relief_um: Tensor | None = None
    filters: Filters | None = None

    @classmethod
    def of(cls, camera: Camera) -> "LoadedCamera":
        """A camera whose description names no files.

        Raises
        ------
        DataError
            If it does name one.
        """
        efficiency, acceptance = camera.sensor.quantum_efficiency, camera.sensor.acceptance
        if camera.files:
            raise DataError(
                f"the camera {camera.name!r} names the file {camera.files[0]}: read it from its "
                "folder with nolens.files.read_camera"
            )
        assert isinstance(efficiency, SpectralCurve) and isinstance(acceptance, AngularCurve)
        array, filters = camera.sensor.filters, None
        if array is not None:
            curve = array.transmission
            assert not isinstance(curve, CurveFile)
            filters = Filters.of(array, (camera.sensor.rows, camera.sensor.columns), curve)
        return cls(camera, efficiency, acceptance, filters=filters)

    def with_relief(
        self, relief: RandomLenslets | ReliefFile, relief_um: Tensor | None = None
    ) -> "LoadedCamera":
        """The same camera with another relief, and its heights where that is a file."""
        mask = self.camera.mask.model_copy(update={"relief": relief})
        camera = self.camera.model_copy(update={"mask": mask})
        return replace(self, camera=camera, relief_um=relief_um)
