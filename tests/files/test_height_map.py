"""Height maps of microscopes, in every format that is read."""

import numpy as np
import pytest
import tifffile
import torch
from height_maps import (
    write_gwyddion,
    write_imagej,
    write_points,
    write_sdf,
    write_table,
    write_tagged,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from nolens.camera import ReliefFile, preset
from nolens.errors import DataError, FileError, NolensError, OptionError
from nolens.fabricate.surface import made_surface
from nolens.files import read_height_map, write_camera
from nolens.files.workshop import write_height_map
from nolens.optics import Relief
from nolens.quantities import Length

PITCH = (0.8, 0.5)


def surface(rows=24, columns=31):
    y, x = np.mgrid[:rows, :columns]
    return 2 * np.sin(x / 5) + np.cos(y / 3) + 0.03 * x


def with_gaps():
    heights = surface()
    heights[[3, 10, 10], [4, 20, 21]] = np.nan
    return heights


def nm(heights):
    return np.rint(heights * 1e3).astype(np.int32)


CASES = {
    "float.tif": (lambda p, h: write_tagged(p, h.astype(np.float32), PITCH), {"unit": "um"}, 1e-6),
    "double.tif": (lambda p, h: write_tagged(p, h * 1e-6, PITCH), {"unit": "m"}, 1e-12),
    "imagej.tif": (lambda p, h: write_imagej(p, h.astype(np.float32), PITCH), {"unit": "um"}, 1e-6),
    "table.csv": (lambda p, h: write_table(p, h, ","), {"unit": "um"}, 1e-5),
    "closed.csv": (lambda p, h: write_table(p, h, ",", ending=","), {"unit": "um"}, 1e-5),
    "blanks.txt": (lambda p, h: write_table(p, h * 1e3, "  ", bad="NaN"), {"unit": "nm"}, 1e-5),
    "german.txt": (lambda p, h: write_table(p, h, "\t", decimal=",", bad=""), {"unit": "um"}, 1e-5),
    "points.xyz": (lambda p, h: write_points(p, h, PITCH), {"unit": "um"}, 1e-5),
    "matrix.txt": (lambda p, h: write_gwyddion(p, h, PITCH), {}, 1e-6),
    "profiles.sdf": (lambda p, h: write_sdf(p, h, PITCH), {}, 1e-4),
}


@pytest.mark.parametrize("name", CASES)
def test_heights_pitch_and_gaps_come_back(name, tmp_path):
    write, told, off = CASES[name]
    heights = with_gaps()
    found = read_height_map(
        write(tmp_path / name, heights),
        **told, **({"pitch": Length.parse("0.6um")} if name[-3:] in ("csv", "txt") else {}),
    )  # fmt: skip
    np.testing.assert_array_equal(np.isnan(found.heights_um), np.isnan(heights))
    np.testing.assert_allclose(found.heights_um, heights, atol=off)
    if name[-3:] in ("csv", "txt"):
        assert found.pitch_um == (0.6, 0.6) and found.pitch_from == "--pitch"
    else:
        assert found.pitch_um == pytest.approx(PITCH, rel=1e-6) and found.pitch_from == "the file"


def test_gwyddions_header_says_the_pitch(tmp_path):
    found = read_height_map(write_gwyddion(tmp_path / "a.txt", surface(), PITCH))
    assert found.pitch_um == pytest.approx(PITCH) and "Gwyddion" in found.format


@pytest.mark.parametrize("stored", ["uint8", "int16", "uint16", "int32", "uint32"])
def test_whole_numbers_fill_their_full_scale(stored, tmp_path):
    info = np.iinfo(stored)
    heights = (surface() - surface().min()) / np.ptp(surface()) * 20
    write_tagged(tmp_path / "a.tif", np.rint(heights / 20 * info.max).astype(stored), PITCH)
    found = read_height_map(tmp_path / "a.tif", full_scale=Length.parse("20um"))
    np.testing.assert_allclose(found.heights_um, heights, atol=20 / info.max)
    if info.bits == 32:
        with pytest.raises(DataError, match="which no mask's do"):
            read_height_map(tmp_path / "a.tif", unit="nm")
        return
    counted = read_height_map(tmp_path / "a.tif", unit="nm", pitch=Length.parse("1um"))
    assert counted.heights_um.max() == pytest.approx(info.max * 1e-3)
    assert counted.pitch_um == (1, 1)


def test_a_cameras_own_relief_says_its_unit(tmp_path):
    camera = preset("small")
    relief = ReliefFile(kind="file", file="relief.tif", grid=Length.parse("2um"))
    mask = camera.mask.model_copy(update={"relief": relief})
    heights = torch.from_numpy(surface()).float()
    write_camera(tmp_path, camera.model_copy(update={"mask": mask}), heights)
    found = read_height_map(tmp_path / "relief.tif", pitch=Length.parse("2um"))
    np.testing.assert_allclose(found.heights_um, surface(), atol=1e-6)


def test_heights_for_lithography_say_pitch_and_scale(tmp_path):
    relief = Relief(torch.from_numpy(surface()).float(), 0.7)
    write_height_map(tmp_path / "mask.tif", made_surface(relief, "replica", "made up"))
    found = read_height_map(tmp_path / "mask.tif")
    np.testing.assert_allclose(found.heights_um, surface()[::-1], atol=6 / 65535)
    assert found.pitch_um == pytest.approx((0.7, 0.7), rel=1e-6)
    counts = read_height_map(tmp_path / "mask.tif", unit="nm")
    assert counts.heights_um.max() == pytest.approx(65.535)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(16, 20), st.integers(16, 20), st.floats(0.01, 40), st.floats(0.01, 40),
    st.integers(0, 2**31),
)  # fmt: skip
def test_points_in_any_order_at_any_pitch(tmp_path_factory, rows, columns, down, right, seed):
    heights = np.random.default_rng(seed).normal(size=(rows, columns))
    path = tmp_path_factory.mktemp("map") / "a.xyz"
    found = read_height_map(write_points(path, heights, (down, right), seed), unit="um")
    np.testing.assert_allclose(found.heights_um, heights, rtol=1e-4, atol=1e-5)
    assert found.pitch_um == pytest.approx((down, right), rel=1e-3, abs=2e-6)


def text(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


GOOD = "\n".join([",".join(["1"] * 16)] * 16)
SDF = "aISO-1.0\nNumPoints = 16\nNumProfiles = 16\nXscale = 1e-6\nYscale = 1e-6\nZscale = 1e-9\n"


@pytest.mark.parametrize(
    ("name", "content", "told", "words"),
    [
        ("a.csv", GOOD, {}, "a.csv does not say what its numbers stand for: give --unit um"),
        ("a.csv", GOOD, {"unit": "um"}, "how far apart its points lie: give --pitch"),
        ("a.csv", GOOD, {"full_scale": Length.parse("1um")}, "is for a TIFF of whole numbers"),
        ("a.csv", GOOD, {"full_scale": Length.parse("1um"), "unit": "um"}, "leave one out"),
        ("a.csv", GOOD.replace("1,1\n", "1,x1\n", 1), {"unit": "um"}, "line 1: 'x1' is no number"),
        ("a.csv", GOOD + ",1", {"unit": "um"}, "line 16 has 17 values, but the first one has 16"),
        ("a.csv", "1,2,4\n3,4,7\n4,7,9\n", {"unit": "um"}, "do not lie on a regular grid"),
        ("a.csv", "1,2\n3,4\n", {"unit": "um", "pitch": Length.parse("1um")}, "has 2×2 points"),
        ("a.csv", "", {}, "is empty"),
        ("a.csv", "\n# only words\n", {}, "holds no numbers"),
        ("a.csv", "height\n", {}, "holds no numbers"),
        ("a.csv", b"\0\1\2", {}, "is no text"),
        ("a.txt", "# Value units: V\n" + GOOD, {}, "its values are in 'V': heights in nm"),
        ("a.txt", "# Value units: nm\n" + GOOD, {"unit": "um"}, "says its heights are in nm"),
        ("a.txt", "# Value units: m\n# Width: 9\n# Height: 9 um\n" + GOOD, {}, "header is damaged"),
        ("a.csv", GOOD.replace("1", "nan"), {"unit": "um", "pitch": Length.parse("1um")},
         "holds no measured point"),
        ("a.sdf", SDF, {}, r"has no \* behind its header"),
        ("a.sdf", SDF + "*\n1 2 3\n*\n", {}, "has 3 heights, but its header says 16×16"),
        ("a.sdf", "aISO-1.0\nNumPoints = 16\n*\n", {}, "does not say the size .*numprofiles"),
        ("a.sdf", SDF.replace("s = 16", "s = -16") + "*\n", {}, "does not say the size"),
        ("a.sdf", SDF.replace("1e-6", "1e-3") + "*\n" + "1 " * 256 + "\n*", {}, "1000 µm apart"),
        ("a.csv", GOOD, {"unit": "um", "pitch": Length.parse("2mm")}, "2 mm: give 0.1nm to 1mm"),
        ("a.csv", GOOD.replace("1", "9e307", 1), {"unit": "m", "pitch": Length.parse("1um")},
         "heights of .* go from 1e.06 to inf µm, which no mask's do: check"),
        ("a.csv", GOOD.replace("1", "2", 1), {"unit": "m", "pitch": Length.parse("1um")},
         "check what a value stands for"),
        ("a.sdf", b"bISO-1.0\0\0", {}, "is a binary SDF: save it as ASCII"),
        ("a.png", b"x", {}, r"the suffix .png is not known. Accepted are .tif, .tiff, .txt"),
        ("a.tif", b"x" * 9, {}, "it is no TIFF file"),
    ],
)  # fmt: skip
def test_refused(tmp_path, name, content, told, words):
    with pytest.raises(NolensError, match=words) as error:
        read_height_map(text(tmp_path / name, content), **told)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("values", "told", "kind", "words"),
    [
        (np.zeros((20, 20), np.float32), {}, OptionError, "heights stand for: give --unit um"),
        (np.zeros((20, 20), np.uint16), {}, OptionError, "or --full-scale 20um"),
        (np.zeros((20, 20), np.float32), {"full_scale": Length.parse("1um")}, OptionError,
         "for whole numbers, and a.tif holds float32"),
        (np.zeros((20, 20, 3), np.uint8), {"unit": "um"}, FileError, "3 channels"),
        (np.full((20, 20), np.nan, np.float32), {"unit": "um"}, DataError, "no measured point"),
    ],
)  # fmt: skip
def test_refused_tiff(tmp_path, values, told, kind, words):
    photometric = "rgb" if values.ndim == 3 else "minisblack"
    tifffile.imwrite(
        tmp_path / "a.tif", values, photometric=photometric, metadata=None,
        resolution=(1e4, 1e4), resolutionunit="CENTIMETER",
    )  # fmt: skip
    with pytest.raises(kind, match=words):
        read_height_map(tmp_path / "a.tif", **told)


@pytest.mark.parametrize("resolution", [(300, 300), (0, 0)])
def test_the_resolution_of_a_printer_is_no_pitch(tmp_path, resolution):
    tifffile.imwrite(
        tmp_path / "a.tif", np.zeros((20, 20), np.float32), photometric="minisblack",
        metadata=None, resolution=resolution, resolutionunit="INCH",
    )  # fmt: skip
    with pytest.raises(OptionError, match="give"):
        read_height_map(tmp_path / "a.tif", unit="um")


def test_nothing_there(tmp_path):
    with pytest.raises(FileError, match="there is no file"):
        read_height_map(tmp_path / "a.csv")
