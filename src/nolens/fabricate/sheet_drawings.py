"""The drawings of the process sheet: a camera in its frame, cut through and seen from the scene."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from nolens.camera import Camera, Layer
from nolens.errors import OptionError
from nolens.fabricate.frame import FrameGeometry, is_air, poured_layer
from nolens.fabricate.resin import MouldAmount
from nolens.fabricate.sheet_parts import (
    WORD_MM,
    Anchor,
    Area,
    Drawing,
    Line,
    Point,
    Shape,
    Tone,
    Word,
    millimetres,
)
from nolens.fabricate.solid import frame_corners

_WIDTH_MM = 180.0
"""Of every drawing: what an A4 page has between its margins."""
_LETTER_MM = 0.62 * WORD_MM
"""Room that a letter is given; those of DejaVu Sans are narrower on average."""
_LINE_MM = 1.3 * WORD_MM
"""From one line of words to the next."""
_BASE_MM = 0.36 * WORD_MM
"""From the middle of a line of words down to its baseline."""
_TICK_MM = 1.2
_SCALES = (100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)
_BAR_MM = 10.0
_SECTION_ROOM = 132.0, 60.0
_SECTION_TOP_MM, _BOARD_MM = 8.0, 4.0
_MOULD_MM, _OVERHANG_MM = 12.0, 3.5
"""How much of the mould is drawn at most, upwards and beside the frame, in mm of paper."""
_ROW_MM = 5.0
_SECTION_MIDDLE_MM = 93.5
_VIEW_ROOM = 100.0, 70.0
_VIEW_MIDDLE_MM, _VIEW_TOP_MM = 79.0, 1.0


def draw_section(camera: Camera, frame: FrameGeometry, mould: MouldAmount) -> Drawing:
    """Draw sensor, glass, gap, resin, frame and mould to scale.

    The layers below the resin lie in the package; what is large of the mould is cut off, and the
    relief is too low to be drawn. There are measures, a key and a bar of 10 mm.

    Raises
    ------
    OptionError
        If the frame is too large for the sheet.
    """
    place = _Place.of(camera, frame, mould)
    floor = place.floor + _BOARD_MM
    shapes = [*_parts(place), *_heights(place)]
    rows = (
        (place.pixels, camera.sensor.width_mm, "pixels"),
        (place.inner, frame.inner_width_mm, "inside"),
        (place.outer, frame.outer_width_mm, "outside"),
    )
    y = floor + _ROW_MM
    for ends, width_mm, what in rows:
        shapes += _width_dimension(*ends, y, f"{what} {millimetres(width_mm)}", floor)
        y += _ROW_MM
    named = _named(place)
    shapes += _pointers([(letter, at) for letter, at, _ in named], _SECTION_TOP_MM - 4)
    y -= 2
    shapes += _key([f"{letter}  {name}" for letter, _, name in named], y)
    y += _LINE_MM * ((len(named) + 1) // 2)
    shapes += _scale_bar(place.outer[0], y + 3.5, place.scale)
    return Drawing(
        title=f"Section along the pixel rows, scale {scale_name(place.scale)}, measures in mm",
        description=(
            f"The sensor's package, {millimetres(frame.glass_top_mm)} mm high, stands in a frame "
            f"{millimetres(frame.outer_width_mm)} mm wide and {millimetres(frame.height_mm)} mm "
            "high. Over its glass the frame is filled with a layer of resin "
            f"{millimetres(frame.layer_mm)} mm thick, on which the mould lies."
        ),
        width_mm=_WIDTH_MM,
        height_mm=y + 5.5,
        scale=place.scale,
        shapes=tuple(shapes),
    )


def draw_top(camera: Camera, frame: FrameGeometry) -> Drawing:
    """Draw the frame's top with its rim, vents and mark, and the sensor in it, to scale.

    The pixels lie in the middle of the package; rows run to the right, from row to row upwards.
    There are measures, names and a bar of 10 mm.

    Raises
    ------
    OptionError
        If the frame is too large for the sheet.
    """
    scale = scale_for((frame.outer_width_mm, frame.outer_height_mm), _VIEW_ROOM)
    centre = _VIEW_MIDDLE_MM, _VIEW_TOP_MM + frame.outer_height_mm * scale / 2

    def on_paper(x_mm: float, y_mm: float) -> Point:
        return centre[0] + x_mm * scale, centre[1] - y_mm * scale

    def around(width_mm: float, height_mm: float) -> tuple[float, float, float, float]:
        return *on_paper(-width_mm / 2, height_mm / 2), *on_paper(width_mm / 2, -height_mm / 2)

    rim = 2 * frame.rim_mm
    sensor = camera.sensor
    inner = around(frame.inner_width_mm, frame.inner_height_mm)
    outer = around(frame.outer_width_mm, frame.outer_height_mm)
    pixels = around(sensor.width_mm, sensor.height_mm)
    shapes: list[Shape] = [
        Area(tuple(on_paper(*corner) for corner in frame_corners(frame)), "frame", "frame"),
        _box(*around(frame.inner_width_mm + rim, frame.inner_height_mm + rim), "mould", "rim"),
        *_vents(frame, outer, inner, on_paper),
        _box(*inner, "resin", "inside"),
        _box(*around(frame.package_width_mm, frame.package_height_mm), "glass", "package"),
        _box(*pixels, "package", "pixels"),
    ]
    first = pixels[0], pixels[3]
    shapes.append(_box(first[0], first[1] - 1.6, first[0] + 1.6, first[1], "air", "pixel-0-0"))
    names = _names(camera, frame, outer, on_paper)
    shapes += names
    texts = [
        f"outside {millimetres(frame.outer_width_mm)}",
        f"inside {millimetres(frame.inner_width_mm)}",
    ]
    y = outer[3] + _ROW_MM + 1
    for ends, text in zip((inner, outer), reversed(texts), strict=True):
        shapes += _width_dimension(ends[0], ends[2], y, text, outer[3])
        y += _ROW_MM
    for number, (ends, height_mm) in enumerate(
        ((inner, frame.inner_height_mm), (outer, frame.outer_height_mm))
    ):
        shapes += _height_dimension(
            (ends[1], ends[3]), (millimetres(height_mm),), outer[0] - 4 - 12 * number, outer[0]
        )
    lowest = max(word.at[1] for word in names if isinstance(word, Word))
    y = max(y, lowest + _LINE_MM)
    shapes += _scale_bar(outer[0], y, scale)
    mark = " Its lower left corner, beside pixel (0, 0), is cut off." if frame.mark_mm > 0 else ""
    return Drawing(
        title=f"Frame and sensor seen from the scene, scale {scale_name(scale)}, measures in mm",
        description=(
            f"The frame is {millimetres(frame.outer_width_mm)} mm wide and "
            f"{millimetres(frame.outer_height_mm)} mm high around an opening of "
            f"{millimetres(frame.inner_width_mm)} by {millimetres(frame.inner_height_mm)} mm.{mark}"
        ),
        width_mm=_WIDTH_MM,
        height_mm=y + 3,
        scale=scale,
        shapes=tuple(shapes),
    )


def material_name(layer: Layer) -> str:
    """What a layer is made of, for people."""
    return layer.material or f"a material of index {layer.index:g}"


@dataclass(frozen=True)
class _Place:
    """Where everything lies on paper, in mm: ends along x, heights along y."""

    camera: Camera
    frame: FrameGeometry
    mould: MouldAmount
    scale: float
    outer: Point
    inner: Point
    package: Point
    pixels: Point
    top: float
    floor: float
    below: tuple[Layer, ...]

    @classmethod
    def of(cls, camera: Camera, frame: FrameGeometry, mould: MouldAmount) -> "_Place":
        scale = scale_for((frame.outer_width_mm, frame.height_mm), _SECTION_ROOM)
        top = _SECTION_TOP_MM + min(mould.thickness_mm * scale, _MOULD_MM)

        def ends(width_mm: float) -> Point:
            half = width_mm * scale / 2
            return _SECTION_MIDDLE_MM - half, _SECTION_MIDDLE_MM + half

        return cls(
            camera,
            frame,
            mould,
            scale,
            outer=ends(frame.outer_width_mm),
            inner=ends(frame.inner_width_mm),
            package=ends(frame.package_width_mm),
            pixels=ends(camera.sensor.width_mm),
            top=top,
            floor=top + frame.height_mm * scale,
            below=camera.layers[camera.mask.surface + 1 :],
        )

    @property
    def glass_top(self) -> float:
        return self.floor - self.frame.glass_top_mm * self.scale

    @property
    def levels(self) -> list[float]:
        """Tops of the layers that come with the sensor, and the pixels' plane."""
        y = [self.glass_top]
        for layer in self.below:
            y.append(y[-1] + layer.thickness.mm * self.scale)
        return y


def _parts(place: _Place) -> list[Shape]:
    frame, scale = place.frame, place.scale
    left, right = place.outer
    rim = frame.rim_mm * scale
    top, floor, inner = place.top, place.floor, place.inner
    ground = left - _OVERHANG_MM, right + _OVERHANG_MM
    resin = (
        (inner[0] - rim, top),
        (inner[1] + rim, top),
        (inner[1], top + rim),
        (inner[1], floor),
        (inner[0], floor),
        (inner[0], top + rim),
    )
    shapes: list[Shape] = [
        _box(ground[0], floor, ground[1], floor + _BOARD_MM, "board", "board"),
        Area(resin, "resin", "resin"),
        _box(*_corners(place.package, place.glass_top, floor), "package", "package"),
    ]
    for out, into, way in ((left, inner[0], -1), (right, inner[1], 1)):
        wall = ((out, top), (into + way * rim, top), (into, top + rim), (into, floor), (out, floor))
        shapes.append(Area(wall, "frame", "wall"))
    shapes.append(_mould(place))
    levels = place.levels
    for layer, upper, lower in zip(place.below, levels, levels[1:], strict=False):
        air = is_air(layer)
        ends = place.package if not air else _between(place.package, place.pixels)
        tone: Tone = "air" if air else "glass"
        shapes.append(_box(*_corners(ends, upper, lower), tone, tone))
    pixels = levels[-1]
    shapes.append(Line((place.pixels[0], pixels), (place.pixels[1], pixels), 0.8, part="pixels"))
    return shapes


def _mould(place: _Place) -> Area:
    """The mould; wavy where it goes on."""
    left, right = place.outer[0] - _OVERHANG_MM, place.outer[1] + _OVERHANG_MM
    high = place.mould.thickness_mm * place.scale
    if high <= _MOULD_MM:
        return _box(left, place.top - high, right, place.top, "mould", "mould")
    steps = 24
    width = (right - left) / steps
    broken = [
        (right - number * width, _SECTION_TOP_MM + (0.7 if number % 2 else -0.7))
        for number in range(steps + 1)
    ]
    return Area(((left, place.top), (right, place.top), *broken), "mould", "mould")


def _heights(place: _Place) -> list[Shape]:
    frame = place.frame
    right, left = place.outer[1] + 5, place.outer[0] - 4.5
    texts = [f"t′ {millimetres(frame.layer_mm)}"]
    texts += [millimetres(layer.thickness.mm) for layer in place.below]
    glass_top = (millimetres(frame.glass_top_mm),)
    whole = (millimetres(frame.height_mm),)
    return [
        *_height_dimension([place.top, *place.levels], texts, right, place.inner[1]),
        *_height_dimension((place.glass_top, place.floor), glass_top, left, place.package[0]),
        *_height_dimension((place.top, place.floor), whole, left - 11, place.outer[0]),
    ]


def _named(place: _Place) -> list[tuple[str, Point, str]]:
    """Letter, place and name of all parts, from left to right."""
    frame, levels = place.frame, place.levels
    poured = poured_layer(place.camera)
    named = [
        (
            (sum((place.outer[0], place.inner[0])) / 2, (place.top + place.floor) / 2),
            f"frame, wall {millimetres(frame.wall_mm)}, rim {millimetres(frame.rim_mm)} at 45°",
        ),
        (
            (_along(place.package, 0.06), (place.glass_top + place.floor) / 2 + _BOARD_MM / 2),
            "package of the sensor; its inside is a sketch",
        ),
        (
            (_along(place.pixels, 0.1), (place.top + place.glass_top) / 2),
            f"{poured.name or 'resin'}: {material_name(poured)}, "
            f"t′ = {millimetres(frame.layer_mm)}",
        ),
    ]
    for number, layer in enumerate(place.below):
        fraction = 0.3 + 0.3 * number / max(1, len(place.below) - 1)
        at = _along(place.pixels, fraction), (levels[number] + levels[number + 1]) / 2
        name = layer.name or material_name(layer)
        named.append((at, f"{name}, {millimetres(layer.thickness.mm)}"))
    named += [
        ((_along(place.pixels, 0.75), levels[-1]), "pixels"),
        (
            (_along(place.pixels, 0.92), (2 * place.top + _SECTION_TOP_MM) / 3),
            f"mould of PDMS, {place.mould.thickness_mm:.4g} thick and wider than the frame",
        ),
        ((place.outer[1] + _OVERHANG_MM / 2, place.floor + _BOARD_MM / 2), "board"),
    ]
    return [(chr(ord("A") + number), at, name) for number, (at, name) in enumerate(named)]


def _corners(ends: Point, top: float, bottom: float) -> tuple[float, float, float, float]:
    return ends[0], top, ends[1], bottom


def _between(wide: Point, narrow: Point) -> Point:
    return (wide[0] + narrow[0]) / 2, (wide[1] + narrow[1]) / 2


def _along(ends: Point, fraction: float) -> float:
    return ends[0] + fraction * (ends[1] - ends[0])


def _vents(
    frame: FrameGeometry,
    outer: tuple[float, float, float, float],
    inner: tuple[float, float, float, float],
    on_paper: Callable[[float, float], Point],
) -> list[Shape]:
    """The channels across the wall's top."""
    shapes: list[Shape] = []
    half = frame.vent_width_mm / 2
    for side, offsets in enumerate(frame.vent_offsets_mm()):
        for offset in offsets:
            left, top = on_paper(offset - half, offset + half)
            right, bottom = on_paper(offset + half, offset - half)
            ends = (
                (inner[2], top, outer[2], bottom),
                (outer[0], top, inner[0], bottom),
                (left, outer[1], right, inner[1]),
                (left, inner[3], right, outer[3]),
            )[side]
            shapes.append(_box(*ends, "air", "vent"))
    return shapes


def _names(
    camera: Camera,
    frame: FrameGeometry,
    outer: tuple[float, float, float, float],
    on_paper: Callable[[float, float], Point],
) -> list[Shape]:
    """What everything is, to the right of it; the mark at the left."""
    sensor = camera.sensor
    x, y = frame.inner_width_mm / 2, frame.inner_height_mm / 2
    package = f"{millimetres(frame.package_width_mm)} × {millimetres(frame.package_height_mm)}"
    named = [
        (
            on_paper(x + (frame.rim_mm + frame.wall_mm) / 2, 0.9 * y),
            f"wall {millimetres(frame.wall_mm)}: mould lies here",
        ),
        (
            on_paper(0.8 * x, 0.3 * (sensor.height_mm / 2 + frame.package_height_mm / 2)),
            f"package {package}",
        ),
        (
            on_paper(0.4 * sensor.width_mm, -0.2 * sensor.height_mm),
            f"pixels {millimetres(sensor.width_mm)} × {millimetres(sensor.height_mm)}",
        ),
    ]
    if frame.rim_mm > 0:
        at = on_paper(x + frame.rim_mm / 2, 0.6 * y)
        named.append((at, f"pouring rim {millimetres(frame.rim_mm)} at 45°"))
    if frame.vents:
        vent = f"{millimetres(frame.vent_width_mm)} wide, {millimetres(frame.vent_depth_mm)} deep"
        offset = frame.vent_offsets_mm()[0][0]
        named.append((on_paper(x + frame.wall_mm * 0.7, offset), f"vent {vent}"))
    named.sort(key=lambda each: each[0][1])
    left = outer[2] + 8
    shapes: list[Shape] = []
    places = spread([at[1] for at, _ in named], 1.6 * _LINE_MM)
    down = max(0.0, _LINE_MM / 2 - places[0])
    for (at, text), place in zip(named, places, strict=True):
        y_word = place + down
        shapes += [Line((left - 1, y_word), at), Word((left, y_word + _BASE_MM), text)]
    if frame.mark_mm > 0:
        corner = outer[0] + frame.mark_mm, outer[3] - frame.mark_mm
        y_word = outer[3] + _ROW_MM
        shapes += [
            Word((0, y_word), "mark, at"),
            Word((0, y_word + _LINE_MM), "pixel (0, 0)"),
            Line((15, y_word - _BASE_MM), corner),
        ]
    return shapes


def _box(left: float, top: float, right: float, bottom: float, tone: Tone, part: str = "") -> Area:
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


def _width_dimension(left: float, right: float, y: float, text: str, edge: float) -> list[Shape]:
    """Dimension line along x with its text above it, or beside it where it is too short.

    Thin lines go from it to the part's edge.
    """
    beyond = math.copysign(_TICK_MM, y - edge)
    shapes: list[Shape] = [Line((x, edge), (x, y + beyond)) for x in (left, right)]
    shapes += [Line((left, y), (right, y)), *_tick(left, y), *_tick(right, y)]
    if right - left > len(text) * _LETTER_MM:
        return [*shapes, Word(((left + right) / 2, y - 0.8), text, "middle")]
    return [*shapes, Word((right + 1.5, y + _BASE_MM), text)]


def _height_dimension(
    places: Sequence[float], texts: Sequence[str], x: float, edge: float
) -> list[Shape]:
    """Chain of dimension lines along y between rising places, each with its text.

    The texts are on the side away from the part; thin lines go to the part's edge.
    """
    way = math.copysign(1.0, x - edge)
    shapes: list[Shape] = [Line((edge, y), (x + way * _TICK_MM, y)) for y in places]
    shapes.append(Line((x, places[0]), (x, places[-1])))
    for y in places:
        shapes += _tick(x, y)
    middles = [sum(pair) / 2 for pair in pairwise(places)]
    anchor: Anchor = "start" if way > 0 else "end"
    for y, text in zip(spread(middles, _LINE_MM), texts, strict=True):
        shapes.append(Word((x + 1.8 * way, y + _BASE_MM), text, anchor))
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


def _scale_bar(left: float, y: float, scale: float) -> list[Shape]:
    """A bar of 10 mm on paper that shows whether a printer changed the scale."""
    right = left + _BAR_MM
    part_mm = _BAR_MM / scale
    shapes: list[Shape] = [Line((left, y), (right, y), 0.5, part="scale-bar")]
    shapes += [Line((x, y - 1.2), (x, y + 1.2), 0.3) for x in (left, right)]
    text = f"{_BAR_MM:g} mm on paper, {part_mm:g} mm of the part: scale {scale_name(scale)}"
    return [*shapes, Word((right + 2, y + _BASE_MM), text)]


def _pointers(named: Sequence[tuple[str, Point]], y: float) -> list[Shape]:
    """Words side by side at a height, in the order of what they name, and lines down to that."""
    dot = 0.45
    shapes: list[Shape] = []
    apart = spread([at[0] for _, at in named], 2 * WORD_MM)
    for x, (text, at) in zip(apart, named, strict=True):
        shapes += [
            Word((x, y), text, "middle", bold=True),
            Line((x, y + 0.8), at),
            _box(at[0] - dot, at[1] - dot, at[0] + dot, at[1] + dot, "sensor"),
        ]
    return shapes


def _key(texts: Sequence[str], y: float) -> list[Shape]:
    """Texts below each other in two columns, from some height on; long ones are cut."""
    rows = (len(texts) + 1) // 2
    most = int(_WIDTH_MM / 2 / _LETTER_MM)
    return [
        Word(
            (_WIDTH_MM / 2 * (number // rows), y + _LINE_MM * (number % rows + 1)),
            text if len(text) <= most else f"{text[: most - 1]}…",
        )
        for number, text in enumerate(texts)
    ]


def _tick(x: float, y: float) -> list[Shape]:
    half = _TICK_MM * 0.7
    return [Line((x - half, y + half), (x + half, y - half), 0.35)]


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)
