"""Drawings to scale: lines, areas and words in millimetres of paper."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from nolens.errors import OptionError

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
WIDTH_MM = 180.0
"""Of every drawing: what an A4 page has between its margins."""
WORD_MM = 2.8
"""Height of the letters, as the size of their font."""
LETTER_MM = 0.62 * WORD_MM
"""Room that a letter is given; those of DejaVu Sans are narrower on average."""
LINE_MM = 1.3 * WORD_MM
"""From one line of words to the next."""
BASE_MM = 0.36 * WORD_MM
"""From the middle of a line of words down to its baseline."""
_THIN_MM = 0.18
_TICK_MM = 1.2
_SCALES = (100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)
_BAR_MM = 10.0


@dataclass(frozen=True)
class Line:
    """A straight line.

    Parameters
    ----------
    start, end
        (x, y) in mm from the drawing's upper left corner, y downwards.
    weight_mm
        Width of the line.
    part
        What it shows, for programs that look for it.
    """

    start: Point
    end: Point
    weight_mm: float = _THIN_MM
    part: str = ""


@dataclass(frozen=True)
class Area:
    """A filled polygon.

    Parameters
    ----------
    points
        Its corners, as in `Line`.
    tone
        What it is made of.
    part
        What it shows, for programs that look for it.
    weight_mm
        Width of its outline.
    """

    points: tuple[Point, ...]
    tone: Tone
    part: str = ""
    weight_mm: float = _THIN_MM


@dataclass(frozen=True)
class Word:
    """A line of text.

    Parameters
    ----------
    at
        Place of its baseline, as in `Line`.
    text
        What it says.
    anchor
        Which end of the text stands at that place.
    size_mm
        Size of its font.
    bold
        Whether the letters are bold.
    """

    at: Point
    text: str
    anchor: Anchor = "start"
    size_mm: float = WORD_MM
    bold: bool = False


Shape = Line | Area | Word


@dataclass(frozen=True)
class Drawing:
    """A drawing in millimetres of paper.

    Parameters
    ----------
    title
        What it is, on one line.
    description
        What it shows, for people who do not see it.
    width_mm, height_mm
        Its size on paper.
    scale
        Millimetres on paper for one of the part.
    shapes
        In the order in which they cover each other.
    """

    title: str
    description: str
    width_mm: float
    height_mm: float
    scale: float
    shapes: tuple[Shape, ...]


def box(left: float, top: float, right: float, bottom: float, tone: Tone, part: str = "") -> Area:
    """Give a rectangle with sides along the axes."""
    return Area(((left, top), (right, top), (right, bottom), (left, bottom)), tone, part)


def scale_for(size_mm: Point, room_mm: Point) -> float:
    """Largest usual scale at which a part of so much (width, height) fits into so much paper.

    Raises
    ------
    OptionError
        If none of them does, down to 1:10.
    """
    for scale in _SCALES:
        if all(part * scale <= room for part, room in zip(size_mm, room_mm, strict=True)):
            return scale
    raise OptionError(
        f"a part of {size_mm[0]:.4g} × {size_mm[1]:.4g} mm does not fit on the sheet at 1:10: the "
        f"sheet holds parts up to {10 * room_mm[0]:g} × {10 * room_mm[1]:g} mm"
    )


def scale_name(scale: float) -> str:
    """Write a scale as drawings do: ``10:1`` or ``1:2``."""
    return f"{scale:g}:1" if scale >= 1 else f"1:{1 / scale:g}"


def millimetres(length_mm: float) -> str:
    """Write a length as on drawings: two decimals, a third where it matters."""
    rounded = round(length_mm, 3)
    return f"{rounded:.3f}" if round(rounded, 2) != rounded else f"{rounded:.2f}"


def width_dimension(left: float, right: float, y: float, text: str, edge: float) -> list[Shape]:
    """Dimension line along x with its text above it, or beside it where it is too short.

    Parameters
    ----------
    left, right
        Between which places.
    y
        Where the line runs.
    text
        What it says.
    edge
        Where the thin lines to the part end.
    """
    beyond = math.copysign(_TICK_MM, y - edge)
    shapes: list[Shape] = [Line((x, edge), (x, y + beyond)) for x in (left, right)]
    shapes += [Line((left, y), (right, y)), *_tick(left, y), *_tick(right, y)]
    if right - left > len(text) * LETTER_MM:
        return [*shapes, Word(((left + right) / 2, y - 0.8), text, "middle")]
    return [*shapes, Word((right + 1.5, y + BASE_MM), text)]


def height_dimension(
    places: Sequence[float], texts: Sequence[str], x: float, edge: float
) -> list[Shape]:
    """Chain of dimension lines along y, with their texts on the side away from the part.

    Parameters
    ----------
    places
        Rising places between which the lines run.
    texts
        One for each of them.
    x
        Where the lines run.
    edge
        Where the thin lines to the part end.
    """
    way = math.copysign(1.0, x - edge)
    shapes: list[Shape] = [Line((edge, y), (x + way * _TICK_MM, y)) for y in places]
    shapes.append(Line((x, places[0]), (x, places[-1])))
    for y in places:
        shapes += _tick(x, y)
    middles = [sum(pair) / 2 for pair in pairwise(places)]
    anchor: Anchor = "start" if way > 0 else "end"
    for y, text in zip(spread(middles, LINE_MM), texts, strict=True):
        shapes.append(Word((x + 1.8 * way, y + BASE_MM), text, anchor))
    return shapes


def spread(places: Sequence[float], spacing: float) -> list[float]:
    """Move rising places apart, each as little as it takes, until neighbours keep a distance."""
    moved: list[float] = []
    groups: list[list[float]] = []
    # Groups of places that touch share the move: their mean stays where it was.
    for number, place in enumerate(places):
        groups.append([place - number * spacing])
        while len(groups) > 1 and _mean(groups[-2]) > _mean(groups[-1]):
            last = groups.pop()
            groups[-1] += last
    for group in groups:
        moved += [_mean(group)] * len(group)
    return [place + number * spacing for number, place in enumerate(moved)]


def scale_bar(left: float, y: float, scale: float) -> list[Shape]:
    """A bar of 10 mm on paper that shows whether a printer changed the scale."""
    right = left + _BAR_MM
    part_mm = _BAR_MM / scale
    shapes: list[Shape] = [Line((left, y), (right, y), 0.5, part="scale-bar")]
    shapes += [Line((x, y - 1.2), (x, y + 1.2), 0.3) for x in (left, right)]
    text = f"{_BAR_MM:g} mm on paper, {part_mm:g} mm of the part: scale {scale_name(scale)}"
    return [*shapes, Word((right + 2, y + BASE_MM), text)]


def pointers(named: Sequence[tuple[str, Point]], y: float) -> list[Shape]:
    """Words side by side at a height, in the order of what they name, and lines down to that."""
    dot = 0.45
    shapes: list[Shape] = []
    apart = spread([at[0] for _, at in named], 2 * WORD_MM)
    for x, (text, at) in zip(apart, named, strict=True):
        shapes += [
            Word((x, y), text, "middle", bold=True),
            Line((x, y + 0.8), at),
            box(at[0] - dot, at[1] - dot, at[0] + dot, at[1] + dot, "sensor"),
        ]
    return shapes


def key(texts: Sequence[str], y: float) -> list[Shape]:
    """Texts below each other in two columns, from some height on; long ones are cut."""
    rows = (len(texts) + 1) // 2
    most = int(WIDTH_MM / 2 / LETTER_MM)
    return [
        Word(
            (WIDTH_MM / 2 * (number // rows), y + LINE_MM * (number % rows + 1)),
            text if len(text) <= most else f"{text[: most - 1]}…",
        )
        for number, text in enumerate(texts)
    ]


def _tick(x: float, y: float) -> list[Shape]:
    half = _TICK_MM * 0.7
    return [Line((x - half, y + half), (x + half, y - half), 0.35)]


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)
