"""`nolens calibrate pairs`."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from nolens.cli.app import Json, Output, Quantity, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import CalibratePairsOptions, calibrate_pairs

Pairs = Parameter(group="Pairs")
Result = Parameter(group="Result")
_Flag = Parameter(negative=(), show_default=False)


def pairs(
    measured: Path | None = None,
    pictures: Path | None = None,
    /,
    *,
    distance: Annotated[str | None, Quantity, Pairs] = None,
    pixel: Annotated[str | None, Quantity, Pairs] = None,
    region: Annotated[str | None, Pairs] = None,
    dark: Annotated[Path | None, Pairs] = None,
    black: Annotated[float | None, Pairs] = None,
    white: Annotated[float | None, Pairs] = None,
    mosaic: Annotated[Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None, Pairs] = None,
    bgr: Annotated[bool | None, _Flag, Pairs] = None,
    each_channel: Annotated[bool | None, _Flag, Result] = None,
    check: Annotated[bool | None, _Flag, Result] = None,
    output: Annotated[Path | None, Output, Result] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Solve the PSF from measurements of known pictures, where no point source is to be had.

    nolens calibrate pairs measured pictures --distance 300mm --pixel 1.55um -o mycamera

    Show pictures with much detail on a screen, five or more, the room dark; the PSF is the one
    that explains all of the measurements. It is as wide as sensor and picture together: nolens
    reconstruct takes it with --psf-wider.

    Parameters
    ----------
    measured
        Folder of what the camera measured: camera raw, .tif, .png or .npy. Needed.
    pictures
        Folder of what was shown, with the same names: .png, .jpg or .tif of 8 or 16 bits (sRGB),
        or float .tif and .npy (linear). Their cells are those of a reconstruction: cell (i, j) is
        the one whose light falls through the middle of the PSF onto cell (i, j) of the sensor; a
        sensor with a colour mosaic has a cell for each 2×2 pixels. Needed.
    distance
        Of the pictures from the camera, such as 300mm, or infinity. Needed.
    pixel
        Distance of the pixels in the measurements, such as 1.55um, where the folder has no camera.
    region
        Where the pictures' cells lie: HEIGHTxWIDTH+TOP+LEFT in cells of the sensor's frame.
        [default: in the middle]
    dark
        Measurement without light; it is subtracted.
    black
        Black level in counts. Camera raw says it.
    white
        Count from which a pixel is saturated. Camera raw and 8 or 16-bit files say it.
    mosaic
        Colours of the 2×2 cell of measurements whose files do not say it.
    bgr
        Colour channels of all files are stored as B, G, R.
    each_channel
        A PSF for each channel.  [default: one for all channels, from all of them]
    check
        Also solve without each pair in turn, and say how well that one is reconstructed.
    output
        Folder of the camera's PSFs; made if it is not there. The PSF, the list psfs.toml and the
        record pairs-….json go into it. Needed.
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = calibrate_pairs(CalibratePairsOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    for line in _lines(summary):
        show(line)
    return 0


def _lines(summary: dict[str, Any]) -> list[str]:
    rows, columns = summary["cells"]
    lines = [
        f"{rows}×{columns} cells of {summary['cell']}, light in "
        f"{100 * summary['support_share']:.1f} % of them",
        "of each measurement, not explained by the PSF: with one PSF for the whole picture, and "
        "with one that may change over it (a large difference: the PSF varies over the field)",
    ]
    wide = max(len(row["name"]) for row in summary["pairs"])
    for row in summary["pairs"]:
        left, varying, gain = (
            sum(row[key]) / len(row[key]) for key in ("misfit", "misfit_varying", "gain")
        )
        lines.append(
            f"  {row['name']:<{wide}}  {100 * left:.1f} %  {100 * varying:.1f} %  "
            f"brightness {gain:.3f}"
        )
    if summary["left_out"]:
        lines.append("with the PSF of the other pairs: left, and the reconstruction")
    for row in summary["left_out"]:
        left = sum(row["misfit"]) / len(row["misfit"])
        alike = "" if row["ssim"] is None else f", SSIM {row['ssim']:.3f}"
        lines.append(
            f"  {row['name']:<{wide}}  {100 * left:.1f} %  PSNR {row['psnr_db']:.2f} dB{alike}"
        )
    return [*lines, f"{summary['seconds']:.1f} s", *summary["outputs"]]
