"""PSFs of other distances than the measured one, by the rays of the layers."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from nolens.camera import Camera
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.optics import Stack
from nolens.quantities import Angle, Length
from nolens.twin import REFERENCE_NM

Values = NDArray[np.float64]

_DIGITS = 5
_MUCH_UNKNOWN = 0.001
_DEFOCUSED_MM = 20.0
_TABLE = 512
_SPLINE = 5
_NEIGHBOURHOOD = 12.0
"""Width of the Gaussian, in pixels, that unknown light is the mean over."""


@dataclass(frozen=True)
class Layers:
    """What light passes on its way to the sensor.

    Parameters
    ----------
    before
        Layers between the air in front of the camera and the mask.
    after
        Layers between mask and sensor.
    outside
        Refractive index of the space that the scene is in.
    """

    before: Stack
    after: Stack
    outside: float = 1.0

    @classmethod
    def of_camera(cls, camera: Camera) -> "Layers":
        """The layers of a camera, at the wavelength that stands for all."""
        thicknesses = tuple(layer.thickness.um for layer in camera.layers)
        indices, surface = camera.indices(REFERENCE_NM), camera.mask.surface
        return cls(
            Stack(thicknesses[:surface], indices[:surface]),
            Stack(thicknesses[surface:], indices[surface:]),
            camera.outside,
        )

    @classmethod
    def of_air(cls, reduced_um: float) -> "Layers":
        """Layers of which only the reduced thickness Σ t/n is known, as air of that thickness."""
        return cls(Stack((), ()), Stack((reduced_um,), (1.0,)))

    @property
    def reduced_um(self) -> float:
        """Reduced thickness of all layers."""
        return self.before.reduced_um + self.after.reduced_um

    def magnification(self, distance_um: float, shift_um: float = 0.0) -> float:
        """How large the PSF of a source is beside that of a far one: 1 + D / (z + b).

        D and b are the reduced thicknesses behind and before the mask (`uvimprint`, sec. 3.5). For
        a source whose ray through the middle falls so far beside the axis it is the root of the
        product of what rays do along that shift, and across.
        """
        if math.isinf(distance_um):
            return 1.0
        front = self._front(distance_um)
        if shift_um == 0:
            return 1 + self.after.reduced_um / front.reduced_um
        p = self.before.then(self.after).ray(torch.tensor(shift_um, dtype=torch.float64))
        along = 1 + float(self.after.spread_um(p) / front.spread_um(p))
        across = 1 + float(self.after.displacement_um(p) / front.displacement_um(p))
        return math.sqrt(along * across)

    def shift_um(self, angle: tuple[Angle, Angle]) -> tuple[float, float]:
        """Place of the ray through the middle, to the right and up, by Snell's law."""
        tangents = [math.tan(each.rad) for each in angle]
        size = math.hypot(*tangents)
        if size == 0:
            return 0.0, 0.0
        p = torch.tensor(self.outside * size / math.sqrt(1 + size * size), dtype=torch.float64)
        shift = float(self.before.then(self.after).displacement_um(p))
        return shift * tangents[0] / size, shift * tangents[1] / size

    def along_um(self, angle_deg: float) -> float:
        """Shift of the PSF by an angle along one axis."""
        return self.shift_um((Angle.of(angle_deg, "deg"), Angle.of(0, "deg")))[0]

    def angle_at(self, shift_um: tuple[float, float]) -> tuple[Angle, Angle]:
        """Field angles whose ray falls there, to 0.01 deg: the inverse of `shift_um`."""
        size = math.hypot(*shift_um)
        if size == 0:
            return Angle("0", "deg"), Angle("0", "deg")
        p = float(self.before.then(self.after).ray(torch.tensor(size, dtype=torch.float64)))
        tangent = p / math.sqrt(self.outside**2 - p * p) / size
        degrees = [math.degrees(math.atan(each * tangent)) for each in shift_um]
        right, up = (Angle.of(round(each, 2) + 0.0, "deg") for each in degrees)
        return right, up

    def on_sensor(self, mask_um: Tensor, distance_um: float) -> Tensor:
        """Where a ray falls that passes the mask at some distances from the axis, float64.

        It comes from a source on the axis at a distance, which may be infinite.
        """
        if math.isinf(distance_um):
            return mask_um
        ray = self._front(distance_um).ray(mask_um)
        return mask_um + self.after.displacement_um(ray)

    def on_mask(self, sensor_um: Tensor, distance_um: float) -> Tensor:
        """Where a ray passes the mask that falls on a place of the sensor: the inverse."""
        if math.isinf(distance_um):
            return sensor_um
        front = self._front(distance_um)
        ray = front.then(self.after).ray(sensor_um)
        return front.displacement_um(ray)

    def _front(self, distance_um: float) -> Stack:
        return Stack((distance_um,), (self.outside,)).then(self.before)


@dataclass(frozen=True)
class Scaled:
    """A PSF of another distance.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    magnification
        How large its PSF is beside that of the measured one, near the axis.
    unknown_fraction
        Fraction of its pixels whose light comes from beyond the measured PSF; they have the mean
        light of their neighbourhood.
    """

    psf: Tensor
    magnification: float
    unknown_fraction: float

    def warnings(self, distance: Depth) -> list[str]:
        """What may make the PSF of this distance worse than a measured one."""
        texts = []
        if self.unknown_fraction > _MUCH_UNKNOWN:
            texts.append(
                f"{100 * self.unknown_fraction:.2g} % of the PSF of {distance} lies beyond the "
                "measured one, and has the mean light of its neighbourhood: a stitched PSF, or one "
                "measured at a nearer distance would not need that"
            )
        if isinstance(distance, Length) and distance.mm < _DEFOCUSED_MM:
            texts.append(
                f"{distance} is so near that the lenslets focus behind the sensor, which scaling "
                "does not show: measure a PSF there"
            )
        return texts


def evenly_between(nearest: Depth, farthest: Depth, count: int) -> list[Depth]:
    """So many distances that are equally far apart in 1/z, as PSFs are in size, ends included.

    Raises
    ------
    OptionError
        If the first one is not the nearer one.
    """
    ends = [0.0 if isinstance(each, str) else 1 / each.mm for each in (nearest, farthest)]
    if ends[0] <= ends[1]:
        raise OptionError(
            f"--between {nearest},{farthest}: give the nearer distance first, such as 8cm,1m"
        )
    steps = [ends[0] + (ends[1] - ends[0]) * number / (count - 1) for number in range(1, count - 1)]
    inner = [Length.of(float(f"{1 / each:.{_DIGITS}g}"), "mm") for each in steps]
    return [nearest, *inner, farthest]


def scaled_psf(
    psf: Tensor, pixel_um: float, layers: Layers, *, measured_um: float, target_um: float
) -> Scaled:
    r"""PSF of a point source on the axis at another distance than the measured one's.

    The PSF moves with the rays that carry it. The ray that falls on the radius
    :math:`r_1` from the target distance passes the mask at m; from the measured distance the one
    through the same m falls on :math:`r_0(r_1)` (Snell's law in every layer). The light goes with
    them: :math:`p_1(r_1) = p_0(r_0)\,\frac{r_0}{r_1}\frac{dr_0}{dr_1}`. Near the axis that is a
    magnification by :math:`M_1/M_0`, :math:`M = 1 + D/z`. What the distance does to the focus is
    left out: it is small against the depth of focus from a few cm on.

    Parameters
    ----------
    psf
        (channels, rows, columns); its middle is the axis.
    pixel_um
        Pitch of its pixels.
    layers
        What the light passes.
    measured_um, target_um
        Distances of the point sources; may be infinite.

    Raises
    ------
    OptionError
        If nothing of the measured PSF is left at the target distance.
    """
    rows, columns = psf.shape[-2:]
    places = [(torch.arange(n, dtype=torch.float64) - (n - 1) / 2) for n in (rows, columns)]
    radius = torch.hypot(places[0][:, None].expand(-1, columns), places[1].expand(rows, -1))
    table = torch.linspace(0, float(radius.max()) * pixel_um, _TABLE, dtype=torch.float64)
    there = layers.on_sensor(layers.on_mask(table, target_um), measured_um)
    near = layers.magnification(measured_um) / layers.magnification(target_um)
    ratio = np.append(near, (there[1:] / table[1:]).numpy())
    density = ratio * np.gradient(there.numpy(), table.numpy(), edge_order=2)
    scale = _along(radius, pixel_um, table, ratio)
    light = _along(radius, pixel_um, table, density)
    at = [places[0][:, None].numpy() * scale, places[1].numpy() * scale]
    unknown = (np.abs(at[0]) > (rows - 1) / 2) | (np.abs(at[1]) > (columns - 1) / 2)
    if unknown.all():
        raise OptionError("nothing of the PSF is left at that distance: choose a nearer one")
    where = np.stack([at[0] + (rows - 1) / 2, at[1] + (columns - 1) / 2])
    planes = [
        ndimage.map_coordinates(plane, where, order=_SPLINE, mode="nearest") * light
        for plane in psf.double().numpy()
    ]
    result = torch.from_numpy(np.stack(planes))
    known = torch.from_numpy(~unknown)
    return Scaled(
        with_mean_light(result, known).to(psf.dtype), 1 / near, float((~known).double().mean())
    )


def with_mean_light(psf: Tensor, known: Tensor) -> Tensor:
    """Give pixels of (channels, rows, columns) that are not known the mean light around them."""
    if bool(known.all()):
        return psf
    mask = known.double().numpy()
    # Beyond the extent of the Gaussian the nearest known light is what there is.
    nearest = ndimage.distance_transform_edt(mask == 0, return_distances=False, return_indices=True)
    weight = ndimage.gaussian_filter(mask, _NEIGHBOURHOOD)
    filled = []
    for plane in psf.double().numpy():
        total = ndimage.gaussian_filter(plane * mask, _NEIGHBOURHOOD)
        mean = total / np.where(weight > 1e-3, weight, 1)
        around = np.where(weight > 1e-3, mean, mean[tuple(nearest)])
        filled.append(np.where(mask > 0, plane, around))
    return torch.from_numpy(np.stack(filled)).to(psf.dtype)


def _along(radius: Tensor, pixel_um: float, table: Tensor, values: Values) -> Values:
    """Values of a table of radii, at each pixel's radius."""
    result: Values = np.interp((radius * pixel_um).numpy(), table.numpy(), values)
    return result


def pixel_angle(camera: Camera, pixel_um: float) -> float:
    """Angle between neighbouring scene pixels in the middle of the view, in rad, of a far scene.

    A ray at the small angle θ moves by Dθ on its way from mask to sensor, D = Σ t/n.

    Parameters
    ----------
    camera
        The measurement's.
    pixel_um
        Pitch of the measurement's pixels.
    """
    return pixel_um / (camera.outside * Layers.of_camera(camera).after.reduced_um)
