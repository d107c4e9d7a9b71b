"""A simulated camera: its mask, its layers at a wavelength, its limits, and a preview of it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nolens.camera import (
    AngularCurve,
    Camera,
    Filters,
    Flat,
    LoadedCamera,
    RandomLenslets,
    ReliefFile,
    SpectralCurve,
)
from nolens.errors import OptionError
from nolens.machine import BYTES_OF_PROGRAM, check_memory
from nolens.operators import PixelRectangle
from nolens.optics import (
    Grid,
    Illumination,
    Margin,
    MaskSurface,
    Media,
    Opening,
    PointSource,
    Relief,
    Stack,
    random_lenslets,
    surface_bytes,
    transmittance,
)
from nolens.quantities import Length

REFERENCE_NM = 550.0
"""Wavelength whose chief rays say where a field angle lies on the sensor."""
LARGEST_ANGLE_DEG = 50.0
"""Field angle to which the model holds; beyond, the paper's camera sees nothing either."""
_NEAREST_MM = 1.0
"""Distance from which on the relief may be taken as thin against the curvature of the wave."""
_ANGLES_DEG = (10, 30, 50)
_NEAR_MM = 80.0
_LENSLETS = 10
_POINTS = 500
"""Sides of the patch that stands for all random lenslets: this many of them, or points."""
_BYTES_PER_HEIGHT = 4
_STEPS = 10
"""Places that lenslets are spread on, along a pitch (see `random_lenslets`)."""


@dataclass(frozen=True)
class Twin:
    """A camera as the simulation uses it.

    Parameters
    ----------
    camera
        The description.
    quantum_efficiency, acceptance
        Its curves.
    mask
        Relief and opening, on the device that computes.
    fresnel
        Whether light is lost at the surfaces between media.
    filters
        On the sensor's pixels; None where all are alike or it has a mosaic.
    """

    camera: Camera
    quantum_efficiency: SpectralCurve
    acceptance: AngularCurve
    mask: MaskSurface
    fresnel: bool = True
    filters: Filters | None = None

    @classmethod
    def of(
        cls, loaded: LoadedCamera, *, device: torch.device | str = "cpu", fresnel: bool = True
    ) -> "Twin":
        """Prepare a camera; random lenslets are computed here (seconds for the paper's).

        Raises
        ------
        OptionError
            If the relief is coarser than the light needs.
        """
        camera = loaded.camera
        opening = None
        if camera.mask.aperture is not None:
            hole = camera.mask.aperture
            opening = Opening(hole.shape, hole.height.um, hole.width.um)
        relief = _relief(loaded)
        mask = MaskSurface(Relief(relief.height_um.to(device), relief.grid_um), opening)
        twin = cls(
            camera, loaded.quantum_efficiency, loaded.acceptance, mask, fresnel, loaded.filters
        )
        coarsest = twin.coarsest_pitch_um()
        if relief.grid_um > coarsest:
            # Finer points show steeper slopes.
            coarsest *= 0.75
            raise OptionError(
                f"the relief of {camera.name!r} has a point every {relief.grid_um:g} µm, too "
                f"coarse for the light that its slopes of up to {relief.steepest:.2g} turn: a "
                f"grid of {_round_down(coarsest)} µm or finer would do"
            )
        return twin

    def reading(self, rows: int, columns: int) -> "Twin":
        """The same camera and mask, of whose sensor only the middle pixels are read."""
        sensor = self.camera.sensor.model_copy(update={"rows": rows, "columns": columns})
        camera = self.camera.model_copy(update={"sensor": sensor})
        filters = self.filters and self.filters.reading(rows, columns)
        return replace(self, camera=camera, filters=filters)

    @property
    def sensor_pitch_um(self) -> float:
        """Distance of the pixels."""
        return self.camera.sensor.pitch.um

    @property
    def superpixel(self) -> int:
        """Sensor pixels along a pixel of the reconstruction: 2 behind a colour mosaic."""
        return self.camera.sensor.superpixel

    @property
    def pixel_um(self) -> float:
        """Pitch of the pixels of the reconstruction."""
        return self.superpixel * self.sensor_pitch_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the sensor in pixels of the reconstruction."""
        sensor = self.camera.sensor
        return sensor.rows // self.superpixel, sensor.columns // self.superpixel

    @property
    def aperture_room_um(self) -> tuple[float, float] | None:
        """How far the PSF behind an aperture may move before it leaves the sensor.

        Along the rows' and the columns' direction; None where there is no aperture, or one that is
        as large as the sensor.
        """
        opening, sensor, pitch = self.mask.opening, self.camera.sensor, self.sensor_pitch_um
        if opening is None:
            return None
        room = (
            (sensor.rows * pitch - opening.height_um) / 2,
            (sensor.columns * pitch - opening.width_um) / 2,
        )
        return room if min(room) > 0 else None

    def psf_shape(self, support: PixelRectangle) -> tuple[int, int]:
        """(rows, columns) of the PSF that a reconstruction of a support needs, in its pixels.

        Without an aperture light from the side passes mask that the sensor's own PSF does not show.
        """
        rows, columns = self.shape
        if self.aperture_room_um is not None:
            return rows, columns
        return rows + support.height, columns + support.width

    def coarsest_pitch_um(self, shortest_nm: float | None = None, divergence: float = 0.0) -> float:
        """Largest distance of samples that carries the light behind the relief, at any angle.

        `shortest_nm` is the shortest wavelength; None takes the shortest that the sensor sees. For
        `divergence` see `MaskSurface.coarsest_pitch_um`.
        """
        if shortest_nm is None:
            shortest_nm = self.quantum_efficiency.wavelength_nm[0]
        steep = (self.camera.outside * math.sin(math.radians(LARGEST_ANGLE_DEG))) ** 2
        coupling = float(self.media(shortest_nm).coupling(torch.tensor(steep, dtype=torch.float64)))
        return self.mask.coarsest_pitch_um(shortest_nm * 1e-3, coupling, divergence)

    def media(self, wavelength_nm: float) -> Media:
        """What lies on the two sides of the mask at a wavelength."""
        surface = self.camera.mask.surface
        indices = self.camera.media(wavelength_nm)
        return Media(
            wavelength_nm * 1e-3,
            indices[surface],
            indices[surface + 1],
            indices if self.fresnel else (),
        )

    def stack(self, wavelength_nm: float = REFERENCE_NM) -> Stack:
        """All layers, from the outermost surface to the sensor."""
        return _stack(self.camera, 0, len(self.camera.layers), wavelength_nm)

    def illumination(self, source: PointSource, wavelength_nm: float) -> Illumination:
        """Light of a source on the mask."""
        surface = self.camera.mask.surface
        return Illumination(
            source,
            _stack(self.camera, 0, surface, wavelength_nm),
            _stack(self.camera, surface, len(self.camera.layers), wavelength_nm),
            self.camera.outside,
        )

    def p_of(self, source: PointSource) -> float:
        """N sin θ of a source's field angle, in the space that the scene is in."""
        return self.camera.outside * source.p

    def response(self) -> Callable[[Tensor], Tensor]:
        """Fraction of the light that a pixel accepts, by p² = sin² of the field angle."""

        def accepted(squared: Tensor) -> Tensor:
            angle = torch.asin(squared.clamp(0, 1).sqrt()) * (180 / math.pi)
            return torch.from_numpy(np.asarray(self.acceptance.at(angle.numpy())))

        return accepted

    def accepting_all(self) -> "Twin":
        """The same camera with pixels that accept light from all sides alike."""
        even = AngularCurve(source="light from all sides", angle_deg=(0.0, 90.0), response=(1, 1))
        return replace(self, acceptance=even)

    def vignetting(self, p: Tensor) -> Tensor:
        """Irradiance that a point of a far plane gives, by the sine p of its angle; 1 on the axis.

        cos³θ (see `monochromatic_psf`), the pixels' acceptance, and Fresnel's losses if they count.
        """
        squared = p.square()
        cosine = (1 - squared / self.camera.outside**2).sqrt()
        power = cosine.pow(3) * self.response()(squared)
        surfaces = self.media(REFERENCE_NM).surfaces
        if surfaces:
            power = power * transmittance(surfaces, squared)
        zero = torch.zeros((), dtype=torch.float64)
        return power / (self.response()(zero) * (transmittance(surfaces, zero) if surfaces else 1))

    def shift_um(self, source: PointSource) -> tuple[float, float]:
        """Where the chief ray through the middle of the camera falls, (row, column) direction."""
        p = self.p_of(source)
        if p == 0:
            return 0.0, 0.0
        shift = float(self.stack().displacement_um(torch.tensor(p, dtype=torch.float64)))
        size = math.hypot(*source.tangent)
        return shift * source.tangent[0] / size, shift * source.tangent[1] / size

    def check_source(self, source: PointSource) -> None:
        """Refuse a source that the model does not hold for.

        Raises
        ------
        OptionError
            If its angle is beyond ±50°, its light is totally reflected, or it is nearer than 1 mm.
        """
        if source.angle_deg > LARGEST_ANGLE_DEG + 1e-6:
            raise OptionError(
                f"light from {source.angle_deg:.1f} deg off the axis is beyond the model, which "
                f"holds to {LARGEST_ANGLE_DEG:g} deg (a corner counts by its own angle): choose a "
                "smaller angle"
            )
        if self.p_of(source) >= self.stack().critical:
            raise OptionError(
                f"light from {source.angle_deg:.1f} deg off the axis is totally reflected on its "
                "way to the sensor: choose a smaller angle"
            )
        if not source.distance_um >= _NEAREST_MM * 1e3:
            raise OptionError(
                f"a distance of {source.distance_um * 1e-3:g} mm is nearer than the mask's near "
                f"limit: choose {_NEAREST_MM:g} mm or more"
            )

    def check_extent(self, source: PointSource, grid: Grid) -> None:
        """Refuse a PSF that needs more mask than there is.

        Raises
        ------
        OptionError
            If light passes the mask's plane beyond the relief, where no opening ends it either.
        """
        if self.mask.opening is not None or isinstance(self.camera.mask.relief, Flat):
            return
        light = self.illumination(source, REFERENCE_NM)
        media = self.media(REFERENCE_NM)
        places = [grid.positions_um(axis)[[0, -1]].tolist() for axis in (0, 1)]
        beyond = 0.0
        sensor = self.camera.sensor.rows, self.camera.sensor.columns
        for row in places[0]:
            for column in places[1]:
                ray = light.chief_ray((row, column))
                squared = torch.tensor(ray.squared, dtype=torch.float64)
                turned = float(media.coupling(squared).abs()) * self.mask.relief.steepest
                spread = float(light.after.spread_um(squared.sqrt()))
                margin = Margin.needed(turned, spread, media.wavelength_um)
                needed = margin.geometric_um + margin.diffraction_um
                for axis, pixels in enumerate(sensor):
                    half = pixels * self.sensor_pitch_um / 2
                    extent = abs(ray.mask_um[axis]) + needed
                    if extent > self.mask.relief.extent_um[axis] / 2 + self.mask.relief.grid_um:
                        beyond = max(beyond, extent - half)
        if beyond > 0:
            raise OptionError(
                f"light of this angle reaches the PSF's edge through the mask up to "
                f"{beyond * 1e-3:.2f} mm beyond the sensor, where the relief of "
                f"{self.camera.name!r} has ended: give it an overhang of "
                f"{math.ceil(beyond / 50 + 0.5) * 0.05:.2f} mm or more, an aperture, or choose a "
                "smaller angle"
            )


def described_lenslets(camera: Camera, size_um: tuple[float, float]) -> Relief:
    """Surface of the random lenslets that a camera describes, over an area of (height, width).

    They bulge out of the denser medium, towards the scene or the sensor.
    """
    relief = camera.mask.relief
    assert isinstance(relief, RandomLenslets)
    surface = random_lenslets(
        radius_um=relief.radius.um,
        pitch_um=relief.pitch.um,
        smoothing_um=relief.smoothing.um,
        size_um=size_um,
        grid_um=relief.grid.um,
        seed=relief.seed,
    )
    number = camera.mask.surface
    above, below = camera.media(REFERENCE_NM)[number : number + 2]
    return surface if above <= below else Relief(-surface.height_um, surface.grid_um)


def preview_model(loaded: LoadedCamera, *, fresnel: bool = True) -> Twin:
    """Prepare a camera for rays and for estimates, in a moment.

    Parameters
    ----------
    loaded
        The camera.
    fresnel
        Whether light is lost at surfaces.

    Returns
    -------
    Twin
        Of random lenslets, which take seconds and gigabytes, it has only a patch.

    Raises
    ------
    OptionError
        If the relief is coarser than its lenslets or the light need.
    """
    relief = loaded.camera.mask.relief
    if not isinstance(relief, RandomLenslets):
        return Twin.of(loaded, fresnel=fresnel)
    if relief.pitch.exact < 2 * relief.grid.exact:
        raise OptionError(
            f"the relief of {loaded.camera.name!r} has a lenslet every {relief.pitch}, but a point "
            f"only every {relief.grid}: give it a grid of {relief.pitch.um / _STEPS:.2g} µm or "
            "finer, or a larger pitch"
        )
    side_um = min(_LENSLETS * relief.pitch.um, _POINTS * relief.grid.um)
    patch = described_lenslets(loaded.camera, (side_um, side_um))
    file = ReliefFile(kind="file", file="patch.tif", grid=relief.grid)
    twin = Twin.of(loaded.with_relief(file, patch.height_um), fresnel=fresnel)
    return replace(twin, camera=loaded.camera)


def relief_points(loaded: LoadedCamera) -> float:
    """Points that the relief of random lenslets is computed on, and its lenslets are spread on."""
    camera = loaded.camera
    relief, sensor = camera.mask.relief, camera.sensor
    if not isinstance(relief, RandomLenslets):
        return 0.0
    beyond, pitch = 2 * relief.overhang.um, sensor.pitch.um
    area = math.prod(count * pitch + beyond for count in (sensor.rows, sensor.columns))
    # A place that lenslets are spread on takes twice the memory of a point.
    return area / relief.grid.um**2 + 2 * area * (_STEPS / relief.pitch.um) ** 2


def simulation_bytes(points: float, working: float) -> float:
    """Most memory that a simulation holds: its relief is computed first, and held from then on.

    `relief_points` counts the points; the PSFs and what is made of them hold the `working` bytes.
    """
    return max(surface_bytes(points), working + _BYTES_PER_HEIGHT * points)


def check_simulation_memory(
    loaded: LoadedCamera, working: float, device: torch.device, remedy: str
) -> float:
    """Bytes that a simulation needs, `working` beside the camera's relief, if there are as many.

    Raises
    ------
    OptionError
        If the machine has less memory, before the relief is computed; `remedy` ends the message.
    """
    needed = BYTES_OF_PROGRAM + simulation_bytes(relief_points(loaded), working)
    check_memory(needed, device, remedy)
    return needed


def distance_um(distance: Length | str | None, loaded: LoadedCamera) -> float:
    """A distance as the optics take it: the word is infinity, None the camera's own."""
    if distance is None:
        return loaded.camera.reference_distance.um
    return distance.um if isinstance(distance, Length) else math.inf


def camera_figures(loaded: LoadedCamera) -> dict[str, Any]:
    """Derive figures of a camera, in values that JSON has.

    Parameters
    ----------
    loaded
        The camera.

    Returns
    -------
    dict
        Size of the sensor in mm and pixels of the reconstruction; reduced thickness Σ t/n of all
        layers in mm; how much larger the PSF of a point source at 80 mm is than that of a far
        one; shift of the chief ray in um by the field angle in degrees; electrons at which a
        pixel clips; names of the curves that are placeholders.
    """
    twin = preview_model(loaded)
    camera, sensor = loaded.camera, loaded.camera.sensor
    near = twin.illumination(PointSource(distance_um=_NEAR_MM * 1e3), REFERENCE_NM)
    curves = {
        "quantum_efficiency": loaded.quantum_efficiency.source,
        "acceptance": loaded.acceptance.source,
    }
    return {
        "sensor_mm": [round(sensor.height_mm, 4), round(sensor.width_mm, 4)],
        "pixels": list(twin.shape),
        "layers": len(camera.layers),
        "reduced_thickness_mm": round(twin.stack().reduced_um * 1e-3, 5),
        "magnification_at_80mm": round(
            1 + near.after.reduced_um / (_NEAR_MM * 1e3 + near.before.reduced_um), 5
        ),
        "chief_ray_um": {
            str(angle): round(
                twin.shift_um(PointSource((0.0, math.tan(math.radians(angle)))))[1], 2
            )
            for angle in _ANGLES_DEG
        },
        "clip_electrons": round(sensor.clip_electrons, 1),
        "placeholders": [
            name for name, source in curves.items() if source.startswith("placeholder")
        ],
    }


def _stack(camera: Camera, first: int, last: int, wavelength_nm: float) -> Stack:
    return Stack(
        tuple(layer.thickness.um for layer in camera.layers[first:last]),
        camera.indices(wavelength_nm)[first:last],
    )


def _relief(loaded: LoadedCamera) -> Relief:
    relief, sensor = loaded.camera.mask.relief, loaded.camera.sensor
    if isinstance(relief, RandomLenslets):
        beyond = 2 * relief.overhang.um
        height, width = (
            count * sensor.pitch.um + beyond for count in (sensor.rows, sensor.columns)
        )
        return described_lenslets(loaded.camera, (height, width))
    if isinstance(relief, ReliefFile):
        assert loaded.relief_um is not None
        return Relief(loaded.relief_um, relief.grid.um)
    return Relief(torch.zeros(2, 2), sensor.pitch.um)


def _round_down(pitch_um: float) -> str:
    digits = 1 - math.floor(math.log10(pitch_um))
    return f"{math.floor(pitch_um * 10**digits) / 10**digits:g}"
