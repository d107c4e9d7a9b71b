"""What a report of a reproduction is made of, for the screen, for paper and for the docs."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ReportRow:
    """One quantity, as the paper has it and as it came out here.

    Parameters
    ----------
    what
        The quantity.
    where
        Section or figure of the paper.
    paper
        Its value there, with its unit.
    ours
        The value here.
    ratio
        Ours over the paper's; empty where there is none to form.
    why
        Where the two differ, why; else how it was found.
    """

    what: str
    where: str
    paper: str
    ours: str
    ratio: str
    why: str


@dataclass(frozen=True)
class ReportPicture:
    """A picture of a report.

    Parameters
    ----------
    name
        Of its file, without suffix.
    png
        Its bytes.
    caption
        What it shows.
    width_mm
        How wide it is printed, at most the width of the text.
    """

    name: str
    png: bytes
    caption: str
    width_mm: float = 180.0


@dataclass(frozen=True)
class ReportSection:
    """A figure of the paper, made again.

    Parameters
    ----------
    name
        To be referred to.
    title
        Its heading.
    texts
        Paragraphs above the pictures.
    pictures
        Beside its table.
    rows
        The table.
    """

    name: str
    title: str
    texts: tuple[str, ...]
    pictures: tuple[ReportPicture, ...]
    rows: tuple[ReportRow, ...]


@dataclass(frozen=True)
class Report:
    """A whole report.

    Parameters
    ----------
    title, subtitle
        At its head.
    texts
        Paragraphs below them.
    sections
        In their order.
    """

    title: str
    subtitle: str
    texts: tuple[str, ...]
    sections: tuple[ReportSection, ...]


COLUMNS = ("quantity", "the paper", "here", "ratio", "where they differ, why")
"""Heads of every table; the section of the paper stands below the quantity."""
