"""`nolens reproduce`: the paper's figures and numbers, made again, in one report."""

import os
import platform
import shutil
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic_core import to_json

from nolens import __version__
from nolens.camera import preset
from nolens.errors import FileError
from nolens.files import readable
from nolens.files.pdf import write_report_pdf
from nolens.files.reports import Report, write_report_html, write_report_markdown
from nolens.files.sample_pictures import check_sample_pictures
from nolens.jobs.fields import FilePath, Name, OutputFolderOptions
from nolens.jobs.options import Option, Written
from nolens.jobs.run import Product, Run, Writer, job
from nolens.machine import check_memory
from nolens.progress import Clock
from nolens.ranges import Between
from nolens.reproduction import depths, photographs, psf, resolution, thickness
from nolens.reproduction.comparison import paper_row
from nolens.reproduction.photographs import SCENES
from nolens.reproduction.setup import FULL, NEEDED_BY, QUICK, ExperimentSetup
from nolens.reproduction.steps import Step, StepResult, carry_out

_INFO = Path("/proc/cpuinfo")
_STEPS, _PICTURES = "steps", "pictures"
"""Folders in that of the report."""
_RECORD_FILE = "report.json"
_REPORT_FILES = ("report.html", "report.pdf", _RECORD_FILE, "reproduction.md", "timing.json")
_TITLE = "The paper's figures, made again"
_SECTIONS = (
    thickness.rays,
    thickness.films,
    psf.psf,
    resolution.two_points,
    resolution.siemens,
    resolution.off_axis_psfs,
    resolution.dots,
    photographs.photographs,
    depths.magnification,
    depths.refocus,
)


class ReproduceOptions(OutputFolderOptions):
    """Make every figure of the paper again that simulation can give, beside the paper's values.

    nolens reproduce -o report/ --quick

    Writes report.html and report.pdf, which are the same to the byte for the same seed; the
    record report.json; the pictures; timing.json with all that differs from run to run; and
    reproduction.md with both. Parts that are done are kept in steps/, so a run that was stopped
    goes on when it is started again.
    """

    usage = "reproduce -o FOLDER"
    record_file = _RECORD_FILE

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
    loaded = run.camera(options.camera)
    setup = ExperimentSetup(loaded, QUICK if options.quick else FULL, options.seed)
    remedy = "a camera with fewer pixels, or --quick, needs less"
    check_memory(setup.bytes, torch.device("cpu"), remedy)
    _check_folder(options.output, setup.written_bytes)
    run.begin()
    steps = all_steps(setup, options.camera)
    reporter.note(
        f"{len(steps)} parts, which take about {setup.bytes / 1e9:.1f} GB of memory; each is kept "
        f"in {readable(options.output / _STEPS)} when it is done, so this can be stopped and "
        "started again"
    )
    results = carry_out(steps, options.output / _STEPS, reporter)
    # The reporter was told when the parts could not be made.
    refused = {name: each.refused for name, each in results.items() if each.refused}
    run.warn(*(f"{name}: {reason}" for name, reason in refused.items()), aloud=False)
    report = Report(
        _TITLE,
        _subtitle(setup),
        _intro(setup),
        tuple(make(setup, results) for make in _SECTIONS),
    )
    figures = {
        "camera": loaded.camera.name,
        "pixels": list(setup.pixels),
        "reduced": setup.reduced,
        "seed": options.seed,
        "rows": [asdict(row) for section in report.sections for row in section.rows],
    }
    return Product(
        report,
        figures,
        _report_writers(options.output, report, _timing(results, run.clock)),
        outputs=tuple(each.path for each in options.written if each.path != options.record),
    )


def all_steps(setup: ExperimentSetup, camera: str) -> tuple[Step, ...]:
    """All parts, in the order of the paper."""
    return (
        *thickness.steps(setup, camera),
        *psf.steps(setup),
        *resolution.steps(setup),
        *photographs.steps(setup),
        *depths.steps(setup),
    )


def _check_folder(folder: Path, needed_bytes: float) -> None:
    """Refuse a folder that holds something else than a report, or a disk without room for it."""
    if folder.is_dir():
        ours = {*_REPORT_FILES, _PICTURES, _STEPS}
        # What begins with a dot is a system's, or left over by a run that was killed.
        others = (each.name for each in folder.iterdir() if not each.name.startswith("."))
        foreign = sorted(name for name in others if name not in ours)
        if foreign:
            raise FileError(
                f"{folder} holds {foreign[0]}, which is no part of a report: give a folder that is "
                "empty or new, or that of an earlier report (-o)"
            )
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    free = shutil.disk_usage(there).free
    if free < needed_bytes:
        raise FileError(
            f"the report needs about {needed_bytes / 1e6:.0f} MB, and the disk of {folder} has "
            f"{free / 1e6:.0f} MB left: make room, or give another folder (-o)"
        )


def _timing(results: dict[str, StepResult], clock: Clock) -> dict[str, Any]:
    """What differs from run to run."""
    photographs_s = {
        scene.name: results[f"scene-{scene.name}"].seconds["photograph"]
        for scene in SCENES
        if results[f"scene-{scene.name}"].refused is None
    }
    parts = {name: each.seconds["all"] for name, each in results.items()}
    return {
        "nolens": __version__,
        "machine": _machine(),
        "date": clock.started,
        "seconds": sum(parts.values()),
        "photographs": photographs_s,
        "parts": parts,
    }


def _subtitle(setup: ExperimentSetup) -> str:
    rows, columns = setup.pixels
    part = "the middle " if setup.reduced else "all "
    return (
        f"nolens reproduce: camera {setup.loaded.camera.name!r}, {part}{columns}×{rows} pixels, "
        f"seed {setup.seed}"
    )


def _intro(setup: ExperimentSetup) -> tuple[str, ...]:
    texts = [
        "Every figure and number of “Fabrication of Integrated Lensless Cameras via UV-Imprint "
        "Lithography” that a computer can produce, by simulation of the camera that it describes. "
        "No row is tuned to the paper: what is computed follows from the camera's description, "
        "and where a value differs, the last column says why.",
        "What the simulation does not have: the paper's own diffuser (random lenslets of its mean "
        "radius and pitch stand for it), a measured curve of the light that its pixels accept at "
        "angles (a placeholder), measured spectra of its colours (their ratios in white light are "
        "fitted to Raspberry Pi's tuning of the camera, an infrared-cut filter included), and the "
        "paper's scenes (photographs stand for them).",
    ]
    if setup.loaded.camera != preset("paper"):
        texts.append(
            "The camera is another one than the paper's, whose preset is named paper: where a "
            "value differs, that comes first, and the explanations hold for the rest."
        )
    if setup.reduced:
        texts.append(
            "This is a report of reduced size: a part of the sensor, fewer PSFs and iterations. "
            "Rows that this changes say so; without --quick they come out at full size."
        )
    return tuple(texts)


def _report_writers(folder: Path, report: Report, timing: Mapping[str, Any]) -> dict[Path, Writer]:
    """What writes each file of the report, but for the record."""
    writers: dict[Path, Writer] = {
        folder / _PICTURES / f"{picture.name}.png": partial(Path.write_bytes, data=picture.png)
        for section in report.sections
        for picture in section.pictures
    }
    seconds = dict(timing["photographs"])
    notes = (
        f"Written by `nolens reproduce` of nolens {timing['nolens']} on {timing['date'][:10]}; "
        f"{timing['machine']}; all parts together took {timing['seconds'] / 60:.0f} min.",
    )
    return writers | {
        folder / "timing.json": partial(Path.write_bytes, data=to_json(timing, indent=1) + b"\n"),
        folder / "reproduction.md": partial(
            write_report_markdown,
            report=_timed(report, seconds, str(timing["machine"])),
            folder=_PICTURES,
            notes=notes,
        ),
        folder / "report.pdf": partial(write_report_pdf, report=report),
        folder / "report.html": partial(write_report_html, report=report),
    }


def _timed(report: Report, seconds: Mapping[str, float], machine: str) -> Report:
    """The report with what the photographs took, for where it may differ from run to run."""
    if not seconds:
        return report
    longest = max(seconds.values())
    row = paper_row(
        "seconds",
        longest,
        f"up to {longest:.0f} s",
        f"The reconstruction alone, three colours, on {machine}: another machine than the "
        "paper's, so the ratio says what a person waits and no more.",
    )

    sections = tuple(
        replace(section, rows=tuple(row if each.key == row.key else each for each in section.rows))
        for section in report.sections
    )
    return replace(report, sections=sections)


def _machine() -> str:
    """Name of the processor, and how many cores there are."""
    name = platform.processor() or platform.machine()
    if _INFO.exists():
        lines = _INFO.read_text().splitlines()
        models = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        name = next(models, name)
    return f"{name}, {os.cpu_count()} cores"
