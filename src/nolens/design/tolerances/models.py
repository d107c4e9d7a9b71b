"""Sharpness of cameras that came out differently: by the wave optics of the twin, or by rays."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import Camera
from nolens.design.tolerances.builds import Builds
from nolens.design.tolerances.criterion import Criterion
from nolens.design.tolerances.patch import Patch
from nolens.design.tolerances.sharpness import Sharpness
from nolens.design.tolerances.variables import lit_width_um
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
from nolens.twin.psf import field_step, samples_per_pixel

_WAIST_OF_DISC = 0.364
"""Radius of the Gaussian beam (1/e²) whose focus is as wide as that of a disc, over its diameter:
the widths at half height, 1.029 λD/d of the disc and √(2 ln 2) λD/(π w) of the beam, are equal."""


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

    def figures(self, builds: Builds) -> Tensor:
        """One figure for each camera, float64."""
        with ThreadPoolExecutor(self.threads) as pool:
            found = list(pool.map(partial(self._figure, builds), range(len(builds))))
        return torch.tensor(found, dtype=torch.float64)

    def _figure(self, builds: Builds, number: int) -> float:
        pattern = self.pattern(builds, number)
        lenslet = float(builds.scale[number]) ** 2 * self.patch.lenslets.area_um2
        cell, lit = self.patch.twin.sensor_pitch_um, math.prod(self._lit_um())
        return self.sharpness.of_pattern(pattern, cell, lit / lenslet)

    def pattern(self, builds: Builds, number: int) -> Tensor:
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
            media = (1.0, *stack.indices)
            pattern = monochromatic_psf(
                Illumination(PointSource(distance_um=distance), before, after),
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
            total.add_(nnf.avg_pool2d(pattern[None, None], per_pixel)[0, 0], alpha=weight)
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
