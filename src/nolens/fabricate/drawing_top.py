"""The drawing of a frame around its sensor, seen from the scene."""

from collections.abc import Callable

from nolens.camera import Camera
from nolens.fabricate.drawing import (
    BASE_MM,
    LINE_MM,
    WIDTH_MM,
    Area,
    Drawing,
    Line,
    Point,
    Shape,
    Word,
    box,
    height_dimension,
    millimetres,
    scale_bar,
    scale_for,
    scale_name,
    spread,
    width_dimension,
)
from nolens.fabricate.frame import FrameGeometry
from nolens.fabricate.solid import outline

_ROOM = 100.0, 70.0
_MIDDLE_MM, _TOP_MM, _ROW_MM = 79.0, 1.0, 5.0


def draw_top(camera: Camera, frame: FrameGeometry) -> Drawing:
    """Draw the frame's top with its rim, vents and mark, and the sensor in it, to scale.

    Parameters
    ----------
    camera
        Its sensor's pixels lie in the middle of the package.
    frame
        The frame.

    Returns
    -------
    Drawing
        With measures, names and a bar of 10 mm; the rows of pixels run to the right, from row to
        row upwards.

    Raises
    ------
    OptionError
        If the frame is too large for the sheet.
    """
    scale = scale_for((frame.outer_width_mm, frame.outer_height_mm), _ROOM)
    centre = _MIDDLE_MM, _TOP_MM + frame.outer_height_mm * scale / 2

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
        Area(tuple(on_paper(*corner) for corner in outline(frame)), "frame", "frame"),
        box(*around(frame.inner_width_mm + rim, frame.inner_height_mm + rim), "mould", "rim"),
        *_vents(frame, outer, inner, on_paper),
        box(*inner, "resin", "inside"),
        box(*around(frame.package_width_mm, frame.package_height_mm), "glass", "package"),
        box(*pixels, "package", "pixels"),
    ]
    first = pixels[0], pixels[3]
    shapes.append(box(first[0], first[1] - 1.6, first[0] + 1.6, first[1], "air", "pixel-0-0"))
    names = _names(camera, frame, outer, on_paper)
    shapes += names
    texts = [
        f"outside {millimetres(frame.outer_width_mm)}",
        f"inside {millimetres(frame.inner_width_mm)}",
    ]
    y = outer[3] + _ROW_MM + 1
    for ends, text in zip((inner, outer), reversed(texts), strict=True):
        shapes += width_dimension(ends[0], ends[2], y, text, outer[3])
        y += _ROW_MM
    for number, (ends, height_mm) in enumerate(
        ((inner, frame.inner_height_mm), (outer, frame.outer_height_mm))
    ):
        shapes += height_dimension(
            (ends[1], ends[3]), (millimetres(height_mm),), outer[0] - 4 - 12 * number, outer[0]
        )
    lowest = max(word.at[1] for word in names if isinstance(word, Word))
    y = max(y, lowest + LINE_MM)
    shapes += scale_bar(outer[0], y, scale)
    mark = " Its lower left corner, beside pixel (0, 0), is cut off." if frame.mark_mm > 0 else ""
    return Drawing(
        title=f"Frame and sensor seen from the scene, scale {scale_name(scale)}, measures in mm",
        description=(
            f"The frame is {millimetres(frame.outer_width_mm)} mm wide and "
            f"{millimetres(frame.outer_height_mm)} mm high around an opening of "
            f"{millimetres(frame.inner_width_mm)} by {millimetres(frame.inner_height_mm)} mm.{mark}"
        ),
        width_mm=WIDTH_MM,
        height_mm=y + 3,
        scale=scale,
        shapes=tuple(shapes),
    )


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
            shapes.append(box(*ends, "air", "vent"))
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
    places = spread([at[1] for at, _ in named], 1.6 * LINE_MM)
    down = max(0.0, LINE_MM / 2 - places[0])
    for (at, text), place in zip(named, places, strict=True):
        y_word = place + down
        shapes += [Line((left - 1, y_word), at), Word((left, y_word + BASE_MM), text)]
    if frame.mark_mm > 0:
        corner = outer[0] + frame.mark_mm, outer[3] - frame.mark_mm
        y_word = outer[3] + _ROW_MM
        shapes += [
            Word((0, y_word), "mark, at"),
            Word((0, y_word + LINE_MM), "pixel (0, 0)"),
            Line((15, y_word - BASE_MM), corner),
        ]
    return shapes
