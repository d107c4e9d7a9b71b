"""Writing a process sheet, for the screen and for the wall above the bench."""

from pathlib import Path

from nolens.fabricate.sheet_parts import Sheet
from nolens.files.atomic import atomic_write
from nolens.files.write_sheet_markup import sheet_html
from nolens.files.write_sheet_pages import build_pages


def write_sheet_html(path: str | Path, sheet: Sheet) -> None:
    """Write a sheet as one HTML file that needs no other; it prints on A4, drawings to scale.

    Parameters
    ----------
    path
        The file to write.
    sheet
        What is on it. The same sheet gives the same bytes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        temporary.write_text(sheet_html(sheet), encoding="utf-8")


def write_sheet_pdf(path: str | Path, sheet: Sheet) -> None:
    """Write a sheet as PDF on A4, drawings to scale, its fonts embedded.

    Parameters
    ----------
    path
        The file to write.
    sheet
        What is on it. The same sheet gives the same bytes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        build_pages(temporary, sheet)
