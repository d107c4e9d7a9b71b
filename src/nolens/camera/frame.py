"""What a camera's file holds, before anything is done to it."""

from dataclasses import dataclass, field

from torch import Tensor

MOSAICS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""The colour mosaics that are known: the colours of the 2×2 superpixel, row by row."""


@dataclass(frozen=True)
class Frame:
    """The counts of one exposure as they are stored, and what the file says about them.

    Attributes
    ----------
    counts
        Stored values, float32, (channels, height, width). Integers of up to 24 bits are exact.
    channels
        Name of every channel: ``("grey",)``, ``("R", "G", "B")``, or ``("mosaic",)`` for one
        plane behind a colour mosaic.
    mosaic
        Colours of the 2×2 superpixel of the visible area, row by row (one of `MOSAICS`), or None.
    black
        Count that stands for no light: one value for all pixels, or four for the four pixels
        of a superpixel, row by row, or one for each channel.
    white
        Count from which a pixel is saturated; None where it is not known (float files).
    stored_as
        Name of the stored type, such as ``"uint16"``.
    source
        Where the frame comes from, usually the path of its file.
    exposure_s
        Exposure time in seconds; None where it is not known.
    black_stated
        Whether the file says its black level.
    sensor
        (height, width) of the camera's whole sensor in pixels of the frame; None where it is not
        known.
    """

    counts: Tensor = field(repr=False)
    channels: tuple[str, ...]
    mosaic: str | None
    black: tuple[float, ...]
    white: float | None
    stored_as: str
    source: str
    exposure_s: float | None = None
    black_stated: bool = False
    sensor: tuple[int, int] | None = None

    @property
    def is_linear(self) -> bool:
        """Whether it is finished: floats of which somebody says that 0 is no light."""
        return self.black_stated and not any(self.black) and self.stored_as.startswith("float")

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in pixels."""
        return self.counts.shape[-2], self.counts.shape[-1]

    @property
    def size_text(self) -> str:
        """Height and width in pixels, as text for messages."""
        return size_text(self.counts)


def size_text(values: Tensor) -> str:
    """Height and width of a tensor of shape (..., height, width), as text for messages."""
    return f"{values.shape[-2]}×{values.shape[-1]}"
