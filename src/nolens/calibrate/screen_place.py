"""Where a screen lies before a lensless camera, by single dots, without a PSF.

A dot on a screen is a point source: its frame is the PSF, moved. The shift of one dot's frame
against another's is the distance of the two dots in the picture's pixels, whatever the PSF is.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from nolens.calibrate.registration import fine_structure, match_overlap
from nolens.errors import DataError
from nolens.evaluate.registration import coarse_shift
from nolens.operators import PixelRectangle

Place = tuple[float, float]
"""(row, column), in pixels."""

_LONGEST = 160
"""Pixels along the longer side in which the shifts are first sought."""
_LEAST_CORRELATION = 0.2
_LEAST_OVERLAP = 0.12
_WORST_PX = 2.0
_FREEDOMS = 8


@dataclass(frozen=True)
class ScreenPlace:
    """Where a screen lies.

    Parameters
    ----------
    matrix
        Homography (3, 3) from (row, column, 1) of the picture's pixels, in the sensor's frame, to
        those of the screen.
    error_px
        Standard error of a dot's place against it, in the picture's pixels.
    correlations
        Of the dots' frames with that of the middle dot.
    """

    matrix: NDArray[np.float64]
    error_px: float
    correlations: tuple[float, ...]

    def support(self, screen: tuple[int, int], sensor: tuple[int, int]) -> PixelRectangle:
        """The smallest rectangle around the middle of the sensor that holds the screen."""
        rows, columns = (np.array([0, count - 1.0]) for count in screen)
        corners = np.array([[r, c, 1] for r in rows for c in columns]).T
        places = np.linalg.inv(self.matrix) @ corners
        places = places[:2] / places[2]
        sizes = [
            2 * math.ceil(float(np.abs(line - count // 2).max())) + 1 + count % 2
            for line, count in zip(places, sensor, strict=True)
        ]
        return PixelRectangle.centred(sizes[0], sizes[1], sensor)


def find_screen(frames: Mapping[Place, Tensor], middle: Place) -> ScreenPlace:
    """Find a homography by frames of single dots.

    Parameters
    ----------
    frames
        By the place of the dot on the screen: what was measured of it, without the dark frame;
        (channels, rows, columns). Five or more, not on one line.
    middle
        Which of them is the one in the middle; it is taken to lie at pixel
        (rows // 2, columns // 2), the zero shift of the PSF that its frame is.

    Raises
    ------
    DataError
        If the dots are not seen in the frames, or do not lie as on a plane.
    """
    planes = {place: fine_structure(each.double().sum(dim=0).numpy(), 24) for place, each in
              frames.items()}  # fmt: skip
    centre = planes[middle]
    places, shifts, correlations = [middle], [(0.0, 0.0)], []
    for place, plane in planes.items():
        if place == middle:
            continue
        by = math.ceil(max(plane.shape) / _LONGEST)
        start = coarse_shift(centre, plane, by, _LEAST_OVERLAP)
        match = match_overlap(centre, plane, start, 2 * by)
        correlations.append(0.0 if match is None else match.correlation)
        if match is None or match.correlation < _LEAST_CORRELATION:
            continue
        places.append(place)
        shifts.append(match.shift)
    if len(places) < len(frames):
        raise DataError(
            f"the screen is not found: {len(frames) - len(places)} of its {len(frames)} dots are "
            f"not seen where the middle one is (correlations {_listed(correlations)}; "
            f"{_LEAST_CORRELATION:g} is needed). Check that the whole screen is before the camera, "
            "that the room is dark, and that the page fills the screen; a screen farther away, or "
            "a longer --exposure, shows more"
        )
    rows, columns = centre.shape
    seen = np.array(shifts) + np.array([rows // 2, columns // 2])
    matrix = _homography(seen, np.array(places))
    back = np.column_stack([places, np.ones(len(places))]) @ np.linalg.inv(matrix).T
    beside = back[:, :2] / back[:, 2:] - seen
    free = max(2 * len(places) - _FREEDOMS, 1)
    error = math.sqrt(float((beside**2).sum()) / free * 2)
    if error > _WORST_PX:
        raise DataError(
            f"the screen is not found: its dots lie {error:.1f} pixels beside those of a plane. "
            "Check that neither screen nor camera moves, and that nothing else shines"
        )
    return ScreenPlace(matrix, error, tuple(correlations))


def _listed(values: list[float]) -> str:
    return ", ".join(f"{each:.2f}" for each in values)


def _homography(seen: NDArray[np.float64], shown: NDArray[np.float64]) -> NDArray[np.float64]:
    """From places in the picture to those on the screen: the direct linear transform.

    Both are normalised first (`hartley2004`).
    """
    scales = [_normalising(each) for each in (seen, shown)]
    one, other = (
        (np.column_stack([each, np.ones(len(each))]) @ scale.T)[:, :2]
        for each, scale in zip((seen, shown), scales, strict=True)
    )
    rows = []
    for (r, c), (u, v) in zip(one, other, strict=True):
        rows.append([r, c, 1, 0, 0, 0, -u * r, -u * c, -u])
        rows.append([0, 0, 0, r, c, 1, -v * r, -v * c, -v])
    matrix = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    matrix = np.linalg.inv(scales[1]) @ matrix @ scales[0]
    result: NDArray[np.float64] = matrix / matrix[2, 2]
    return result


def _normalising(places: NDArray[np.float64]) -> NDArray[np.float64]:
    middle = places.mean(axis=0)
    by = math.sqrt(2) / float(np.sqrt(((places - middle) ** 2).sum(axis=1)).mean())
    return np.array([[by, 0, -by * middle[0]], [0, by, -by * middle[1]], [0, 0, 1]])
