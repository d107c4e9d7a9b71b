"""How much a PSF from the side is like the one from straight ahead."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.kernels import fast_length, irfft2, rfft2

_AROUND = 12


@dataclass(frozen=True)
class PeakCorrelation:
    """Where two PSFs are most alike, and how much.

    Parameters
    ----------
    frame
        Peak of the normalised cross-correlation of the whole frames, outside of which there is
        nothing: what leaves the frame is missed. Each frame counts by its own norm, so it does not
        matter how bright it is.
    projection
        The same peak over the first frame's own, ⟨a, b⟩/⟨a, a⟩: by how much of the first PSF the
        second one holds, in the units of the frames. Of frames of one exposure time it counts
        vignetting too.
    overlap
        Correlation over those pixels alone that lie over each other there, or near to where the
        PSF is known to have moved.
    shift
        By how many pixels the second one lies further down and to the right where the whole frames
        are most alike.
    """

    frame: float
    projection: float
    overlap: float
    shift: tuple[float, float]


def peak_correlation(
    one: Tensor, other: Tensor, near: tuple[float, float] | None = None
) -> PeakCorrelation:
    r"""Compare two PSFs as they were captured (`uvimprint`, fig. 6c).

    .. math:: c(s) = \frac{\sum_x (a_x - \bar a)(b_{x+s} - \bar b)}{|a - \bar a|\,|b - \bar b|}

    with both zero outside of the frame; between the pixels the peak is a parabola's. Over the
    overlap mean and norm are those of its pixels.

    Parameters
    ----------
    one, other
        (rows, columns) alike, in any unit.
    near
        By how many pixels the second one is known to lie further down and to the right: the overlap
        is compared at the best place within 12 pixels of that, even where chance is more alike
        elsewhere. None: where the whole frames are most alike.

    Raises
    ------
    DataError
        If they differ in size, or one of them is even.
    """
    if one.shape != other.shape:
        raise DataError(
            f"PSFs of {one.shape[0]}×{one.shape[1]} and {other.shape[0]}×{other.shape[1]} pixels "
            "cannot be compared: give both from the same sensor"
        )
    frames = [each.double() - each.double().mean() for each in (one, other)]
    norms = [float(each.norm()) for each in frames]
    if not min(norms) > 0:
        raise DataError("one of the PSFs is even: it has no structure to compare")
    rows, columns = one.shape
    period = (
        fast_length(2 * rows, of_rows=False),
        fast_length(2 * columns, of_rows=True),
    )
    first, second = (rfft2(_padded(each.float(), period)) for each in frames)
    found = irfft2(first.conj() * second, period)
    place = _signed(int(found.argmax()), period, (rows, columns))
    around = [
        [float(found[(place[0] + i) % period[0], (place[1] + j) % period[1]]) for j in (-1, 0, 1)]
        for i in (-1, 0, 1)
    ]
    top, moved = _vertex(around)
    known = place if near is None else _best_near(found, near)
    over = [
        [_pearson(one, other, (known[0] + i, known[1] + j)) for j in (-1, 0, 1)] for i in (-1, 0, 1)
    ]
    return PeakCorrelation(
        frame=min(1.0, top / (norms[0] * norms[1])),
        projection=top / norms[0] ** 2,
        overlap=min(1.0, _vertex(over)[0]),
        shift=(place[0] + moved[0], place[1] + moved[1]),
    )


def falls_to(level: float, angles_deg: Sequence[float], values: Sequence[float]) -> float | None:
    """Angle at which values that are given by angle first fall to a level, between them.

    Parameters
    ----------
    level
        The level.
    angles_deg
        Rising.
    values
        One for each.

    Returns
    -------
    float or None
        None where they stay above it.
    """
    for number, value in enumerate(values):
        if value <= level:
            if number == 0:
                return angles_deg[0]
            before, start = values[number - 1], angles_deg[number - 1]
            return start + (before - level) / (before - value) * (angles_deg[number] - start)
    return None


def _padded(frame: Tensor, period: tuple[int, int]) -> Tensor:
    placed = torch.zeros(period)
    placed[: frame.shape[0], : frame.shape[1]] = frame
    return placed


def _signed(index: int, period: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    """Shift of a value of the cross-correlation, by its number."""
    row, column = divmod(index, period[1])
    return (
        row - period[0] if row >= size[0] else row,
        column - period[1] if column >= size[1] else column,
    )


def _best_near(found: Tensor, near: tuple[float, float]) -> tuple[int, int]:
    """Shift of the highest value of the cross-correlation around a known one."""
    steps = torch.arange(-_AROUND, _AROUND + 1)
    at = [steps + round(middle) for middle in near]
    part = found[(at[0] % found.shape[0])[:, None], at[1] % found.shape[1]]
    row, column = divmod(int(part.argmax()), len(steps))
    return int(at[0][row]), int(at[1][column])


def _pearson(one: Tensor, other: Tensor, shift: tuple[int, int]) -> float:
    """Correlation of the cells that lie over each other when the second is moved back."""
    parts = []
    for frame, sign in ((one, 1), (other, -1)):
        part = frame
        for axis, step in enumerate(shift):
            kept = frame.shape[axis] - abs(step)
            if kept < 2:
                return 0.0
            part = part.narrow(axis, max(0, -step * sign), kept)
        parts.append(part.double() - part.double().mean())
    product = float(parts[0].norm() * parts[1].norm())
    return float((parts[0] * parts[1]).sum()) / product if product > 0 else 0.0


def _vertex(near: list[list[float]]) -> tuple[float, tuple[float, float]]:
    """Top of parabolas along both axes through 3×3 values, and its place from the middle."""
    middle = near[1][1]
    height, moved = middle, []
    for before, after in ((near[0][1], near[2][1]), (near[1][0], near[1][2])):
        bend = before - 2 * middle + after
        step = 0.5 * (before - after) / bend if bend < 0 else 0.0
        step = math.copysign(min(abs(step), 1.0), step)
        moved.append(step)
        height -= 0.25 * (before - after) * step
    return height, (moved[0], moved[1])
