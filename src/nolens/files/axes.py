"""Axes of arrays that hold frames: which are frames, channels, rows and columns."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nolens.errors import FileError
from nolens.files.formats import numbered

Part = tuple[int | slice, ...]
"""What is taken of an array, axis by axis."""

_CHANNELS = (1, 3)
_NARROWEST = 16
"""Columns of a frame: a shorter last axis is channels, which one picture has too many of."""
_MOST_AXES = 5


@dataclass(frozen=True)
class Layout:
    """What the axes of an array are.

    Attributes
    ----------
    shape
        Of the array.
    axes
        A letter for each: Y and X for rows and columns, C for channels, others for frames.
    """

    shape: tuple[int, ...]
    axes: str

    @classmethod
    def of(cls, shape: tuple[int, ...], source: str, axes: str | None = None) -> "Layout":
        """Find what axes are, by the letters that a file has for them or by their lengths.

        Of several axes that letters call channels (C and S), one may be longer than 1.

        Raises
        ------
        FileError
            If that is not clear, or they are not those of frames.
        """
        if axes is None:
            return cls(shape, _guessed(shape, source))
        axes = axes.replace("S", "C")
        long = [at for at, each in enumerate(axes) if each == "C" and shape[at] > 1]
        if axes.count("Y") != 1 or axes.count("X") != 1 or len(long) > 1:
            raise FileError(
                f"{source} has the axes {axes} of {_text(shape)}; accepted are one Y and X, "
                "one of channels, and others for frames"
            )
        return cls(
            shape, "".join("T" if e == "C" and at not in long else e for at, e in enumerate(axes))
        )

    @property
    def frame_shape(self) -> tuple[int, ...]:
        """Lengths of the axes of one frame."""
        return tuple(n for n, each in zip(self.shape, self.axes, strict=True) if each in "CYX")

    @property
    def names(self) -> tuple[str, ...]:
        """One for each frame."""
        return numbered(math.prod(self._frames))

    @property
    def _frames(self) -> tuple[int, ...]:
        return tuple(n for n, each in zip(self.shape, self.axes, strict=True) if each not in "CYX")

    def part(self, number: int) -> Part:
        """What is taken of the array for a frame."""
        places = iter(np.unravel_index(number, self._frames) if self._frames else ())
        return tuple(slice(None) if each in "CYX" else int(next(places)) for each in self.axes)

    def channels_first(self, frame: NDArray[Any]) -> NDArray[Any]:
        """A frame that was taken, as (channels, height, width)."""
        kept = [each for each in self.axes if each in "CYX"]
        if "C" not in kept:
            frame, kept = frame[None], ["C", *kept]
        return frame.transpose([kept.index(each) for each in "CYX"])


def _guessed(shape: tuple[int, ...], source: str) -> str:
    if 3 <= len(shape) <= _MOST_AXES:
        first, last = shape[-3] in _CHANNELS, shape[-1] in _CHANNELS
        if first and last:
            raise FileError(
                f"{source} has the shape {shape}, whose channels can be the first axis or "
                "the last: save it as (height, width)"
            )
        frame = "YXC" if last else "CYX" if first else "TYX" if shape[-1] >= _NARROWEST else ""
        if frame:
            return frame.rjust(len(shape), "T")
    if len(shape) == 2:
        return "YX"
    raise FileError(
        f"{source} has the shape {shape}; accepted are (height, width), (height, width, 1 or 3) "
        "and (1 or 3, height, width), and for many frames one more axis before these"
    )


def matlab_axes(shape: tuple[int, ...]) -> str:
    """Axes of an array of MATLAB: rows, columns, colours, frames; or as Python saves it."""
    if len(shape) == 3 and shape[2] not in _CHANNELS:
        return "CYX" if shape[0] in _CHANNELS else "YXT"
    if len(shape) == 4 and shape[2] not in _CHANNELS and shape[3] in _CHANNELS:
        return "TYXC"
    return "YXC".ljust(len(shape), "T")[: len(shape)]


def _text(shape: tuple[int, ...]) -> str:
    return "×".join(map(str, shape))
