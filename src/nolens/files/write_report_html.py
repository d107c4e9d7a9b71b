"""A report as one HTML file that needs no other."""

import base64
from html import escape
from pathlib import Path

from nolens.files.atomic import atomic_write
from nolens.files.html_page import html_page
from nolens.files.report import COLUMNS, Report, ReportPicture, ReportRow, ReportSection

_WIDE_MM = 120.0


def write_report_html(path: str | Path, report: Report) -> None:
    """Write a report as HTML with its pictures inside, readable on a phone as on a screen.

    Parameters
    ----------
    path
        The file to write.
    report
        What is in it. The same report gives the same bytes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        temporary.write_text(report_html(report), encoding="utf-8")


def report_html(report: Report) -> str:
    """Write a report as an HTML document with everything in it."""
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
    return html_page(report.title, body, style="write_report.css", scheme="light")


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
    cells = zip(
        ("paper", "ours", "ratio", "why"),
        COLUMNS[1:],
        (row.paper, row.ours, row.ratio, row.why),
        strict=True,
    )
    told = "".join(
        f'<td class="{kind}" data-head="{escape(head)}">{escape(text)}</td>'
        for kind, head, text in cells
    )
    where = f'<span class="where">{escape(row.where)}</span>'
    return f'<tr><th scope="row">{escape(row.what)}{where}</th>{told}</tr>'
