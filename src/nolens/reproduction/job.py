"""The paper's figures and numbers, made again with a simulated camera."""

import os
import platform
import shutil
from pathlib import Path
from typing import Annotated, Any

import torch

from nolens import __version__
from nolens.errors import FileError
from nolens.files import camera_files, read_camera, readable
from nolens.files.reports import Report
from nolens.jobs.fields import FilePath, Name
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import Clock, Product, Run, check_memory, job
from nolens.jobs.sample_pictures import check_sample_pictures
from nolens.ranges import Between
from nolens.reproduction import (
    depths,
    field,
    pattern,
    photographs,
    resolution,
    thickness,
)
from nolens.reproduction.photographs import SCENES
from nolens.reproduction.report import PICTURES, report_writers, tell
from nolens.reproduction.steps import Found, Step, carry_out
from nolens.reproduction.workbench import FULL, NEEDED_BY, QUICK, Workbench

_INFO = Path("/proc/cpuinfo")
_RECORD_FILE, _STEPS = "report.json", "steps"
_REPORT_FILES = ("report.html", "report.pdf", _RECORD_FILE, "reproduction.md", "timing.json")


class ReproduceOptions(JobOptions):
    """Make every figure of the paper again that simulation can give, beside the paper's values.

    nolens reproduce -o report/ --quick

    Writes report.html and report.pdf, which are the same to the byte for the same seed; the
    record report.json; the pictures; timing.json with all that differs from run to run; and
    reproduction.md with both. Parts that are done are kept in steps/, so a run that was stopped
    goes on when it is started again.
    """

    usage = "reproduce -o FOLDER"

    output: Annotated[
        FilePath,
        Option(
            "Folder of the report: new, empty, or that of an earlier one.",
            needed="the folder of the report (-o FOLDER)",
            role="output",
            flag="-o",
        ),
    ]
    quick: Annotated[
        bool,
        Option(
            "A part of the sensor, with fewer PSFs and iterations: minutes instead of half an "
            "hour.",
            default="off",
            negative=False,
        ),
    ] = False
    seed: Annotated[
        int,
        Between(0, 2**31 - 1),
        Option("Number that the noise of all frames is drawn from, 0 or more."),
    ] = 0
    camera: Annotated[
        Name,
        Option(
            "Camera to make them with: a preset, a folder with camera.toml, or a .toml file.",
            role="camera",
        ),
    ] = "paper"

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / _RECORD_FILE

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

    @property
    def written(self) -> tuple[Written, ...]:
        """The report's files."""
        return tuple(Written("report", self.output / name) for name in _REPORT_FILES)


@job
def reproduce(run: Run[ReproduceOptions]) -> Product[Report]:
    """Compute every figure, part by part, and write the report.

    Parts that are in the folder from an earlier run of the same camera, size, seed and code are
    taken as they are.

    Raises
    ------
    NolensError
        If an option, the camera or the folder cannot be used.
    """
    options, reporter = run.options, run.reporter
    check_sample_pictures(NEEDED_BY)
    opened = read_camera(options.camera)
    run.reads(camera_files(options.camera, opened.camera))
    work = Workbench(opened, QUICK if options.quick else FULL, options.seed)
    remedy = "a camera with fewer pixels, or --quick, needs less"
    check_memory(work.bytes, torch.device("cpu"), remedy)
    _check_folder(options.output, work.written_bytes)
    run.begin()
    steps = all_steps(work, options.camera)
    reporter.note(
        f"{len(steps)} parts, which take about {work.bytes / 1e9:.1f} GB of memory; each is kept "
        f"in {readable(options.output / _STEPS)} when it is done, so this can be stopped and "
        "started again"
    )
    found = carry_out(steps, options.output / _STEPS, reporter)
    # They were told when the parts could not be made.
    refused = {name: each.refused for name, each in found.items() if each.refused}
    run.warn(*(f"{name}: {reason}" for name, reason in refused.items()), aloud=False)
    told = tell(work, found)
    figures = {
        "camera": opened.camera.name,
        "pixels": list(work.pixels),
        "reduced": work.reduced,
        "seed": options.seed,
        "rows": told.rows,
    }
    return Product(
        told.report,
        figures,
        report_writers(options.output, told.report, _timing(found, run.clock)),
        outputs=tuple(each.path for each in options.written if each.path != options.record),
    )


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


def _check_folder(folder: Path, needed_bytes: float) -> None:
    """Refuse a folder that holds something else than a report, or a disk without room for it."""
    if folder.is_dir():
        ours = {*_REPORT_FILES, PICTURES, _STEPS}
        # What begins with a dot is a system's, or left over by a run that was killed.
        others = (each.name for each in folder.iterdir() if not each.name.startswith("."))
        found = sorted(name for name in others if name not in ours)
        if found:
            raise FileError(
                f"{folder} holds {found[0]}, which is no part of a report: give a folder that is "
                "empty or new, or that of an earlier report (-o)"
            )
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    free = shutil.disk_usage(there).free
    if free < needed_bytes:
        raise FileError(
            f"the report needs about {needed_bytes / 1e6:.0f} MB, and the disk of {folder} has "
            f"{free / 1e6:.0f} MB left: make room, or give another folder (-o)"
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
        "machine": _machine(),
        "date": clock.started,
        "seconds": sum(parts.values()),
        "photographs": photographs_s,
        "parts": parts,
    }


def _machine() -> str:
    """Name of the processor, and how many cores there are."""
    name = platform.processor() or platform.machine()
    if _INFO.exists():
        lines = _INFO.read_text().splitlines()
        models = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        name = next(models, name)
    return f"{name}, {os.cpu_count()} cores"
