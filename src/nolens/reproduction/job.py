"""The paper's figures and numbers, made again with a simulated camera."""

from dataclasses import dataclass
from typing import Any

import torch

from nolens import __version__
from nolens.files import InputFile, RunRecord, camera_files, read_camera, readable
from nolens.jobs.clock import Clock
from nolens.jobs.cost import Cost, check_memory, duration_text
from nolens.jobs.options import check_apart
from nolens.jobs.reporter import Reporter
from nolens.jobs.sample_pictures import check_sample_pictures
from nolens.reproduction import (
    depths,
    field,
    pattern,
    photographs,
    resolution,
    thickness,
)
from nolens.reproduction.options import STEPS, ReproduceOptions, check_report_folder, machine_name
from nolens.reproduction.photographs import SCENES
from nolens.reproduction.report import tell, write_report
from nolens.reproduction.steps import Found, Step, carry_out
from nolens.reproduction.workbench import FULL, NEEDED_BY, QUICK, Size, Workbench


@dataclass(frozen=True)
class ReproduceOutcome:
    """What a reproduction came to.

    Parameters
    ----------
    summary
        Rows of the report and where it is, in values that JSON has.
    """

    summary: dict[str, Any]


def reproduce(
    options: ReproduceOptions, reporter: Reporter, size: Size | None = None
) -> ReproduceOutcome:
    """Compute every figure, part by part, and write the report.

    Parts that are in the folder from an earlier run of the same camera, size, seed and code are
    taken as they are.

    Parameters
    ----------
    options
        What to compute, and where to write.
    reporter
        Sees notes, warnings and how far the work is.
    size
        How much is computed; None: what the options say.

    Raises
    ------
    NolensError
        If an option, the camera or the folder cannot be used.
    """
    clock = Clock()
    check_sample_pictures(NEEDED_BY)
    opened = read_camera(options.camera)
    files = camera_files(options.camera, opened.camera)
    check_apart(options, files)
    work = Workbench(opened, size or (QUICK if options.quick else FULL), options.seed)
    cost = Cost(work.bytes, 0.0)
    check_memory(cost, torch.device("cpu"), "a camera with fewer pixels, or --quick, needs less")
    check_report_folder(options.output, work.written_bytes)
    inputs = {role: InputFile.of(path) for role, path in files.items()}
    steps = all_steps(work, options.camera)
    whole = duration_text(sum(step.seconds for step in steps))
    reporter.note(
        f"{len(steps)} parts, about {whole} on two cores and {work.bytes / 1e9:.1f} GB of memory; "
        f"each is kept in {readable(options.output / STEPS)} when it is done, so this can be "
        "stopped and started again"
    )
    found = carry_out(steps, options.output / STEPS, reporter)
    told = tell(work, found)
    timing = _timing(found, clock)
    summary = {
        "camera": opened.camera.name,
        "pixels": list(work.pixels),
        "reduced": work.reduced,
        "seed": options.seed,
        "rows": told.rows,
        "outputs": [readable(each.path) for each in options.written],
        "seconds": clock.seconds,
    }
    warnings = [f"{name}: {each.refused}" for name, each in found.items() if each.refused]
    record = RunRecord(
        started=clock.started,
        inputs=inputs,
        parameters=options.model_dump(mode="json"),
        result=summary,
        history=[],
        warnings=warnings,
    )
    write_report(options.output, told, record, timing)
    return ReproduceOutcome(summary)


def all_steps(work: Workbench, camera: str) -> tuple[Step, ...]:
    """All parts, in the order of the paper."""
    return (
        *thickness.steps(work, camera),
        *pattern.steps(work),
        *resolution.steps(work),
        *field.steps(work),
        *photographs.steps(work),
        *depths.steps(work),
    )


def _timing(found: dict[str, Found], clock: Clock) -> dict[str, Any]:
    """What differs from run to run."""
    photographs_s = {
        scene.name: found[f"scene-{scene.name}"].seconds["photograph"]
        for scene in SCENES
        if found[f"scene-{scene.name}"].refused is None
    }
    parts = {name: each.seconds["all"] for name, each in found.items()}
    return {
        "nolens": __version__,
        "machine": machine_name(),
        "date": clock.started,
        "seconds": sum(parts.values()),
        "photographs": photographs_s,
        "parts": parts,
    }
