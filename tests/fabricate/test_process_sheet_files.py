"""The sheet as HTML and PDF: the same words, drawings to scale, nothing beside the page."""

import io
import re

import pypdf
import pytest
from lxml import etree, html
from reportlab.pdfbase.pdfmetrics import stringWidth
from sheets import LINES, camera_of, sheet_of, words_of

from nolens.camera import preset
from nolens.errors import FileError
from nolens.fabricate import FrameGeometry, Sheet
from nolens.fabricate.sheet_parts import Blank, Figure, Section, Table, Word
from nolens.files.pdf import BOLD, REGULAR, write_sheet_pdf
from nolens.files.sheet import write_sheet_html

POINTS_PER_MM = 72 / 25.4
A4_MM = 210, 297
MARGIN_MM = 14.9


@pytest.fixture(scope="module")
def quick():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nolens.fabricate.sheet.expected_lines", lambda camera, limits: LINES)
        yield


@pytest.fixture(scope="module")
def sheet(quick) -> Sheet:
    return sheet_of(preset("paper"))


@pytest.fixture(scope="module")
def page(sheet, tmp_path_factory):
    """The HTML as text and as a tree."""
    path = tmp_path_factory.mktemp("sheet") / "sheet.html"
    write_sheet_html(path, sheet)
    text = path.read_text(encoding="utf-8")
    return text, html.fromstring(text)


@pytest.fixture(scope="module")
def document(sheet, tmp_path_factory) -> pypdf.PdfReader:
    path = tmp_path_factory.mktemp("sheet") / "sheet.pdf"
    write_sheet_pdf(path, sheet)
    return pypdf.PdfReader(io.BytesIO(path.read_bytes()))


def squeezed(text: str) -> str:
    """The text without the breaks that lines and pages make."""
    return re.sub(r"\s+", "", text)


def pdf_text(document: pypdf.PdfReader) -> str:
    return "\n".join(page.extract_text() for page in document.pages)


# --- The same words --------------------------------------------------------------------------


def test_html_and_pdf_say_all_the_sheet_says(sheet, page, document):
    shown = squeezed(page[1].find(".//main").text_content())
    # Words at a page's or column's edge are broken into lines, but keep their order.
    printed = squeezed(pdf_text(document))
    for line in words_of(sheet).splitlines():
        for word in line.split():
            assert squeezed(word) in shown, line
            assert squeezed(word) in printed, line


def test_html_and_pdf_have_the_words_of_drawings(sheet, page, document):
    drawn = [each.text_content() for each in page[1].iter("text")]
    printed = squeezed(document.pages[0].extract_text())
    figures = [block for block in sheet.sections[0].blocks if isinstance(block, Figure)]
    words = [
        shape.text for figure in figures for shape in figure.drawing.shapes
        if isinstance(shape, Word)
    ]  # fmt: skip
    assert drawn == words and len(words) > 30
    for word in words:
        assert squeezed(word) in printed


@pytest.mark.parametrize("text", ["4.99 g base + 0.83 g hardener", "3.00 ± 0.20 mm", "20.0 µm"])
def test_amounts_are_in_both(page, document, text):
    assert text in page[1].text_content()
    assert squeezed(text) in squeezed(pdf_text(document))


def test_signs_of_markup_are_only_signs(quick, tmp_path):
    camera = preset("paper").model_copy(update={"name": 'a <b>&amp; "c"</b>'})
    sheet = sheet_of(camera)
    write_sheet_html(tmp_path / "sheet.html", sheet)
    write_sheet_pdf(tmp_path / "sheet.pdf", sheet)
    title = html.fromstring((tmp_path / "sheet.html").read_text("utf-8")).find(".//h1")
    assert title.text_content() == sheet.title == 'Process sheet: camera “a <b>&amp; "c"</b>”'
    printed = pdf_text(pypdf.PdfReader(tmp_path / "sheet.pdf"))
    assert squeezed(sheet.title) in squeezed(printed)


# --- HTML ------------------------------------------------------------------------------------


def test_html_is_well_formed(page):
    """An XML parser takes it, once the elements that HTML never closes are closed."""
    text = page[0].removeprefix("<!DOCTYPE html>\n")
    closed = re.sub(r"<(meta|input|col)\b([^>]*)>", r"<\1\2/>", text)
    root = etree.fromstring(closed.encode())
    assert root.get("lang") == "en-GB"
    assert root.find("head/title").text == "Process sheet: camera “paper”"


def test_html_needs_no_other_file(page):
    text, tree = page
    assert "http" not in text and "url(" not in text and "@import" not in text
    assert not tree.xpath("//*[@src or @href or @data or @srcset] | //script | //link")


def test_html_is_accessible(page):
    tree = page[1]
    names = tree.xpath("//@id")
    assert len(names) == len(set(names))
    drawings = tree.findall(".//svg")
    assert len(drawings) == 2
    for drawing in drawings:
        assert drawing.get("role") == "img"
        for name in drawing.get("aria-labelledby").split():
            assert tree.get_element_by_id(name).text
    for entry in tree.findall(".//input"):
        assert entry.get("aria-label").strip(", ")
    for table in tree.findall(".//table"):
        assert table.find("caption").text
        assert all(head.get("scope") == "col" for head in table.findall("thead/tr/th"))
        assert all(row.find("th").get("scope") == "row" for row in table.findall("tbody/tr"))
    assert [int(head.tag[1]) for head in tree.iter("h1", "h2", "h3")] == [1] + [2] * 10


def test_svg_is_to_scale(page):
    frame = FrameGeometry.of(preset("paper"))
    for drawing, part in zip(page[1].findall(".//svg"), ("wall", "frame"), strict=True):
        scale = float(drawing.get("data-scale"))
        size = [float(drawing.get(side).removesuffix("mm")) for side in ("width", "height")]
        assert drawing.get("viewbox").split() == ["0", "0", *(f"{side:g}" for side in size)]
        places = " ".join(drawing.xpath(f".//polygon[@data-part='{part}']/@points")).split()
        x = [float(place.split(",")[0]) for place in places]
        assert (max(x) - min(x)) / scale == pytest.approx(frame.outer_width_mm, abs=1e-4)
        (bar,) = drawing.xpath(".//line[@data-part='scale-bar']")
        assert float(bar.get("x2")) - float(bar.get("x1")) == pytest.approx(10, abs=1e-4)
        assert size[0] <= A4_MM[0] - 2 * 15


# --- PDF -------------------------------------------------------------------------------------


def paths_mm(page: pypdf.PageObject) -> list[tuple[float, float]]:
    """Width and height of all paths of a page, in mm on paper."""
    found: list[tuple[float, float]] = []
    points: list[tuple[float, float]] = []

    def see(operator, operands, matrix, _text) -> None:
        if operator in (b"m", b"l"):
            x, y = (float(each) for each in operands)
            points.append((matrix[0] * x, matrix[3] * y))
        elif operator in (b"S", b"B", b"b", b"f", b"B*", b"n") and points:
            columns, rows = zip(*points, strict=True)
            size = max(columns) - min(columns), max(rows) - min(rows)
            found.append((size[0] / POINTS_PER_MM, size[1] / POINTS_PER_MM))
            points.clear()

    page.extract_text(visitor_operand_before=see)
    return found


def test_pdf_is_to_scale(document):
    frame = FrameGeometry.of(preset("paper"))
    drawn = paths_mm(document.pages[0])

    def has(width_mm: float, height_mm: float) -> bool:
        return any(size == pytest.approx((width_mm, height_mm), abs=0.01) for size in drawn)

    assert has(5 * frame.outer_width_mm, 5 * frame.outer_height_mm)
    assert has(10 * frame.wall_mm, 10 * frame.height_mm)
    assert has(10 * frame.package_width_mm, 10 * 0.49)
    assert has(10, 0)
    assert not has(11, 0)


def test_pdf_is_a_few_pages_of_a4(document):
    assert len(document.pages) == 4
    for page in document.pages:
        size = [float(side) / POINTS_PER_MM for side in page.mediabox[2:]]
        assert size == pytest.approx(A4_MM, abs=0.1)
    assert "page 4 of 4" in document.pages[3].extract_text()
    assert document.metadata.title == "Process sheet: camera “paper”"


def test_pdf_holds_its_fonts(document):
    for page in document.pages:
        for font in page["/Resources"]["/Font"].values():
            font = font.get_object()
            if "/FontDescriptor" in font:
                assert "DejaVu" in font["/BaseFont"]
                assert "/FontFile2" in font["/FontDescriptor"].get_object()


def long_named() -> Sheet:
    camera = camera_of(thickness_mm=2.345)
    sensor = camera.sensor.model_copy(update={"name": "a sensor of a name " * 8})
    return sheet_of(camera.model_copy(update={"name": "name " * 40, "sensor": sensor}))


@pytest.mark.parametrize("which", ["paper", "small", "long"])
def test_words_stay_on_the_page(quick, tmp_path, which):
    sheet = long_named() if which == "long" else sheet_of(preset(which))
    write_sheet_pdf(tmp_path / "sheet.pdf", sheet)
    document = pypdf.PdfReader(tmp_path / "sheet.pdf")
    assert len(document.pages) <= 5
    ends = []

    def see(text, matrix, own, font, size) -> None:
        if text.strip():
            name = BOLD if "Bold" in str((font or {}).get("/BaseFont")) else REGULAR
            left = (matrix[4] + own[4]) / POINTS_PER_MM
            widest = max(stringWidth(line.rstrip(), name, size) for line in text.splitlines())
            ends.append((left, left + widest / POINTS_PER_MM, text))

    for page in document.pages:
        page.extract_text(visitor_text=see)
    assert len(ends) > 100
    for left, right, text in ends:
        # Full lines have their spaces narrowed a little, which is not reckoned with here.
        assert left >= MARGIN_MM and right <= A4_MM[0] - MARGIN_MM + 0.4, (left, right, text)


def test_a_table_longer_than_a_page_goes_on(quick, tmp_path):
    rows = tuple((f"row {number}", Blank(unit="mm")) for number in range(80))
    sheet = Sheet("t", "s", (Section("1  x", (Table("c", ("a", "b"), (0.5, 0.5), rows),)),))
    write_sheet_pdf(tmp_path / "sheet.pdf", sheet)
    printed = pdf_text(pypdf.PdfReader(tmp_path / "sheet.pdf"))
    assert all(f"row {number}\n" in f"{printed}\n" for number in range(80))


# --- Both ------------------------------------------------------------------------------------


@pytest.mark.parametrize("write", [write_sheet_html, write_sheet_pdf])
def test_the_same_sheet_gives_the_same_bytes(sheet, tmp_path, write):
    write(tmp_path / "a", sheet)
    write(tmp_path / "b", sheet)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert b"/work" not in (tmp_path / "a").read_bytes()


@pytest.mark.parametrize("write", [write_sheet_html, write_sheet_pdf])
def test_a_path_that_cannot_be_written_leaves_nothing(sheet, tmp_path, write):
    with pytest.raises(FileError, match="cannot write"):
        write(tmp_path / "no" / "sheet", sheet)
    assert list(tmp_path.iterdir()) == []
