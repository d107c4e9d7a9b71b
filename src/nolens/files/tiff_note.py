"""What the TIFFs of this program say about their values, in the file's description."""

from dataclasses import dataclass, replace
from typing import Any

import tifffile

from nolens.camera import MOSAICS, Frame
from nolens.documents import parse_json
from nolens.errors import DataError

SOFTWARE = "nolens"
"""Name in the files whose description is such a note."""


@dataclass(frozen=True)
class TiffNote:
    """What is known of the values.

    Parameters
    ----------
    black
        Value that stands for no light; None where the note does not say.
    white
        Count from which a pixel is saturated.
    mosaic
        Colours of the 2×2 superpixel.
    exposure_s
        Exposure time in seconds.
    """

    black: float | None = None
    white: float | None = None
    mosaic: str | None = None
    exposure_s: float | None = None

    @classmethod
    def of(cls, page: tifffile.TiffPage) -> "TiffNote":
        """Read the note of a page; one of another program's, or a damaged one, says nothing."""
        if page.software != SOFTWARE:
            return cls()
        try:
            found = parse_json(page.description, "the note")
        except DataError:
            return cls()
        if not isinstance(found, dict):
            return cls()
        mosaic = found.get("mosaic")
        return cls(
            black=_number(found.get("black")),
            white=_number(found.get("white")) if "black" in found else None,
            mosaic=mosaic if mosaic in MOSAICS else None,
            exposure_s=_number(found.get("exposure_s")),
        )

    def applied(self, frame: Frame) -> Frame:
        """The frame with what the note says."""
        if self.black is None:
            return frame
        frame = replace(frame, black=(self.black,), black_stated=True, exposure_s=self.exposure_s)
        if self.white is not None:
            frame = replace(frame, white=self.white)
        if self.mosaic is not None and frame.channels == ("grey",):
            frame = replace(frame, channels=("mosaic",), mosaic=self.mosaic)
        return frame


def _number(value: Any) -> float | None:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and 0 <= value < 2**24 else None
