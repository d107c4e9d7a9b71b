"""What a process sheet consists of, before it is HTML or PDF."""

from dataclasses import dataclass
from typing import Literal

from nolens.fabricate.drawing import Drawing

Origin = Literal["paper", "advice", "computed", "data sheet"]
"""Where an instruction comes from: the paper, general advice of the workshop, this camera's
figures, or what the maker of a material says."""


@dataclass(frozen=True)
class Blank:
    """A line to write on.

    Parameters
    ----------
    label
        What is to be written; may be empty in a table.
    unit
        Unit behind the line.
    """

    label: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Text:
    """A paragraph.

    Parameters
    ----------
    text
        What it says.
    kind
        ``"plain"``, ``"note"`` in small letters, ``"warning"`` in a frame.
    """

    text: str
    kind: Literal["plain", "note", "warning"] = "plain"


@dataclass(frozen=True)
class Blanks:
    """Some lines to write on, side by side."""

    blanks: tuple[Blank, ...]


@dataclass(frozen=True)
class Step:
    """One thing to do, with a box to tick.

    Parameters
    ----------
    text
        What to do.
    origin
        Where that comes from.
    amount
        The figure that counts, in large letters.
    blanks
        What to write down when it is done.
    """

    text: str
    origin: Origin
    amount: str = ""
    blanks: tuple[Blank, ...] = ()


@dataclass(frozen=True)
class Steps:
    """Things to do one after the other; numbered through the whole sheet.

    Parameters
    ----------
    first
        Number of the first one.
    steps
        The things.
    """

    first: int
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Table:
    """A table; cells are text or lines to write on.

    Parameters
    ----------
    caption
        What it shows.
    columns
        Heads of the columns.
    shares
        Widths of the columns, as shares of the page's.
    rows
        The cells; the first of each row names it.
    """

    caption: str
    columns: tuple[str, ...]
    shares: tuple[float, ...]
    rows: tuple[tuple[str | Blank, ...], ...]


@dataclass(frozen=True)
class Figure:
    """A drawing and what stands under it."""

    drawing: Drawing
    caption: str


Block = Text | Blanks | Steps | Table | Figure


@dataclass(frozen=True)
class Section:
    """A heading and what belongs to it."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Sheet:
    """A process sheet.

    Parameters
    ----------
    title, subtitle
        What is made.
    sections
        In the order of the work.
    """

    title: str
    subtitle: str
    sections: tuple[Section, ...]
