"""The point spread functions of one camera at several points of its field."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera.psf import Flip

_EVEN = 0.16
"""Standard deviation of the logarithm of light that PSFs of one exposure may have."""
_FALL, _FALLS = 4.0, 8.0
"""Power of the cosine with which light falls off the axis, and by how much it may be another."""


@dataclass(frozen=True)
class FieldPsf:
    """PSFs of point sources of one distance, each about its own chief ray.

    Parameters
    ----------
    values
        (points, channels, height, width): the zero shift is the pixel
        (height // 2, width // 2) of each.
    places
        (points, 2): rows and columns from the sensor's middle, its pixel
        (height // 2, width // 2), to where the chief ray falls.
    """

    values: Tensor = field(repr=False)
    places: Tensor

    @classmethod
    def of(cls, planes: Sequence[Tensor], places: Tensor) -> "FieldPsf":
        """PSFs of any sizes and exposures: dark beside what is known, and equally bright.

        The scene is then as bright as its light reaches the sensor, as with one PSF: a PSF that
        kept the fall of light towards the edges would take it out of the picture.

        Parameters
        ----------
        planes
            (channels, height, width) each.
        places
            As above.
        """
        size = [max(plane.shape[axis] for plane in planes) for axis in (-2, -1)]
        values = planes[0].new_empty((len(planes), planes[0].shape[0], *size))
        light = torch.empty((*values.shape[:2], 1, 1), dtype=torch.float64, device=values.device)
        # One by one: of hundreds of PSFs a copy is gigabytes.
        for plane, own, power in zip(planes, values, light, strict=True):
            own.copy_(around_middle(plane, size))
            power.copy_(own.mean(dim=(-2, -1), keepdim=True, dtype=torch.float64))
        field_psf = cls(values, places)
        least = torch.finfo(values.dtype).tiny
        for own, factor in zip(
            values, light[field_psf.middle] / light.clamp_min(least), strict=True
        ):
            own.mul_(factor.to(values))
        return field_psf

    @property
    def points(self) -> int:
        """How many there are."""
        return self.values.shape[0]

    @property
    def middle(self) -> int:
        """The one that is nearest to the axis."""
        return int(self.places.double().square().sum(dim=1).argmin())

    @property
    def on_axis(self) -> Tensor:
        """PSF of the point nearest to the axis, (channels, height, width)."""
        return self.values[self.middle]

    def flipped_places(self, flip: Flip) -> "FieldPsf":
        """The same PSFs of a camera whose pictures are turned over, as they are already."""
        signs = [-1.0 if flip in (axis, "both") else 1.0 for axis in ("vertical", "horizontal")]
        return replace(self, places=self.places * self.places.new_tensor(signs))

    def to(self, device: torch.device | str) -> "FieldPsf":
        """The same where it is to be computed with."""
        return replace(self, values=self.values.to(device))


def odd_light(cosines: Sequence[float], light: Sequence[float]) -> tuple[int, float] | None:
    r"""Find the PSF whose light its angle does not explain.

    Light falls with a power p of the cosine of the angle, :math:`\ln L = a + p \ln\cos θ`: with the
    fourth, or with more where pixels accept less from the side, and with none where PSFs were made
    equally bright. The other PSFs tell a and p, and so what each one should have.

    Parameters
    ----------
    cosines
        Of the angle off the axis of each, two or more.
    light
        Sum of the values of each.

    Returns
    -------
    tuple or None
        Number of the one that is the farthest off, and how many times as much light it has as it
        should; None if all fit.
    """
    least = torch.finfo(torch.float64).tiny
    fall = torch.tensor(cosines, dtype=torch.float64).log()
    brightness = torch.tensor(light, dtype=torch.float64).clamp_min(least).log() - _FALL * fall
    terms = torch.stack([torch.ones_like(fall), fall], dim=1)
    doubt = torch.zeros(2, 2, dtype=torch.float64)
    doubt[1, 1] = (_EVEN / _FALLS) ** 2
    odd: tuple[int, float] | None = None
    worst = 1.0
    for number, term in enumerate(terms):
        others = torch.arange(len(terms)) != number
        weights = terms[others].T @ terms[others] + doubt
        reach = torch.linalg.solve(weights, term)
        off = float(brightness[number] - reach @ (terms[others].T @ brightness[others]))
        allowed = _EVEN * math.sqrt(1 + float(reach @ term))
        if abs(off) > worst * allowed:
            worst, odd = abs(off) / allowed, (number, math.exp(off))
    return odd


def spread(places: Sequence[tuple[float, float]], most: int) -> list[int]:
    """Numbers of at most so many places, evenly spread: the one nearest to the axis first.

    Each further one is the farthest from all that are chosen.
    """
    at = torch.tensor(places, dtype=torch.float64)
    chosen = [int(at.square().sum(dim=1).argmin())]
    away = (at - at[chosen[0]]).norm(dim=1)
    while len(chosen) < min(most, len(at)):
        chosen.append(int(away.argmax()))
        away = torch.minimum(away, (at - at[chosen[-1]]).norm(dim=1))
    return chosen


def around_middle(plane: Tensor, size: Sequence[int]) -> Tensor:
    """The same with dark pixels around it, its zero shift in the new middle."""
    sides: list[int] = []
    for each, most in zip(plane.shape[:-3:-1], size[::-1], strict=True):
        before = most // 2 - each // 2
        sides += [before, most - each - before]
    return nnf.pad(plane, sides)
