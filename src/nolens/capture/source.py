"""What every source of frames can do: open, be set, hand over a frame with its metadata, close."""

import math
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Protocol

from nolens.errors import OptionError

if TYPE_CHECKING:
    # It brings torch, and who only lists the sources does not need that.
    from nolens.camera import Frame


@dataclass(frozen=True)
class Shot:
    """One exposure of a camera.

    Attributes
    ----------
    frame
        Counts as they were stored, with mosaic, black and white level.
    taken
        When, in UTC.
    exposure_s, gain
        Those that were really in effect; 0 where the camera does not say.
    camera
        Such as ``"Raspberry Pi imx477"`` or ``"twin of live"``.
    details
        What else the camera says, in values that JSON has.
    """

    frame: "Frame"
    taken: datetime
    exposure_s: float
    gain: float
    camera: str
    details: dict[str, float | int | str]


@dataclass(frozen=True)
class Limits:
    """What a camera can be set to.

    Attributes
    ----------
    exposure_s
        Shortest and longest exposure time.
    gain
        Least and most analogue gain.
    """

    exposure_s: tuple[float, float]
    gain: tuple[float, float]

    def check(self, exposure_s: float, gain: float) -> None:
        """Refuse settings beyond these limits.

        Raises
        ------
        OptionError
            If one is, or is no number.
        """
        shortest, longest = self.exposure_s
        # Cameras count in whole us; a limit that was read as seconds must stay within.
        within = shortest * (1 - 1e-6) <= exposure_s <= longest * (1 + 1e-6)
        if not (math.isfinite(exposure_s) and within):
            raise OptionError(
                f"an exposure time of {1e3 * exposure_s:g} ms is beyond this camera: give "
                f"{1e3 * shortest:g} ms to {longest:g} s"
            )
        least, most = self.gain
        if not (math.isfinite(gain) and least * (1 - 1e-6) <= gain <= most * (1 + 1e-6)):
            raise OptionError(
                f"a gain of {gain:g} is beyond this camera: give {least:g} to {most:g}"
            )


class CameraSource(Protocol):
    """Something that frames come from.

    It is used by one thread at a time: `open`, any number of `set` and `shot`, `close`.
    """

    @property
    def name(self) -> str:
        """Of the camera, for people."""

    @property
    def limits(self) -> Limits | None:
        """What it can be set to, known once it is open; None where nothing can be set."""

    def open(self) -> None:
        """Make it ready to take frames.

        Raises
        ------
        CameraError
            If there is no camera, it is in use, or has no raw mode that can be read here.
        """

    def set(self, *, exposure_s: float, gain: float) -> None:
        """Set exposure time and gain of all shots from the next one on.

        Raises
        ------
        OptionError
            If they are beyond the limits, or nothing can be set.
        CameraError
            If the camera is not open.
        """

    def shot(self) -> Shot:
        """Wait for the next frame that was exposed as set, and hand it over.

        Raises
        ------
        CameraError
            If the camera is not open, or no frame comes any more, as where it was unplugged.
        """

    def close(self) -> None:
        """Give the camera back; nothing happens where it is closed already."""
