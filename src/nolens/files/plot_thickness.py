"""Plots of replicas: focus by colour, and width of the lines by thickness."""

from pathlib import Path
from typing import TYPE_CHECKING

from nolens.design.thickness import ColourCurves
from nolens.files.save_plot import save_plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLUMNS = 3
_SHADE = "#2a7f62"
_LINE = {450.0: "#3557c9", 550.0: "#2f9140", 650.0: "#c23b2e"}


def plot_thickness(path: Path, materials: list[ColourCurves]) -> None:
    """Draw the focus of all materials by wavelength, and of each the width of its lines.

    Parameters
    ----------
    path
        PNG to be written.
    materials
        What to draw.
    """
    panels = 1 + len(materials)
    columns = min(_COLUMNS, panels)
    rows = -(-panels // columns)
    # It takes a third of a second, which other commands need not wait.
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(4.4 * columns, 3.6 * rows), layout="constrained")
        places = figure.subplots(rows, columns, squeeze=False).ravel()
        _draw_focus(places[0], materials)
        for axes, material in zip(places[1:panels], materials, strict=True):
            _draw_widths(axes, material)
        for axes in places[panels:]:
            axes.set_axis_off()
        save_plot(figure, path)


def _draw_focus(axes: "Axes", materials: list[ColourCurves]) -> None:
    """Thickness in focus over wavelength."""
    for number, material in enumerate(materials):
        if material.focus:
            wavelengths, thicknesses = zip(*material.focus, strict=True)
            axes.plot(wavelengths, thicknesses, color=f"C{number}", label=material.name)
    axes.set_xlabel("wavelength, nm")
    axes.set_ylabel("thickness in focus, mm")
    axes.set_title("focus by colour")
    axes.margins(y=0.15)
    if any(material.focus for material in materials):
        axes.legend(fontsize=8)


def _draw_widths(axes: "Axes", material: ColourCurves) -> None:
    """Width of the lines over thickness, by colour."""
    axes.axvspan(*material.sharp_mm, color=_SHADE, alpha=0.12, linewidth=0)
    axes.axvline(material.thickness_mm, color="black", linewidth=0.9)
    for wavelength_nm, widths in material.widths_um.items():
        axes.plot(
            material.thicknesses_mm,
            widths,
            color=_LINE.get(wavelength_nm, "0.3"),
            label=f"{wavelength_nm:g} nm",
        )
    off = f" ± {material.plus_minus_mm:.2f}" if material.plus_minus_mm > 0 else ""
    low, high = material.sharp_mm
    axes.set_title(
        f"{material.name}: {material.thickness_mm:.2f}{off} mm\n"
        f"lines at most 10 % wider from {low:.2f} to {high:.2f} mm",
        fontsize=9,
    )
    axes.set_xlabel("thickness, mm")
    axes.set_ylabel("width of the lines, µm")
    axes.set_ylim(bottom=0)
    if material.widths_um:
        axes.legend(fontsize=8, loc="lower left")
