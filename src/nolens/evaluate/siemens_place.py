"""Where a Siemens star is in a picture: its centre, its size and its number of spokes."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize
from torch import Tensor

from nolens.errors import DataError

_SAMPLES = 1024
_CIRCLES = 24
_ROUNDS = 30
_FEWEST, _MOST = 4, 200
_DOMINANT = 0.3
_RIM = 0.5
_Array = NDArray[np.float64]


@dataclass(frozen=True)
class StarPlace:
    """A star in a picture.

    Parameters
    ----------
    centre
        Row and column.
    radius
        To the ends of its spokes, or as far as whole circles fit into the picture, in cells.
    periods
        Bright spokes.
    """

    centre: tuple[float, float]
    radius: float
    periods: int


def finest_radius(periods: int) -> float:
    """Radius in cells at which a spoke with the dark beside it is 2.5 cells wide."""
    return 1.25 * periods / math.pi


def find_star(picture: Tensor, periods: int | None = None) -> StarPlace:
    r"""Find a Siemens star.

    All edges of the spokes point at the centre: it is first the place that is nearest to the
    lines through all cells across their gradients, in least squares that heed outliers little.
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
    found = 0
    for _ in range(2):  # A second time from the better centre.
        orders = _orders(values, centre)
        found = _dominant(orders)
        centre = _refined(values, centre, found, _rim(orders, found))
    if periods is not None and found != periods:
        raise DataError(
            f"the star in the picture has {found} bright spokes, not {periods}: give --spokes "
            f"{found}, or the picture of the other star"
        )
    radius = _rim(_orders(values, centre), found)
    return StarPlace(centre, float(radius), found)


def _meeting_point(values: _Array) -> tuple[float, float]:
    smooth = ndimage.gaussian_filter(values, 1.0)
    slopes = np.gradient(smooth)
    size = np.hypot(*slopes)
    strong = size > 0.1 * size.max()
    unit = np.stack([slope[strong] / size[strong] for slope in slopes])
    place = np.stack(np.nonzero(strong)).astype(float)
    meant = (unit * place).sum(0)
    weight = size[strong]
    centre = np.array(values.shape) / 2
    scale = max(values.shape) / 4
    for _ in range(_ROUNDS):
        off = unit.T @ centre - meant
        heeded = weight / (1 + (off / scale) ** 2)
        normal = (unit * heeded) @ unit.T
        try:
            centre = np.linalg.solve(normal, (unit * heeded) @ meant)
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
    reach = math.floor(min(room))
    if reach < 8:
        raise _no_star()
    turn = np.arange(_SAMPLES) * (2 * math.pi / _SAMPLES)
    radii = np.arange(reach + 1)[:, None]
    places = [centre[0] - radii * np.sin(turn), centre[1] + radii * np.cos(turn)]
    circles = ndimage.map_coordinates(values, places, order=1, mode="nearest")
    return np.abs(np.fft.rfft(circles, axis=1))


def _dominant(orders: _Array) -> int:
    """The strongest order of the circles, refused where others are as strong."""
    power = (orders**2).sum(0)
    power[: _FEWEST - 1] = 0
    found = int(power[: _MOST + 1].argmax())
    rim = _rim(orders, found)
    outer = orders[2 * rim // 3 : rim + 1] ** 2
    # Order 0 is the mean; 1 and 2 are an uneven light or a centre that is a little off.
    share = outer[:, found].sum() / max(outer[:, 3:].sum(), 1e-300)
    if found < _FEWEST or not share > _DOMINANT:
        raise _no_star()
    return found


def _rim(orders: _Array, periods: int) -> int:
    """The outermost circle with at least half the largest amplitude."""
    amplitude = orders[:, periods]
    return int(np.flatnonzero(amplitude >= _RIM * amplitude.max())[-1])


def _refined(
    values: _Array, centre: tuple[float, float], periods: int, rim: int
) -> tuple[float, float]:
    """The centre around which the spokes of all circles have the largest fundamental."""
    inner = math.ceil(finest_radius(periods))
    if rim <= inner + 2:
        return centre
    spline = ndimage.spline_filter(values, order=3)
    samples = max(_SAMPLES // 4, 6 * periods)
    turn = np.arange(samples) * (2 * math.pi / samples)
    radii = np.linspace(inner, rim - 1, min(rim - inner, _CIRCLES))[:, None]
    away = [-radii * np.sin(turn), radii * np.cos(turn)]
    wave = np.exp(-1j * periods * turn)

    def lost(at: _Array) -> float:
        places = [each + start for each, start in zip(away, at, strict=True)]
        circles = ndimage.map_coordinates(spline, places, order=3, prefilter=False, mode="nearest")
        return -float(np.abs(circles @ wave).sum())

    start = np.array(centre)
    simplex = start + np.array([[0.0, 0.0], [1.0, 0.3], [-0.3, 1.0]])
    found = optimize.minimize(
        lost, start, method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-9 * abs(lost(start))},
    ).x  # fmt: skip
    return float(found[0]), float(found[1])


def _no_star() -> DataError:
    return DataError(
        "the picture shows no Siemens star: there are no evenly spaced spokes around one centre. "
        "Give the picture of a star that lies inside it with all of its spokes, cut to it "
        "(--region) where there is much beside it"
    )
