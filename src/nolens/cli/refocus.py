"""`nolens refocus`."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from nolens.cli.app import Json, Output, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.files.write_stack import depth_text
from nolens.jobs import RefocusOptions
from nolens.jobs import refocus as run_refocus
from nolens.solvers import Prior

Input = Parameter(group="Input")
Depth = Parameter(group="Depth")
Model = Parameter(group="Model and solver")
Picture = Parameter(group="Picture")


def refocus(
    measurement: Path | None = None,
    /,
    *,
    psfs: Path | None = None,
    output: Annotated[Path | None, Output] = None,
    depth: Annotated[str | None, Quantity, Depth] = None,
    at: Annotated[str | None, Quantity, Depth] = None,
    search: Annotated[str | None, Quantity, Depth] = None,
    stack: Annotated[str | None, Quantity, Depth] = None,
    steps: Annotated[int | None, Whole, Depth] = None,
    dark: Annotated[Path | None, Input] = None,
    flat: Annotated[Path | None, Input] = None,
    black: Annotated[float | None, Input] = None,
    white: Annotated[float | None, Input] = None,
    mosaic: Annotated[str | None, Input] = None,
    bgr: Annotated[bool | None, Input] = None,
    channels: Annotated[str | None, Input] = None,
    bin: Annotated[int | None, Input, Whole] = None,  # noqa: A002 (the option's name)
    region: Annotated[str | None, Model] = None,
    tau: Annotated[float | None, Model] = None,
    prior: Annotated[Prior | None, Model] = None,
    iterations: Annotated[int | None, Model, Whole] = None,
    device: Annotated[Literal["auto", "cpu", "cuda"] | None, Model] = None,
    flip: Annotated[Literal["none", "vertical", "horizontal", "both"] | None, Picture] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Focus a photograph at any depth, after it was taken.

    nolens refocus raw.dng --psfs camera -o out

    nolens refocus raw.dng --psfs camera --stack 8cm,50cm -o out

    Without --depth the sharpest depth is found: the one whose PSF explains the photograph best,
    or with --at the one at which that place is sharpest.

    Parameters
    ----------
    measurement
        What the sensor measured: camera raw, .png, .tif or .npy. Needed.
    psfs
        Folder with the camera's PSFs at some distances (psfs.toml, as nolens calibrate writes it),
        and camera.toml where there is one. Between distances PSFs are magnified. Needed.
    output
        Folder for the pictures: focused.png, focused.tif (16 bits, linear) and refocus.json (the
        record); with --stack also stack.tif (for ImageJ), sweep.png (animated), sweep.html (a page
        with a slider), all-in-focus.png, depth.png and depth.tif (mm). Needed.
    depth
        Distance that is to be sharp, such as 8cm, or infinity.  [default: the sharpest]
    at
        ROW,COLUMN of focused.png, in pixels: what is to be sharp.  [default: the whole picture]
    search
        NEAR,FAR: depths between which the sharpest is sought, such as 8cm,infinity.
        [default: the distances of the PSFs]
    stack
        NEAR,FAR: pictures at depths from near to far, in equal steps of 1/distance. Without
        --depth or --at, focused.png is left out.
    steps
        How many.  [default: 9]
    dark
        Dark frame; it is subtracted, and holds the black level too.
    flat
        Flat field; the measurement is divided by it.
    black
        Black level in counts. Camera raw says it.
    white
        Count from which a pixel is saturated. Camera raw and 8 or 16-bit files say it.
    mosaic
        RGGB, BGGR, GRBG or GBRG: a .tif, .png or .npy holds raw counts of a colour mosaic.
    bgr
        The measurement's colour channels are stored as B, G, R.
    channels
        all, grey, or letters such as g or rg.  [default: all]
    bin
        Average N×N cells into one.  [default: 1]
    region
        Cells that light can come from: HEIGHTxWIDTH around the middle of the sensor, or
        HEIGHTxWIDTH+TOP+LEFT in cells of the sensor's frame.  [default: no limit]
    tau
        Weight of the prior.  [default: 1e-4]
    prior
        What the scene is assumed to be like.  [default: tv]
    iterations
        Limit of the iterations for a picture; while searching, at most 60.  [default: 100]
    device
        Where to compute; auto takes CUDA where there is one.  [default: auto]
    flip
        Turn the pictures over.  [default: none]
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = run_refocus(RefocusOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 130 if reporter.interrupted else 0
    if "depth_mm" in summary:
        show(_depth_text(summary))
    if "stack_mm" in summary:
        depths = summary["stack_mm"]
        show(f"{len(depths)} depths from {_text(depths[0])} to {_text(depths[-1])}")
    show(f"{summary['seconds']:.1f} s on {summary['device']}")
    for path in summary["outputs"]:
        show(path)
    return 130 if reporter.interrupted else 0


def _depth_text(summary: dict[str, Any]) -> str:
    depth, *ends = (_text(summary[key]) for key in ("depth_mm", "sharp_from_mm", "sharp_to_mm"))
    found = "sharpest at " if "tried" in summary else ""
    return f"{found}{depth}; sharp from {' to '.join(ends)}"


def _text(millimetres: float | str) -> str:
    return millimetres if isinstance(millimetres, str) else depth_text(millimetres * 1e3)
