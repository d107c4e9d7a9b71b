"""`nolens calibrate pairs`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import CalibratePairsOptions, calibrate_pairs


def _lines(summary: dict[str, Any]) -> list[str]:
    rows, columns = summary["cells"]
    lines = [
        f"{rows}×{columns} pixels of {summary['cell']}, light in "
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
    return [*lines, f"{summary['seconds']:.1f} s"]


pairs = command(CalibratePairsOptions, calibrate_pairs, _lines, name="pairs")
