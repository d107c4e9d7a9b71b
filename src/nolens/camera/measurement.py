"""From a stored frame to linear values: black level, dark frame, flat field, mosaic, binning."""

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera.frame import Frame, size_text
from nolens.camera.part import Counts
from nolens.camera.values import arrange_rgb, squares, unusable
from nolens.errors import DataError, OptionError

BlackLevel = Counts | Literal["auto"] | None
"""In counts; "auto" where a PSF's darkest corner says it, None where the files do."""

_CORNER_START, _CORNER_SIZE = 5, 10
_PILED = 16
"""Fewest pixels of one count that are taken for saturated ones."""
_PILE_RATIO = 4
"""How many times as many they must be as those of the count below."""


@dataclass(frozen=True)
class Measurement:
    """Linear values of a sensor, with 0 for no light.

    Attributes
    ----------
    values
        Linear counts above black, float32, (channels, height, width). Not clipped: noise
        around zero stays as it is, so that its mean is unbiased.
    valid
        Bool, (channels, height, width): False where a pixel is saturated or has no value.
    channels
        Name of every channel: ``("grey",)`` or letters of ``("R", "G", "B")``.
    mosaic
        The mosaic the values come from, or None.
    source
        Where they come from, usually the path of a file.
    black_stated
        Whether a file, a dark frame or a person said what no light is.
    """

    values: Tensor = field(repr=False)
    valid: Tensor = field(repr=False)
    channels: tuple[str, ...]
    mosaic: str | None
    source: str
    black_stated: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in pixels."""
        return self.values.shape[-2], self.values.shape[-1]

    @property
    def size_text(self) -> str:
        """Height and width in pixels, as text for messages."""
        return size_text(self.values)

    @functools.cached_property
    def brightest(self) -> int:
        """Number of the channel that carries most, from 0."""
        return int(squares(torch.where(self.valid, self.values, 0)).argmax())


def develop(
    frame: Frame,
    *,
    dark: Frame | None = None,
    flat: Frame | None = None,
    black: float | None = None,
    white: float | None = None,
    bin_by: int = 1,
    channels: str = "all",
) -> Measurement:
    """Make linear values of a frame: ``bin(superpixels((counts - dark) / gain))``.

    In this order: the dark frame, which contains the black level, or else the black level is
    subtracted; the result is divided by the gain, ``(flat - dark or black) / its mean`` for
    each colour; each 2×2 superpixel of a mosaic becomes one pixel (R, mean of both G, B, without
    interpolation); channels are chosen; N×N pixels are averaged. Odd last rows and columns
    are dropped. A pixel made of several is valid if all of them are.

    Parameters
    ----------
    frame
        The frame to develop.
    dark
        An exposure without light, of the same size. Subtracted from the flat field as well.
    flat
        An exposure of even light, of the same size. Pixels it shows as dark become invalid.
    black
        Black level in counts, in place of the frames' own.
    white
        Count from which a pixel is saturated, in place of the frames' own (`saturation_count`).
    bin_by
        Number of pixels in each direction that are averaged into one.
    channels
        ``"all"``, ``"grey"`` (mean of the channels), or letters such as ``"g"`` or ``"rg"``.

    Raises
    ------
    DataError
        If frames do not fit together, hold NaN or infinity, are constant, nowhere brighter
        than black, or saturated everywhere.
    OptionError
        If `bin_by` or `channels` cannot be used, or `black` is given beside a dark frame.
    """
    if dark is not None and black is not None:
        raise OptionError(
            f"both a dark frame ({dark.source}) and a black level ({black:g}) are given, but a "
            "dark frame contains the black level: give one of the two"
        )
    _check_data(frame)
    values = frame.counts.clone()
    valid = _unsaturated(frame, saturation_count(frame) if white is None else white)
    if dark is not None:
        _check_fit(dark, "dark frame", frame)
        valid &= _unsaturated(dark, white)
    _subtract(values, frame, dark, black)
    if not float(values.max()) > 0:
        raise DataError(
            f"{frame.source} is nowhere brighter than its "
            + (f"dark frame {dark.source}" if dark else f"black level {_black_text(frame, black)}")
            + ": give the black level of this camera (--black), or another exposure"
        )
    if flat is not None:
        _check_fit(flat, "flat field", frame)
        gain = flat.counts.clone()
        _subtract(gain, flat, dark, black)
        lit = gain > 0
        _normalise(gain, lit, flat, frame.mosaic)
        values /= torch.where(lit, gain, 1.0)
        valid &= lit & _unsaturated(flat, white)
    names = frame.channels
    if frame.mosaic is not None:
        values, valid = _merge_superpixels(frame, values, valid)
        names = ("R", "G", "B")
    values, valid, names = _select(values, valid, names, channels, frame.source)
    values, valid = _bin(values, valid, bin_by, frame.source)
    for name, plane, usable in zip(names, values, valid, strict=True):
        if not bool(usable.max()):
            raise DataError(
                f"no pixel of channel {name} of {frame.source} can be used: all are saturated or "
                "have no flat field. Take a shorter exposure, or give the count at which a "
                "pixel is saturated (--white)"
            )
        if float(plane.min()) == float(plane.max()) == 0:
            raise DataError(
                f"channel {name} of {frame.source} is zero everywhere: leave it out (--channels)"
            )
    stated = dark is not None or black is not None or frame.black_stated
    return Measurement(values, valid, names, frame.mosaic, frame.source, stated)


def saturation_count(frame: Frame) -> float:
    """Count from which pixels are saturated; the largest one if very many have just that.

    Infinite where neither the file nor its counts tell.
    """
    stated = math.inf if frame.white is None else frame.white
    top = float(frame.counts.max())
    if top >= stated:
        return stated
    at_top = int((frame.counts == top).count_nonzero())
    # Frames of a few levels have most pixels at one of them.
    if at_top < _PILED or at_top > frame.counts.numel() / 2:
        return stated
    below = frame.counts[frame.counts < top].max()
    return top if at_top > _PILE_RATIO * int((frame.counts == below).count_nonzero()) else stated


def dark_corner(frame: Frame) -> float:
    """Black level read off the darkest corner of a frame, in counts.

    The smallest of the four means over the 10×10 pixels that start 5 pixels from the corner;
    the one at the top left is ``counts[:, 5:15, 5:15]``.

    Raises
    ------
    DataError
        If the frame has fewer than 15 rows or columns.
    """
    need = _CORNER_START + _CORNER_SIZE
    if min(frame.counts.shape[-2:]) < need:
        raise DataError(
            f"{frame.source} is {frame.size_text} pixels, too small to read a black level off its "
            f"corners ({need}×{need} at least): give the black level as a number"
        )
    return darkest_corner(frame.counts)


def black_level(black: BlackLevel, psf: Frame) -> float | None:
    """Black level in counts as `develop` takes it; "auto" is read off the PSF's darkest corner.

    Raises
    ------
    DataError
        If the PSF is too small for that.
    """
    return dark_corner(psf) if black == "auto" else black


def darkest_corner(values: Tensor) -> float:
    """`dark_corner` of values (channels, height, width) of at least 15×15 pixels."""
    start, stop = _CORNER_START, _CORNER_START + _CORNER_SIZE
    near, far = slice(start, stop), slice(-stop, -start)
    return min(float(values[:, y, x].mean()) for y in (near, far) for x in (near, far))


def colour_planes(values: Tensor, mosaic: str) -> dict[str, list[Tensor]]:
    """Views (…, rows, columns) of a mosaic plane by colour: one for R, two for G, one for B."""
    planes: dict[str, list[Tensor]] = {"R": [], "G": [], "B": []}
    for colour, plane in zip(mosaic, _superpixel_planes(values), strict=True):
        planes[colour].append(plane)
    return planes


def rgb_counts(frame: Frame, step: int = 1) -> Tensor:
    """Counts of a frame for showing: R, G, B of each 2×2 superpixel of a mosaic, every `step`-th.

    Returns
    -------
    Tensor
        (3 or 1, rows, columns), with the black level.
    """
    if frame.mosaic is None:
        return arrange_rgb(frame.counts, frame.channels)[:, ::step, ::step]
    rows, columns = (count // 2 * 2 for count in frame.counts.shape[-2:])
    planes = colour_planes(frame.counts[0, :rows, :columns], frame.mosaic)
    means = [torch.stack([part[::step, ::step] for part in parts]) for parts in planes.values()]
    return torch.stack([parts.mean(dim=0) for parts in means])


def _superpixel_planes(values: Tensor) -> Iterator[Tensor]:
    """The four views of a mosaic plane, one for each pixel of its superpixel, row by row."""
    return (values[..., row::2, column::2] for row in (0, 1) for column in (0, 1))


def _check_data(frame: Frame) -> None:
    counts = frame.counts
    reason = unusable(counts)
    if reason is not None:
        raise DataError(f"{frame.source} holds {reason}")
    lowest, highest = float(counts.min()), float(counts.max())
    if lowest == highest:
        raise DataError(
            f"{frame.source} is {lowest:g} everywhere: it holds no picture. Check the exposure "
            "and that this is the right file"
        )


def _check_fit(other: Frame, role: str, frame: Frame) -> None:
    if other.counts.shape != frame.counts.shape:
        shape, need = tuple(other.counts.shape), tuple(frame.counts.shape)
        raise DataError(
            f"the {role} {other.source} has (channels, height, width) {shape}, but "
            f"{frame.source} has {need}: take both with the same camera settings"
        )
    if other.mosaic is not None and frame.mosaic is not None and other.mosaic != frame.mosaic:
        raise DataError(
            f"the {role} {other.source} has the colour mosaic {other.mosaic}, but "
            f"{frame.source} has {frame.mosaic}: take both with the same camera settings"
        )
    reason = unusable(other.counts)
    if reason is not None:
        raise DataError(f"the {role} {other.source} holds {reason}")


def _unsaturated(frame: Frame, white: float | None) -> Tensor:
    level = frame.white if white is None else white
    if level is None:
        return torch.ones_like(frame.counts, dtype=torch.bool)
    return frame.counts < level


def _subtract(values: Tensor, frame: Frame, dark: Frame | None, black: float | None) -> None:
    """Subtract, in place, the dark frame or the black level."""
    levels = frame.black if black is None else (black,)
    if dark is not None:
        values -= dark.counts
    elif len(levels) == 1:
        values -= levels[0]
    elif frame.mosaic is not None:
        for plane, level in zip(_superpixel_planes(values), levels, strict=True):
            plane -= level
    else:
        values -= torch.tensor(levels)[:, None, None]


def _black_text(frame: Frame, black: float | None) -> str:
    levels = frame.black if black is None else (black,)
    return ", ".join(f"{level:g}" for level in levels)


def _normalise(gain: Tensor, lit: Tensor, flat: Frame, mosaic: str | None) -> None:
    """Divide, in place, each colour of a flat field by the mean of its lit pixels."""
    if mosaic is None:
        groups = [([plane], [mask]) for plane, mask in zip(gain, lit, strict=True)]
    else:
        masks = colour_planes(lit, mosaic)
        groups = [(planes, masks[name]) for name, planes in colour_planes(gain, mosaic).items()]
    for planes, used in groups:
        count = sum(int(mask.sum()) for mask in used)
        if count == 0:
            raise DataError(
                f"the flat field {flat.source} is nowhere brighter than black in one of its "
                "colours: take an exposure of even light"
            )
        total = sum(float(p[m].double().sum()) for p, m in zip(planes, used, strict=True))
        for plane in planes:
            plane /= total / count


def _merge_superpixels(frame: Frame, values: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """One pixel (R, G, B) for each 2×2 superpixel of a mosaic."""
    assert frame.mosaic is not None
    rows, columns = (n // 2 * 2 for n in values.shape[-2:])
    if rows == 0 or columns == 0:
        raise DataError(
            f"{frame.source} is {frame.size_text} pixels: no 2×2 superpixel of a mosaic fits"
        )
    colours = colour_planes(values[0, :rows, :columns], frame.mosaic)
    masks = colour_planes(valid[0, :rows, :columns], frame.mosaic)
    merged = [sum(planes[1:], planes[0]) / len(planes) for planes in colours.values()]
    usable = [functools.reduce(torch.logical_and, planes) for planes in masks.values()]
    return torch.stack(merged), torch.stack(usable)


def _select(
    values: Tensor, valid: Tensor, names: tuple[str, ...], choice: str, source: str
) -> tuple[Tensor, Tensor, tuple[str, ...]]:
    option = choice.lower()
    if option == "all" or (option == "grey" and len(names) == 1):
        return values, valid, names
    if option == "grey":
        return values.mean(0, keepdim=True), valid.all(0, keepdim=True), ("grey",)
    letters = tuple(option.upper())
    if not letters or len(set(letters)) < len(letters) or not set(letters) <= set(names):
        available = ", ".join(names)
        letter = ", or letters such as g or rg" if len(names) > 1 else ""
        raise OptionError(
            f"channels {choice!r} cannot be taken from {source}, which has {available}: "
            f"give all, grey{letter}"
        )
    rows = [names.index(letter) for letter in letters]
    return values[rows], valid[rows], letters


def _bin(values: Tensor, valid: Tensor, bin_by: int, source: str) -> tuple[Tensor, Tensor]:
    if bin_by == 1:
        return values, valid
    if bin_by < 1 or bin_by > min(values.shape[-2:]):
        raise OptionError(
            f"cannot bin {source} by {bin_by}: a whole number from 1 to "
            f"{min(values.shape[-2:])} fits its {size_text(values)} pixels"
        )
    unusable = nnf.max_pool2d((~valid).float()[None], bin_by)[0] > 0
    return bin_mean(values, bin_by), ~unusable


def bin_mean(values: Tensor, bin_by: int) -> Tensor:
    """Mean of each bin_by×bin_by block of (channels, height, width); remainders are dropped."""
    return nnf.avg_pool2d(values[None], bin_by)[0]
