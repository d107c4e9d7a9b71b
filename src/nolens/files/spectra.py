"""Spectra at a place: tables and plots."""

import csv
from collections.abc import Sequence
from pathlib import Path

from nolens.files.atomic import atomic_write
from nolens.files.plots import ACCENT, plot_figure
from nolens.twin import Band


def _axis(bands: Sequence[Band]) -> tuple[str, list[float]]:
    """Name of what bands differ in, and their values."""
    angles = [band.polarisation.deg for band in bands if band.polarisation is not None]
    if angles:
        return "angle_deg", angles
    return "wavelength_nm", [band.wavelength_nm or 0.0 for band in bands]


def write_spectrum(path: str | Path, bands: Sequence[Band], values: Sequence[float]) -> None:
    """Write the radiance of each band as CSV.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    name, places = _axis(bands)
    with (
        atomic_write(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
    ):
        table = csv.writer(file, lineterminator="\n")
        table.writerow((name, "radiance"))
        pairs = zip(places, values, strict=True)
        table.writerows((f"{place:.6g}", f"{value:.6g}") for place, value in pairs)


def plot_spectrum(
    path: str | Path, bands: Sequence[Band], values: Sequence[float], title: str
) -> None:
    """Draw the radiance of each band.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    name, places = _axis(bands)
    with plot_figure(path, (4.5, 2.8)) as figure:
        axes = figure.add_subplot()
        axes.plot(places, values, "o-", color=ACCENT, markersize=4)
        axes.set_ylim(bottom=0)
        label = "wavelength in nm" if name == "wavelength_nm" else "angle of polarisation in deg"
        axes.set_xlabel(label)
        axes.set_ylabel("radiance, any unit")
        axes.set_title(title)
