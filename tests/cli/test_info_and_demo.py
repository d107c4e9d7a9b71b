"""`nolens info` and `nolens demo`."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from little_camera import BLACK, SENSOR, WHITE, Camera, save
from running import run

from nolens.experiments import demonstration
from nolens.files import read_frame


def test_info_of_a_raw_file(camera: Camera) -> None:
    done = run("info", camera.raw)
    assert done.code == 0 and done.err == ""
    lines = dict(line.split("  ", 1) for line in done.out.splitlines())
    found = {name.strip(): value.strip() for name, value in lines.items()}
    assert found["height"] == "96" and found["width"] == "128"
    assert found["mosaic"] == "RGGB" and found["black"] == "256" and found["white"] == "4095"
    assert found["exposure s"] == "not stated"


def test_info_as_json(camera: Camera) -> None:
    done = run("info", camera.psf, "--json")
    assert done.code == 0 and done.err == "" and done.out.count("\n") == 1
    found = json.loads(done.out)
    counts = read_frame(camera.psf).counts
    assert found["file"] == str(camera.psf) and found["format"] == "dng"
    assert (found["height"], found["width"]) == (2 * SENSOR[0], 2 * SENSOR[1])
    assert found["black"] == [BLACK] and found["white"] == WHITE
    assert found["counts"]["R"]["max"] == float(counts[0, ::2, ::2].max())
    assert found["counts"]["B"]["mean"] == pytest.approx(float(counts[0, 1::2, 1::2].mean()))
    assert found["dark_corner"] == pytest.approx(BLACK, abs=3)


def test_info_of_strange_values_is_still_json(tmp_path: Path) -> None:
    values = torch.full((1, 20, 20), float("nan"))
    values[0, 3, 3] = float("inf")
    done = run("info", save(tmp_path / "odd.npy", values), "--json")
    assert done.code == 0
    found = json.loads(done.out, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert found["not_finite"] == 400 and found["counts"] == {"grey": None}


def test_info_of_a_mosaic_in_a_plain_file(tmp_path: Path) -> None:
    path = tmp_path / "raw.npy"
    np.save(path, np.arange(64, dtype=np.uint16).reshape(8, 8))
    assert json.loads(run("info", path, "--json").out)["mosaic"] is None
    found = json.loads(run("info", path, "--mosaic", "GRBG", "--json").out)
    assert found["mosaic"] == "GRBG" and found["counts"]["R"]["min"] == 1


def test_version_and_help() -> None:
    assert run("--version").out.strip()
    for page in ((), ("--help",), ("reconstruct", "--help"), ("info", "-h"), ("demo", "--help")):
        done = run(*page)
        assert done.code == 0 and done.err == "" and "Usage: nolens" in done.out


def test_help_tells_defaults_and_what_is_needed() -> None:
    text = " ".join(run("reconstruct", "--help-all").out.replace("│", " ").split())
    for words in (
        "what the sensor measured of a point source. Kinds of file as for measurements; or a",
        "means the same at any binning, support and number of channels. [default: auto]",
        "[default: 200; exact 5000; fista 300; in a sequence 8, or 4 turns of a trained prior]",
        "[default: photo] [choices: draft, photo, exact]",
        "[default: admm] [choices: admm, fista, wiener]",
        "[default: auto] [choices: auto, cpu, cuda]",
        "HEIGHTxWIDTH+TOP+LEFT",
        "99.5th percentile",
    ):
        assert words in text, words


def test_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a quarter of the pixels, and of the view, in each direction."""
    for name in ("_SCENE_PIXELS", "_PSF_PIXELS"):
        rows, columns = getattr(demonstration, name)
        monkeypatch.setattr(demonstration, name, (rows // 8 * 2, columns // 8 * 2))
    monkeypatch.setattr(demonstration, "_ANGLE_DEG", demonstration._ANGLE_DEG / 4)
    folder = tmp_path / "new" / "demo"
    done = run("demo", "-o", folder, "--json")
    assert done.code == 0, done.err
    assert done.out.count("\n") == 1
    result = json.loads(done.out)
    assert result["psnr_db"] > 18
    assert result["picture"] == str(folder / "demo.png")
    # The command that it prints asks the same of its files; two iterations show that it runs.
    record = folder / "reconstruction.json"
    asked = json.loads(record.read_text())["parameters"]
    again = run(*result["command"][1:], "--iterations", 2, "--tau", asked["tau"])
    assert again.code == 0 and "taken as extended" in again.err, again.err
    there = json.loads(record.read_text())["parameters"]
    assert there.pop("options_set") == sorted([*asked.pop("options_set"), "iterations", "tau"])
    assert there == {**asked, "iterations": 2, "weights": []}
    names = ["camera", "demo.png", "measurement.dng", "reconstruction.json", "reconstruction.png"]
    assert sorted(path.name for path in folder.iterdir()) == names
    assert result["field_points"] == 5
    assert read_frame(folder / "demo.png").counts.shape[0] == 3
    measurement = read_frame(folder / "measurement.dng")
    assert measurement.mosaic == "RGGB"
    assert measurement.black == (256,) and measurement.white == 4095
    psfs = sorted((folder / "camera").glob("psf-300mm*.tif"))
    assert len(psfs) == 5
    assert 2 * read_frame(psfs[0]).counts.shape[1] > measurement.counts.shape[1]
    # Side by side at one height: measurement | reconstruction | truth.
    height, width = read_frame(folder / "demo.png").counts.shape[1:]
    assert width > 2 * height
