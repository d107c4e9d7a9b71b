"""How a PSF is cut into windows that are computed one by one."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from nolens.kernels import fast_length

_LARGEST = 3072
_FRESNEL_WIDTHS = 3.0
_DIVERGENCE_SHARE = 0.1


@dataclass(frozen=True)
class Window:
    """One part of the PSF.

    Parameters
    ----------
    rows, columns
        First and last-but-one sample of the PSF that this part gives.
    """

    rows: tuple[int, int]
    columns: tuple[int, int]


@dataclass(frozen=True)
class Margin:
    r"""What a window has around the part that it gives, so that all light of that part is in it.

    Light that the relief turns by Δp moves sideways by Δp · spread; diffraction blurs that by
    some widths of the first Fresnel zone, √(λ · spread). Beyond, the field is faded out over as
    many widths, so that the window's edge diffracts nothing.

    Parameters
    ----------
    geometric_um
        How far the relief turns light aside.
    diffraction_um
        Width that diffraction needs, and width of the fading.
    """

    geometric_um: float
    diffraction_um: float

    @classmethod
    def needed(cls, turned: float, spread_um: float, wavelength_um: float) -> "Margin":
        """Margin for light that is turned by up to `turned` (in p)."""
        zone = math.sqrt(wavelength_um * spread_um)
        return cls(turned * spread_um, _FRESNEL_WIDTHS * zone)

    @property
    def total_um(self) -> float:
        """All of it, on each side."""
        return self.geometric_um + 2 * self.diffraction_um

    def fading(self, samples: int, pitch_um: float) -> Tensor:
        """Weights along one side of a window: 1 inside, falling smoothly to 0 at the edges."""
        width = max(1.0, self.diffraction_um / pitch_um)
        place = torch.arange(samples, dtype=torch.float64)
        inside = torch.minimum(place, samples - 1 - place) / width
        return (0.5 - 0.5 * torch.cos(math.pi * inside.clamp(0, 1))).float()


def divergence(pitch_um: float, distance_um: float) -> float:
    """How far the light of a source spreads, in p, from the middle of a window to its edge."""
    return min(_DIVERGENCE_SHARE, _LARGEST * pitch_um / distance_um) / 2


def windows(rows: int, columns: int, pitch_um: float, distance_um: float) -> Iterator[Window]:
    """Cut a PSF into windows of about equal size.

    No window is larger than what the processor's caches and the memory like, nor than the fraction
    of the source's distance over which the light's direction changes little.

    Parameters
    ----------
    rows, columns
        Samples of the PSF.
    pitch_um
        Their distance.
    distance_um
        Of the source.
    """
    largest = _LARGEST
    if math.isfinite(distance_um):
        largest = max(64, min(largest, int(_DIVERGENCE_SHARE * distance_um / pitch_um)))
    for top, bottom in _cut(rows, largest):
        for left, right in _cut(columns, largest):
            yield Window((top, bottom), (left, right))


def window_length(samples: int, margin: Margin, pitch_um: float, *, of_rows: bool) -> int:
    """Length of a transform that holds so many samples and the margin on both sides."""
    return fast_length(samples + 2 * math.ceil(margin.total_um / pitch_um) + 2, of_rows=of_rows)


def _cut(count: int, largest: int) -> list[tuple[int, int]]:
    parts = -(-count // largest)
    edges = [count * i // parts for i in range(parts + 1)]
    return list(pairwise(edges))
