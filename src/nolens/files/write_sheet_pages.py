"""A process sheet as pages of a PDF."""

from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from reportlab.lib.colors import HexColor
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import (
    BaseDocTemplate,
    Flowable,
    Frame,
    KeepTogether,
    PageTemplate,
    Paragraph,
    Spacer,
    TableStyle,
)
from reportlab.platypus import Table as Grid

from nolens.fabricate.drawing import INK
from nolens.fabricate.sheet_parts import (
    Blank,
    Blanks,
    Block,
    Figure,
    Sheet,
    Step,
    Steps,
    Table,
    Text,
)
from nolens.files.write_sheet_drawing import BOLD, REGULAR, Picture, register_fonts

_MARGIN = 15 * mm
_HEAD_ROOM, _FOOT = 12 * mm, 13 * mm
_WIDTH = A4[0] - 2 * _MARGIN
_GREY, _LIGHT, _WARNING = HexColor("#5a5f66"), HexColor("#eceef1"), HexColor("#fff4d6")
_BOX, _GAP = 4.2 * mm, 1.2 * mm
_LINES, _ORIGINS = 41 * mm, 18 * mm


def _style(name: str, size: float, **more: Any) -> ParagraphStyle:
    given = {"fontName": REGULAR, "leading": 1.32 * size, "textColor": HexColor(INK), **more}
    return ParagraphStyle(name, fontSize=size, **given)


_TITLE = _style("title", 19, fontName=BOLD)
_SUBTITLE = _style("subtitle", 11.5, textColor=_GREY)
_HEADING = _style("heading", 14, fontName=BOLD, spaceBefore=4 * mm, spaceAfter=1.5 * mm)
_BODY = _style("body", 10.5)
_NOTE = _style("note", 9, textColor=_GREY)
_AMOUNT = _style("amount", 13.5, fontName=BOLD)
_NUMBER = _style("number", 12, fontName=BOLD)
_CELL = _style("cell", 9.5)
_HEAD = _style("head", 9, fontName=BOLD)
_CAPTION = _style("caption", 9, textColor=_GREY, spaceAfter=1 * mm)


def build_pages(path: Path, sheet: Sheet) -> None:
    """Write the pages; the same sheet gives the same bytes.

    Parameters
    ----------
    path
        The PDF to write.
    sheet
        What is on it.
    """
    register_fonts()
    document = BaseDocTemplate(
        str(path),
        pagesize=A4,
        title=sheet.title,
        subject=sheet.subtitle,
        creator="nolens",
        author="nolens",
        invariant=1,
        lang="en-GB",
    )
    inside = Frame(
        _MARGIN,
        _FOOT,
        _WIDTH,
        A4[1] - _FOOT - _HEAD_ROOM,
        leftPadding=0,
        rightPadding=0,
        topPadding=0,
        bottomPadding=0,
    )
    document.addPageTemplates([PageTemplate(frames=[inside])])
    story: list[Flowable] = [
        Paragraph(escape(sheet.title), _TITLE),
        Paragraph(escape(sheet.subtitle), _SUBTITLE),
    ]
    for section in sheet.sections:
        groups = [[Paragraph(escape(section.title), _HEADING)]]
        for block in section.blocks:
            groups += _groups(block)
        # A heading stays with what follows it.
        groups[:2] = [groups[0] + groups[1]]
        for group in groups:
            story.append(KeepTogether(group))
    document.build(story, canvasmaker=_numbered(sheet.title))


def _groups(block: Block) -> list[list[Flowable]]:
    """What a block consists of; each group stays on one page."""
    if isinstance(block, Text):
        return [[_text(block), Spacer(0, _GAP)]]
    if isinstance(block, Blanks):
        return [[_Rules(block.blanks, _WIDTH), Spacer(0, _GAP)]]
    if isinstance(block, Figure):
        title = Paragraph(escape(block.drawing.title), _HEAD)
        under = Paragraph(escape(block.caption), _CAPTION)
        return [[title, Spacer(0, mm), Picture(block.drawing), under, Spacer(0, _GAP)]]
    if isinstance(block, Steps):
        return [[_step(number, step)] for number, step in enumerate(block.steps, block.first)]
    caption = Paragraph(escape(block.caption), _CAPTION)
    return [[caption, _table(block), Spacer(0, _GAP)]]


def _text(text: Text) -> Flowable:
    if text.kind == "plain":
        return Paragraph(escape(text.text), _BODY)
    if text.kind == "note":
        return Paragraph(escape(text.text), _NOTE)
    framed = Grid([[Paragraph(escape(text.text), _CELL)]], colWidths=[_WIDTH])
    framed.setStyle(
        TableStyle(
            [
                ("BACKGROUND", (0, 0), (-1, -1), _WARNING),
                ("BOX", (0, 0), (-1, -1), 0.8, HexColor(INK)),
                ("TOPPADDING", (0, 0), (-1, -1), 3),
                ("BOTTOMPADDING", (0, 0), (-1, -1), 5),
            ]
        )
    )
    return framed


def _step(number: int, step: Step) -> Flowable:
    """A box to tick, the number, what to do with its amount, lines to write on, the origin."""
    words = [Paragraph(escape(step.text), _BODY)]
    if step.amount:
        words.append(Paragraph(escape(step.amount), _AMOUNT))
    widths = [_BOX + 2 * mm, 9 * mm, 0.0, _LINES, _ORIGINS]
    widths[2] = _WIDTH - sum(widths)
    lines = [_Rules((blank,), widths[3] - 10) for blank in step.blanks]
    origin = Paragraph(escape(step.origin), _NOTE)
    grid = Grid([[_Tick(), Paragraph(f"{number}", _NUMBER), words, lines, origin]], widths)
    grid.setStyle(
        TableStyle(
            [
                ("VALIGN", (0, 0), (-1, -1), "TOP"),
                ("LINEBELOW", (0, 0), (-1, -1), 0.4, _GREY),
                ("LEFTPADDING", (0, 0), (-1, -1), 2),
                ("LEFTPADDING", (3, 0), (3, 0), 8),
                ("RIGHTPADDING", (0, 0), (-1, -1), 2),
                ("TOPPADDING", (0, 0), (-1, -1), 2),
                ("BOTTOMPADDING", (0, 0), (-1, -1), 4),
            ]
        )
    )
    return grid


def _table(table: Table) -> Flowable:
    widths = [share * _WIDTH for share in table.shares]
    rows = [[Paragraph(escape(head), _HEAD) for head in table.columns]]
    for row in table.rows:
        rows.append(
            [
                Paragraph(escape(cell), _CELL)
                if isinstance(cell, str)
                else _Rules((cell,), width - 8)
                for cell, width in zip(row, widths, strict=True)
            ]
        )
    grid = Grid(rows, widths, repeatRows=1)
    grid.setStyle(
        TableStyle(
            [
                ("GRID", (0, 0), (-1, -1), 0.5, _GREY),
                ("BACKGROUND", (0, 0), (-1, 0), _LIGHT),
                ("VALIGN", (0, 0), (-1, -1), "MIDDLE"),
                ("LEFTPADDING", (0, 0), (-1, -1), 4),
                ("RIGHTPADDING", (0, 0), (-1, -1), 4),
                ("TOPPADDING", (0, 0), (-1, -1), 3),
                ("BOTTOMPADDING", (0, 0), (-1, -1), 4),
            ]
        )
    )
    return grid


class _Tick(Flowable):  # type: ignore[misc]
    """A box to tick."""

    def __init__(self) -> None:
        super().__init__()
        self.width = self.height = _BOX

    def draw(self) -> None:
        self.canv.setStrokeColor(HexColor(INK))
        self.canv.setLineWidth(0.9)
        self.canv.rect(0, -0.5 * mm, _BOX, _BOX)


class _Rules(Flowable):  # type: ignore[misc]
    """Lines to write on side by side, each between its label and its unit."""

    def __init__(self, blanks: tuple[Blank, ...], width: float) -> None:
        super().__init__()
        self.blanks = blanks
        self.width, self.height = width, 7 * mm

    def draw(self) -> None:
        canvas = self.canv
        share = self.width / len(self.blanks)
        canvas.setFont(REGULAR, _CELL.fontSize)
        canvas.setFillColor(HexColor(INK))
        canvas.setStrokeColor(HexColor(INK))
        canvas.setLineWidth(0.6)
        for number, blank in enumerate(self.blanks):
            left, right = number * share, (number + 1) * share - 2 * mm
            if blank.label:
                canvas.drawString(left, 1.5 * mm, f"{blank.label}:")
                left += pdfmetrics.stringWidth(f"{blank.label}: ", REGULAR, _CELL.fontSize)
            if blank.unit:
                canvas.drawRightString(right, 1.5 * mm, blank.unit)
                right -= pdfmetrics.stringWidth(f" {blank.unit}", REGULAR, _CELL.fontSize)
            canvas.line(left, 1.2 * mm, right, 1.2 * mm)


def _numbered(title: str) -> type[Canvas]:
    """A canvas that writes the sheet's title and the page's number under every page."""

    class Numbered(Canvas):  # type: ignore[misc]
        def __init__(self, *given: Any, **named: Any) -> None:
            super().__init__(*given, **named)
            self.pages: list[dict[str, Any]] = []

        def showPage(self) -> None:  # noqa: N802
            self.pages.append(dict(self.__dict__))
            self._startPage()

        def save(self) -> None:
            for number, page in enumerate(self.pages, 1):
                self.__dict__.update(page)
                self.setFont(REGULAR, _NOTE.fontSize)
                self.setFillColor(_GREY)
                self.drawString(_MARGIN, 8 * mm, title[:70])
                self.drawRightString(A4[0] - _MARGIN, 8 * mm, f"page {number} of {len(self.pages)}")
                super().showPage()
            super().save()

    return Numbered
