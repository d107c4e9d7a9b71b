"""A report as pages of a PDF."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from PIL import Image as Pixels
from reportlab import rl_config
from reportlab.lib.colors import HexColor
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import (
    BaseDocTemplate,
    CondPageBreak,
    Flowable,
    Frame,
    Image,
    KeepTogether,
    PageTemplate,
    Paragraph,
    Spacer,
    Table,
    TableStyle,
)

from nolens.fabricate.drawing import INK
from nolens.files.atomic import atomic_write
from nolens.files.report import COLUMNS, Report, ReportPicture, ReportRow, ReportSection
from nolens.files.write_sheet_drawing import BOLD, REGULAR, register_fonts

_MARGIN, _FOOT = 15 * mm, 16 * mm
_WIDTH = A4[0] - 2 * _MARGIN
_TALLEST = 150 * mm
_SHARES = (0.21, 0.135, 0.135, 0.07, 0.45)
_GREY, _LIGHT, _LINE = HexColor("#5a5f66"), HexColor("#eceef1"), HexColor("#c9ced5")


def _style(name: str, size: float, **more: Any) -> ParagraphStyle:
    given = {"fontName": REGULAR, "leading": 1.35 * size, "textColor": HexColor(INK), **more}
    return ParagraphStyle(name, fontSize=size, **given)


_TITLE = _style("title", 19, fontName=BOLD, spaceAfter=1 * mm)
_SUBTITLE = _style("subtitle", 11, textColor=_GREY, spaceAfter=2 * mm)
_HEADING = _style("heading", 13, fontName=BOLD, spaceBefore=6 * mm, spaceAfter=1.5 * mm)
_BODY = _style("body", 9.5, spaceAfter=1.5 * mm)
_CAPTION = _style("caption", 8, textColor=_GREY, spaceAfter=2 * mm)
_HEAD = _style("head", 7.5, fontName=BOLD)
_CELL = _style("cell", 8)


def write_report_pdf(path: str | Path, report: Report) -> None:
    """Write a report as PDF on A4, its fonts and pictures embedded.

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
    register_fonts()
    story: list[Flowable] = [
        Paragraph(escape(report.title), _TITLE),
        Paragraph(escape(report.subtitle), _SUBTITLE),
        *(Paragraph(escape(text), _BODY) for text in report.texts),
    ]
    for section in report.sections:
        story += _section(section)
    with atomic_write(path) as temporary:
        document = BaseDocTemplate(
            str(temporary),
            pagesize=A4,
            title=report.title,
            subject=report.subtitle,
            creator="nolens",
            author="nolens",
            invariant=1,
            lang="en-GB",
        )
        inside = Frame(
            _MARGIN,
            _FOOT,
            _WIDTH,
            A4[1] - _FOOT - _MARGIN,
            leftPadding=0,
            rightPadding=0,
            topPadding=0,
            bottomPadding=0,
        )
        document.addPageTemplates([PageTemplate(frames=[inside], onPage=_foot)])
        with _binary_streams():
            document.build(story)


@contextmanager
def _binary_streams() -> Iterator[None]:
    """Without reportlab's spelling of bytes as text, pictures are a quarter smaller."""
    before = rl_config.useA85
    rl_config.useA85 = 0
    try:
        yield
    finally:
        rl_config.useA85 = before


def _foot(canvas: Canvas, document: BaseDocTemplate) -> None:
    canvas.setFont(REGULAR, 8)
    canvas.setFillColor(_GREY)
    canvas.drawString(_MARGIN, 9 * mm, document.title)
    canvas.drawRightString(A4[0] - _MARGIN, 9 * mm, f"{document.page}")


def _section(section: ReportSection) -> list[Flowable]:
    """A heading stays with what follows it; long tables go on over the page."""
    head: list[Flowable] = [
        Paragraph(escape(section.title), _HEADING),
        *(Paragraph(escape(text), _BODY) for text in section.texts),
    ]
    if section.pictures:
        first, *more = map(_picture, section.pictures)
        parts: list[Flowable] = [KeepTogether([*head, *first])]
        parts += [KeepTogether(each) for each in more]
    else:
        parts = [CondPageBreak(60 * mm), *head]
    if section.rows:
        parts.append(_table(section.rows))
    return parts


def _picture(picture: ReportPicture) -> list[Flowable]:
    with Pixels.open(BytesIO(picture.png)) as opened:
        columns, rows = opened.size
    width = min(picture.width_mm * mm, _WIDTH, _TALLEST * columns / rows)
    image = Image(BytesIO(picture.png), width, width * rows / columns, hAlign="LEFT")
    return [image, Spacer(0, 1 * mm), Paragraph(escape(picture.caption), _CAPTION)]


def _table(rows: tuple[ReportRow, ...]) -> Table:
    cells = [[Paragraph(escape(head), _HEAD) for head in COLUMNS]]
    for row in rows:
        what = f'{escape(row.what)}<br/><font size="7" color="#5a5f66">{escape(row.where)}</font>'
        rest = (row.paper, row.ours, row.ratio, row.why)
        cells.append([Paragraph(what, _CELL), *(Paragraph(escape(each), _CELL) for each in rest)])
    table = Table(cells, [share * _WIDTH for share in _SHARES], repeatRows=1)
    table.setStyle(
        TableStyle(
            [
                ("LINEBELOW", (0, 0), (-1, -1), 0.4, _LINE),
                ("BACKGROUND", (0, 0), (-1, 0), _LIGHT),
                ("VALIGN", (0, 0), (-1, -1), "TOP"),
                ("LEFTPADDING", (0, 0), (-1, -1), 3),
                ("RIGHTPADDING", (0, 0), (-1, -1), 3),
                ("TOPPADDING", (0, 0), (-1, -1), 2),
                ("BOTTOMPADDING", (0, 0), (-1, -1), 3),
            ]
        )
    )
    return table
