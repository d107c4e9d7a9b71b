"""A report as Markdown, with its pictures in files beside it."""

from pathlib import Path

from nolens.files.atomic import atomic_write
from nolens.files.report import COLUMNS, Report, ReportSection


def write_report_markdown(
    path: str | Path, report: Report, *, folder: str, notes: tuple[str, ...] = ()
) -> None:
    """Write a report as Markdown.

    Parameters
    ----------
    path
        The file to write.
    report
        What is in it.
    folder
        Where its pictures lie, from the file's own folder.
    notes
        Paragraphs after those of the report: what differs from run to run, such as the time.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    parts = [f"# {report.title}", report.subtitle, *report.texts, *notes]
    for section in report.sections:
        parts += _section(section, folder)
    with atomic_write(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _section(section: ReportSection, folder: str) -> list[str]:
    parts = [f"## {section.title}", *section.texts]
    for picture in section.pictures:
        parts += [
            f"![{picture.name}]({folder}/{picture.name}.png)",
            f"*{picture.caption}*",
        ]
    if section.rows:
        head = f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}"
        rows = "\n".join(
            _line(f"{row.what} ({row.where})", row.paper, row.ours, row.ratio, row.why)
            for row in section.rows
        )
        parts.append(f"{head}\n{rows}")
    return parts


def _line(*cells: str) -> str:
    return f"| {' | '.join(cell.replace('|', '∣') for cell in cells)} |"
