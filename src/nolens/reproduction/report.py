"""The report as a whole, and the files that it is written to."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from pydantic_core import to_json

from nolens.camera import preset
from nolens.files.pdf import write_report_pdf
from nolens.files.reports import Report, ReportRow, write_report_html, write_report_markdown
from nolens.reproduction import (
    depths,
    field,
    pattern,
    photographs,
    resolution,
    thickness,
)
from nolens.reproduction.draft import Draft
from nolens.reproduction.paper import PAPER
from nolens.reproduction.rows import Row
from nolens.reproduction.steps import Found
from nolens.reproduction.workbench import Workbench

PICTURES = "pictures"
"""Folder of the pictures, in that of the report."""
_TITLE = "The paper's figures, made again"
_SECTIONS: tuple[Callable[[Workbench, Mapping[str, Found]], Draft], ...] = (
    thickness.rays,
    thickness.films,
    pattern.psf,
    resolution.two_points,
    resolution.siemens,
    field.angles,
    field.dots,
    photographs.photographs,
    depths.magnification,
    depths.refocus,
)


@dataclass(frozen=True)
class Told:
    """The report, and its rows as values.

    Parameters
    ----------
    report
        What is written.
    rows
        In values that JSON has.
    """

    report: Report
    rows: list[dict[str, Any]]


def tell(work: Workbench, found: Mapping[str, Found]) -> Told:
    """Put what was found beside what the paper says."""
    drafts = [section(work, found) for section in _SECTIONS]
    reduced = work.reduced
    report = Report(
        _TITLE,
        _subtitle(work),
        _intro(work),
        tuple(draft.finished(reduced=reduced) for draft in drafts),
    )
    return Told(report, [row.stored(reduced=reduced) for draft in drafts for row in draft.rows])


def _subtitle(work: Workbench) -> str:
    rows, columns = work.pixels
    part = "the middle " if work.reduced else "all "
    return (
        f"nolens reproduce: camera {work.opened.camera.name!r}, {part}{columns}×{rows} pixels, "
        f"seed {work.seed}"
    )


def _intro(work: Workbench) -> tuple[str, ...]:
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
    if work.opened.camera != preset("paper"):
        texts.append(
            "The camera is another one than the paper's, whose preset is named paper: where a "
            "value differs, that comes first, and the explanations hold for the rest."
        )
    if work.reduced:
        texts.append(
            "This is a report of reduced size: a part of the sensor, fewer PSFs and iterations. "
            "Rows that this changes say so; without --quick they come out at full size."
        )
    return tuple(texts)


def report_writers(
    folder: Path, report: Report, timing: Mapping[str, Any]
) -> dict[Path, Callable[[Path], None]]:
    """What writes each file of the report, but for the record.

    Parameters
    ----------
    folder
        Where they go.
    report
        The report.
    timing
        What differs from run to run: machine, date and seconds.
    """
    writers: dict[Path, Callable[[Path], None]] = {
        folder / PICTURES / f"{picture.name}.png": partial(_write_bytes, content=picture.png)
        for section in report.sections
        for picture in section.pictures
    }
    seconds = dict(timing["photographs"])
    notes = (
        f"Written by `nolens reproduce` of nolens {timing['nolens']} on {timing['date'][:10]}; "
        f"{timing['machine']}; all parts together took {timing['seconds'] / 60:.0f} min.",
    )
    return writers | {
        folder / "timing.json": partial(_write_bytes, content=to_json(timing, indent=1) + b"\n"),
        folder / "reproduction.md": partial(
            write_report_markdown,
            report=_timed(report, seconds, str(timing["machine"])),
            folder=PICTURES,
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
    row = Row(
        "seconds",
        longest,
        f"up to {longest:.0f} s",
        f"The reconstruction alone, three colours, on {machine}: another machine than the "
        "paper's, so the ratio says what a person waits and no more.",
    ).told(reduced=False)

    def exchanged(each: ReportRow) -> ReportRow:
        return row if each.what == PAPER["seconds"].what else each

    sections = tuple(
        replace(section, rows=tuple(map(exchanged, section.rows))) for section in report.sections
    )
    return replace(report, sections=sections)


def _write_bytes(path: Path, content: bytes) -> None:
    path.write_bytes(content)
