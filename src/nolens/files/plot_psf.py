"""Plot of a point spread function, as the paper's Fig. 5."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from nolens.evaluate import PsfFigures
from nolens.files.atomic import atomic_write
from nolens.files.save_plot import save_plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARK = "#c23b2e"
_COLOURS = {0: "#3557c9", 90: "#2f9140", 180: "#e08a1e", 270: "#8a4fb0"}
_MOST_CELLS = 1200
_ZOOM_PITCHES = 7.0
_SHOWN_PITCHES = 2.6
_BRIGHTEST = 99.7
_DECADES = 1e-4


def write_psf_plot(path: str | Path, figures: PsfFigures, psf: Tensor, cell_um: float) -> None:
    """Draw a PSF with a part of it enlarged, its autocorrelation, and its spectral magnitude.

    Parameters
    ----------
    path
        PNG to be written.
    figures
        Of `nolens.evaluate.psf_figures`.
    psf
        (rows, columns).
    cell_um
        Pitch of its pixels.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    # It takes a third of a second, which other commands need not wait.
    import matplotlib as mpl
    from matplotlib.figure import Figure

    values = psf.detach().cpu().double().numpy()
    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(18, 4.4), layout="constrained")
        left, part, middle, right = figure.subplots(1, 4, width_ratios=(1.15, 0.8, 1, 1))
        _draw_psf(left, part, values, figures, cell_um)
        _draw_autocorrelation(middle, figures)
        _draw_magnitude(right, values, figures)
        with atomic_write(path) as temporary:
            save_plot(figure, temporary)


def _draw_psf(
    axes: "Axes",
    part: "Axes",
    values: NDArray[np.float64],
    figures: PsfFigures,
    cell_um: float,
) -> None:
    """All of it, and a few pitches of its middle enlarged beside it."""
    from matplotlib.patches import Rectangle

    rows, columns = values.shape
    low, high = np.percentile(values, [1, _BRIGHTEST])
    shades = {"cmap": "gray", "vmin": low, "vmax": high}
    step = max(1, -(-max(rows, columns) // _MOST_CELLS))
    height, width = rows * cell_um * 1e-3, columns * cell_um * 1e-3
    coarse = values[: rows // step * step, : columns // step * step]
    coarse = coarse.reshape(rows // step, step, columns // step, step).mean(axis=(1, 3))
    axes.imshow(coarse, extent=(0, width, height, 0), **shades)
    axes.set_xlabel("mm")
    axes.set_ylabel("mm")
    axes.set_title(f"(a) PSF, {rows}×{columns} pixels of {cell_um:.4g} µm")
    pitch_um = figures.pitch_um or 5 * figures.fwhm_um
    half = min(round(_ZOOM_PITCHES / 2 * pitch_um / cell_um), rows // 4, columns // 4)
    if half < 4:
        part.set_axis_off()
        return
    top, left = rows // 2 - half, columns // 2 - half
    mm = cell_um * 1e-3
    part.imshow(
        values[top : top + 2 * half, left : left + 2 * half],
        extent=(left * mm, (left + 2 * half) * mm, (top + 2 * half) * mm, top * mm),
        interpolation="nearest",
        **shades,
    )
    part.set_xticks([])
    part.set_yticks([])
    for spine in part.spines.values():
        spine.set(visible=True, edgecolor=_MARK, linewidth=1.4)
    axes.add_patch(
        Rectangle(
            (left * mm, top * mm), 2 * half * mm, 2 * half * mm, fill=False, edgecolor=_MARK, lw=1.4
        )
    )
    part.set_title(f"its middle, {2 * half * cell_um:.0f} µm wide")


def _draw_autocorrelation(axes: "Axes", figures: PsfFigures) -> None:
    """Over all directions and along the rows, with width and pitch."""
    lag = np.array(figures.lag_um)
    pitch = figures.pitch_um
    shown = min(lag[-1], _SHOWN_PITCHES * pitch if pitch else 8 * figures.fwhm_um)
    for values, colour, style, label in (
        (figures.row_autocorrelation, "0.65", "-", "along the rows"),
        (figures.autocorrelation, "black", "-", "all directions"),
    ):
        axes.plot(
            np.concatenate([-lag[::-1], lag]),
            np.concatenate([values[::-1], values]),
            color=colour,
            linestyle=style,
            linewidth=1.3,
            label=label,
        )
    axes.set_xlim(-shown, shown)
    axes.axhline(0, color="0.85", linewidth=0.8, zorder=0)
    half = (1 + figures.level) / 2
    width = figures.fwhm_um
    axes.annotate(
        "",
        (-width / 2, half),
        (width / 2, half),
        arrowprops={"arrowstyle": "<->", "color": _MARK, "shrinkA": 0, "shrinkB": 0},
    )
    axes.annotate(
        f"FWHM {width:.2f} µm\nline {figures.line_width_um:.2f} µm\n"
        f"half way to 0: {figures.fwhm_over_mean_um:.2f} µm",
        (width / 2, half),
        (10, 0),
        textcoords="offset points",
        color=_MARK,
        va="center",
    )
    axes.axhline(figures.level, color=_MARK, linewidth=0.7, linestyle=":", zorder=0)
    if pitch is not None:
        top = float(np.interp(pitch, lag, figures.autocorrelation))
        axes.plot([pitch, pitch], [figures.level, top], color=_MARK, linewidth=0.9)
        axes.annotate(
            f"pitch {pitch:.2f} µm",
            (pitch, top),
            (0, 14),
            textcoords="offset points",
            color=_MARK,
            ha="center",
        )
    axes.set_xlabel("distance, µm")
    axes.set_ylabel("autocorrelation, mean taken off")
    axes.set_title("(b) autocorrelation")
    axes.legend(fontsize=8, loc="upper right", frameon=False)


def _draw_magnitude(axes: "Axes", values: NDArray[np.float64], figures: PsfFigures) -> None:
    """In four directions, over all of them, and the noise; the spectrum in the corner."""
    lowest = max(_DECADES * max(figures.magnitude), figures.noise_magnitude / 2)
    for angle, (at, magnitude) in figures.direction_magnitude.items():
        axes.plot(
            at,
            np.maximum(magnitude, lowest / 10),
            color=_COLOURS[angle],
            linewidth=0.8,
            linestyle="-" if angle < 180 else (0, (3, 3)),
            label=f"{angle}°",
        )
    axes.plot(figures.per_mm, figures.magnitude, color="black", linewidth=1.4, label="mean")
    if figures.noise_magnitude > lowest:
        axes.axhline(figures.noise_magnitude, color="0.5", linestyle="--", linewidth=0.9)
        axes.annotate(
            "noise",
            (0, figures.noise_magnitude),
            (4, 3),
            textcoords="offset points",
            color="0.4",
            fontsize=8,
        )
    axes.axvline(figures.line_per_mm, color=_MARK, linewidth=0.8)
    axes.annotate(
        f" line {figures.line_per_mm:.3g}/mm",
        (figures.line_per_mm, 0.02),
        xycoords=("data", "axes fraction"),
        color=_MARK,
        fontsize=8,
    )
    axes.set_yscale("log")
    axes.set_ylim(lowest, 1.3)
    axes.set_xlim(0, 500 / figures.pixel_um)
    axes.set_xlabel("spatial frequency on the sensor, lines/mm")
    axes.set_ylabel("spectral magnitude, of the light")
    axes.set_title("(c) spectral magnitude")
    axes.legend(fontsize=8, loc="upper center", frameon=False, ncols=1)
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(values - values.mean())))
    spectrum = _in_blocks(spectrum, 240)
    inset = axes.inset_axes((0.62, 0.58, 0.38, 0.42))
    shown = np.log10(np.maximum(spectrum, spectrum.max() * _DECADES))
    inset.imshow(shown, cmap="inferno", aspect="auto")
    inset.set_box_aspect(1)
    inset.set_xticks([])
    inset.set_yticks([])
    inset.set_xlabel("spectrum", fontsize=8, labelpad=2)


def _in_blocks(values: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """Root of the mean square over blocks, so that at most so many rows and columns are left."""
    steps = [max(1, -(-count // most)) for count in values.shape]
    rows, columns = (count // step for count, step in zip(values.shape, steps, strict=True))
    cut = values[: rows * steps[0], : columns * steps[1]]
    squares = (cut**2).reshape(rows, steps[0], columns, steps[1]).mean(axis=(1, 3))
    root: NDArray[np.float64] = np.sqrt(squares)
    return root
