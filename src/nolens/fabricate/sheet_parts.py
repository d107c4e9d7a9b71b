"""What a process sheet consists of, before it is HTML or PDF: drawings, texts, steps, tables."""

from dataclasses import dataclass
from typing import Literal

Origin = Literal["paper", "advice", "computed", "data sheet"]
"""Where an instruction comes from: the paper, general advice of the workshop, this camera's
figures, or what the maker of a material says."""
Point = tuple[float, float]
Anchor = Literal["start", "middle", "end"]
Tone = Literal["board", "package", "sensor", "glass", "air", "resin", "frame", "mould"]
TONES: dict[Tone, str] = {
    "board": "#b9cbb0",
    "package": "#8d9196",
    "sensor": "#1b1b1b",
    "glass": "#c5e0f2",
    "air": "#ffffff",
    "resin": "#fbd98b",
    "frame": "#b4b9bf",
    "mould": "#ded5ec",
}
"""Colours that differ in grey too, for printers without colour."""
INK = "#1b1b1b"
"""Of lines and words."""
WORD_MM = 2.8
"""Height of the letters, as the size of their font."""
_THIN_MM = 0.18


@dataclass(frozen=True)
class Line:
    """A straight line between points in mm from the drawing's upper left corner, y downwards.

    `part` says what it shows, for programs that look for it.
    """

    start: Point
    end: Point
    weight_mm: float = _THIN_MM
    part: str = ""


@dataclass(frozen=True)
class Area:
    """A filled polygon with its corners as in `Line`, and what it is made of."""

    points: tuple[Point, ...]
    tone: Tone
    part: str = ""
    weight_mm: float = _THIN_MM


@dataclass(frozen=True)
class Word:
    """A line of text; `anchor` says which of its ends stands at the place of its baseline."""

    at: Point
    text: str
    anchor: Anchor = "start"
    size_mm: float = WORD_MM
    bold: bool = False


Shape = Line | Area | Word


@dataclass(frozen=True)
class Drawing:
    """A drawing in millimetres of paper, of which `scale` stand for one of the part.

    The description is for people who do not see it; later shapes cover earlier ones.
    """

    title: str
    description: str
    width_mm: float
    height_mm: float
    scale: float
    shapes: tuple[Shape, ...]


def millimetres(length_mm: float) -> str:
    """Write a length as on drawings: two decimals, a third where it matters."""
    rounded = round(length_mm, 3)
    return f"{rounded:.3f}" if round(rounded, 2) != rounded else f"{rounded:.2f}"


@dataclass(frozen=True)
class Blank:
    """A line to write on, with what is to be written in front and its unit behind."""

    label: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Text:
    """A paragraph: ``"plain"``, a ``"note"`` in small letters, or a ``"warning"`` in a frame."""

    text: str
    kind: Literal["plain", "note", "warning"] = "plain"


@dataclass(frozen=True)
class Blanks:
    """Some lines to write on, side by side."""

    blanks: tuple[Blank, ...]


@dataclass(frozen=True)
class Step:
    """One thing to do, with a box to tick.

    The amount, the figure that counts, is in large letters; the blanks are filled in afterwards.
    """

    text: str
    origin: Origin
    amount: str = ""
    blanks: tuple[Blank, ...] = ()


@dataclass(frozen=True)
class Steps:
    """Things to do one after the other, numbered from `first` on through the whole sheet."""

    first: int
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Table:
    """A table; cells are text or lines to write on, and the first of each row names it.

    The widths of the columns are fractions of the page's.
    """

    caption: str
    columns: tuple[str, ...]
    fractions: tuple[float, ...]
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
    """A process sheet: what is made, and sections in the order of the work."""

    title: str
    subtitle: str
    sections: tuple[Section, ...]
