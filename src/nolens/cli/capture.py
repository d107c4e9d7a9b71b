"""`nolens capture`."""

import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from nolens.capture import Levels
from nolens.cli.app import Json, Output, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.errors import OptionError
from nolens.jobs import CaptureOptions, CaptureReporter, capture_frames

Camera = Parameter(group="Camera")
What = Parameter(group="What is taken")
Result = Parameter(group="Result")

_BARS = " ▁▂▃▄▅▆▇█"
_WIDTH = 32
_LISTED = 12


class CaptureTerminal(TerminalReporter, CaptureReporter):
    """Shows the histogram of the newest frame beside the bar."""

    def __init__(self) -> None:
        super().__init__()
        self._seen = ""

    def levels(self, levels: Levels) -> None:
        """See how bright the newest frame is."""
        self._seen = histogram_text(levels)

    def step(self, what: str, done: int, limit: int, kept: str, state: str = "") -> bool:
        """Show how many frames are taken; True if the person wants to stop."""
        return super().step(what, done, limit, kept, state or self._seen)


def capture(
    *,
    output: Annotated[Path | None, Output, Result] = None,
    dark: Annotated[bool, What, Parameter(negative=())] = False,
    psf: Annotated[bool, What, Parameter(negative=())] = False,
    frames: Annotated[int | None, What, Whole] = None,
    average: Annotated[bool | None, What, Parameter(negative=())] = None,
    exposure: Annotated[str | None, Quantity, What] = None,
    gain: Annotated[float | None, What] = None,
    bracket: Annotated[int | None, What, Whole] = None,
    factor: Annotated[float | None, What] = None,
    every: Annotated[str | None, Quantity, What] = None,
    count: Annotated[int | None, What, Whole] = None,
    source: Annotated[str | None, Camera] = None,
    scene: Annotated[Path | None, Camera] = None,
    existing: Annotated[bool | None, Camera, Parameter(negative=())] = None,
    mosaic: Annotated[Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None, Camera] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Take raw frames with a camera: one, many, averaged, bracketed, or over a long time.

    nolens capture -o shot.dng

    Each frame is written as soon as it is taken, with its record as .json beside it; Ctrl-C ends
    after the frame in work, and what was taken stays.

    Parameters
    ----------
    output
        .dng (whole counts of a colour sensor), .tif (with mosaic and levels in it) or .npy (counts
        alone). Of several frames the name is numbered: -o day.dng writes day-0001.dng and so on.
        Without a suffix it is a folder. Needed.
    dark
        The camera is covered: take what is subtracted from other frames, with their exposure time
        (--exposure) and gain.
    psf
        The camera sees one point source: no pixel may be saturated. Then: nolens calibrate.
    frames
        Frames one after the other.  [default: 1]
    average
        These become one file, their mean (.tif or .npy, with fractions of counts).
    exposure
        Exposure time, such as 40ms.  [default: one that fits what the camera sees, up to 1 s]
    gain
        Analogue gain of the sensor; 1 has the least noise.  [default: 1]
    bracket
        Exposure times, each --factor times as long as the one before; the first is --exposure.
        [default: 1]
    factor
        Between the exposure times of a bracket.  [default: 4]
    every
        Begin a new round each 10s, for a time-lapse.
    count
        Rounds of a time-lapse.  [default: until Ctrl-C]
    source
        auto (the Raspberry Pi's camera, or else a simulated one), raspberry, raspberry:1 (the
        second camera), twin (simulated), twin:CAMERA (preset or folder), or folder:PATH (raw files
        that another camera writes there).  [default: auto]
    scene
        Picture that a simulated camera looks at, or a folder of them, as of a film: each frame
        sees the next one.  [default: a test chart]
    existing
        Files that a watched folder holds already are taken too.
    mosaic
        Colours of the 2×2 cell of a watched folder's files that do not say it.
    json_
        Print one JSON object on standard output.
    """
    if dark and psf:
        raise OptionError("--dark and --psf are both given: a frame shows either, leave one out")
    given = {
        name: value
        for name, value in given_options(locals()).items()
        if name not in ("dark", "psf")
    }
    given["kind"] = "dark" if dark else "psf" if psf else "frame"
    reporter = CaptureTerminal()
    with reporter:
        summary = capture_frames(CaptureOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
    else:
        for line in _told(summary):
            show(line)
    return 130 if reporter.interrupted else 0


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
    lines.append(_brightness(levels.bright, levels.clipped_share))
    return "\n".join(lines)


def _brightness(bright: float, clipped_share: float, kind: str = "frame") -> str:
    pixels = "brightest pixel" if kind == "psf" else "bright pixels"
    text = f"{pixels} at {100 * bright:.0f} %"
    return f"{text}, {100 * clipped_share:.2g} % saturated" if clipped_share > 0 else text


def _told(summary: dict[str, Any]) -> list[str]:
    frames, outputs = summary["frames"], summary["outputs"]
    times = "; ".join(
        (f"{1e3 * each['exposure_s']:.4g} ms, " if each["exposure_s"] else "")
        + _brightness(each["bright"], each["clipped_share"], summary["kind"])
        for each in summary["exposures"]
    )
    lines = [
        f"{summary['source']}: {frames} frame{'' if frames == 1 else 's'} in "
        f"{summary['seconds']:.1f} s at gain {summary['gain']:g}",
        times,
        *outputs[:_LISTED],
    ]
    if len(outputs) > _LISTED:
        lines.append(f"and {len(outputs) - _LISTED} more, to {outputs[-1]}")
    if summary["kind"] == "psf":
        lines += _next(summary)
    return lines


def _next(summary: dict[str, Any]) -> list[str]:
    """What is done with frames of a point source."""
    lines, asked = [], summary["asked"]
    if asked["exposure_s"] is not None:
        more = f" --gain {asked['gain']:g}" if asked["gain"] != 1 else ""
        if asked["bracket"] > 1:
            more += f" --bracket {asked['bracket']} --factor {asked['factor']:g}"
        lines.append(
            f"then, with the camera covered: nolens capture --dark --exposure "
            f"{1e3 * asked['exposure_s']:.6g}ms{more} --frames 8 -o dark"
        )
    return [*lines, "then: nolens calibrate POINT... --dark DARK... --distance 300mm -o mycamera"]
