"""A picture of a mask and its PSF, beside the paper's diffuser."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import spectral_magnitude

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

_SHOWN_UM = 600.0
_OWN, _PAPERS = "#2a7f62", "#5b6b7a"


@dataclass(frozen=True)
class MaskPlot:
    """What is drawn.

    Parameters
    ----------
    heights_um
        The relief around the middle of the sensor, (rows, columns).
    grid_um
        Distance of its samples.
    psf, papers_psf
        PSFs of this mask and of the paper's diffuser, (channels, rows, columns).
    cell_um
        Pitch of their pixels.
    title
        Over all.
    """

    heights_um: Tensor
    grid_um: float
    psf: Tensor
    papers_psf: Tensor
    cell_um: float
    title: str


def plot_mask(path: Path, plot: MaskPlot) -> None:
    """Draw relief, PSFs and spectral magnitude.

    Parameters
    ----------
    path
        PNG to be written.
    plot
        What is drawn.
    """
    # It takes a third of a second, which other commands need not wait.
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(10, 8.4), layout="constrained")
        figure.suptitle(plot.title)
        (relief, magnitude), (own, papers) = figure.subplots(2, 2)
        image = _show(relief, plot.heights_um, plot.grid_um, "viridis", None)
        relief.set_title("relief around the middle")
        figure.colorbar(image, ax=relief, label="height, µm", shrink=0.85)
        _draw_magnitude(magnitude, plot)
        channel = min(1, len(plot.psf) - 1)
        for axes, psf, title in (
            (own, plot.psf, "PSF"),
            (papers, plot.papers_psf, "PSF of the paper's diffuser"),
        ):
            # The brightest spots of a sparse pattern would leave all else black.
            most = float(np.quantile(psf[channel].numpy(), 0.998))
            image = _show(axes, psf[channel], plot.cell_um, "inferno", most)
            axes.set_title(title)
            figure.colorbar(image, ax=axes, label="times its mean", shrink=0.85)
        figure.savefig(path, format="png", dpi=110)


def _show(
    axes: "Axes", values: Tensor, step_um: float, colours: str, most: float | None
) -> "AxesImage":
    """The middle of some values as an image with a scale in um."""
    sides = [min(count, round(_SHOWN_UM / step_um)) for count in values.shape]
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


def _draw_magnitude(axes: "Axes", plot: MaskPlot) -> None:
    """Spectral magnitude of one square millimetre over the spatial frequency."""
    frequencies = np.geomspace(3, 0.48e3 / plot.cell_um, 60)
    for psf, colour, name in (
        (plot.psf, _OWN, "this mask"),
        (plot.papers_psf, _PAPERS, "the paper's diffuser"),
    ):
        pattern = psf[min(1, len(psf) - 1)]
        values = []
        for each in frequencies:
            try:
                values.append(spectral_magnitude(pattern, plot.cell_um, float(each)))
            except DataError:
                values.append(np.nan)
        axes.loglog(frequencies, values, color=colour, label=name)
    axes.set_xlabel("lines per mm on the sensor")
    axes.set_title("spectral magnitude of 1 mm² of the PSF")
    axes.set_ylim(bottom=1e-4)
    axes.grid(alpha=0.3)
    axes.legend()
