"""The PSF of any depth from those of a few, and the distance of mask and sensor behind it."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import torch
from torch import Tensor

from nolens.calibrate.distances import covered, magnified
from nolens.calibrate.registration import register
from nolens.camera import Camera
from nolens.errors import DataError
from nolens.refocusing.depth import depth_of_focus_per_m, line_pixels, lit_pixels, per_m

_LARGEST_UM = 20e3
"""Reduced distance of mask and sensor beyond which none is sought."""
_LEAST_LINES = 0.25
"""Lines by which the edge must move between two PSFs for them to tell the magnification."""
_LEAST_ALIKE = 0.7
"""Correlation of neighbours below which they are too unlike to be blended."""


@dataclass(frozen=True)
class PsfAt:
    """A PSF and the distance of its point source.

    Parameters
    ----------
    psf
        (channels, rows, columns), not negative; zero shift is the pixel (rows // 2, columns // 2).
    distance_um
        May be infinite.
    """

    psf: Tensor
    distance_um: float

    def depth_of_focus_per_m(self, reduced_um: float, sensor: tuple[int, int]) -> float:
        """`nolens.refocusing.depth_of_focus_per_m` on a sensor of (rows, columns) in its pixels."""
        return depth_of_focus_per_m(line_pixels(self.psf), reduced_um, lit_pixels(self.psf, sensor))


@dataclass(frozen=True)
class PsfBetween:
    """PSFs at some distances, and what leads from one to another.

    Parameters
    ----------
    known
        The farthest first.
    reduced_um
        Reduced distance D of mask and sensor: a source at z magnifies the PSF by 1 + D/z.
    moved
        Pixels by which each is moved down and to the right against the first one.
    brightness
        Of each, beside the first one.
    alike
        Correlation of each with the next one, once it is magnified to its distance.
    """

    known: tuple[PsfAt, ...]
    reduced_um: float
    moved: tuple[tuple[float, float], ...]
    brightness: tuple[float, ...]
    alike: tuple[float, ...]

    @classmethod
    def of(cls, known: Sequence[PsfAt], reduced_um: float) -> Self:
        """Bring PSFs into one place and to one brightness.

        Parameters
        ----------
        known
            Of one camera, alike in shape, each at its own distance.
        reduced_um
            D; `measured_reduced_um` finds it.
        """
        ordered = tuple(sorted(known, key=lambda each: -each.distance_um))
        moved, brightness, alike = [(0.0, 0.0)], [1.0], []
        for one, two in pairwise(ordered):
            factor = _factor(reduced_um, one.distance_um, two.distance_um)
            place = register(two.psf, one.psf, magnification=factor)
            here = moved[-1]
            moved.append((here[0] + place.shift[0], here[1] + place.shift[1]))
            size = (one.psf.shape[-2], one.psf.shape[-1])
            both = covered(size, factor, moved=place.shift)
            larger = magnified(one.psf, factor, moved=place.shift)
            larger, target = (each.mean(dim=0)[both].double() for each in (larger, two.psf))
            brightness.append(brightness[-1] * float(target.sum() / larger.sum()))
            alike.append(float(torch.corrcoef(torch.stack([larger, target]))[0, 1]))
        return cls(ordered, reduced_um, tuple(moved), tuple(brightness), tuple(alike))

    def at(self, depth_um: float) -> Tensor:
        r"""The PSF of a depth: its neighbours, magnified to it and blended linearly in 1/z.

        Beyond the ends the last one is magnified: :math:`M = (1 + D/z) / (1 + D/z_i)`.

        Parameters
        ----------
        depth_um
            May be infinite.
        """
        places = [per_m(each.distance_um) for each in self.known]
        place = per_m(depth_um)
        upper = bisect_left(places, place)
        if upper in (0, len(places)) or places[upper] == place:
            return self._from(min(upper, len(places) - 1), depth_um)[0]
        fraction = (place - places[upper - 1]) / (places[upper] - places[upper - 1])
        one, one_covers = self._from(upper - 1, depth_um)
        two, two_covers = self._from(upper, depth_um)
        weights = (1 - fraction) * one_covers, fraction * two_covers
        return (weights[0] * one + weights[1] * two) / (weights[0] + weights[1]).clamp_min(1e-9)

    @property
    def gaps(self) -> list[tuple[float, float, float]]:
        """Neighbours too unlike to be blended: near and far distance in um, and `alike`."""
        return [
            (near.distance_um, far.distance_um, alike)
            for (far, near), alike in zip(pairwise(self.known), self.alike, strict=True)
            if alike < _LEAST_ALIKE
        ]

    def _from(self, number: int, depth_um: float) -> tuple[Tensor, Tensor]:
        """One of the PSFs magnified to a depth, and the pixels that it covers there."""
        known, shift = self.known[number], self.moved[number]
        factor = _factor(self.reduced_um, known.distance_um, depth_um)
        moved = (-shift[0] * factor if shift[0] else 0.0, -shift[1] * factor if shift[1] else 0.0)
        size = (known.psf.shape[-2], known.psf.shape[-1])
        psf = magnified(known.psf, factor, moved=moved).div_(self.brightness[number])
        return psf, covered(size, factor, moved=moved).float()


def cut_alike(psfs: Sequence[PsfAt]) -> list[PsfAt]:
    """PSFs cut to the size that all of them have; the zero shift stays in the middle."""
    rows, columns = (min(each.psf.shape[axis] for each in psfs) for axis in (-2, -1))

    def middle(psf: Tensor) -> Tensor:
        top, left = psf.shape[-2] // 2 - rows // 2, psf.shape[-1] // 2 - columns // 2
        return psf[..., top : top + rows, left : left + columns]

    return [replace(each, psf=middle(each.psf)) for each in psfs]


def measured_reduced_um(known: Sequence[PsfAt]) -> float | None:
    """D from how much larger the nearest source's PSF is than the farthest one's.

    Parameters
    ----------
    known
        PSFs of one camera, alike in shape.

    Returns
    -------
    float or None
        None where there is one distance only, or the sizes are too alike to tell.

    Raises
    ------
    DataError
        If the sizes differ by more than the distances do.
    """
    near = min(known, key=lambda each: each.distance_um)
    far = max(known, key=lambda each: each.distance_um)
    if near.distance_um == far.distance_um:
        return None
    line = line_pixels(far.psf)
    largest = _factor(_LARGEST_UM, far.distance_um, near.distance_um)
    factor = register(near.psf, far.psf, magnification=(1.0, largest)).magnification
    if (factor - 1) * max(far.psf.shape[-2:]) / 2 < _LEAST_LINES * line:
        return None
    difference = per_m(near.distance_um) - factor * per_m(far.distance_um)
    if not difference > 0:
        raise DataError(
            f"from {far.distance_um * 1e-3:.4g} to {near.distance_um * 1e-3:.4g} mm the PSF "
            f"becomes {factor:.4g} times as large, more than the PSF of any camera: check the "
            "distances that the PSFs were taken at, and that they show more than noise (nolens "
            "measure psf)"
        )
    return 1e6 * (factor - 1) / difference


def explained_by(reduced_um: float, known: Sequence[PsfAt], measured_um: float) -> bool:
    """Whether the sizes of PSFs follow from a reduced distance beside the one measured on them.

    They do where the edge of the nearest PSF differs by less than a quarter of a line.
    """
    places = [per_m(each.distance_um) for each in known]
    psf = known[0].psf
    difference = abs(measured_um - reduced_um) * 1e-6 * (max(places) - min(places))
    return difference * max(psf.shape[-2:]) / 2 < _LEAST_LINES * line_pixels(psf)


def reduced_um(camera: Camera, first: int) -> float:
    """Σ thickness / index of a camera's layers from one of them down to the sensor, at 550 nm."""
    layers = zip(camera.layers[first:], camera.indices(550.0)[first:], strict=True)
    return sum(layer.thickness.um / index for layer, index in layers)


def _factor(reduced_um: float, from_um: float, to_um: float) -> float:
    return (1 + reduced_um / to_um) / (1 + reduced_um / from_um)
