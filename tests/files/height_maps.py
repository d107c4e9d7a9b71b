"""Height maps in the formats that microscopes write."""

from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

Heights = NDArray[np.float64]


def write_sdf(path: Path, heights_um: Heights, pitch_um: tuple[float, float]) -> Path:
    """ISO 25178-71 in ASCII; heights in steps of 0.1 nm."""
    rows, columns = heights_um.shape
    header = [
        "aISO-1.0", "ManufacID   = nobody", "CreateDate  = 010120260000",
        "ModDate     = 010120260000", f"NumPoints   = {columns}", f"NumProfiles = {rows}",
        f"Xscale      = {pitch_um[1] * 1e-6:e}", f"Yscale      = {pitch_um[0] * 1e-6:e}",
        "Zscale      = 1.000000e-10", "Zresolution = -1", "Compression = 0", "DataType    = 7",
        "CheckType   = 0", "*",
    ]  # fmt: skip
    counts = ["BAD" if np.isnan(h) else str(round(h * 1e4)) for h in heights_um.ravel().tolist()]
    lines = [" ".join(counts[at : at + columns]) for at in range(0, len(counts), columns)]
    path.write_text("\n".join([*header, *lines, "*", ""]))
    return path


def write_gwyddion(path: Path, heights_um: Heights, pitch_um: tuple[float, float]) -> Path:
    """The data matrix of Gwyddion, with its header and heights in m."""
    rows, columns = heights_um.shape
    header = (
        f"# Channel: Height\n# Width: {columns * pitch_um[1]:.6f} µm\n"
        f"# Height: {rows * pitch_um[0]:.6f} µm\n# Value units: m\n"
    )
    lines = ("\t".join(f"{h * 1e-6:.7e}" for h in row) for row in heights_um.tolist())
    path.write_text(header + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_table(
    path: Path, heights: Heights, separator: str, *, decimal: str = ".", bad: str = "Bad",
    ending: str = "",
) -> Path:  # fmt: skip
    """A table without a header."""
    rows = (
        separator.join(bad if np.isnan(h) else f"{h:.6g}".replace(".", decimal) for h in row)
        for row in heights.tolist()
    )
    path.write_text("".join(f"{row}{ending}\n" for row in rows))
    return path


def write_points(path: Path, heights: Heights, pitch: tuple[float, float], seed: int = 0) -> Path:
    """Points x y z in any order, bad ones left out."""
    rows, columns = np.nonzero(~np.isnan(heights))
    lines = [
        f"{12.5 + x * pitch[1]:.5f} {-3 + y * pitch[0]:.5f} {heights[y, x]:.6g}\n"
        for y, x in zip(rows.tolist(), columns.tolist(), strict=True)
    ]
    np.random.default_rng(seed).shuffle(lines)
    path.write_text("x y z\n" + "".join(lines))
    return path


def write_tagged(path: Path, values: NDArray[np.generic], pitch_um: tuple[float, float]) -> Path:
    """A TIFF that says its pitch, as points in a centimetre."""
    tifffile.imwrite(
        path, values, photometric="minisblack", metadata=None, resolutionunit="CENTIMETER",
        resolution=(1e4 / pitch_um[1], 1e4 / pitch_um[0]),
    )  # fmt: skip
    return path


def write_imagej(path: Path, values: NDArray[np.generic], pitch_um: tuple[float, float]) -> Path:
    """A TIFF as ImageJ writes it."""
    tifffile.imwrite(
        path, values, imagej=True, metadata={"unit": "\\u00B5m"},
        resolution=(1 / pitch_um[1], 1 / pitch_um[0]),
    )  # fmt: skip
    return path
