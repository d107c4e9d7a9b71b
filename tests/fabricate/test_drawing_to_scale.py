"""Drawings keep their scale, and their words stay on the paper, for frames of any size."""

import itertools

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from reportlab.pdfbase.pdfmetrics import stringWidth
from sheets import camera_of

from nolens.camera import preset
from nolens.errors import OptionError
from nolens.fabricate import FrameGeometry, MouldAmount
from nolens.fabricate.sheet_drawings import draw_section, draw_top, scale_for, scale_name, spread
from nolens.fabricate.sheet_parts import Area, Drawing, Line, Word, millimetres
from nolens.files.pdf import BOLD, REGULAR, register_fonts


def sizes(least: float, most: float) -> st.SearchStrategy[float]:
    """Lengths as people give them, to a micrometre."""
    return st.integers(round(1000 * least), round(1000 * most)).map(lambda each: each / 1000)


@st.composite
def frames(draw):
    """Frames that can be made, around packages from the paper's size to far larger ones."""
    wall, layer = draw(sizes(0.5, 3)), draw(sizes(0.2, 5))
    try:
        return FrameGeometry(
            package_width_mm=draw(sizes(8, 90)),
            package_height_mm=draw(sizes(6, 55)),
            glass_top_mm=draw(sizes(0.9, 8)),
            layer_mm=layer,
            clearance_mm=draw(sizes(0, 0.5)),
            wall_mm=wall,
            rim_mm=draw(sizes(0, 0.6)) * min(wall, layer),
            vent_width_mm=0.8,
            vent_depth_mm=layer / 3,
            vents=draw(st.integers(0, 9)),
            mark_mm=draw(sizes(0, 0.7)) * wall,
        )
    except OptionError:
        assume(False)


def extent(drawing: Drawing, part: str) -> tuple[float, float]:
    """Width and height of all shapes of a part together, in mm of the part."""
    points = []
    for shape in drawing.shapes:
        if isinstance(shape, Area) and shape.part == part:
            points += shape.points
        if isinstance(shape, Line) and shape.part == part:
            points += [shape.start, shape.end]
    x, y = zip(*points, strict=True)
    return (max(x) - min(x)) / drawing.scale, (max(y) - min(y)) / drawing.scale


def boxes(drawing: Drawing) -> list[tuple[str, float, float, float, float]]:
    """Text, left, top, right and bottom of all words, as DejaVu Sans writes them."""
    register_fonts()
    found = []
    for word in drawing.shapes:
        if isinstance(word, Word):
            width = stringWidth(word.text, BOLD if word.bold else REGULAR, word.size_mm)
            left = word.at[0] - width * {"start": 0, "middle": 0.5, "end": 1}[word.anchor]
            top = word.at[1] - 0.75 * word.size_mm
            found.append((word.text, left, top, left + width, word.at[1] + 0.1 * word.size_mm))
    return found


@settings(max_examples=40)
@given(frame=frames(), mould_mm=st.floats(0.5, 20))
def test_section_is_to_scale(frame, mould_mm):
    camera = camera_of(thickness_mm=frame.layer_mm)
    drawing = draw_section(camera, frame, MouldAmount.of(frame, thickness_mm=mould_mm))
    assert extent(drawing, "wall") == pytest.approx((frame.outer_width_mm, frame.height_mm))
    assert extent(drawing, "package") == pytest.approx((frame.package_width_mm, frame.glass_top_mm))
    rim = 2 * frame.rim_mm
    assert extent(drawing, "resin") == pytest.approx((frame.inner_width_mm + rim, frame.height_mm))
    assert extent(drawing, "glass") == pytest.approx((frame.package_width_mm, 0.49))
    assert extent(drawing, "air")[1] == pytest.approx(0.235)
    assert extent(drawing, "pixels") == pytest.approx((4056 * 1.55e-3, 0))
    heights = {
        part: {y for shape in drawing.shapes if getattr(shape, "part", "") == part
               for _, y in shape.points}
        for part in ("resin", "glass", "wall", "mould")
    }  # fmt: skip
    top = min(heights["wall"])
    assert min(heights["glass"]) - top == pytest.approx(frame.layer_mm * drawing.scale)
    assert max(heights["mould"]) == top
    drawn = top - min(heights["mould"])
    if mould_mm * drawing.scale <= 12:
        assert drawn == pytest.approx(mould_mm * drawing.scale)
    else:
        assert drawn == pytest.approx(12.7)  # cut off in a wavy line


@settings(max_examples=40)
@given(frame=frames())
def test_top_view_is_to_scale(frame):
    drawing = draw_top(preset("paper"), frame)
    outer = frame.outer_width_mm, frame.outer_height_mm
    assert extent(drawing, "frame") == pytest.approx(outer)
    inner = frame.inner_width_mm, frame.inner_height_mm
    assert extent(drawing, "inside") == pytest.approx(inner)
    assert extent(drawing, "pixels") == pytest.approx((4056 * 1.55e-3, 3040 * 1.55e-3))
    assert extent(drawing, "package") == pytest.approx(
        (frame.package_width_mm, frame.package_height_mm)
    )
    vents = [each for each in drawing.shapes if getattr(each, "part", "") == "vent"]
    assert len(vents) == frame.vents
    for vent in vents:
        x, y = zip(*vent.points, strict=True)
        sides = sorted(((max(x) - min(x)) / drawing.scale, (max(y) - min(y)) / drawing.scale))
        expected = sorted((frame.vent_width_mm, frame.wall_mm))
        assert sides == pytest.approx(expected)


@settings(max_examples=40)
@given(frame=frames())
def test_the_mark_is_at_the_first_pixel(frame):
    """Seen from the scene it is the lower left corner: y runs down on paper."""
    drawing = draw_top(preset("paper"), frame)
    shapes = {shape.part: shape for shape in drawing.shapes if isinstance(shape, Area)}
    x, y = zip(*shapes["frame"].points, strict=True)
    assert ((min(x), max(y)) in shapes["frame"].points) == (frame.mark_mm == 0)
    assert (max(x), max(y)) in shapes["frame"].points
    pixels, first = (shapes[part].points for part in ("pixels", "pixel-0-0"))
    assert min(px for px, _ in pixels) == min(px for px, _ in first)
    assert max(py for _, py in pixels) == max(py for _, py in first)


@settings(max_examples=40)
@given(frame=frames(), name=st.text("Wm ", min_size=1, max_size=200))
def test_words_stay_on_the_paper_and_apart(frame, name):
    camera = camera_of(thickness_mm=frame.layer_mm)
    resin, *others = camera.layers
    layers = (resin.model_copy(update={"name": name}), *others)
    camera = camera.model_copy(update={"layers": layers})
    for drawing in (
        draw_section(camera, frame, MouldAmount.of(frame)), draw_top(camera, frame)
    ):  # fmt: skip
        words = boxes(drawing)
        for text, left, top, right, bottom in words:
            inside = left >= 0 and top >= 0 and right <= drawing.width_mm
            assert inside and bottom <= drawing.height_mm, (text, left, top, right, bottom)
        for one, other in itertools.combinations(words, 2):
            beside = one[3] <= other[1] or other[3] <= one[1]
            assert beside or one[4] <= other[2] or other[4] <= one[2], (one, other)


@pytest.mark.parametrize("make", [draw_section, draw_top])
def test_the_bar_is_10_mm_on_paper(make):
    camera = preset("paper")
    frame = FrameGeometry.of(camera)
    more = (MouldAmount.of(frame),) if make is draw_section else ()
    drawing = make(camera, frame, *more)
    assert extent(drawing, "scale-bar")[0] * drawing.scale == pytest.approx(10)
    assert f"scale {scale_name(drawing.scale)}" in drawing.title
    of_part = 10 / drawing.scale
    text = f"10 mm on paper, {of_part:g} mm of the part: scale {scale_name(drawing.scale)}"
    assert text in [word[0] for word in boxes(drawing)]


def test_the_papers_camera_is_drawn_at_10_and_5_to_1():
    camera = preset("paper")
    frame = FrameGeometry.of(camera)
    assert draw_section(camera, frame, MouldAmount.of(frame)).scale == 10
    assert draw_top(camera, frame).scale == 5


@pytest.mark.parametrize(
    ("size", "scale", "name"),
    [((13, 3), 10, "10:1"), ((13.3, 3), 5, "5:1"), ((1, 7), 5, "5:1"), ((200, 1), 0.5, "1:2")],
)
def test_scale_is_the_largest_usual_one_that_fits(size, scale, name):
    found = scale_for(size, (132, 60))
    assert found == scale
    assert scale_name(found) == name


def test_too_large_a_part_is_refused():
    with pytest.raises(OptionError, match="holds parts up to 1320 × 600 mm"):
        scale_for((1400, 2), (132, 60))


@pytest.mark.parametrize(
    ("length", "text"), [(1.06, "1.06"), (0.235, "0.235"), (3, "3.00"), (6.2868, "6.287")]
)
def test_lengths_on_drawings(length, text):
    assert millimetres(length) == text


@given(
    places=st.lists(st.floats(-50, 50), min_size=1, max_size=8).map(sorted),
    spacing=st.floats(0.1, 10),
)
def test_spread_keeps_order_distance_and_mean(places, spacing):
    moved = spread(places, spacing)
    assert all(b - a >= spacing - 1e-9 for a, b in itertools.pairwise(moved))
    assert sum(moved) == pytest.approx(sum(places), abs=1e-6)
    if all(b - a >= spacing for a, b in itertools.pairwise(places)):
        assert moved == pytest.approx(places, abs=1e-9)
