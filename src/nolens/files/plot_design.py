"""Plots of designs: a mask with its PSF beside the paper's diffuser, and replicas by thickness."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

from nolens.design.masks import MaskComparison
from nolens.design.thickness import ColourCurves
from nolens.errors import DataError
from nolens.evaluate import spectral_magnitude
from nolens.files.plots import plot_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

_DISPLAYED_UM = 600.0
_OWN, _PAPERS = "#2a7f62", "#5b6b7a"

_COLUMNS = 3
_SHADE = "#2a7f62"
_LINE = {450.0: "#3557c9", 550.0: "#2f9140", 650.0: "#c23b2e"}


def plot_mask(path: Path, comparison: MaskComparison, title: str) -> None:
    """Draw relief, PSFs and spectral magnitude of a mask beside the paper's diffuser."""
    planes = comparison.own.plane, comparison.paper.plane
    surface, pixel_um = comparison.own.twin.mask.relief, comparison.own.twin.pixel_um
    with plot_figure(path, (10, 8.4), title_size="large") as figure:
        figure.suptitle(title)
        (relief, magnitude), below = figure.subplots(2, 2)
        image = _show(relief, surface.height_um.cpu(), surface.grid_um, "viridis", None)
        relief.set_title("relief around the middle")
        figure.colorbar(image, ax=relief, label="height, µm", shrink=0.85)
        _draw_magnitude(magnitude, planes, pixel_um)
        for axes, plane, name in zip(
            below, planes, ("PSF", "PSF of the paper's diffuser"), strict=True
        ):
            # The brightest spots of a sparse PSF would leave all else black.
            most = float(np.quantile(plane.numpy(), 0.998))
            image = _show(axes, plane, pixel_um, "inferno", most)
            axes.set_title(name)
            figure.colorbar(image, ax=axes, label="times its mean", shrink=0.85)


def _show(
    axes: "Axes", values: Tensor, step_um: float, colours: str, most: float | None
) -> "AxesImage":
    """The middle of some values as an image with a scale in um."""
    sides = [min(count, round(_DISPLAYED_UM / step_um)) for count in values.shape]
    starts = [(count - side) // 2 for count, side in zip(values.shape, sides, strict=True)]
    part = values[starts[0] : starts[0] + sides[0], starts[1] : starts[1] + sides[1]]
    half = [side * step_um / 2 for side in sides]
    axes.set_xlabel("µm")
    return axes.imshow(
        part.numpy(),
        cmap=colours,
        vmin=None if most is None else 0,
        vmax=most,
        extent=(-half[1], half[1], half[0], -half[0]),
        interpolation="nearest",
    )


def _draw_magnitude(axes: "Axes", planes: tuple[Tensor, Tensor], pixel_um: float) -> None:
    """Spectral magnitude of one square millimetre over the spatial frequency."""
    frequencies = np.geomspace(3, 0.48e3 / pixel_um, 60)
    for plane, colour, name in zip(
        planes, (_OWN, _PAPERS), ("this mask", "the paper's diffuser"), strict=True
    ):
        values = []
        for each in frequencies:
            try:
                values.append(spectral_magnitude(plane, pixel_um, float(each)))
            except DataError:
                values.append(np.nan)
        axes.loglog(frequencies, values, color=colour, label=name)
    axes.set_xlabel("lines per mm on the sensor")
    axes.set_title("spectral magnitude of 1 mm² of the PSF")
    axes.set_ylim(bottom=1e-4)
    axes.grid(alpha=0.3)
    axes.legend()


def plot_thickness(path: Path, materials: list[ColourCurves]) -> None:
    """Draw the focus of all materials by wavelength, and of each the width of its lines."""
    panels = 1 + len(materials)
    columns = min(_COLUMNS, panels)
    rows = -(-panels // columns)
    with plot_figure(path, (4.4 * columns, 3.6 * rows), title_size="large") as figure:
        places = figure.subplots(rows, columns, squeeze=False).ravel()
        _draw_focus(places[0], materials)
        for axes, material in zip(places[1:panels], materials, strict=True):
            _draw_widths(axes, material)
        for axes in places[panels:]:
            axes.set_axis_off()


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
