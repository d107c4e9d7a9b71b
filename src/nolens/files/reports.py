"""Reports of a reproduction, as Markdown for the docs and HTML; the frame of all HTML pages."""

import base64
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path

from nolens.files.atomic import atomic_write

COLUMNS = ("quantity", "the paper", "here", "ratio", "where they differ, why")
"""Heads of every table; the section of the paper stands below the quantity."""
_WIDE_MM = 120.0


@dataclass(frozen=True)
class ReportRow:
    """One quantity, as the paper has it and as it came out here.

    `where` is the section or figure of the paper, `paper` and `text` are both values with their
    units, and `paper_value` and `value` the numbers alone. `ratio` is ours over the paper's; `why`
    says why the two differ, or how the quantity was computed. `reduced` is whether it would come
    out otherwise at full size.
    """

    key: str
    what: str
    where: str
    paper: str
    paper_value: float | None
    value: float | None
    text: str
    ratio: float | None
    why: str
    reduced: bool = False

    @property
    def columns(self) -> tuple[str, str, str, str]:
        """Texts below all of `COLUMNS` but the first."""
        ours = f"{self.text} (reduced size)" if self.reduced else self.text
        return self.paper, ours, "" if self.ratio is None else f"{self.ratio:.2f}", self.why


@dataclass(frozen=True)
class ReportPicture:
    """A picture of a report: the name of its file without suffix, its bytes, what it shows.

    `width_mm` is how wide it is printed, at most the width of the text.
    """

    name: str
    png: bytes
    caption: str
    width_mm: float = 180.0


@dataclass(frozen=True)
class ReportSection:
    """A figure of the paper, made again: paragraphs above pictures beside a table.

    `name` is what refers to it, `title` its heading.
    """

    name: str
    title: str
    texts: tuple[str, ...]
    pictures: tuple[ReportPicture, ...]
    rows: tuple[ReportRow, ...]


@dataclass(frozen=True)
class Report:
    """A whole report: paragraphs below its title and subtitle, and sections in their order."""

    title: str
    subtitle: str
    texts: tuple[str, ...]
    sections: tuple[ReportSection, ...]


def html_page(
    title: str, body: str, *, style: str, scheme: str, head: str = "", end: str = ""
) -> str:
    """Put a document together.

    Parameters
    ----------
    title
        As plain text.
    body
        Markup of what it shows.
    style
        File of its style, beside this one.
    scheme
        Colour schemes that the style knows: light, dark or both.
    head
        More markup of the head.
    end
        Markup after what it shows.
    """
    css = (files("nolens.files") / style).read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en-GB">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="{scheme}">
{head}<title>{escape(title)}</title>
<style>
{css}</style>
</head>
<body>
<main>
{body}</main>
{end}</body>
</html>
"""


def write_report_markdown(
    path: str | Path, report: Report, *, folder: str, notes: tuple[str, ...] = ()
) -> None:
    """Write a report as Markdown.

    Parameters
    ----------
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
        parts += _markdown_section(section, folder)
    with atomic_write(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _markdown_section(section: ReportSection, folder: str) -> list[str]:
    parts = [f"## {section.title}", *section.texts]
    for picture in section.pictures:
        parts += [
            f"![{picture.name}]({folder}/{picture.name}.png)",
            f"*{picture.caption}*",
        ]
    if section.rows:
        head = f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}"
        rows = "\n".join(
            _markdown_line(f"{row.what} ({row.where})", *row.columns) for row in section.rows
        )
        parts.append(f"{head}\n{rows}")
    return parts


def _markdown_line(*texts: str) -> str:
    return f"| {' | '.join(text.replace('|', '∣') for text in texts)} |"


def write_report_html(path: str | Path, report: Report) -> None:
    """Write a report as HTML with its pictures inside, readable on a phone as on a screen.

    The same report gives the same bytes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    links = "\n".join(
        f'<a href="#{escape(section.name)}">{escape(section.title)}</a>'
        for section in report.sections
    )
    body = f"""<header>
<h1>{escape(report.title)}</h1>
<p class="subtitle">{escape(report.subtitle)}</p>
{_paragraphs(report.texts)}
<nav aria-label="figures">
{links}
</nav>
</header>
{"".join(map(_section, report.sections))}"""
    page = html_page(report.title, body, style="report.css", scheme="light")
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _paragraphs(texts: tuple[str, ...]) -> str:
    return "\n".join(f"<p>{escape(text)}</p>" for text in texts)


def _section(section: ReportSection) -> str:
    pictures = "\n".join(map(_picture, section.pictures))
    narrow = section.pictures and all(each.width_mm <= _WIDE_MM for each in section.pictures)
    body = f"<div>\n{pictures}\n</div>\n<div>\n{_table(section)}</div>"
    return (
        f'<section id="{escape(section.name)}">\n<h2>{escape(section.title)}</h2>\n'
        f"{_paragraphs(section.texts)}\n"
        f'<div class="{"beside" if narrow else "below"}">\n{body}\n</div>\n</section>\n'
    )


def _picture(picture: ReportPicture) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    caption = escape(picture.caption)
    return (
        f'<figure>\n<img src="data:image/png;base64,{data}" alt="{caption}">\n'
        f"<figcaption>{caption}</figcaption>\n</figure>"
    )


def _table(section: ReportSection) -> str:
    if not section.rows:
        return ""
    heads = "".join(f'<th scope="col">{escape(head)}</th>' for head in COLUMNS)
    rows = "\n".join(map(_row, section.rows))
    return f"<table>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table>\n"


def _row(row: ReportRow) -> str:
    cells = zip(("paper", "ours", "ratio", "why"), COLUMNS[1:], row.columns, strict=True)
    values = "".join(
        f'<td class="{kind}" data-head="{escape(head)}">{escape(text)}</td>'
        for kind, head, text in cells
    )
    where = f'<span class="where">{escape(row.where)}</span>'
    return f'<tr><th scope="row">{escape(row.what)}{where}</th>{values}</tr>'
