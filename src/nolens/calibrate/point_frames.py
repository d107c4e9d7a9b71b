"""Frames of one exposure time, averaged as they come."""

import math
from collections.abc import Iterable, Sequence

import torch
from torch import Tensor

from nolens.camera import MOSAICS, Frame
from nolens.camera.finite import unusable
from nolens.errors import DataError

UNKNOWN_S = 1.0
"""Stands for the exposure time where none is known."""
SAME_TIME = 2e-3
_ALIKE = 0.05
"""Difference of brightness from which frames are not of one exposure."""
_PILED = 16
_PILE_RATIO = 4


class FrameMean:
    """Mean of frames of the same light, taken with one exposure time.

    Frames are added one by one, so that only their sums are held. Every second one goes into a
    second sum: the difference of both tells the noise.

    Parameters
    ----------
    first
        The first frame; all others must have its size, colours, black and white level.
    role
        What the frames are, for messages.
    """

    def __init__(self, first: Frame, role: str = "frame") -> None:
        self.first, self.role = first, role
        self.sums = [torch.zeros_like(first.counts), torch.zeros_like(first.counts)]
        self.counts = [0, 0]
        self.clipped = torch.zeros_like(first.counts, dtype=torch.bool)
        self.levels: list[float] = []
        self.add(first)

    def add(self, frame: Frame) -> None:
        """Add a frame.

        Raises
        ------
        DataError
            If it holds no finite counts, or was taken by another camera or with other settings.
        """
        check_alike(frame, self.first, self.role)
        half = sum(self.counts) % 2
        self.sums[half] += frame.counts
        self.counts[half] += 1
        clipped = frame.counts >= _white(frame)
        self.levels.append(self._level(frame, clipped))
        self.clipped |= clipped

    @property
    def count(self) -> int:
        """Number of frames."""
        return sum(self.counts)

    @property
    def mean(self) -> Tensor:
        """Their mean, in counts, black level included."""
        return (self.sums[0] + self.sums[1]) / self.count

    @property
    def white(self) -> float:
        """Count from which a pixel is saturated; infinite where that is not known."""
        return _white(self.first)

    @property
    def uneven(self) -> float:
        """Largest difference of a frame's brightness from the first one's, as a fraction."""
        return max(abs(level - 1) for level in self.levels)

    @property
    def alike(self) -> bool:
        """Whether all frames are as bright as those of one exposure are."""
        return self.uneven <= _ALIKE

    def half_difference(self) -> Tensor | None:
        """Difference of the means of both halves, times what gives it the noise of one frame.

        None where there is only one frame.
        """
        if self.counts[1] == 0:
            return None
        one, other = (total / count for total, count in zip(self.sums, self.counts, strict=True))
        difference: Tensor = one - other
        return difference / math.sqrt(1 / self.counts[0] + 1 / self.counts[1])

    def half(self, number: int) -> tuple[Tensor, int]:
        """Mean of every second frame, from the first or the second one on, and their count."""
        return self.sums[number] / self.counts[number], self.counts[number]

    def _level(self, frame: Frame, clipped: Tensor) -> float:
        """Brightness beside that of the first frame, where neither is clipped."""
        black = black_plane(self.first)
        one, other = self.first.counts - black, frame.counts - black
        used = ~clipped & ~self.clipped
        total = float(one[used].square().sum())
        return float((one[used] * other[used]).sum()) / total if total > 0 else 1.0


def add_frame(
    means: dict[float, FrameMean], frame: Frame, time_s: float | None, role: str = "frame"
) -> None:
    """Add a frame to the mean of those of its exposure time.

    Parameters
    ----------
    means
        By exposure time in s.
    frame
        To be added.
    time_s
        Its exposure time; None where it is not known.
    role
        What the frames are, for messages.

    Raises
    ------
    DataError
        If it was taken by another camera or with other settings.
    """
    time = UNKNOWN_S if time_s is None else time_s
    near = [each for each in means if math.isclose(each, time, rel_tol=SAME_TIME)]
    if near:
        means[near[0]].add(frame)
    else:
        means[time] = FrameMean(frame, role)


def match_darks(
    exposures: Iterable[float], darks: dict[float, FrameMean]
) -> dict[float, FrameMean]:
    """The dark frames of each exposure time; those of a single time serve all.

    Parameters
    ----------
    exposures
        Exposure times in s.
    darks
        Dark frames by exposure time; none leaves every time without.

    Raises
    ------
    DataError
        If there are dark frames of several times, and none of one of these.
    """
    matched: dict[float, FrameMean] = {}
    for time in exposures if darks else ():
        same = [each for each in darks if math.isclose(each, time, rel_tol=SAME_TIME)]
        if not same and len(darks) > 1:
            have = ", ".join(f"{1e3 * each:g} ms" for each in sorted(darks))
            raise DataError(
                f"there is no dark frame of {1e3 * time:g} ms, only of {have}: take one of every "
                "exposure time, or give those of one time, for all"
            )
        matched[time] = darks[same[0] if same else next(iter(darks))]
    return matched


def check_alike(frame: Frame, first: Frame, role: str = "frame") -> None:
    """Refuse a frame that was not taken by the camera, or with the settings, of another one.

    Raises
    ------
    DataError
        If its size, colours, black or white level are others, or it holds NaN or infinity.
    """
    reason = unusable(frame.counts)
    if reason is not None:
        raise DataError(f"{frame.source} holds {reason}")
    both = f"the {role} {frame.source}", f"but {first.source}"
    remedy = "give frames of one camera, taken with one setting of it"
    if frame.counts.shape != first.counts.shape or frame.channels != first.channels:
        shapes = [
            f"{each.size_text} pixels ({', '.join(each.channels)})" for each in (frame, first)
        ]
        raise DataError(f"{both[0]} has {shapes[0]}, {both[1]} has {shapes[1]}: {remedy}")
    if frame.mosaic != first.mosaic:
        raise DataError(
            f"{both[0]} has the colour mosaic {frame.mosaic}, {both[1]} has {first.mosaic}: "
            f"{remedy}"
        )
    if frame.black != first.black or frame.white != first.white:
        levels = [f"black {_text(each.black)} and white {each.white}" for each in (frame, first)]
        raise DataError(f"{both[0]} has {levels[0]}, {both[1]} has {levels[1]}: {remedy}")


def black_plane(frame: Frame) -> Tensor:
    """Black level of a frame, of a shape that broadcasts with its counts."""
    levels = torch.tensor(frame.black)
    if len(levels) == 1:
        return levels.reshape(1, 1, 1)
    if frame.mosaic in MOSAICS:
        rows, columns = frame.counts.shape[-2:]
        return levels.reshape(2, 2).repeat(-(-rows // 2), -(-columns // 2))[:rows, :columns][None]
    return levels[:, None, None]


def _white(frame: Frame) -> float:
    """Count from which pixels are saturated; the largest one if very many have just that."""
    stated = float("inf") if frame.white is None else frame.white
    top = float(frame.counts.max())
    if top >= stated:
        return stated
    at_top = int((frame.counts == top).sum())
    below = int((frame.counts == top - 1).sum())
    whole = bool((frame.counts == frame.counts.round()).all())
    return top if whole and at_top >= _PILED and at_top > _PILE_RATIO * below else stated


def _text(levels: Sequence[float]) -> str:
    return ", ".join(f"{level:g}" for level in levels)
