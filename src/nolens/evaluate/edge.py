"""A slanted edge: its drawing, its spread in a picture, and the contrast by frequency."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import windows
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate.screen import FlatPicture, pixel_means

_BINS_PER_PIXEL = 4
_ROUNDS = 4
_STRAIGHT = 1.0
_FEWEST = 16
_FULL_STEP, _MOST_ROWS = 0.6, 0.8
_SHARPNESS = 0.5
_WIDEST_GAP = 0.42
_Array = NDArray[np.float64]


def slanted_edge(side: int, tilt_deg: float) -> Tensor:
    """Dark at the left, bright at the right of an edge through the middle of a square.

    Parameters
    ----------
    side
        Pixels along the square.
    tilt_deg
        Of the edge from upright, to the left at its top.

    Returns
    -------
    Tensor
        (side, side), 0 to 1; each pixel the mean over its area.
    """
    tilt = math.tan(math.radians(tilt_deg))
    return pixel_means(lambda right, up: (right + tilt * up > 0).float(), side)


@dataclass(frozen=True)
class EdgeResponse:
    """What an edge shows.

    Parameters
    ----------
    tilt_deg
        From the pixels' columns or rows, whichever it is nearer to.
    direction_deg
        Of the line across the edge, along which contrast is measured, from the right towards up.
    centre
        Row and column of its middle.
    at
        Distances from the edge in pixels, (places,).
    spread
        Light there, from about 0 to about 1.
    frequencies
        In cycles per pixel, (frequencies,), up to 0.5.
    transfer
        Contrast there, 1 at frequency 0.
    """

    tilt_deg: float
    direction_deg: float
    centre: tuple[float, float]
    at: Tensor
    spread: Tensor
    frequencies: Tensor
    transfer: Tensor

    def frequency_of(self, contrast: float) -> float | None:
        """Lowest frequency at which the contrast has fallen to a value; None: nowhere."""
        transfer = self.transfer.tolist()
        for number in range(1, len(transfer)):
            if transfer[number] < contrast:
                before, after = transfer[number - 1 : number + 1]
                fraction = (before - contrast) / (before - after)
                low, high = self.frequencies[number - 1 : number + 1].tolist()
                return float(low + fraction * (high - low))
        return None


def edge_response(picture: Tensor) -> EdgeResponse:
    r"""Spatial frequency response of an edge (`iso12233`, e-SFR; `burns2000`).

    The place of the edge in every row is the centroid of the row's derivative; a straight line
    through these places (least squares) gives every pixel its distance from the edge. The light
    by distance, in bins of a quarter of a pixel that a spline makes even, is derived and
    transformed; what the bins and the difference of neighbours take off, :math:`\mathrm{sinc}`,
    is given back. In place of the norm's Hamming window, which widens the line by itself, the ends
    alone are tapered.

    Parameters
    ----------
    picture
        (height, width), linear, with one edge from end to end, dark on one side.

    Raises
    ------
    DataError
        If there is no such edge, or it is too upright or at an angle whose pixels fall on a few
        distances only.
    """
    values = picture.double().cpu().numpy()
    if min(values.shape) < _FEWEST or not np.isfinite(values).all():
        raise DataError(
            f"a picture of {values.shape[0]}×{values.shape[1]} pixels, or with values that are not "
            f"finite, is none of an edge: at least {_FEWEST}×{_FEWEST} pixels are needed"
        )
    across, along = (np.abs(np.diff(values, axis=axis).sum(axis=axis)).sum() for axis in (1, 0))
    lying = along > across
    upright = values.T if lying else values
    if upright[:, -1].sum() < upright[:, 0].sum():
        upright = -upright
    first, last = _rows_with_edge(upright)
    upright = upright[first:last]
    start, slope = _line(upright)
    rows, columns = np.arange(upright.shape[0])[:, None], np.arange(upright.shape[1])
    distance: _Array = (columns - start - slope * rows) / math.hypot(1.0, slope)
    at, spread = _spread(upright, distance, slope)
    frequencies, transfer = _transfer(spread)
    middle = (upright.shape[0] - 1) / 2
    place = (first + middle, start + slope * middle)
    tilt = math.degrees(math.atan(slope))
    return EdgeResponse(
        tilt,
        90.0 - tilt if lying else tilt,
        place[::-1] if lying else place,
        *map(torch.from_numpy, (at, _normalised(spread), frequencies, transfer)),
    )


def _rows_with_edge(values: _Array) -> tuple[int, int]:
    """First row and the one after the last in which it is as bright beyond the edge as in most.

    A picture often ends in half a row.
    """
    quarter = values.shape[1] // 4
    steps = values[:, -quarter:].mean(1) - values[:, :quarter].mean(1)
    rows = np.flatnonzero(steps > _FULL_STEP * np.median(steps))
    if len(rows) < max(_FEWEST, _MOST_ROWS * len(steps)) or not np.median(steps) > 0:
        raise _no_edge()
    return int(rows[0]), int(rows[-1]) + 1


def _line(values: _Array) -> tuple[float, float]:
    """Column of the edge in row 0, and columns by which it moves from row to row."""
    slopes = np.gradient(values, axis=1)
    total = slopes.sum()
    columns = np.arange(values.shape[1])
    rows = np.arange(values.shape[0])
    steps = np.diff(values, axis=1)
    if not total > _SHARPNESS * np.abs(steps.mean(0)).sum() or not total > 0:
        raise _no_edge()
    line = np.array([0.0, 0.0])
    window = np.ones_like(values)
    for number in range(_ROUNDS):
        weight = (slopes * window).sum(1)
        if not (weight > 0.2 * weight.mean()).all() or not weight.mean() > 0:
            raise _no_edge()
        places = (slopes * window * columns).sum(1) / weight
        line = np.polynomial.polynomial.polyfit(rows, places, 1)
        extent = values.shape[1] / 2 ** (1 + 0.5 * number)
        away = columns - (line[0] + line[1] * rows)[:, None]
        window = np.where(np.abs(away) < extent, 0.5 + 0.5 * np.cos(math.pi * away / extent), 0.0)
    off = places - (line[0] + line[1] * rows)
    if math.sqrt(float((off**2).mean())) > _STRAIGHT:
        raise _no_edge()
    if abs(line[1]) * (len(rows) - 1) < 1:
        raise DataError(
            f"the edge stands upright to {math.degrees(math.atan(abs(line[1]))):.2g} deg, so that "
            f"its pixels all lie at the same distances from it: turn it by about 5 deg"
        )
    return float(line[0]), float(line[1])


def _spread(values: _Array, distance: _Array, slope: float) -> tuple[_Array, _Array]:
    """Mean light by distance from the edge, as far as all rows reach."""
    extent = min(-distance[:, 0].max(), distance[:, -1].min())
    count = math.floor(extent * _BINS_PER_PIXEL)
    if count < 4 * _BINS_PER_PIXEL:
        raise DataError(
            f"the edge comes within {max(extent, 0):.1f} pixels of the picture's side: at least 4 "
            "pixels on both sides of it are needed"
        )
    number = np.round(distance * _BINS_PER_PIXEL).astype(int) + count
    inside = (number >= 0) & (number <= 2 * count)
    pixels = np.bincount(number[inside], minlength=2 * count + 1)
    filled = pixels > 0
    places, light = (
        np.bincount(number[inside], each[inside], minlength=2 * count + 1)[filled] / pixels[filled]
        for each in (distance, values)
    )
    if np.diff(places).max() > _WIDEST_GAP:
        raise DataError(
            f"the pixels around an edge at {math.degrees(math.atan(abs(slope))):.3g} deg all lie "
            "at a few distances from it: turn it to about 5 deg"
        )
    at = np.arange(-count, count + 1) / _BINS_PER_PIXEL
    return at, CubicSpline(places, light)(at)


def _transfer(spread: _Array) -> tuple[_Array, _Array]:
    """Frequencies in cycles per pixel, and contrast."""
    slope = (spread[2:] - spread[:-2]) / 2
    line: _Array = slope * windows.tukey(len(slope) + 2, 0.5)[1:-1]
    if not line.sum() > 0:
        raise _no_edge()
    spectrum = np.abs(np.fft.rfft(line, 4 * len(line)))
    frequencies = np.fft.rfftfreq(4 * len(line), 1 / _BINS_PER_PIXEL)
    measured = frequencies <= 0.5
    averaging = np.sinc(2 * frequencies / _BINS_PER_PIXEL) * np.sinc(frequencies / _BINS_PER_PIXEL)
    transfer: _Array = (spectrum / spectrum[0] / averaging)[measured]
    return frequencies[measured].astype(np.float64), transfer


def _normalised(spread: _Array) -> _Array:
    """Light by distance, 0 on the dark side and 1 on the bright one."""
    ends = max(1, len(spread) // 8)
    dark, bright = spread[:ends].mean(), spread[-ends:].mean()
    normalised: _Array = (spread - dark) / (bright - dark)
    return normalised


def _no_edge() -> DataError:
    return DataError(
        "the picture shows no straight edge from end to end, dark on one side and bright on the "
        "other: give one that does, or cut it to the edge (--support)"
    )


@dataclass(frozen=True)
class EdgeResolution:
    """Resolution by a slanted edge.

    Parameters
    ----------
    picture
        In which it was measured.
    response
        Spread and contrast across the edge.
    pixel_deg
        Angle of a pixel there, across the edge.
    """

    picture: FlatPicture
    response: EdgeResponse
    pixel_deg: float

    def per_deg(self, contrast: float) -> float | None:
        """Cycles to the degree at which the contrast has fallen to a value; None: nowhere."""
        frequency = self.response.frequency_of(contrast)
        return None if frequency is None else frequency / self.pixel_deg

    @property
    def figures(self) -> dict[str, Any]:
        """What is resolved, and the contrast by frequency, in values that JSON has."""
        half, tenth = self.per_deg(0.5), self.per_deg(0.1)
        frequencies = self.response.frequencies / self.pixel_deg
        return {
            "resolved_deg": None if tenth is None else 1 / tenth,
            "half_contrast_per_deg": half,
            "tenth_contrast_per_deg": tenth,
            "tilt_deg": self.response.tilt_deg,
            "direction_deg": self.response.direction_deg,
            "cycles_per_deg": frequencies.tolist(),
            "contrast": self.response.transfer.tolist(),
        }

    @classmethod
    def of(cls, picture: FlatPicture) -> "EdgeResolution":
        """Measure a picture (`edge_response`).

        Raises
        ------
        DataError
            If it shows no such edge.
        """
        response = edge_response(picture.values)
        turn = math.radians(response.direction_deg)
        across = (-math.sin(turn), math.cos(turn))
        return cls(picture, response, picture.angle_deg(response.centre, across, 1.0))
