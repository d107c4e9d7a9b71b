"""`nolens capture`."""

import math
from typing import Any

from nolens.capture import Levels
from nolens.cli.command import command
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import CaptureReporter, capture_frames

_BARS = " ▁▂▃▄▅▆▇█"
_WIDTH = 32


class CaptureTerminal(TerminalReporter, CaptureReporter):
    """Shows the histogram of the newest frame beside the bar."""

    def __init__(self) -> None:
        super().__init__()
        self._histogram = ""

    def levels(self, levels: Levels) -> None:
        """See how bright the newest frame is."""
        self._histogram = histogram_text(levels)

    def step(self, what: str, done: int, limit: int, result: str, state: str = "") -> bool:
        """Show how many frames are taken; True if the person wants to stop."""
        return super().step(what, done, limit, result, state or self._histogram)


def histogram_text(levels: Levels) -> str:
    """Draw the histogram, a line for each colour, and say what is saturated."""
    lines = []
    for name, counts in levels.histogram.items():
        step = len(counts) // _WIDTH
        columns = [sum(counts[at : at + step]) for at in range(0, len(counts), step)]
        # Most pixels of a lensless camera are dark: beside them the others would not show.
        most = math.log1p(max(columns)) or 1.0
        bars = "".join(_BARS[round(math.log1p(each) / most * (len(_BARS) - 1))] for each in columns)
        lines.append(f"{name[:1].upper()} {bars}│")
    lines.append(_brightness(levels.bright, levels.clipped_fraction))
    return "\n".join(lines)


def _brightness(bright: float, clipped_fraction: float, kind: str = "frame") -> str:
    pixels = "brightest pixel" if kind == "psf" else "bright pixels"
    text = f"{pixels} at {100 * bright:.0f} %"
    return f"{text}, {100 * clipped_fraction:.2g} % saturated" if clipped_fraction > 0 else text


def _lines(summary: dict[str, Any]) -> list[str]:
    frames = summary["frames"]
    times = "; ".join(
        (f"{1e3 * each['exposure_s']:.4g} ms, " if each["exposure_s"] else "")
        + _brightness(each["bright"], each["clipped_fraction"], summary["kind"])
        for each in summary["exposures"]
    )
    lines = [
        f"{summary['source']}: {frames} frame{'' if frames == 1 else 's'} in "
        f"{summary['seconds']:.1f} s at gain {summary['gain']:g}",
        times,
    ]
    return [*lines, *_next(summary)] if summary["kind"] == "psf" else lines


def _next(summary: dict[str, Any]) -> list[str]:
    """What is done with frames of a point source."""
    lines, request = [], summary["request"]
    if request["exposure_s"] is not None:
        more = f" --gain {request['gain']:g}" if request["gain"] != 1 else ""
        if request["bracket"] > 1:
            more += f" --bracket {request['bracket']} --factor {request['factor']:g}"
        lines.append(
            f"then, with the camera covered: nolens capture --dark --exposure "
            f"{1e3 * request['exposure_s']:.6g}ms{more} --frames 8 -o dark"
        )
    return [*lines, "then: nolens calibrate POINT... --dark DARK... --distance 300mm -o mycamera"]


capture = command(capture_frames, _lines, name="capture", reporter=CaptureTerminal)
