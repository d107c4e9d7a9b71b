"""A Siemens star: its drawing, its place in a picture, its contrast, and what is resolved."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage, optimize
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.evaluate.screen import FlatPicture, pixel_means

_SAMPLES = 1024
_CIRCLES = 24
_ROUNDS = 30
_FEWEST, _MOST = 4, 200
_DOMINANT = 0.3
_RIM = 0.5
_Array = NDArray[np.float64]
_SECTORS = 8
_STAR_THRESHOLD = 0.10
"""Fraction of the contrast of wide spokes at which spokes count as just resolved."""
_OUTER = 0.95
_LOW = 0.85
_HALF_RING = 1.5
_FEWEST_RINGS = 6
_SQUARE_WAVE = 4 / math.pi
_DIAMETER = 0.96
"""Of the drawn star, to the side of its square."""


def siemens_star(side: int, periods: int) -> Tensor:
    """Bright and dark spokes around the middle of a square; dark beside the star.

    Parameters
    ----------
    side
        Pixels along the square.
    periods
        Bright spokes.

    Returns
    -------
    Tensor
        (side, side), 0 to 1; each pixel the mean over its area.

    Raises
    ------
    OptionError
        If there are fewer than 4 bright spokes.
    """
    if periods < _FEWEST:
        raise OptionError(f"a star of {periods} bright spokes: give at least 4, such as 36")

    def value(right: Tensor, up: Tensor) -> Tensor:
        turned = torch.atan2(up, right) * (periods / (2 * math.pi))
        bright = (turned - turned.round()).abs() < 0.25
        return (bright & (torch.hypot(right, up) <= _DIAMETER)).float()

    return pixel_means(value, side)


def star_square_deg(angle_deg: float) -> float:
    """Field angle of the side of a star's square, by that of the star from side to side."""
    return 2 * math.degrees(math.atan(math.tan(math.radians(angle_deg) / 2) / _DIAMETER))


@dataclass(frozen=True)
class StarPlace:
    """A star in a picture.

    Parameters
    ----------
    centre
        Row and column.
    radius
        To the ends of its spokes, or as far as whole circles fit into the picture, in pixels.
    periods
        Bright spokes.
    """

    centre: tuple[float, float]
    radius: float
    periods: int


def _finest_radius(periods: int) -> float:
    """Radius in pixels at which a spoke with the dark beside it is 2.5 pixels wide."""
    return 1.25 * periods / math.pi


def find_star(picture: Tensor, periods: int | None = None) -> StarPlace:
    r"""Find a Siemens star.

    All edges of the spokes point at the centre: it is first the place that is nearest to the
    lines through all pixels across their gradients, in least squares that heed outliers little.
    Then it is where the fundamentals :math:`|\sum v\,e^{-iNφ}|` of all circles have the largest
    sum: beside the centre their phases differ from side to side. N is the strongest order of
    the outer circles.

    Parameters
    ----------
    picture
        (height, width), linear.
    periods
        Bright spokes that it should have; None takes what is found.

    Raises
    ------
    DataError
        If there is no star, or it has another number of spokes.
    """
    values = picture.double().cpu().numpy()
    if not np.isfinite(values).all() or not values.max() > values.min():
        raise DataError("the picture is even or not finite: it shows no star")
    centre = _meeting_point(values)
    spokes = 0
    for _ in range(2):  # A second time from the better centre.
        orders = _orders(values, centre)
        spokes = _dominant(orders)
        centre = _refined(values, centre, spokes, _rim(orders, spokes))
    if periods is not None and spokes != periods:
        raise DataError(
            f"the star in the picture has {spokes} bright spokes, not {periods}: give --spokes "
            f"{spokes}, or the picture of the other star"
        )
    radius = _rim(_orders(values, centre), spokes)
    return StarPlace(centre, float(radius), spokes)


def _meeting_point(values: _Array) -> tuple[float, float]:
    smooth = ndimage.gaussian_filter(values, 1.0)
    slopes = np.gradient(smooth)
    size = np.hypot(*slopes)
    strong = size > 0.1 * size.max()
    unit = np.stack([slope[strong] / size[strong] for slope in slopes])
    place = np.stack(np.nonzero(strong)).astype(float)
    offsets = (unit * place).sum(0)
    weight = size[strong]
    centre = np.array(values.shape) / 2
    scale = max(values.shape) / 4
    for _ in range(_ROUNDS):
        off = unit.T @ centre - offsets
        weighted = weight / (1 + (off / scale) ** 2)
        normal = (unit * weighted) @ unit.T
        try:
            centre = np.linalg.solve(normal, (unit * weighted) @ offsets)
        except np.linalg.LinAlgError:
            break
        scale = max(2.0, 0.8 * scale)
    inside = (centre > 0) & (centre < np.array(values.shape) - 1)
    if not inside.all():
        raise _no_star()
    return float(centre[0]), float(centre[1])


def _orders(values: _Array, centre: tuple[float, float]) -> _Array:
    """Amplitude of every order of the whole circles around a centre, (circles, orders)."""
    room = [min(at, count - 1 - at) for at, count in zip(centre, values.shape, strict=True)]
    extent = math.floor(min(room))
    if extent < 8:
        raise _no_star()
    turn = np.arange(_SAMPLES) * (2 * math.pi / _SAMPLES)
    radii = np.arange(extent + 1)[:, None]
    places = [centre[0] - radii * np.sin(turn), centre[1] + radii * np.cos(turn)]
    circles = ndimage.map_coordinates(values, places, order=1, mode="nearest")
    return np.abs(np.fft.rfft(circles, axis=1))


def _dominant(orders: _Array) -> int:
    """The strongest order of the circles, refused where others are as strong."""
    power = (orders**2).sum(0)
    power[: _FEWEST - 1] = 0
    periods = int(power[: _MOST + 1].argmax())
    rim = _rim(orders, periods)
    outer = orders[2 * rim // 3 : rim + 1] ** 2
    # Order 0 is the mean; 1 and 2 are an uneven light or a centre that is a little off.
    fraction = outer[:, periods].sum() / max(outer[:, 3:].sum(), 1e-300)
    if periods < _FEWEST or not fraction > _DOMINANT:
        raise _no_star()
    return periods


def _rim(orders: _Array, periods: int) -> int:
    """The outermost circle with at least half the largest amplitude."""
    amplitude = orders[:, periods]
    return int(np.flatnonzero(amplitude >= _RIM * amplitude.max())[-1])


def _refined(
    values: _Array, centre: tuple[float, float], periods: int, rim: int
) -> tuple[float, float]:
    """The centre around which the spokes of all circles have the largest fundamental."""
    inner = math.ceil(_finest_radius(periods))
    if rim <= inner + 2:
        return centre
    spline = ndimage.spline_filter(values, order=3)
    samples = max(_SAMPLES // 4, 6 * periods)
    turn = np.arange(samples) * (2 * math.pi / samples)
    radii = np.linspace(inner, rim - 1, min(rim - inner, _CIRCLES))[:, None]
    away = [-radii * np.sin(turn), radii * np.cos(turn)]
    wave = np.exp(-1j * periods * turn)

    def loss(at: _Array) -> float:
        places = [each + start for each, start in zip(away, at, strict=True)]
        circles = ndimage.map_coordinates(spline, places, order=3, prefilter=False, mode="nearest")
        return -float(np.abs(circles @ wave).sum())

    start = np.array(centre)
    simplex = start + np.array([[0.0, 0.0], [1.0, 0.3], [-0.3, 1.0]])
    best = optimize.minimize(
        loss,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-9 * abs(loss(start))},
    ).x
    return float(best[0]), float(best[1])


def _no_star() -> DataError:
    return DataError(
        "the picture shows no Siemens star: there are no evenly spaced spokes around one centre. "
        "Give the picture of a star that lies inside it with all of its spokes, cut to it "
        "(--support) where there is much beside it"
    )


@dataclass(frozen=True)
class StarContrast:
    r"""Contrast of a star's spokes.

    Parameters
    ----------
    place
        Where the star is, and how many bright spokes it has.
    radii
        Of the rings in pixels, from the inside out, (rings,).
    contrast
        (sectors, rings): amplitude of the spokes to their mean, as a fraction of that of evenly
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
        In pixels; the innermost ring's where even that is resolved.
    plus_minus
        Half the distance of two rings and the noise, added as squares.
    at_limit
        Whether the innermost ring is resolved, so that the true radius may be smaller.
    """

    radius: float
    plus_minus: float
    at_limit: bool


def star_contrast(picture: Tensor, *, periods: int | None = None) -> StarContrast:
    r"""Measure the contrast of a Siemens star by radius and direction.

    The star is found by itself (`find_star`). In every sector of every ring the pixels are fit
    with :math:`a + a'φ + (b + b'r)\cos Nφ + (c + c'r)\sin Nφ` and the third harmonic by least
    squares, r from the ring's middle, and the contrast is :math:`\sqrt{b^2+c^2}/a`, the
    fundamental of the spokes (`loebich2007`). Rings are a pixel apart and three pixels wide.

    Parameters
    ----------
    picture
        (height, width), linear, in any unit, geometrically flat: spokes are straight in it.
    periods
        Bright spokes that the star should have; None takes what is found.

    Raises
    ------
    DataError
        If there is no star, it has another number of spokes, or it is too small in pixels.
    """
    place = find_star(picture, periods)
    values = picture.double().cpu().numpy()
    inner = math.ceil(_finest_radius(place.periods))
    outer = math.floor(_OUTER * place.radius)
    if outer - inner < _FEWEST_RINGS:
        raise DataError(
            f"the star reaches {place.radius:.0f} pixels from its centre, and its {place.periods} "
            f"bright spokes can be resolved from {inner} on: a star of fewer spokes or "
            "of a larger angle is needed"
        )
    rows, columns = np.indices(values.shape)
    row, column = rows - place.centre[0], columns - place.centre[1]
    pixels = _Pixels(np.hypot(row, column), np.arctan2(-row, column), values, place.periods)
    middles = np.arange(_SECTORS) * (2 * math.pi / _SECTORS)
    radii = np.arange(inner, outer + 1, dtype=np.float64)
    contrast, noise = np.empty((2, _SECTORS, len(radii)))
    for number, radius in enumerate(radii):
        ring = pixels.where(np.abs(pixels.radius - radius) < _HALF_RING)
        for sector, middle in enumerate(middles):
            beside = (ring.turn - middle + math.pi) % (2 * math.pi) - math.pi
            part = np.abs(beside) <= math.pi / _SECTORS
            fit = _fundamental(ring.where(part), beside[part], radius)
            contrast[sector, number], noise[sector, number] = fit
    return StarContrast(
        place,
        torch.from_numpy(radii),
        torch.from_numpy(contrast),
        torch.from_numpy(noise),
        torch.from_numpy(np.degrees(middles)),
    )


def resolved_radii(
    star: StarContrast, *, threshold: float = _STAR_THRESHOLD
) -> tuple[ResolvedRadius, ...]:
    """Find for every sector from which radius on the spokes are resolved.

    From the outside in, the contrast falls below the threshold there for the first time;
    linear between rings.

    Parameters
    ----------
    star
        Its contrast.
    threshold
        As a fraction of the contrast of the widest spokes.

    Raises
    ------
    DataError
        If the widest spokes are not resolved in a sector.
    """
    limit = threshold * star.wide
    radii = star.radii.tolist()
    resolved = []
    for contrast, noise, direction in zip(
        star.contrast.tolist(), star.noise.tolist(), star.directions_deg.tolist(), strict=True
    ):
        below = [number for number, each in enumerate(contrast) if each < limit]
        if not below:
            resolved.append(ResolvedRadius(radii[0], (radii[1] - radii[0]) / 2, True))
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
        resolved.append(ResolvedRadius(radius, math.hypot(step / 2, slope * noise[last]), False))
    return tuple(resolved)


@dataclass(frozen=True)
class _Pixels:
    """Some pixels of a picture: where they are around the star, and how bright."""

    radius: _Array
    turn: _Array
    light: _Array
    periods: int

    def where(self, mask: NDArray[np.bool_]) -> "_Pixels":
        return _Pixels(self.radius[mask], self.turn[mask], self.light[mask], self.periods)


def _fundamental(pixels: _Pixels, beside: _Array, radius: float) -> tuple[float, float]:
    """Contrast of the spokes in a piece of a ring, and its standard deviation."""
    outwards, wave = pixels.radius - radius, pixels.periods * pixels.turn
    cos, sin = np.cos(wave), np.sin(wave)
    basis = np.stack(
        [
            cos,
            sin,
            np.ones_like(wave),
            beside,
            outwards * cos,
            outwards * sin,
            np.cos(3 * wave),
            np.sin(3 * wave),
        ]
    )
    inverse = np.linalg.pinv(basis @ basis.T)
    fit = inverse @ (basis @ pixels.light)
    rest = ((pixels.light - fit @ basis) ** 2).sum() / max(len(wave) - len(basis), 1)
    # A dark ring has no contrast, however faint its noise.
    mean = max(fit[2], 1e-6 * float(np.abs(pixels.light).max()), 1e-300)
    scale = 1 / (mean * _SQUARE_WAVE)
    spread = math.sqrt(max(rest * (inverse[0, 0] + inverse[1, 1]) / 2, 0.0))
    return float(np.hypot(fit[0], fit[1]) * scale), spread * scale


@dataclass(frozen=True)
class StarResolution:
    """Resolution by a Siemens star.

    Parameters
    ----------
    picture
        In which it was measured.
    star
        Contrast by radius and sector.
    pairs_deg
        Angle of a bright spoke and the dark beside it, (sectors, rings).
    resolved_deg
        The smallest that is resolved, for each sector.
    plus_minus_deg
        Of each.
    at_limit
        Whether each is the finest that there is, so that finer ones may be resolved.
    threshold
        Fraction of the contrast of wide spokes from which on they count as resolved.
    """

    picture: FlatPicture
    star: StarContrast
    pairs_deg: Tensor
    resolved_deg: tuple[float, ...]
    plus_minus_deg: tuple[float, ...]
    at_limit: tuple[bool, ...]
    threshold: float

    @property
    def worst(self) -> int:
        """Number of the sector in which least is resolved."""
        return max(range(len(self.resolved_deg)), key=self.resolved_deg.__getitem__)

    @property
    def resolved_everywhere_deg(self) -> float:
        """Smallest pair of a bright and a dark spoke that is resolved in all directions."""
        return self.resolved_deg[self.worst]

    @property
    def diameter_deg(self) -> float:
        """Field angle of the star, from side to side."""
        middle, radius = self.star.place.centre, self.star.place.radius
        ends = [(middle[1] + side * radius - self.picture.axis[1]) for side in (-1, 1)]
        angles = [math.degrees(math.atan(end * self.picture.tangent)) for end in ends]
        return angles[1] - angles[0]

    @property
    def figures(self) -> dict[str, Any]:
        """What is resolved, and contrast by frequency and direction, in values that JSON has."""
        star, worst = self.star, self.worst
        return {
            "resolved_deg": self.resolved_everywhere_deg,
            "plus_minus_deg": self.plus_minus_deg[worst],
            "spoke_deg": self.resolved_everywhere_deg / 2,
            "worst_direction_deg": float(star.directions_deg[worst]),
            "finest_of_the_pixels": self.at_limit[worst],
            "contrast_needed": self.threshold * star.wide,
            "contrast_of_wide_spokes": star.wide,
            "spokes": star.place.periods,
            "centre": star.place.centre,
            "diameter_deg": self.diameter_deg,
            "directions": [
                {
                    "direction_deg": float(star.directions_deg[number]),
                    "resolved_deg": resolved_deg,
                    "plus_minus_deg": self.plus_minus_deg[number],
                    "cycles_per_deg": [1 / each for each in self.pairs_deg[number].tolist()],
                    "contrast": star.contrast[number].tolist(),
                }
                for number, resolved_deg in enumerate(self.resolved_deg)
            ],
        }

    @classmethod
    def of(
        cls, picture: FlatPicture, *, periods: int | None = None, threshold: float = _STAR_THRESHOLD
    ) -> "StarResolution":
        """Measure a picture (`star_contrast`, `resolved_radii`).

        Raises
        ------
        DataError
            If it shows no such star.
        """
        star = star_contrast(picture.values, periods=periods)
        radii = resolved_radii(star, threshold=threshold)

        def pair_deg(radius: float, turn: float) -> float:
            row, column = -math.sin(turn), math.cos(turn)
            place = star.place.centre[0] + radius * row, star.place.centre[1] + radius * column
            length = 2 * math.pi * radius / star.place.periods
            return picture.angle_deg(place, (column, -row), length)

        turns = torch.deg2rad(star.directions_deg).tolist()
        pairs = [[pair_deg(radius, turn) for radius in star.radii.tolist()] for turn in turns]
        resolved = [pair_deg(each.radius, turn) for each, turn in zip(radii, turns, strict=True)]
        off = [
            pair_deg(each.radius + each.plus_minus, turn) - angle
            for each, turn, angle in zip(radii, turns, resolved, strict=True)
        ]
        return cls(
            picture,
            star,
            torch.tensor(pairs),
            tuple(resolved),
            tuple(off),
            tuple(each.at_limit for each in radii),
            threshold,
        )
