"""Written pictures, records and atomic writes."""

import hashlib
import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest
import tifffile
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from nolens.camera import Frame
from nolens.errors import DataError, FileError
from nolens.files import (
    InputFile,
    RunRecord,
    atomic_write,
    check_output,
    describe,
    read_frame,
    versions,
    write_dng,
    write_frame,
    write_png,
    write_record,
    write_tiff16,
    write_tiff32,
)


def radiance(channels: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(channels, 20, 50, generator=torch.manual_seed(seed)) * 3 - 0.2


@pytest.mark.parametrize("channels", [1, 3])
def test_png_values(tmp_path, channels):
    # 995 of 1000 pixels do not exceed 2, which is white; 1 is half of it: sRGB code 188.
    values = torch.ones(channels, 20, 50)
    values[:, 0, :10], values[:, 1], values[:, 2] = 2, 0, -1
    values[:, 0, :5] = 7
    write_png(tmp_path / "a.png", values)
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    assert picture.shape == ((20, 50) if channels == 1 else (20, 50, 3))
    assert (picture[0, :10] == 255).all()
    assert (picture[0, 10:] == 188).all()
    assert (picture[1:3] == 0).all()


def test_colours_keep_their_places(tmp_path):
    values = torch.zeros(3, 4, 5)
    values[0, 0], values[1, 1], values[2, 2] = 1, 1, 1
    write_png(tmp_path / "a.png", values)
    write_tiff16(tmp_path / "a.tif", values)
    for stored in (np.asarray(Image.open(tmp_path / "a.png")), tifffile.imread(tmp_path / "a.tif")):
        assert (stored.argmax(-1)[:3] == np.arange(3)[:, None]).all()


@settings(deadline=None, max_examples=20)
@given(channels=st.sampled_from([1, 3]), scale=st.floats(1e-8, 1e8))
def test_tiffs_come_back(tmp_path_factory, channels, scale):
    folder = tmp_path_factory.mktemp("tiff")
    values = radiance(channels) * scale
    write_tiff32(folder / "32.tif", values)
    assert torch.equal(read_frame(folder / "32.tif").counts, values)
    write_tiff16(folder / "16.tif", values)
    with tifffile.TiffFile(folder / "16.tif") as tiff:
        note = json.loads(tiff.pages[0].description)
        assert tiff.pages[0].photometric.name == ("RGB" if channels == 3 else "MINISBLACK")
    back = read_frame(folder / "16.tif").counts.double() * note["per_count"]
    expected = values.double().clamp(0, note["white"])
    assert float((back - expected).abs().max()) <= 0.501 * note["per_count"]


@pytest.mark.parametrize("write", [write_png, write_tiff16])
@pytest.mark.parametrize("values", [torch.zeros(1, 9, 9), torch.full((1, 9, 9), math.nan)])
def test_nothing_to_show_is_not_written(tmp_path, write, values):
    with pytest.raises(DataError):
        write(tmp_path / "a.png", values)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("write", [write_png, write_tiff16, write_tiff32])
def test_two_channels_are_no_picture(tmp_path, write):
    with pytest.raises(DataError, match=r"1 or 3 channels, not \(2, 20, 50\)"):
        write(tmp_path / "a.tif", radiance(2))
    assert not list(tmp_path.iterdir())


def test_counts_are_stored_as_they_are(tmp_path):
    counts = torch.randint(0, 65536, (20, 50), generator=torch.manual_seed(0), dtype=torch.int32)
    frame = Frame(
        counts[None].float(), ("mosaic",), "GBRG", (240.5,), 60000.0, "uint16", "a", exposure_s=0.25
    )
    write_frame(tmp_path / "a.tif", frame)
    assert torch.equal(read_frame(tmp_path / "a.tif", mosaic="GBRG").counts[0].int(), counts)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        note = {"mosaic": "GBRG", "black": 240.5, "white": 60000, "exposure_s": 0.25}
        assert tiff.pages[0].dtype == "uint16"
        assert json.loads(tiff.pages[0].description) == note


def test_exposures_beyond_what_a_dng_holds(tmp_path):
    counts = torch.full((22, 22), 300)
    for exposure in (0.0, 1e-12, 1e30, math.inf):
        write_dng(tmp_path / "a.dng", counts, black=256, white=4095, exposure_s=exposure)
        assert read_frame(tmp_path / "a.dng").exposure_s is None


def test_atomic_write_replaces(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with atomic_write(path) as temporary:
        assert (temporary.parent, temporary.suffix) == (path.parent, ".txt")
        assert temporary.name.startswith(".")
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_atomic_write_leaves_nothing_behind(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(error), atomic_write(path) as temporary:
        temporary.write_text("half")
        raise error
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


def test_what_killed_processes_left_is_removed(tmp_path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    stays = {".nolens-photo.png", f".nolens-{os.getppid()}-0123abcd.png", ".mine", "a.txt"}
    for name in (*stays, f".nolens-{ended.pid}-0123abcd.png", f".nolens-{os.getpid()}-0123abcd"):
        (tmp_path / name).write_text("half")
    with atomic_write(tmp_path / "a.txt") as temporary:
        temporary.write_text("x")
    assert {path.name for path in tmp_path.iterdir()} == stays


def test_atomic_write_keeps_to_the_umask(tmp_path):
    with atomic_write(tmp_path / "a.txt") as temporary:
        temporary.write_text("x")
    (tmp_path / "b.txt").write_text("x")
    modes = [(tmp_path / name).stat().st_mode for name in ("a.txt", "b.txt")]
    assert modes[0] == modes[1]


def test_writing_into_nowhere(tmp_path):
    with pytest.raises(FileError, match=r"cannot write .*No such file"):
        write_png(tmp_path / "none" / "a.png", radiance(1))
    (tmp_path / "b.png").mkdir()
    with pytest.raises(FileError, match="cannot write"):
        write_png(tmp_path / "b.png", radiance(1))
    assert [entry.name for entry in tmp_path.iterdir()] == ["b.png"]


def test_outputs_are_checked_before(tmp_path, monkeypatch):
    accepted = (".png", ".tif")
    check_output(tmp_path / "a.PNG", accepted)
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder.png").mkdir()
    for name, message in [
        ("a.jpg", r"\.jpg is not known here. Accepted: \.png, \.tif"),
        ("a", r"\(none\)"),
        ("none/a.png", "no folder .*none"),
        ("folder.png", "is a folder"),
        ("file/a.png", "is a file, not a folder"),
    ]:
        with pytest.raises(FileError, match=message):
            check_output(tmp_path / name, accepted)
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(FileError, match="no permission"):
        check_output(tmp_path / "a.png", accepted)


def test_record_is_json_and_comes_back(tmp_path):
    (tmp_path / "in.npy").write_bytes(b"abc")
    record = RunRecord(
        started="2026-01-01T12:00:00+00:00",
        inputs={"measurement": InputFile.of(tmp_path / "in.npy")},
        parameters={"tau": 1e-4, "region": (400, 300), "nothing": math.nan},
        result={"stop_reason": "residuals", "objective": math.inf},
        history=[{"objective": 1.5}, {"objective": math.nan}],
        warnings=["é"],
    )
    write_record(tmp_path / "a.json", record)
    data = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert data["schema_version"] == 1
    assert data["inputs"]["measurement"] == {
        "path": str(tmp_path / "in.npy"),
        "sha256": hashlib.sha256(b"abc").hexdigest(),
        "size": 3,
    }
    assert data["parameters"] == {"tau": 1e-4, "region": [400, 300], "nothing": None}
    assert data["result"]["objective"] is None
    assert data["history"] == [{"objective": 1.5}, {"objective": None}]
    assert data["versions"] == versions()
    assert data["warnings"] == ["é"]


def test_nothing_is_no_input(tmp_path):
    with pytest.raises(FileError, match="cannot read"):
        InputFile.of(tmp_path / "none")


def test_describe_mosaic(tmp_path):
    counts = np.full((40, 40), 256, np.uint16)
    counts[0::2, 0::2] = 1000
    counts[1::2, 1::2] = 4095
    counts[5:15, 5:15] = 200
    write_dng(tmp_path / "a.dng", counts, black=256, white=4095, exposure_s=0.5)
    about = describe(read_frame(tmp_path / "a.dng"))
    json.dumps(about, allow_nan=False)
    assert (about["height"], about["width"], about["format"]) == (40, 40, "dng")
    assert (about["mosaic"], about["black"], about["white"]) == ("RGGB", [256], 4095)
    assert about["exposure_s"] == 0.5
    assert about["counts"]["R"] == {"min": 200, "max": 1000, "mean": 1000 - 800 * 25 / 400}
    assert about["at_highest"] == 375
    assert about["saturated_percent"] == pytest.approx(100 * 375 / 1600)
    assert about["dark_corner"] == 200


def test_describe_damaged_data(tmp_path):
    array = np.array([[1, np.nan], [np.inf, 3]], np.float32)
    np.save(tmp_path / "a.npy", array)
    about = describe(read_frame(tmp_path / "a.npy"))
    json.dumps(about, allow_nan=False)
    assert about["not_finite"] == 2
    assert about["counts"] == {"grey": {"min": 1, "max": 3, "mean": 2}}
    assert about["saturated_percent"] is None
    assert about["dark_corner"] is None
    np.save(tmp_path / "b.npy", np.full((20, 20), np.nan))
    about = describe(read_frame(tmp_path / "b.npy"))
    json.dumps(about, allow_nan=False)
    assert about["counts"] == {"grey": None}
