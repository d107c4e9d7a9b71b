"""PDF on A4: process sheets with drawings to scale, and reports; their fonts are embedded."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from matplotlib import get_data_path
from PIL import Image as PixelImage
from reportlab import rl_config
from reportlab.lib.colors import HexColor
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
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
    TableStyle,
)
from reportlab.platypus import Table as Grid

from nolens.fabricate.sheet_parts import (
    INK,
    TONES,
    Blank,
    Blanks,
    Block,
    Drawing,
    Figure,
    Line,
    Shape,
    Sheet,
    Step,
    Steps,
    Table,
    Text,
    Word,
)
from nolens.files.atomic import atomic_write
from nolens.files.reports import COLUMNS, Report, ReportPicture, ReportRow, ReportSection

REGULAR, BOLD = "DejaVuSans", "DejaVuSans-Bold"
"""Fonts that have every sign of a sheet; they come with matplotlib."""
_MARGIN = 15 * mm
_WIDTH = A4[0] - 2 * _MARGIN
_GREY, _LIGHT, _WARNING = HexColor("#5a5f66"), HexColor("#eceef1"), HexColor("#fff4d6")

_SHEET_TOP, _SHEET_FOOT = 12 * mm, 13 * mm
_BOX, _GAP = 4.2 * mm, 1.2 * mm
_LINES, _ORIGINS = 41 * mm, 18 * mm

_REPORT_FOOT = 16 * mm
_TALLEST = 150 * mm
_COLUMN_FRACTIONS = (0.21, 0.135, 0.135, 0.07, 0.45)
_RULE = HexColor("#c9ced5")

_ALL = (0, 0), (-1, -1)
"""Cells of a grid, from the first to the last."""


def _style(name: str, size: float, leading: float = 1.32, **more: Any) -> ParagraphStyle:
    """A style of paragraphs; `leading` is the distance of lines in units of the size."""
    values = {"fontName": REGULAR, "leading": leading * size, "textColor": HexColor(INK), **more}
    return ParagraphStyle(name, fontSize=size, **values)


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

_REPORT_TITLE = _style("title", 19, 1.35, fontName=BOLD, spaceAfter=1 * mm)
_REPORT_SUBTITLE = _style("subtitle", 11, 1.35, textColor=_GREY, spaceAfter=2 * mm)
_REPORT_HEADING = _style(
    "heading", 13, 1.35, fontName=BOLD, spaceBefore=6 * mm, spaceAfter=1.5 * mm
)
_REPORT_BODY = _style("body", 9.5, 1.35, spaceAfter=1.5 * mm)
_REPORT_CAPTION = _style("caption", 8, 1.35, textColor=_GREY, spaceAfter=2 * mm)
_REPORT_HEAD = _style("head", 7.5, 1.35, fontName=BOLD)
_REPORT_CELL = _style("cell", 8, 1.35)


def write_sheet_pdf(path: str | Path, sheet: Sheet) -> None:
    """Write a sheet with its drawings to scale. The same sheet gives the same bytes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    register_fonts()
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
    with atomic_write(path) as temporary:
        document = _document(temporary, sheet.title, sheet.subtitle, (_SHEET_TOP, _SHEET_FOOT))
        document.build(story, canvasmaker=_numbered(sheet.title))


def write_report_pdf(path: str | Path, report: Report) -> None:
    """Write a report with its pictures. The same report gives the same bytes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    register_fonts()
    story: list[Flowable] = [
        Paragraph(escape(report.title), _REPORT_TITLE),
        Paragraph(escape(report.subtitle), _REPORT_SUBTITLE),
        *(Paragraph(escape(text), _REPORT_BODY) for text in report.texts),
    ]
    for section in report.sections:
        story += _report_section(section)
    with atomic_write(path) as temporary:
        margins = _MARGIN, _REPORT_FOOT
        document = _document(temporary, report.title, report.subtitle, margins, onPage=_report_foot)
        with _binary_streams():
            document.build(story)


def register_fonts() -> None:
    """Make the fonts known to reportlab; they are embedded in what uses them."""
    known = pdfmetrics.getRegisteredFontNames()
    for name in (REGULAR, BOLD):
        if name not in known:
            path = Path(get_data_path()) / "fonts" / "ttf" / f"{name}.ttf"
            pdfmetrics.registerFont(TTFont(name, path))


def _document(
    path: Path, title: str, subtitle: str, margins: tuple[float, float], **page: Any
) -> BaseDocTemplate:
    """A document whose pages have margins at the top and the foot, and options of a template."""
    document = BaseDocTemplate(
        str(path),
        pagesize=A4,
        title=title,
        subject=subtitle,
        creator="nolens",
        author="nolens",
        invariant=1,
        lang="en-GB",
    )
    top, foot = margins
    inside = Frame(
        _MARGIN,
        foot,
        _WIDTH,
        A4[1] - foot - top,
        leftPadding=0,
        rightPadding=0,
        topPadding=0,
        bottomPadding=0,
    )
    document.addPageTemplates([PageTemplate(frames=[inside], **page)])
    return document


@contextmanager
def _binary_streams() -> Iterator[None]:
    """Without reportlab's spelling of bytes as text, pictures are a quarter smaller."""
    before = rl_config.useA85
    rl_config.useA85 = 0
    try:
        yield
    finally:
        rl_config.useA85 = before


def _groups(block: Block) -> list[list[Flowable]]:
    """What a block consists of; each group stays on one page."""
    if isinstance(block, Text):
        return [[_text(block), Spacer(0, _GAP)]]
    if isinstance(block, Blanks):
        return [[_Rules(block.blanks, _WIDTH), Spacer(0, _GAP)]]
    if isinstance(block, Figure):
        title = Paragraph(escape(block.drawing.title), _HEAD)
        under = Paragraph(escape(block.caption), _CAPTION)
        return [[title, Spacer(0, mm), _DrawingFlowable(block.drawing), under, Spacer(0, _GAP)]]
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
    frame = ("BACKGROUND", *_ALL, _WARNING), ("BOX", *_ALL, 0.8, HexColor(INK))
    return _styled(framed, (6, 3, 5), "BOTTOM", *frame)


def _step(number: int, step: Step) -> Flowable:
    """A box to tick, the number, what to do with its amount, lines to write on, the origin."""
    words = [Paragraph(escape(step.text), _BODY)]
    if step.amount:
        words.append(Paragraph(escape(step.amount), _AMOUNT))
    widths = [_BOX + 2 * mm, 9 * mm, 0.0, _LINES, _ORIGINS]
    widths[2] = _WIDTH - sum(widths)
    rules = [_Rules((blank,), widths[3] - 10) for blank in step.blanks]
    origin = Paragraph(escape(step.origin), _NOTE)
    grid = Grid([[_Checkbox(), Paragraph(f"{number}", _NUMBER), words, rules, origin]], widths)
    lines = ("LINEBELOW", *_ALL, 0.4, _GREY), ("LEFTPADDING", (3, 0), (3, 0), 8)
    return _styled(grid, (2, 2, 4), "TOP", *lines)


def _table(table: Table) -> Flowable:
    widths = [fraction * _WIDTH for fraction in table.fractions]
    rows = [[Paragraph(escape(head), _HEAD) for head in table.columns]]
    for row in table.rows:
        cells = zip(row, widths, strict=True)
        rows.append([_table_cell(cell, width) for cell, width in cells])
    grid = Grid(rows, widths, repeatRows=1)
    lines = ("GRID", *_ALL, 0.5, _GREY), ("BACKGROUND", (0, 0), (-1, 0), _LIGHT)
    return _styled(grid, (4, 3, 4), "MIDDLE", *lines)


def _table_cell(cell: str | Blank, width: float) -> Flowable:
    return Paragraph(escape(cell), _CELL) if isinstance(cell, str) else _Rules((cell,), width - 8)


class _Checkbox(Flowable):  # type: ignore[misc]
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
        step = self.width / len(self.blanks)
        canvas.setFont(REGULAR, _CELL.fontSize)
        canvas.setFillColor(HexColor(INK))
        canvas.setStrokeColor(HexColor(INK))
        canvas.setLineWidth(0.6)
        for number, blank in enumerate(self.blanks):
            left, right = number * step, (number + 1) * step - 2 * mm
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
        def __init__(self, *arguments: Any, **named: Any) -> None:
            super().__init__(*arguments, **named)
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


class _DrawingFlowable(Flowable):  # type: ignore[misc]
    """A drawing in true millimetres."""

    def __init__(self, drawing: Drawing) -> None:
        super().__init__()
        self.drawing = drawing
        self.width, self.height = drawing.width_mm * mm, drawing.height_mm * mm

    def draw(self) -> None:
        """Draw all shapes, in their order."""
        self.canv.setStrokeColor(HexColor(INK))
        self.canv.setLineJoin(1)
        for shape in self.drawing.shapes:
            self._shape(shape)

    def _at(self, place: tuple[float, float]) -> tuple[float, float]:
        return place[0] * mm, self.height - place[1] * mm

    def _shape(self, shape: Shape) -> None:
        canvas = self.canv
        if isinstance(shape, Word):
            canvas.setFont(BOLD if shape.bold else REGULAR, shape.size_mm * mm)
            canvas.setFillColor(HexColor(INK))
            write = {
                "start": canvas.drawString,
                "middle": canvas.drawCentredString,
                "end": canvas.drawRightString,
            }
            write[shape.anchor](*self._at(shape.at), shape.text)
            return
        canvas.setLineWidth(shape.weight_mm * mm)
        if isinstance(shape, Line):
            canvas.line(*self._at(shape.start), *self._at(shape.end))
            return
        canvas.setFillColor(HexColor(TONES[shape.tone]))
        path = canvas.beginPath()
        path.moveTo(*self._at(shape.points[0]))
        for corner in shape.points[1:]:
            path.lineTo(*self._at(corner))
        path.close()
        canvas.drawPath(path, stroke=1, fill=1)


def _report_foot(canvas: Canvas, document: BaseDocTemplate) -> None:
    canvas.setFont(REGULAR, 8)
    canvas.setFillColor(_GREY)
    canvas.drawString(_MARGIN, 9 * mm, document.title)
    canvas.drawRightString(A4[0] - _MARGIN, 9 * mm, f"{document.page}")


def _report_section(section: ReportSection) -> list[Flowable]:
    """A heading stays with what follows it; long tables go on over the page."""
    head: list[Flowable] = [
        Paragraph(escape(section.title), _REPORT_HEADING),
        *(Paragraph(escape(text), _REPORT_BODY) for text in section.texts),
    ]
    if section.pictures:
        first, *more = map(_report_picture, section.pictures)
        parts: list[Flowable] = [KeepTogether([*head, *first])]
        parts += [KeepTogether(each) for each in more]
    else:
        parts = [CondPageBreak(60 * mm), *head]
    if section.rows:
        parts.append(_report_table(section.rows))
    return parts


def _report_picture(picture: ReportPicture) -> list[Flowable]:
    with PixelImage.open(BytesIO(picture.png)) as image:
        columns, rows = image.size
    width = min(picture.width_mm * mm, _WIDTH, _TALLEST * columns / rows)
    placed = Image(BytesIO(picture.png), width, width * rows / columns, hAlign="LEFT")
    return [placed, Spacer(0, 1 * mm), Paragraph(escape(picture.caption), _REPORT_CAPTION)]


def _report_table(rows: tuple[ReportRow, ...]) -> Grid:
    cells = [[Paragraph(escape(head), _REPORT_HEAD) for head in COLUMNS]]
    for row in rows:
        what = f'{escape(row.what)}<br/><font size="7" color="#5a5f66">{escape(row.where)}</font>'
        cells.append([Paragraph(each, _REPORT_CELL) for each in (what, *map(escape, row.columns))])
    table = Grid(cells, [fraction * _WIDTH for fraction in _COLUMN_FRACTIONS], repeatRows=1)
    lines = ("LINEBELOW", *_ALL, 0.4, _RULE), ("BACKGROUND", (0, 0), (-1, 0), _LIGHT)
    return _styled(table, (3, 2, 3), "TOP", *lines)


def _styled(
    grid: Grid, paddings: tuple[float, float, float], align: str, *styles: tuple[Any, ...]
) -> Grid:
    """The grid with styles, and with paddings beside, above and below what is in its cells."""
    beside, above, below = paddings
    common = (
        ("VALIGN", *_ALL, align),
        ("LEFTPADDING", *_ALL, beside),
        ("RIGHTPADDING", *_ALL, beside),
        ("TOPPADDING", *_ALL, above),
        ("BOTTOMPADDING", *_ALL, below),
    )
    grid.setStyle(TableStyle([*common, *styles]))
    return grid
