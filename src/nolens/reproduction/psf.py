"""Fig. 5: the PSF, its autocorrelation and its spectrum."""

import math
from dataclasses import asdict
from functools import partial

from pydantic import TypeAdapter

from nolens.camera import RandomLenslets, develop
from nolens.evaluate import PsfFigures, psf_figures
from nolens.files.plot_measurements import write_psf_plot
from nolens.progress import ProgressCallback
from nolens.reproduction.comparison import Content, Picture, Results, paper_row, section
from nolens.reproduction.setup import ExperimentSetup
from nolens.reproduction.steps import Step, StepResult

_LOWEST_PER_MM = 3.0
"""Below it a direction has too few frequencies to be compared."""


def steps(setup: ExperimentSetup) -> tuple[Step, ...]:
    """One frame of the paper's point source, and its figures."""
    return (
        Step(
            "psf",
            "fig. 5: the PSF",
            setup.parameters(),
            2 * setup.psf_work(),
            lambda progress: _captured(setup, progress),
        ),
    )


def _captured(setup: ExperimentSetup, progress: ProgressCallback) -> StepResult:
    """Figures of the frame, noise and mosaic included, all colours together."""
    frame = setup.experiment.point(setup.source, seed=setup.seed, progress=progress)
    psf = develop(frame).values.sum(dim=0)
    twin = setup.experiment.twin
    figures = psf_figures(psf, twin.pixel_um, reduced_um=twin.stack().reduced_um)
    return StepResult(asdict(figures), {"psf": psf[None]})


@section("psf", "Fig. 5: the PSF", ("width", "line", "pitch", "mtf"), ("psf",))
def psf(setup: ExperimentSetup, results: Results) -> Content:
    """Figures of one frame of the point source."""
    figures = TypeAdapter(PsfFigures).validate_python(results["psf"].figures)
    width, pitch = figures.fwhm_over_mean_um, figures.pitch_um
    line = width / math.sqrt(2)
    spread = _directions_differ(figures)
    rows = (
        paper_row(
            "width",
            width,
            f"{width:.2f} µm",
            f"{_described(setup)}Half height is counted from the PSF's mean, all directions "
            f"averaged; counted from the valley beside the peak it is {figures.fwhm_um:.1f} µm. "
            "The paper does not say which it takes.",
        ),
        paper_row("line", line, f"{line:.2f} µm", "The row above over √2."),
        paper_row(
            "pitch",
            pitch,
            "no second peak" if pitch is None else f"{pitch:.1f} µm",
            "As described, see above. The second peak of all directions together "
            "lies a little farther out than that of one line"
            + (
                "."
                if figures.row_pitch_um is None
                else f", which the paper draws and which gives {figures.row_pitch_um:.1f} µm here."
            ),
        ),
        paper_row(
            "mtf",
            None,
            f"equal within {100 * spread:.0f} %",
            f"Mean spectral magnitude from {_LOWEST_PER_MM:g} to {figures.line_per_mm:.0f} "
            "lines/mm along the rows and along the columns, the larger over the smaller. At 0° and "
            "180°, as at 90° and 270°, any PSF has the same spectrum, so four curves say as much "
            "as two. What the paper calls the MTF is drawn here as spectral magnitude: it falls "
            "with one over the root of the number of spots, which a modulation transfer does not.",
        ),
    )
    draw = partial(
        write_psf_plot,
        figures=figures,
        psf=results["psf"].arrays["psf"][0],
        pixel_um=figures.pixel_um,
    )
    caption = (
        "One frame of a white LED behind a 50 µm pinhole at 300 mm, with mosaic and noise, 2×2 "
        "pixels to a superpixel, all colours together: the PSF, its autocorrelation and its "
        "spectrum."
    )
    return Content(rows, (Picture("psf", caption, draw),))


def _described(setup: ExperimentSetup) -> str:
    """What of the mask is the paper's, and what is not."""
    relief = setup.loaded.camera.mask.relief
    if not isinstance(relief, RandomLenslets):
        return ""
    return (
        f"The mask is described by its R of {relief.radius} and its pitch of {relief.pitch}, which "
        f"the paper gives as 0.67 mm and 69.75 µm, and by a rounding of its valleys of "
        f"{relief.smoothing}, of which it says nothing and which decides this width: so the row "
        "shows what the description is of, and predicts nothing. "
    )


def _directions_differ(figures: PsfFigures) -> float:
    """By how much the mean magnitude along rows and columns differ."""
    means = []
    for at, values in figures.direction_magnitude.values():
        inside = [
            value
            for per_mm, value in zip(at, values, strict=True)
            if _LOWEST_PER_MM <= per_mm <= figures.line_per_mm
        ]
        means.append(sum(inside) / len(inside))
    return max(means) / min(means) - 1
