"""Plots and pictures of the reproduction's report."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from torch import Tensor

from nolens.camera import exposure_white, srgb_from_linear
from nolens.errors import DataError
from nolens.files.plots import plot_figure

_HEIGHT_IN, _TITLE_IN, _GAP_IN = 2.6, 0.32, 0.08
_WIDEST_IN = 9.0
_MOST_FILMS = 5
_INK = 0.85
_OURS, _PAPER, _PREDICTED = "#2a5f7f", "#c0562f", "#2a7f62"
_figure = partial(plot_figure, title_size="large", dpi=160)


@dataclass(frozen=True)
class Panel:
    """A picture, linear radiance (1 or 3, height, width), with the title above it.

    `white` is the radiance that is white; None takes `exposure_white`.
    """

    title: str
    radiance: Tensor
    white: float | None = None


def plot_pictures(path: Path, panels: tuple[Panel, ...]) -> None:
    """Draw photographs of one height in a row from left to right, with the sRGB curve."""
    ratios = [panel.radiance.shape[-1] / panel.radiance.shape[-2] for panel in panels]
    gaps = _GAP_IN * (len(panels) - 1)
    height = min(_HEIGHT_IN, (_WIDEST_IN - gaps) / sum(ratios))
    width = height * sum(ratios) + gaps
    with _figure(path, (width, height + _TITLE_IN), layout=None) as figure:
        left = 0.0
        for panel, ratio in zip(panels, ratios, strict=True):
            fraction = height / (height + _TITLE_IN)
            axes = figure.add_axes((left / width, 0.0, height * ratio / width, fraction))
            axes.imshow(_encoded(panel), aspect="auto", interpolation="antialiased")
            axes.set_title(panel.title, fontsize=8.5, pad=4)
            axes.set_axis_off()
            left += height * ratio + _GAP_IN


def _encoded(panel: Panel) -> "np.ndarray[tuple[int, ...], np.dtype[np.float32]]":
    white = exposure_white(panel.radiance) if panel.white is None else panel.white
    picture = srgb_from_linear((panel.radiance / white).clamp(0, 1)).numpy()
    if len(picture) == 1:
        picture = picture.repeat(3, axis=0)
    return np.moveaxis(picture, 0, -1)


def plot_films(
    path: Path,
    widths_um: dict[float, float],
    psfs: dict[float, Tensor],
    *,
    predicted_mm: tuple[float, float],
    paper: tuple[float, float],
    pixel_um: float,
) -> None:
    """Draw the width of the autocorrelation over the thickness of films, and some of their PSFs.

    Parameters
    ----------
    widths_um
        By thickness in mm.
    psfs
        The middle of each film's PSF, (rows, columns).
    predicted_mm
        Thickness in focus by rays, and its ±.
    paper
        Thickness in mm and width in um of the paper's sharpest film.
    pixel_um
        Pitch of the PSFs' pixels.
    """
    thicknesses = sorted(widths_um)
    chosen = (
        np.linspace(0, len(thicknesses) - 1, min(_MOST_FILMS, len(thicknesses))).round().astype(int)
    )
    displayed = [thicknesses[place] for place in chosen]
    with _figure(path, (8.2, 5.0)) as figure:
        above, below = figure.subfigures(2, 1, height_ratios=(2, 3), squeeze=False)[:, 0]
        axes = below.subplots()
        middle, off = predicted_mm
        axes.axvspan(middle - off, middle + off, color=_PREDICTED, alpha=0.10, linewidth=0)
        axes.axvline(
            middle, color=_PREDICTED, linewidth=1, label=f"by rays: {middle:.2f} ± {off:.2f} mm"
        )
        axes.plot(
            thicknesses,
            [widths_um[each] for each in thicknesses],
            "o-",
            color=_OURS,
            label="films, simulated",
        )
        axes.plot(*paper, "D", color=_PAPER, label=f"the paper's sharpest film: {paper[0]:g} mm")
        axes.set_xlabel("thickness of the PDMS film, mm")
        axes.set_ylabel("FWHM of the\nautocorrelation, µm")
        axes.set_xlim(thicknesses[0] - 0.1, thicknesses[-1] + 0.1)
        axes.legend(fontsize=8)
        places = np.atleast_1d(above.subplots(1, len(displayed)))
        for place, thickness in zip(places, displayed, strict=True):
            picture = psfs[thickness].numpy()
            side = picture.shape[-1] * pixel_um
            place.imshow(picture, cmap="gray", vmin=0, extent=(0, side, 0, side))
            place.set_title(f"{thickness:g} mm", fontsize=9)
            place.set_xticks([])
            place.set_yticks([])
        places[0].set_ylabel(f"{side:.0f} µm", fontsize=8)


def plot_overlay(path: Path, psfs: Tensor, names: tuple[str, str, str], pixel_um: float) -> None:
    """Draw three PSFs (3, rows, columns) in red, blue and green over each other.

    They are binarised as in fig. 8a; `pixel_um` is the pitch of their pixels.

    Raises
    ------
    DataError
        If they are not three.
    """
    if psfs.ndim != 3 or len(psfs) != 3:
        raise DataError(f"three PSFs are drawn over each other, not {tuple(psfs.shape)}")
    levels = np.quantile(psfs.numpy(), 0.88, axis=(1, 2))
    bright = psfs.numpy() > levels[:, None, None]
    # On white, each PSF takes away the two colours that are not its own.
    picture = np.ones((*psfs.shape[1:], 3))
    for number, own in enumerate((0, 2, 1)):
        for plane in {0, 1, 2} - {own}:
            picture[..., plane] -= _INK * bright[number]
    side_mm = [count * pixel_um * 1e-3 for count in psfs.shape[1:]]
    with _figure(path, (4.6, 4.8)) as figure:
        axes = figure.subplots()
        axes.imshow(
            picture.clip(0, 1), extent=(0, side_mm[1], 0, side_mm[0]), interpolation="nearest"
        )
        for name, own in zip(names, (0, 2, 1), strict=True):
            colour = [1.0 if plane == own else 1 - _INK for plane in range(3)]
            axes.plot([], [], "s", color=colour, label=name)
        axes.set_xlabel("mm")
        figure.legend(loc="outside upper center", ncols=3, fontsize=8, frameon=False)
