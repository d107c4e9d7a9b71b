"""Master, mould and replica, the part and the points that are kept, and the TIFF of heights."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from workpieces import lopsided, smooth, surface

from nolens.errors import OptionError
from nolens.fabricate import MadeSurface
from nolens.files.workshop import check_height_map, write_height_map
from nolens.optics import Relief


def test_which_surface() -> None:
    relief = lopsided()
    h = relief.height_um
    assert torch.equal(surface(relief, "replica").height_um, h)
    assert torch.equal(surface(relief, "master").height_um, h)
    mould = surface(relief, "mould").height_um
    for row in range(7):
        for column in range(11):
            assert mould[row, column] == -h[row, 10 - column]


def test_mould_fits_onto_the_replica() -> None:
    """Turned over about the y axis, it touches the replica everywhere."""
    relief = lopsided()
    mould = surface(relief, "mould")
    x = (np.arange(11) - 5) * mould.pitch_um
    points = {}
    for row in range(7):
        for column in range(11):
            points[row, round(-x[column], 6)] = -float(mould.height_um[row, column])
    for row in range(7):
        for column in range(11):
            assert points[row, round(x[column], 6)] == float(relief.height_um[row, column])


def test_master_is_larger_by_what_the_mould_shrinks() -> None:
    relief = lopsided()
    master = surface(relief, "master", mould_shrinkage=0.02)
    assert master.pitch_um * 0.98 == pytest.approx(2.0)
    assert torch.allclose(master.height_um * 0.98, relief.height_um)
    for name in ("mould", "replica"):
        other = surface(relief, name, mould_shrinkage=0.02)
        assert other.pitch_um == 2.0
    for share in (-0.01, 0.5, math.nan):
        with pytest.raises(OptionError, match="--mould-shrinkage"):
            surface(relief, "master", mould_shrinkage=share)


@pytest.mark.parametrize(
    ("crop", "rows", "columns"),
    [((0.020, 0.012), (0, 7), (0, 11)), ((0.009, 0.005), (2, 5), (3, 8)),
     ((0.0061, 0.0041), (2, 5), (4, 7))],
)  # fmt: skip
def test_crop_is_the_middle(
    crop: tuple[float, float], rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    relief = lopsided()
    kept = surface(relief, crop_mm=crop)
    assert torch.equal(kept.height_um, relief.height_um[slice(*rows), slice(*columns)])
    assert kept.size_mm[0] <= crop[0] + 1e-9 and kept.size_mm[1] <= crop[1] + 1e-9


@pytest.mark.parametrize(
    ("crop", "words"),
    [((0.0201, 0.012), "0.02 × 0.012 mm"), ((0.02, 0.0121), "--crop"), ((0.0, 0.01), "--crop"),
     ((0.001, 0.01), "fewer than 2×2")],
)  # fmt: skip
def test_crops_that_are_no_part(crop: tuple[float, float], words: str) -> None:
    with pytest.raises(OptionError, match=words):
        surface(lopsided(), crop_mm=crop)


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.floats(1.5, 9), st.integers(40, 90), st.integers(40, 90))
def test_errors_of_coarser_points(seed: int, pitch: float, rows: int, columns: int) -> None:
    """Against bilinear interpolation point by point."""
    fine = surface(smooth(rows, columns, seed))
    coarse = fine.coarser(pitch)
    if coarse is fine:
        return
    kept, meant = coarse.height_um.double().numpy(), fine.height_um.double().numpy()
    assert coarse.size_mm[0] <= fine.size_mm[0] + 1e-9
    misses = []
    for row in range(rows):
        for column in range(columns):
            y = (row - (rows - 1) / 2) * 1.5 / pitch + (kept.shape[0] - 1) / 2
            x = (column - (columns - 1) / 2) * 1.5 / pitch + (kept.shape[1] - 1) / 2
            if not (0 <= y <= kept.shape[0] - 1 and 0 <= x <= kept.shape[1] - 1):
                continue
            i, j = min(int(y), kept.shape[0] - 2), min(int(x), kept.shape[1] - 2)
            v, u = y - i, x - j
            made = (1 - v) * ((1 - u) * kept[i, j] + u * kept[i, j + 1])
            made += v * ((1 - u) * kept[i + 1, j] + u * kept[i + 1, j + 1])
            misses.append(made - meant[row, column])
    assert coarse.largest_error_um == pytest.approx(np.abs(misses).max(), rel=0.02, abs=1e-5)
    assert coarse.rms_error_um == pytest.approx(np.sqrt(np.mean(np.square(misses))), rel=0.02,
                                                abs=1e-5)  # fmt: skip


def test_pitches_that_cannot_be() -> None:
    fine = surface(lopsided())
    with pytest.raises(OptionError, match=r"finer than the relief's 2 µm.*--pitch"):
        fine.coarser(1.9)
    with pytest.raises(OptionError, match="fewer than 2×2"):
        fine.coarser(13.0)
    assert fine.coarser(2.0) is fine


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.sampled_from(["master", "mould", "replica"]),
       st.floats(0.05, 40))  # fmt: skip
def test_heights_read_back_by_another_reader(
    tmp_path_factory: pytest.TempPathFactory, seed: int, name: str, pitch: float
) -> None:
    path = tmp_path_factory.mktemp("tif") / "mask.tif"
    made = surface(smooth(20, 30, seed, grid_um=pitch), name)
    write_height_map(path, made)
    with Image.open(path) as image:
        assert image.mode == "I;16" and image.size == (30, 20)
        tags = image.tag_v2
        assert tags[296] == 3
        for axis in (282, 283):
            assert float(tags[axis]) == pytest.approx(1e4 / pitch, rel=1e-6)
        note = json.loads(tags[270])
        counts = np.asarray(image).astype(np.float64)
    assert note["surface"] == name and note["about"].startswith(name.upper())
    assert note["pitch_um"] == made.pitch_um and note["camera"] == "test"
    assert counts.min() == 0 and counts.max() == 65535
    heights = (note["um_at_zero"] + note["um_per_count"] * counts)[::-1]
    quantum = note["um_per_count"]
    assert np.abs(heights - made.height_um.numpy()).max() <= 0.51 * quantum + 1e-7
    assert note["size_mm"] == pytest.approx([29 * pitch * 1e-3, 19 * pitch * 1e-3])


def test_first_row_of_the_file_is_the_top(tmp_path: Path) -> None:
    """Looking onto the surface, rows go upwards and columns to the right: the corner at the last
    row and first column is the picture's upper left one."""
    heights = torch.zeros(5, 6)
    heights[4, 0], heights[0, 1] = 2.0, 1.0
    write_height_map(tmp_path / "mask.tif", surface(Relief(heights, 1.0)))
    with Image.open(tmp_path / "mask.tif") as image:
        counts = np.asarray(image)
    assert counts[0, 0] == 65535 and counts[4, 1] in (32767, 32768)
    assert (counts > 0).sum() == 2


def test_same_surface_same_file(tmp_path: Path) -> None:
    for name in ("a.tif", "b.tif"):
        write_height_map(tmp_path / name, surface(lopsided()))
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_level_surface(tmp_path: Path) -> None:
    write_height_map(tmp_path / "mask.tif", surface(Relief(torch.full((4, 5), 3.0), 1.0)))
    with Image.open(tmp_path / "mask.tif") as image:
        note = json.loads(image.tag_v2[270])
        assert not np.asarray(image).any() and note["um_at_zero"] == 3


def test_heights_too_many_for_a_tiff() -> None:
    vast = MadeSurface("master", "test", torch.zeros(1).expand(60_000, 50_000), 2.0)
    with pytest.raises(OptionError, match=r"6.0 GB.*--pitch of 2.45um"):
        check_height_map(vast)
    check_height_map(MadeSurface("master", "test", torch.zeros(1).expand(40_000, 50_000), 2.0))
