"""Sharpness of cameras that came out differently: by the wave optics of the twin, or by rays."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.amounts import amount
from nolens.camera import Camera
from nolens.design.tolerances.parameters import (
    Parameter,
    Variable,
    layer_names,
    lit_width_um,
    variables,
)
from nolens.design.tolerances.patch import Patch
from nolens.design.tolerances.sensitivity import Criterion
from nolens.design.tolerances.sharpness import Sharpness
from nolens.errors import OptionError
from nolens.optics import (
    Grid,
    Illumination,
    MaskSurface,
    Media,
    PointSource,
    Relief,
    Stack,
    monochromatic_psf,
)
from nolens.twin import polychromatic_psf_bytes, simulation_bytes
from nolens.twin.psf import field_step, samples_per_pixel

_WAIST_OF_DISC = 0.364
"""Radius of the Gaussian beam (1/e²) whose focus is as wide as that of a disc, over its diameter:
the widths at half height, 1.029 λD/d of the disc and √(2 ln 2) λD/(π w) of the beam, are equal."""


@dataclass(frozen=True)
class Builds:
    """Some cameras that came out differently, float64.

    Parameters
    ----------
    thickness_um
        (cameras, layers), at the mask's middle; shrinkage is included.
    index_change
        (cameras, layers), the same at all wavelengths.
    wedge
        (cameras,), slope of the mask's layer along the sensor's rows.
    gain
        (cameras,), factor on the relief's heights, without shrinkage.
    scale
        (cameras,), factor on the relief in all three directions: 1 − shrinkage.
    decentre_um
        (cameras,), how far the mask lies to the side of larger columns.
    """

    thickness_um: Tensor
    index_change: Tensor
    wedge: Tensor
    gain: Tensor
    scale: Tensor
    decentre_um: Tensor

    @classmethod
    def of(cls, camera: Camera, names: tuple[str, ...], rows: Tensor) -> "Builds":
        """Make cameras of their parameters.

        Parameters
        ----------
        camera
            The description; what is not in `names` is as it says.
        names
            Of the parameters, as in `variables`.
        rows
            (cameras, parameters), in the units of `variables`.
        """
        columns = {
            name: rows[:, names.index(name)]
            if name in names
            else torch.full((len(rows),), each.middle, dtype=torch.float64)
            for name, each in variables(camera).items()
        }
        known, layers = variables(camera), layer_names(camera)
        scale = 1 - columns["relief.shrinkage"] / 100
        thickness = torch.stack([columns[f"{each}.thickness"] for each in layers], dim=1)
        thickness[:, camera.mask.surface] *= scale
        index = [columns[f"{each}.index"] - known[f"{each}.index"].middle for each in layers]
        return cls(
            thickness,
            torch.stack(index, dim=1),
            torch.tan(torch.deg2rad(columns["wedge"])),
            columns["relief.gain"] / 100,
            scale,
            columns["decentre"],
        )

    def __len__(self) -> int:
        return len(self.wedge)

    def at(self, camera: Camera, place_um: float) -> "Builds":
        """The same cameras as they are at a place on the sensor, along its rows from the middle."""
        thickness = self.thickness_um.clone()
        thickness[:, camera.mask.surface] += self.wedge * (place_um - self.decentre_um)
        return replace(self, thickness_um=thickness)


def check_possible(camera: Camera, parameters: tuple[Parameter, ...], rows: Tensor) -> None:
    """Refuse cameras that cannot exist, before one is computed.

    Parameters
    ----------
    camera
        The description.
    parameters
        What varies.
    rows
        (cameras, parameters), drawn from them.

    Raises
    ------
    OptionError
        If a thickness, an index or another parameter is impossible, at its tolerance or in one of
        the cameras; says the largest tolerance that would do.
    """
    known = variables(camera)
    for number, each in enumerate(parameters):
        allowed = known[each.name]
        drawn = rows[:, number]
        ends = torch.tensor([each.middle - each.tolerance, each.middle + each.tolerance])
        values = torch.cat([drawn, ends.double()])
        low, high = float(values.min()), float(values.max())
        if low < allowed.lowest or high > allowed.highest:
            wrong = low if low < allowed.lowest else high
            largest = _floor(largest_possible(allowed, each, rows[:, number]))
            advice = (
                f"with these trials ± {amount(largest, each.unit, digits=6)} is the largest that "
                "would do, or cut the distribution with at_most"
                if largest > 0
                else f"change its mean, {amount(each.middle, each.unit, digits=6)}"
            )
            raise OptionError(
                f"{each.name} = {amount(wrong, each.unit, digits=4)}"
                + f" comes out of a tolerance of {amount(each.tolerance, each.unit, digits=6)}"
                + f", and {allowed.accepted}: {advice}"
            )
    if not leaves_thickness(camera, parameters, rows):
        raise OptionError(
            "the wedge leaves no thickness of the mask's layer at one end of the sensor: give a "
            "smaller tolerance of wedge, or of the layer's thickness"
        )


def leaves_thickness(camera: Camera, parameters: tuple[Parameter, ...], rows: Tensor) -> bool:
    """Whether the mask's layer has a thickness wherever light passes it, in all cameras."""
    names = tuple(each.name for each in parameters)
    builds = Builds.of(camera, names, rows)
    half = lit_width_um(camera) / 2
    ends = [
        builds.at(camera, place).thickness_um[:, camera.mask.surface] for place in (-half, half)
    ]
    return bool((torch.stack(ends) > 0).all())


def largest_possible(allowed: Variable, parameter: Parameter, drawn: Tensor) -> float:
    """Tolerance at which the first of some trials becomes impossible; 0 if the middle is so.

    Parameters
    ----------
    allowed
        Says what is possible.
    parameter
        With what it was drawn.
    drawn
        Its values.
    """
    away = (drawn - parameter.middle) / (parameter.tolerance or 1.0)
    down, up = max(1.0, -float(away.min())), max(1.0, float(away.max()))
    room = (parameter.middle - allowed.lowest) / down, (allowed.highest - parameter.middle) / up
    return max(0.0, min(room))


def _floor(value: float) -> float:
    """Two digits, rounded down."""
    if value <= 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.floor(value / step * (1 + 1e-12)) * step


class Model(Protocol):
    """Gives cameras their figures."""

    def figures(self, builds: Builds) -> Tensor:
        """One figure for each camera, float64."""


@dataclass(frozen=True)
class WaveModel:
    """The twin's PSF of a far point source on the axis.

    Parameters
    ----------
    patch
        The camera.
    sharpness
        The criterion.
    colours
        Pairs of wavelength in nm and weight.
    threads
        Cameras that are computed side by side, where torch itself has one thread.
    """

    patch: Patch
    sharpness: Sharpness
    colours: tuple[tuple[float, float], ...]
    threads: int = 1

    @property
    def bytes_per_camera(self) -> float:
        """Memory that the PSF of one camera takes."""
        twin, (height, width) = self.patch.twin, self.patch.side_um
        psf = polychromatic_psf_bytes(
            twin,
            PointSource(distance_um=twin.camera.reference_distance.um),
            (round(height / twin.pixel_um), round(width / twin.pixel_um)),
            twin.superpixel,
            at_least=2,
            shortest=min(nm for nm, _ in self.colours),
        )
        return simulation_bytes(twin.mask.relief.height_um.numel(), psf)

    def figures(self, builds: Builds) -> Tensor:
        """One figure for each camera, float64."""
        with ThreadPoolExecutor(self.threads) as pool:
            figures = list(pool.map(partial(self._figure, builds), range(len(builds))))
        return torch.tensor(figures, dtype=torch.float64)

    def _figure(self, builds: Builds, number: int) -> float:
        psf = self.psf(builds, number)
        lenslet = float(builds.scale[number]) ** 2 * self.patch.lenslets.area_um2
        pixel_um, lit = self.patch.twin.sensor_pitch_um, math.prod(self._lit_um())
        return self.sharpness.of_psf(psf, pixel_um, lit / lenslet)

    def psf(self, builds: Builds, number: int) -> Tensor:
        """PSF of one camera on the sensor's pixels, (rows, columns).

        Of a mask without an opening the pixels follow the mask, so that all cameras show the same
        lenslets; an opening moves over the sensor.
        """
        twin = self.patch.twin
        pixel = twin.sensor_pitch_um
        per_pixel = samples_per_pixel(twin, at_least=2)
        aside = float(builds.decentre_um[number]) if twin.mask.opening is not None else 0.0
        rows, columns = (round(side / pixel) for side in self.patch.side_um)
        grid = Grid(rows, columns, pixel, (0.0, -aside)).finer(per_pixel)
        distance = twin.camera.reference_distance.um
        step = field_step(
            twin,
            grid.pitch_um,
            shortest_nm=min(each for each, _ in self.colours),
            distance_um=distance,
        )
        mask = self._mask(builds, number, step * grid.pitch_um)
        total = torch.zeros(rows, columns)
        for wavelength_nm, weight in self.colours:
            stack = self._stack(builds, number, wavelength_nm)
            surface = twin.camera.mask.surface
            before = Stack(stack.thicknesses_um[:surface], stack.indices[:surface])
            after = Stack(stack.thicknesses_um[surface:], stack.indices[surface:])
            media = (twin.camera.outside, *stack.indices)
            psf = monochromatic_psf(
                Illumination(PointSource(distance_um=distance), before, after, media[0]),
                mask,
                Media(
                    wavelength_nm * 1e-3,
                    media[surface],
                    media[surface + 1],
                    media if twin.fresnel else (),
                ),
                grid,
                response=twin.response(),
            )
            total.add_(nnf.avg_pool2d(psf[None, None], per_pixel)[0, 0], alpha=weight)
        return total

    def _mask(self, builds: Builds, number: int, grid_um: float) -> MaskSurface:
        """The relief as it came out, on the grid of the field."""
        twin, scale = self.patch.twin, float(builds.scale[number])
        relief = twin.mask.relief
        cast = Relief(
            relief.height_um * (float(builds.gain[number]) * scale), relief.grid_um * scale
        )
        rows, columns = (math.floor(extent / grid_um) + 1 for extent in cast.extent_um)
        heights = cast.sample(Grid(rows, columns, grid_um))
        return MaskSurface(Relief(heights, grid_um), twin.mask.opening)

    def _stack(self, builds: Builds, number: int, wavelength_nm: float) -> Stack:
        usual = self.patch.twin.stack(wavelength_nm).indices
        changes = builds.index_change[number].tolist()
        return Stack(
            tuple(builds.thickness_um[number].tolist()),
            tuple(index + change for index, change in zip(usual, changes, strict=True)),
        )

    def _lit_um(self) -> tuple[float, float]:
        opening = self.patch.twin.mask.opening
        height, width = self.patch.side_um
        if opening is None:
            return height, width
        return min(height, opening.height_um), min(width, opening.width_um)


@dataclass(frozen=True)
class RayModel:
    r"""Gaussian beams through the lenslets, by their ray matrices.

    A lenslet of pitch p passes a beam of the radius w that has the same width in the focus as its
    whole area; behind the matrix [[A, B], [C, D]] from mask to sensor (`mask_to_sensor`) its
    radius is, with the source at the distance z (`kogelnik1966`),

    .. math:: w'^2 = w^2 (A + B/z)^2 + \left(\frac{λ B}{π n_0 w}\right)^2,

    defocus and diffraction. Pixels add the twelfth of their pitch squared to the variance
    :math:`w'^2 / 4`.

    Parameters
    ----------
    patch
        The camera.
    sharpness
        The criterion.
    wavelength_nm
        Of the light.
    """

    patch: Patch
    sharpness: Sharpness
    wavelength_nm: float

    def figures(self, builds: Builds) -> Tensor:
        """One figure for each camera, float64, all at once."""
        pitch = self.patch.lenslets.pitch_um * builds.scale
        sigma = (self.beam_um(builds).square() / 4 + self._pixel_um**2 / 12).sqrt()
        return self.sharpness.of_spots(sigma, pitch, self.patch.lenslets.gathered)

    def beam_um(self, builds: Builds) -> Tensor:
        """Radius of the beams on the sensor, to 1/e² of the intensity."""
        camera = self.patch.twin.camera
        surface = camera.mask.surface
        usual = torch.tensor(self.patch.twin.stack(self.wavelength_nm).indices, dtype=torch.float64)
        index = usual + builds.index_change
        reduced = builds.thickness_um / index
        # A + B/z and B/n₀ of the matrix, written out for all cameras at once.
        behind = reduced[:, surface:].sum(dim=1)
        away = camera.reference_distance.um + reduced[:, :surface].sum(dim=1)
        above = index[:, surface - 1] if surface else torch.ones_like(behind)
        lenslets = self.patch.lenslets
        power = (index[:, surface] - above).abs() / (
            lenslets.radius_um * builds.scale / builds.gain
        )
        pupil = _WAIST_OF_DISC * math.sqrt(4 / math.pi * lenslets.area_um2) * builds.scale
        defocus = pupil * (1 - power * behind + behind / away)
        diffraction = self.wavelength_nm * 1e-3 * behind / (math.pi * pupil)
        return torch.hypot(defocus, diffraction)

    @property
    def _pixel_um(self) -> float:
        return self.patch.twin.sensor_pitch_um


def criterion_of(model: Model, camera: Camera, names: tuple[str, ...]) -> Criterion:
    """The sharpness of cameras, averaged over the length of the sensor where it is not the same.

    A wedge makes the layer thicker on one side: the mean of two places, at 1/√3 of half the
    length, is exact for cubic polynomials of the place.

    Parameters
    ----------
    model
        Gives one place its figure.
    camera
        The description.
    names
        Of the parameters, in the order of the criterion's columns.
    """
    away = lit_width_um(camera) / math.sqrt(12)

    def figures(rows: Tensor) -> Tensor:
        builds = Builds.of(camera, names, rows)
        if not bool(builds.wedge.any()):
            return model.figures(builds)
        sides = (model.figures(builds.at(camera, place)) for place in (-away, away))
        return sum(sides, torch.zeros(len(rows), dtype=torch.float64)) / 2

    return figures
