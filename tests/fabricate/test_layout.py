"""Levels as GDSII and OASIS, read back by KLayout's reader."""

import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import gdstk
import klayout.db as kdb
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from workpieces import lopsided, smooth, surface

from nolens.errors import OptionError
from nolens.fabricate import Levels, MadeSurface
from nolens.files.workshop import layout, write_gds, write_oasis
from nolens.optics import Relief

WRITERS: dict[str, Callable[..., None]] = {".gds": write_gds, ".oas": write_oasis}


def written(path: Path, made: MadeSurface, count: int) -> kdb.Layout:
    steps = Levels(made, count)
    WRITERS[path.suffix](path, layout(steps, steps.polygons()))
    found = kdb.Layout()
    found.read(str(path))
    return found


def polygons(found: kdb.Layout, level: int) -> list[kdb.Polygon]:
    index = found.find_layer(level, 0)
    if index is None:
        return []
    return [shape.polygon for shape in found.top_cell().shapes(index).each()]


def heights_of(found: kdb.Layout, made: MadeSurface, count: int) -> np.ndarray[Any, Any]:
    """How many levels above the lowest cover each point."""
    rows, columns = made.height_um.shape
    covered = np.zeros((rows, columns), int)
    nm = found.dbu * 1e-3 / 1e-6
    assert nm == pytest.approx(1)
    for level in range(1, count):
        regions = polygons(found, level)
        for row in range(rows):
            for column in range(columns):
                x = (column - (columns - 1) / 2) * made.pitch_um * 1e3
                y = (row - (rows - 1) / 2) * made.pitch_um * 1e3
                point = kdb.Point(round(x), round(y))
                covered[row, column] += any(region.inside(point) for region in regions)
    return covered


@pytest.mark.parametrize("suffix", [".gds", ".oas"])
@given(st.integers(0, 10**6), st.sampled_from([2, 3, 8, 16]), st.sampled_from(["master", "mould"]))
@settings(max_examples=8)
def test_heights_read_back_to_half_a_step(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, seed: int, count: int, name: str
) -> None:
    made = surface(smooth(24, 31, seed), name)
    path = tmp_path_factory.mktemp("layout") / f"mask{suffix}"
    found = written(path, made, count)
    steps = heights_of(found, made, count)
    low, high = made.range_um
    step = (high - low) / (count - 1)
    back = low + steps * step
    # On an edge, rounded to 1 nm, a point may belong to either side.
    assert np.abs(back - made.height_um.numpy()).max() <= 0.5 * step * 1.01 + 1e-4


def test_tiles_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Traced in small tiles, the levels cover the same area as traced in one."""
    made = surface(smooth(60, 70, 3))
    areas = []
    for tile in (500, 13):
        monkeypatch.setattr("nolens.fabricate.surface._TILE", tile)
        found = Levels(made, 6).polygons()
        areas.append([sum(each.area() for each in level) for level in found])
        union = [gdstk.boolean(level, [], "or") for level in found]
        merged = [sum(each.area() for each in level) for level in union]
        assert merged == pytest.approx(areas[-1], rel=1e-4)  # No two overlap.
    assert areas[0] == pytest.approx(areas[1], rel=1e-4)


def test_tiles_that_cannot_be_traced_are_halved(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = Levels(surface(smooth(40, 57, 3)), 6)
    whole = steps.polygons()
    trace, sizes = gdstk.contour, []

    def picky(tile: np.ndarray[Any, Any], *given: Any, **more: Any) -> Any:
        sizes.append(tile.shape)
        if max(tile.shape) > 9:
            warnings.warn("Error in boolean operation.", RuntimeWarning, stacklevel=1)
        return trace(tile, *given, **more)

    monkeypatch.setattr(gdstk, "contour", picky)
    for one, halved in zip(whole, steps.polygons(), strict=True):
        beside = gdstk.boolean(one, halved, "xor")
        assert sum(each.area() for each in beside) < 1e-3 * sum(each.area() for each in one)
        assert sum(each.area() for each in halved) == pytest.approx(
            sum(each.area() for each in one), rel=1e-6
        )
    assert min(map(max, sizes)) <= 9


def test_levels_lie_within_each_other() -> None:
    found = Levels(surface(smooth(40, 40, 5)), 8).polygons()
    for lower, upper in pairwise(found):
        beyond = sum(each.area() for each in gdstk.boolean(upper, lower, "not"))
        assert beyond <= 1e-3 * sum(each.area() for each in upper)


def test_area_of_a_slope(tmp_path: Path) -> None:
    """Of a plane from 0 to 9 um in 4 levels, a third is a terrace of 3 and of 6 um each."""
    plane = surface(Relief(torch.arange(10.0).expand(5, 10).contiguous(), 2.0))
    found = written(tmp_path / "mask.gds", plane, 4)
    widths = [18.0, 18 - 3.0, 18 - 9.0, 18 - 15.0]
    for level, width in enumerate(widths):
        area = sum(each.area() for each in polygons(found, level)) * 1e-6
        assert area == pytest.approx(width * 8, rel=1e-3)
    box = found.top_cell().dbbox_per_layer(found.find_layer(3, 0))
    assert (box.left, box.right) == pytest.approx((6.0, 9.0), abs=2e-3)


@pytest.mark.parametrize("suffix", [".gds", ".oas"])
@pytest.mark.parametrize("name", ["master", "mould", "replica"])
def test_files_say_which_surface_and_how_high(name: str, suffix: str, tmp_path: Path) -> None:
    made = surface(lopsided(), name)
    found = written(tmp_path / f"mask{suffix}", made, 5)
    assert found.top_cell().name == f"{name}_test"
    shapes = found.top_cell().shapes(found.find_layer(255, 0))
    texts = [shape.text.string for shape in shapes.each() if shape.is_text()]
    assert len(texts) == 6 and len([text for text in texts if name.upper() in text]) == 1
    low, high = made.range_um
    for level in range(5):
        line = next(text for text in texts if text.startswith(f"layer {level}:"))
        stated = float(line.split(":")[1].split("um")[0])
        assert stated == pytest.approx(low + level * (high - low) / 4, rel=1e-5)


def test_names_of_any_camera(tmp_path: Path) -> None:
    heights = lopsided().height_um
    made = MadeSurface("mould", "Ünser «Gerät» no. 1 of a very long name", heights, 2.0)
    found = written(tmp_path / "mask.gds", made, 3)
    name = found.top_cell().name
    assert name.startswith("mould_") and len(name) <= 32
    assert all(each.isascii() and (each.isalnum() or each == "_") for each in name)


def test_same_levels_same_file(tmp_path: Path) -> None:
    for suffix in (".gds", ".oas"):
        for name in ("a", "b"):
            written(tmp_path / f"{name}{suffix}", surface(lopsided()), 4)
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_level_surface_has_one_layer(tmp_path: Path) -> None:
    flat = surface(Relief(torch.ones(5, 6), 2.0))
    found = written(tmp_path / "mask.gds", flat, 4)
    assert [len(polygons(found, level)) for level in range(4)] == [1, 0, 0, 0]


def test_many_vertices_fit_the_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A comb of so many teeth that its outline has more vertices than GDSII allows."""
    monkeypatch.setattr("nolens.fabricate.surface._TILE", 10_000)
    comb = torch.zeros(6, 5001)
    comb[0], comb[:, ::2] = 1.0, 1.0
    made = surface(Relief(comb, 1.0))
    traced = Levels(made, 2).polygons()[0]
    assert max(len(each.points) for each in traced) > 8190
    found = polygons(written(tmp_path / "mask.gds", made, 2), 1)
    assert max(each.num_points() for each in found) <= 8190
    area = sum(each.area() for each in traced)
    assert sum(each.area() for each in found) * 1e-6 == pytest.approx(area, rel=1e-4)


def test_size_is_foretold(tmp_path: Path) -> None:
    steps = Levels(surface(smooth(300, 300, 7)), 16)
    traced = steps.polygons()
    vertices = sum(len(each.points) for level in traced for each in level)
    assert steps.vertices == pytest.approx(vertices, rel=0.1)
    for suffix, kind in ((".gds", "GDS"), (".oas", "OASIS")):
        path = tmp_path / f"mask{suffix}"
        WRITERS[suffix](path, layout(steps, traced))
        assert steps.expected_bytes(kind) == pytest.approx(path.stat().st_size, rel=0.5)


def test_layouts_that_are_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    made = surface(smooth(100, 100, 1))
    steps = Levels(made, 16)
    steps.check_size()
    monkeypatch.setattr("nolens.fabricate.surface._MOST_BYTES", 0.25 * steps.expected_bytes("GDS"))
    with pytest.raises(OptionError, match=r"levels would fit.*--crop.*--pitch") as refused:
        steps.check_size()
    fitting = int(str(refused.value).split(" levels would fit")[0].split()[-1])
    Levels(made, fitting).check_size()
    with pytest.raises(OptionError, match="larger than GDSII holds"):
        Levels(MadeSurface("master", "test", torch.zeros(2, 2), 2e6), 4)


@pytest.mark.parametrize("count", [-1, 0, 1, 251])
def test_numbers_of_levels(count: int) -> None:
    with pytest.raises(OptionError, match="give 2 to 250"):
        Levels(surface(lopsided()), count)
