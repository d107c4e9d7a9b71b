"""Fig. 5: the PSF as the sensor captures it, its autocorrelation and its spectrum."""

from dataclasses import asdict
from typing import Any

from nolens.camera import develop
from nolens.evaluate import PsfFigures, psf_figures
from nolens.reproduction.steps import Found, Step, Tick
from nolens.reproduction.workbench import Workbench

_SPREAD_OVER = "direction_magnitude"


def steps(work: Workbench) -> tuple[Step, ...]:
    """One frame of the paper's point source, and its figures."""
    return (
        Step(
            "psf",
            "fig. 5: the PSF",
            work.parameters(),
            2.0 + work.psf_seconds(),
            lambda tick: _captured(work, tick),
        ),
    )


def _captured(work: Workbench, tick: Tick) -> Found:
    """Figures of the frame, noise and mosaic included, all colours together."""
    frame = work.bench.point(work.source, seed=work.seed, tick=tick)
    psf = develop(frame).values.sum(dim=0)
    twin = work.bench.twin
    figures = psf_figures(psf, twin.cell_um, reduced_um=twin.stack().reduced_um)
    return Found(asdict(figures), {"psf": psf[None]})


def read_figures(stored: dict[str, Any]) -> PsfFigures:
    """The figures as they were found, from what is stored of them."""
    by_direction = {
        int(angle): (tuple(at), tuple(values))
        for angle, (at, values) in stored[_SPREAD_OVER].items()
    }
    return PsfFigures(**{**stored, _SPREAD_OVER: by_direction})
