"""A camera with another mask: regular, random, or designed for its PSF."""

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from nolens.camera import OpenCamera, RandomLenslets
from nolens.design.masks import (
    FREQUENCIES_PER_MM,
    MaskFigures,
    central_psf,
    correlation,
    mask_figures,
    spread_over,
)
from nolens.files import camera_files, read_camera, write_camera
from nolens.files.plot_mask import MaskPlot, plot_mask
from nolens.jobs.copied import copied_curves
from nolens.jobs.cost import check_memory, surface_cost
from nolens.jobs.designing.mask_kinds import made_mask, with_relief
from nolens.jobs.designing.mask_options import PICTURE_FILE, MaskOptions
from nolens.jobs.run import Product, Run, Writer, job
from nolens.quantities import Length
from nolens.twin import Light, Twin
from nolens.twin.preview import relief_points

_PAPERS = RandomLenslets(
    kind="random-lenslets",
    radius=Length("0.67", "mm"),
    pitch=Length("70", "um"),
    smoothing=Length("11", "um"),
    seed=0,
    grid=Length("1.55", "um"),
    overhang=Length("0.5", "mm"),
)
"""The paper's diffuser, as the preset describes it, around a small part of the sensor."""
_MIDDLE_PIXELS = 1152


@job
def design_mask(run: Run[MaskOptions]) -> Product[OpenCamera]:
    """Design a mask for a camera and write the camera that has it.

    Raises
    ------
    NolensError
        If an option or an output cannot be used; then nothing is written.
    """
    options, reporter, device = run.options, run.reporter, run.device
    opened, light = read_camera(options.camera), Light(options.light)
    run.reads(camera_files(options.camera, opened.camera))
    run.begin()
    made = made_mask(options, opened, light, device, reporter)

    reporter.advance("figures", 0.0)
    twin, paper = (_middle(each, device) for each in (made.opened, with_relief(opened, _PAPERS)))
    psf = central_psf(twin, light)
    reporter.advance("figures", 0.6)
    papers_psf = central_psf(paper, light)
    figures, papers = mask_figures(twin, psf), mask_figures(paper, papers_psf)
    summary: dict[str, Any] = {
        "camera": made.opened.camera.name,
        "kind": options.kind,
        "figures": _plain(figures),
        "paper_diffuser": _plain(papers),
        "magnitude_per_mm": list(FREQUENCIES_PER_MM),
        "stop_reason": "interrupted" if made.stopped else "finished",
    }
    if made.layout is not None:
        summary["period_um"] = made.layout.side * made.layout.grid_um
    if made.target is not None:
        target = spread_over(made.target, (psf.shape[1], psf.shape[2]))
        summary["target_correlation"] = [float(correlation(each, target)) for each in psf]
    plot = MaskPlot(
        heights_um=twin.mask.relief.height_um.cpu(),
        grid_um=twin.mask.relief.grid_um,
        psf=psf,
        papers_psf=papers_psf,
        cell_um=twin.cell_um,
        title=made.opened.camera.name,
    )
    more: dict[str, Writer] = {
        **copied_curves(options.camera, opened),
        PICTURE_FILE: partial(plot_mask, plot=plot),
    }

    def commit(writers: Mapping[Path, Writer]) -> None:
        named = {path.name: write for path, write in writers.items()}
        write_camera(options.output, made.opened.camera, made.opened.relief_um, more=named)

    return Product(
        made.opened,
        summary,
        {options.output / name: write for name, write in more.items()},
        outputs=tuple(each.path for each in options.written if each.path != options.record),
        commit=commit,
    )


def _middle(opened: OpenCamera, device: torch.device) -> Twin:
    """The camera with the middle of its sensor and no opening, ready to be simulated."""
    sensor = opened.camera.sensor
    rows, columns = (min(_MIDDLE_PIXELS, count) for count in (sensor.rows, sensor.columns))
    small = sensor.model_copy(update={"rows": rows, "columns": columns})
    mask = opened.camera.mask.model_copy(update={"aperture": None})
    camera = opened.camera.model_copy(update={"sensor": small, "mask": mask})
    middle = replace(opened, camera=camera)
    cost = surface_cost(relief_points(middle))
    check_memory(cost, device, "a smaller --overhang or a larger --pitch needs less")
    return Twin.of(middle, device=device)


def _plain(figures: MaskFigures) -> dict[str, Any]:
    plain = {**asdict(figures), "line_um": figures.line_um}
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in plain.items()
    }
