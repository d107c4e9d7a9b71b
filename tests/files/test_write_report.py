"""Reports as HTML, PDF and Markdown."""

import base64
import re
import struct
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from pypdf import PdfReader

from nolens.errors import FileError
from nolens.files.pdf import write_report_pdf
from nolens.files.reports import (
    Report,
    ReportPicture,
    ReportRow,
    ReportSection,
    write_report_html,
    write_report_markdown,
)


def png(width: int, height: int) -> bytes:
    """A grey picture, written by hand."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = b"".join(b"\0" + b"\x80" * width for _ in range(height))
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )  # fmt: skip


PICTURE = ReportPicture("fig", png(40, 20), "a & b < c", 90.0)
ROW = ReportRow(
    key="width",
    what="width <of> it",
    where="fig. 5b",
    paper="20.15 µm",
    paper_value=20.15,
    value=20.14,
    text="20.14 µm",
    ratio=20.14 / 20.15,
    why='a | b <c> & "d"',
)
REPORT = Report(
    "Figures & numbers", "camera 'x'", ("First.", "Second."),
    (
        ReportSection("one", "Fig. 1: <one>", ("Above.",), (PICTURE,), (ROW,)),
        ReportSection("two", "Fig. 2", (), (), (ROW, replace(ROW, ratio=None, what="other"))),
    ),
)  # fmt: skip


class Tags(HTMLParser):
    """Checks that what is opened is closed, and keeps words."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words: list[str] = []
        self.cells: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        if tag == "td":
            self.cells.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)
        if self.open and self.open[-1] == "td":
            self.cells[-1] += data


def test_the_html_is_whole_and_says_every_cell(tmp_path: Path) -> None:
    write_report_html(tmp_path / "a.html", REPORT)
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    assert tags.cells[:4] == ["20.15 µm", "20.14 µm", "1.00", 'a | b <c> & "d"']
    assert len(tags.cells) == 12
    assert "width <of> it" in tags.words and "Fig. 1: <one>" in tags.words
    (data,) = re.findall(r"data:image/png;base64,([^\"]+)", text)
    assert base64.b64decode(data) == PICTURE.png
    assert "viewport" in text and "http" not in text


def test_the_pdf_holds_all_words_and_the_picture(tmp_path: Path) -> None:
    write_report_pdf(tmp_path / "a.pdf", REPORT)
    write_report_pdf(tmp_path / "b.pdf", REPORT)
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    reader = PdfReader(tmp_path / "a.pdf")
    words = " ".join(" ".join(page.extract_text() for page in reader.pages).split())
    for text in (
        "Figures & numbers",
        "Fig. 1: <one>",
        "width <of> it",
        "20.14 µm",
        'a | b <c> & "d"',
    ):
        assert text in words
    assert sum(len(page.images) for page in reader.pages) == 1
    assert reader.metadata is not None and reader.metadata.title == "Figures & numbers"


def test_a_long_report_goes_on_over_the_pages(tmp_path: Path) -> None:
    tall = replace(PICTURE, png=png(20, 200))
    rows = tuple(replace(ROW, what=f"row {number}", why="why " * 60) for number in range(60))
    section = ReportSection("long", "Long", ("Text.",), (tall, tall), rows)
    write_report_pdf(tmp_path / "a.pdf", replace(REPORT, sections=(section,)))
    pages = [page.extract_text() for page in PdfReader(tmp_path / "a.pdf").pages]
    assert len(pages) > 4
    assert all(f"row {number}" in " ".join(pages) for number in range(60))
    # The table's head stands on every page that it goes on over.
    assert sum("the paper" in page for page in pages) >= len(pages) - 2


def test_the_markdown_has_a_table_and_the_pictures_beside_it(tmp_path: Path) -> None:
    write_report_markdown(tmp_path / "a.md", REPORT, folder="pictures", notes=("On a machine.",))
    lines = (tmp_path / "a.md").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "# Figures & numbers"
    assert "On a machine." in lines
    assert "![fig](pictures/fig.png)" in lines
    rows = [line for line in lines if line.startswith("| width")]
    assert len(rows) == 2
    assert rows[0].count("|") == 6
    assert rows[0].split(" | ")[2] == "20.14 µm"


@pytest.mark.parametrize("write", [write_report_html, write_report_pdf])
def test_a_report_that_cannot_be_written_is_an_error_and_leaves_nothing(
    tmp_path: Path, write: object
) -> None:
    assert callable(write)
    with pytest.raises(FileError, match="cannot write"):
        write(tmp_path / "none" / "a.x", REPORT)
    assert list(tmp_path.iterdir()) == []
