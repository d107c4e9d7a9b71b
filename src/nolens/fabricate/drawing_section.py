"""The drawing of a camera in its frame, cut through along the rows of its pixels."""

from dataclasses import dataclass

from nolens.camera import Camera, Layer
from nolens.fabricate.drawing import (
    LINE_MM,
    WIDTH_MM,
    Area,
    Drawing,
    Line,
    Point,
    Shape,
    Tone,
    box,
    height_dimension,
    key,
    millimetres,
    pointers,
    scale_bar,
    scale_for,
    scale_name,
    width_dimension,
)
from nolens.fabricate.frame import FrameGeometry
from nolens.fabricate.poured import poured_layer
from nolens.fabricate.resin import MouldAmount

_ROOM = 132.0, 60.0
_TOP_MM, _BOARD_MM = 8.0, 4.0
_MOULD_MM, _OVERHANG_MM = 12.0, 3.5
"""How much of the mould is drawn at most, upwards and beside the frame, in mm of paper."""
_ROW_MM = 5.0
_MIDDLE_MM = 93.5


def draw_section(camera: Camera, frame: FrameGeometry, mould: MouldAmount) -> Drawing:
    """Draw sensor, glass, gap, resin, frame and mould to scale.

    Parameters
    ----------
    camera
        Its layers below the resin lie in the package.
    frame
        The frame.
    mould
        The mould; what is large of it is cut off.

    Returns
    -------
    Drawing
        With measures, a key and a bar of 10 mm. The relief is too low to be drawn.

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
        shapes += width_dimension(*ends, y, f"{what} {millimetres(width_mm)}", floor)
        y += _ROW_MM
    named = _named(place)
    shapes += pointers([(letter, at) for letter, at, _ in named], _TOP_MM - 4)
    y -= 2
    shapes += key([f"{letter}  {name}" for letter, _, name in named], y)
    y += LINE_MM * ((len(named) + 1) // 2)
    shapes += scale_bar(place.outer[0], y + 3.5, place.scale)
    return Drawing(
        title=f"Section along the pixel rows, scale {scale_name(place.scale)}, measures in mm",
        description=(
            f"The sensor's package, {millimetres(frame.glass_top_mm)} mm high, stands in a frame "
            f"{millimetres(frame.outer_width_mm)} mm wide and {millimetres(frame.height_mm)} mm "
            "high. Over its glass the frame is filled with a layer of resin "
            f"{millimetres(frame.layer_mm)} mm thick, on which the mould lies."
        ),
        width_mm=WIDTH_MM,
        height_mm=y + 5.5,
        scale=place.scale,
        shapes=tuple(shapes),
    )


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
        scale = scale_for((frame.outer_width_mm, frame.height_mm), _ROOM)
        top = _TOP_MM + min(mould.thickness_mm * scale, _MOULD_MM)

        def ends(width_mm: float) -> Point:
            half = width_mm * scale / 2
            return _MIDDLE_MM - half, _MIDDLE_MM + half

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
        box(ground[0], floor, ground[1], floor + _BOARD_MM, "board", "board"),
        Area(resin, "resin", "resin"),
        box(*_corners(place.package, place.glass_top, floor), "package", "package"),
    ]
    for out, into, way in ((left, inner[0], -1), (right, inner[1], 1)):
        wall = ((out, top), (into + way * rim, top), (into, top + rim), (into, floor), (out, floor))
        shapes.append(Area(wall, "frame", "wall"))
    shapes.append(_mould(place))
    levels = place.levels
    for layer, upper, lower in zip(place.below, levels, levels[1:], strict=False):
        air = layer.material == "air" or layer.index == 1
        ends = place.package if not air else _between(place.package, place.pixels)
        tone: Tone = "air" if air else "glass"
        shapes.append(box(*_corners(ends, upper, lower), tone, tone))
    pixels = levels[-1]
    shapes.append(Line((place.pixels[0], pixels), (place.pixels[1], pixels), 0.8, part="pixels"))
    return shapes


def _mould(place: _Place) -> Area:
    """The mould; wavy where it goes on."""
    left, right = place.outer[0] - _OVERHANG_MM, place.outer[1] + _OVERHANG_MM
    high = place.mould.thickness_mm * place.scale
    if high <= _MOULD_MM:
        return box(left, place.top - high, right, place.top, "mould", "mould")
    steps = 24
    width = (right - left) / steps
    broken = [
        (right - number * width, _TOP_MM + (0.7 if number % 2 else -0.7))
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
        *height_dimension([place.top, *place.levels], texts, right, place.inner[1]),
        *height_dimension((place.glass_top, place.floor), glass_top, left, place.package[0]),
        *height_dimension((place.top, place.floor), whole, left - 11, place.outer[0]),
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
        share = 0.3 + 0.3 * number / max(1, len(place.below) - 1)
        at = _along(place.pixels, share), (levels[number] + levels[number + 1]) / 2
        name = layer.name or material_name(layer)
        named.append((at, f"{name}, {millimetres(layer.thickness.mm)}"))
    named += [
        ((_along(place.pixels, 0.75), levels[-1]), "pixels"),
        (
            (_along(place.pixels, 0.92), (2 * place.top + _TOP_MM) / 3),
            f"mould of PDMS, {place.mould.thickness_mm:.4g} thick and wider than the frame",
        ),
        ((place.outer[1] + _OVERHANG_MM / 2, place.floor + _BOARD_MM / 2), "board"),
    ]
    return [(chr(ord("A") + number), at, name) for number, (at, name) in enumerate(named)]


def material_name(layer: Layer) -> str:
    """What a layer is made of, for people."""
    return layer.material or f"a material of index {layer.index:g}"


def _corners(ends: Point, top: float, bottom: float) -> tuple[float, float, float, float]:
    return ends[0], top, ends[1], bottom


def _between(wide: Point, narrow: Point) -> Point:
    return (wide[0] + narrow[0]) / 2, (wide[1] + narrow[1]) / 2


def _along(ends: Point, share: float) -> float:
    return ends[0] + share * (ends[1] - ends[0])
