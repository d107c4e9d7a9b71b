"""A camera with another mask: regular, random, or designed for its PSF."""

import math
from dataclasses import asdict, dataclass, replace
from functools import partial
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
from nolens.files import (
    InputFile,
    RunRecord,
    camera_files,
    read_camera,
    readable,
    write_camera,
    write_record,
)
from nolens.files.folder import check_folder
from nolens.files.plot_mask import MaskPlot, plot_mask
from nolens.jobs.clock import Clock
from nolens.jobs.copied import copied_curves
from nolens.jobs.cost import check_memory, surface_cost
from nolens.jobs.designing.mask_kinds import made_mask, with_relief
from nolens.jobs.designing.mask_options import PICTURE_FILE, RECORD_FILE, MaskOptions
from nolens.jobs.device import pick_device
from nolens.jobs.options import check_apart
from nolens.jobs.reporter import Reporter
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


@dataclass(frozen=True)
class MaskOutcome:
    """A camera with a new mask.

    Parameters
    ----------
    opened
        The camera.
    summary
        Figures of the mask and of the paper's, in values that JSON has.
    """

    opened: OpenCamera
    summary: dict[str, Any]


def design_mask(options: MaskOptions, reporter: Reporter) -> MaskOutcome:
    """Design a mask for a camera and write the camera that has it.

    Parameters
    ----------
    options
        Which mask, for which camera, where to write.
    reporter
        Sees notes and how far the work is.

    Raises
    ------
    NolensError
        If an option or an output cannot be used; then nothing is written.
    """
    clock = Clock()
    opened = read_camera(options.camera)
    files = camera_files(options.camera, opened.camera)
    check_apart(options, files)
    check_folder(options.output)
    device, light = pick_device(options.device), Light(options.light)
    inputs = {role: InputFile.of(path) for role, path in files.items()}
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
        "outputs": [readable(each.path) for each in options.written],
        "device": str(device),
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
    summary["seconds"] = clock.seconds
    record = RunRecord(
        started=clock.started,
        inputs=inputs,
        parameters=options.model_dump(mode="json"),
        result=summary,
        history=[],
        warnings=[],
    )
    write_camera(
        options.output,
        made.opened.camera,
        made.opened.relief_um,
        more={
            **copied_curves(options.camera, opened),
            PICTURE_FILE: partial(plot_mask, plot=plot),
            RECORD_FILE: partial(write_record, record=record),
        },
    )
    return MaskOutcome(made.opened, summary)


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
