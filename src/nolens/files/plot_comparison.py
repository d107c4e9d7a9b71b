"""Plots of a comparison: the figures of every method, and its worst pictures beside their truth."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nolens.camera import srgb_from_linear
from nolens.files.plots import ACCENT, GUIDE, plot_figure

if TYPE_CHECKING:
    from nolens.evaluate import Comparison

_LABELS = {
    "psnr_db": "PSNR, dB, linear",
    "shown_psnr_db": "PSNR, dB, as shown",
    "ssim": "SSIM, linear",
    "shown_ssim": "SSIM, as shown",
    "lpips": "LPIPS",
}
_WIDTH_IN, _LABEL_IN = 2.6, 0.3


def write_comparison_plot(
    path: Path, figures: Mapping[str, Mapping[str, NDArray[np.float64]]]
) -> None:
    """Draw every picture's figures, by method, with their mean.

    Parameters
    ----------
    figures
        Values of each figure, by method.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    shown = [name for name in _LABELS if name in next(iter(figures.values()))]
    with plot_figure(path, (2.6 * len(shown), 1.2 + 0.5 * len(figures))) as figure:
        for place, name in enumerate(shown):
            axes = figure.add_subplot(1, len(shown), place + 1)
            for row, values in enumerate(each[name] for each in figures.values()):
                finite = values[np.isfinite(values)]
                beside = row + 0.3 * (np.arange(len(finite)) / max(len(finite) - 1, 1) - 0.5)
                axes.plot(np.sort(finite), beside, ".", color=GUIDE, markersize=3)
                if finite.size:
                    axes.plot(
                        [finite.mean()] * 2, [row - 0.3, row + 0.3], color=ACCENT, linewidth=2
                    )
            axes.set_yticks(
                range(len(figures)), list(figures) if place == 0 else [""] * len(figures)
            )
            axes.set_ylim(len(figures) - 0.5, -0.5)
            axes.set_title(_LABELS[name])


def write_worst_pictures(
    path: Path, pictures: Sequence[tuple[str, "Comparison"]], white: float
) -> None:
    """Draw pictures, their truth, and the error beside them, as a screen shows them.

    Parameters
    ----------
    pictures
        With a label for each, the worst first.
    white
        Radiance that is white.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    tall = [each.picture.shape[-2] / each.picture.shape[-1] for _, each in pictures]
    height = sum(_WIDTH_IN * each + _LABEL_IN for each in tall)
    with plot_figure(path, (3.3 * _WIDTH_IN, height)) as figure:
        rows = figure.subplots(len(pictures), 3, squeeze=False, height_ratios=tall)
        for (label, each), (one, two, three) in zip(pictures, rows, strict=True):
            shown = [
                np.moveaxis(srgb_from_linear(values.float() / white).numpy(), 0, -1)
                for values in (each.picture, each.truth)
            ]
            error = np.abs(shown[0] - shown[1]).mean(axis=-1)
            for axes, values in zip((one, two), shown, strict=True):
                axes.imshow(
                    values if values.shape[-1] == 3 else values[..., 0], cmap="gray", vmin=0, vmax=1
                )
            drawn = three.imshow(error, cmap="inferno", vmin=0)
            figure.colorbar(drawn, ax=three, shrink=0.8)
            one.set_title(f"{label}: {each.figures['psnr_db']:.2f} dB")
            two.set_title("truth")
            three.set_title("error, as shown")
            for axes in (one, two, three):
                axes.set_axis_off()
