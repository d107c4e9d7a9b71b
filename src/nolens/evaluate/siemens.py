"""A Siemens star in a picture: its contrast by frequency in every direction."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate.siemens_place import StarPlace, find_star, finest_radius

SECTORS = 8
STAR_THRESHOLD = 0.10
"""Share of the contrast of wide spokes at which spokes count as just resolved."""

_OUTER = 0.95
_LOW = 0.85
_HALF_RING = 1.5
_FEWEST_RINGS = 6
_SQUARE_WAVE = 4 / math.pi
_Array = NDArray[np.float64]


@dataclass(frozen=True)
class StarContrast:
    r"""Contrast of a star's spokes.

    Parameters
    ----------
    place
        Where the star is, and how many bright spokes it has.
    radii
        Of the rings in cells, from the inside out, (rings,).
    contrast
        (sectors, rings): amplitude of the spokes to their mean, as a share of that of evenly
        bright and dark spokes, :math:`4/π`.
    noise
        Its standard deviation, from what is no spoke, (sectors, rings).
    directions_deg
        Of the middle of each sector, from the right towards up, (sectors,).
    """

    place: StarPlace
    radii: Tensor
    contrast: Tensor
    noise: Tensor
    directions_deg: Tensor

    @property
    def wide(self) -> float:
        """Contrast of the widest spokes: the mean over the outermost rings."""
        return float(self.contrast[:, self.radii >= _LOW * self.radii[-1]].mean())


@dataclass(frozen=True)
class ResolvedRadius:
    """From which radius on spokes are resolved.

    Parameters
    ----------
    radius
        In cells; the innermost ring's where even that is resolved.
    plus_minus
        Half the distance of two rings and the noise, added as squares.
    at_limit
        Whether the innermost ring is resolved, so that the true radius may be smaller.
    """

    radius: float
    plus_minus: float
    at_limit: bool


def star_contrast(
    picture: Tensor, *, periods: int | None = None, sectors: int = SECTORS
) -> StarContrast:
    r"""Measure the contrast of a Siemens star by radius and direction.

    The star is found by itself (`find_star`). In every sector of every ring the cells are fit
    with :math:`a + a'φ + (b + b'r)\cos Nφ + (c + c'r)\sin Nφ` and the third harmonic by least
    squares, r from the ring's middle, and the contrast is :math:`\sqrt{b^2+c^2}/a`, the
    fundamental of the spokes (`loebich2007`). Rings are a cell apart and three cells wide.

    Parameters
    ----------
    picture
        (height, width), linear, in any unit, geometrically flat: spokes are straight in it.
    periods
        Bright spokes that the star should have; None takes what is found.
    sectors
        Into how many equal ones the circle is divided.

    Raises
    ------
    DataError
        If there is no star, it has another number of spokes, or it is too small in cells.
    """
    place = find_star(picture, periods)
    values = picture.double().cpu().numpy()
    inner = math.ceil(finest_radius(place.periods))
    outer = math.floor(_OUTER * place.radius)
    if outer - inner < _FEWEST_RINGS:
        raise DataError(
            f"the star reaches {place.radius:.0f} cells from its centre, and its {place.periods} "
            f"bright spokes can be told from each other from {inner} on: a star of fewer spokes or "
            "of a larger angle is needed"
        )
    rows, columns = np.indices(values.shape)
    row, column = rows - place.centre[0], columns - place.centre[1]
    cells = _Cells(np.hypot(row, column), np.arctan2(-row, column), values, place.periods)
    middles = np.arange(sectors) * (2 * math.pi / sectors)
    radii = np.arange(inner, outer + 1, dtype=np.float64)
    contrast, noise = np.empty((2, sectors, len(radii)))
    for number, radius in enumerate(radii):
        ring = cells.where(np.abs(cells.radius - radius) < _HALF_RING)
        for sector, middle in enumerate(middles):
            beside = (ring.turn - middle + math.pi) % (2 * math.pi) - math.pi
            part = np.abs(beside) <= math.pi / sectors
            fit = _fundamental(ring.where(part), beside[part], radius)
            contrast[sector, number], noise[sector, number] = fit
    return StarContrast(
        place, torch.from_numpy(radii), torch.from_numpy(contrast), torch.from_numpy(noise),
        torch.from_numpy(np.degrees(middles)),
    )  # fmt: skip


def resolved_radii(
    star: StarContrast, *, threshold: float = STAR_THRESHOLD
) -> tuple[ResolvedRadius, ...]:
    """Find for every sector from which radius on the spokes are resolved.

    From the outside in, the contrast falls below the threshold there for the first time;
    linear between rings.

    Parameters
    ----------
    star
        Its contrast.
    threshold
        As a share of the contrast of the widest spokes.

    Raises
    ------
    DataError
        If the widest spokes are not resolved in a sector.
    """
    limit = threshold * star.wide
    radii = star.radii.tolist()
    found = []
    for contrast, noise, direction in zip(
        star.contrast.tolist(), star.noise.tolist(), star.directions_deg.tolist(), strict=True
    ):
        below = [number for number, each in enumerate(contrast) if each < limit]
        if not below:
            found.append(ResolvedRadius(radii[0], (radii[1] - radii[0]) / 2, True))
            continue
        last = below[-1]
        if last == len(radii) - 1:
            raise DataError(
                f"at {direction:g} deg even the widest spokes of the star are not resolved: give a "
                "star of fewer spokes or of a larger angle"
            )
        step = radii[last + 1] - radii[last]
        slope = step / (contrast[last + 1] - contrast[last])
        radius = radii[last] + (limit - contrast[last]) * slope
        found.append(ResolvedRadius(radius, math.hypot(step / 2, slope * noise[last]), False))
    return tuple(found)


@dataclass(frozen=True)
class _Cells:
    """Some cells of a picture: where they are around the star, and how bright."""

    radius: _Array
    turn: _Array
    light: _Array
    periods: int

    def where(self, kept: NDArray[np.bool_]) -> "_Cells":
        return _Cells(self.radius[kept], self.turn[kept], self.light[kept], self.periods)


def _fundamental(cells: _Cells, beside: _Array, radius: float) -> tuple[float, float]:
    """Contrast of the spokes in a piece of a ring, and its standard deviation."""
    outwards, wave = cells.radius - radius, cells.periods * cells.turn
    cos, sin = np.cos(wave), np.sin(wave)
    basis = np.stack([
        cos, sin, np.ones_like(wave), beside, outwards * cos, outwards * sin,
        np.cos(3 * wave), np.sin(3 * wave),
    ])  # fmt: skip
    inverse = np.linalg.pinv(basis @ basis.T)
    fit = inverse @ (basis @ cells.light)
    rest = ((cells.light - fit @ basis) ** 2).sum() / max(len(wave) - len(basis), 1)
    # A dark ring has no contrast, however faint its noise.
    mean = max(fit[2], 1e-6 * float(np.abs(cells.light).max()), 1e-300)
    scale = 1 / (mean * _SQUARE_WAVE)
    spread = math.sqrt(max(rest * (inverse[0, 0] + inverse[1, 1]) / 2, 0.0))
    return float(np.hypot(fit[0], fit[1]) * scale), spread * scale
