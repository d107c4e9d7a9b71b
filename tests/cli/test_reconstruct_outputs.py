"""What is written: pictures that agree with each other, and the record of the run."""

import hashlib
import json
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch
from little_camera import QUICK, SCENE, SUPPORT, Camera, save
from PIL import Image
from running import command, listing, run

from nolens.camera import srgb_from_linear
from nolens.files import read_frame

SUMMARY = {
    "method",
    "iterations",
    "stop_reason",
    "objective",
    "tau",
    "prior",
    "field_points",
    "automatic_tau",
    "detail",
    "automatic_support",
    "report",
    "warnings",
    "seconds",
    "device",
    "outputs",
}


def test_installed_command_writes_pictures_and_record(camera: Camera, tmp_path: Path) -> None:
    png, tif = tmp_path / "out.png", tmp_path / "out.tif"
    done = command(
        "reconstruct", camera.raw, "--psf", camera.psf, "-o", png, "-o", tif, "--support", SUPPORT,
        "--device", "cpu",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.err == ""
    *report, picture, linear, record = done.out.splitlines()
    paths = [picture, linear, record]
    names = ["noise", "unexplained", "resolution", "support", "run"]
    assert [line.split()[0] for line in report] == names
    assert "24×32 pixels" in report[3]
    assert " admm, " in report[4] and " on cpu" in report[4]
    assert "(automatic)" in report[4] and "--detail 2 shows more detail" in report[4]
    assert paths == [str(png), str(tif), str(tmp_path / "out.json")]
    assert sorted(listing(tmp_path)) == ["out.json", "out.png", "out.tif"]


def test_one_json_object_is_printed(
    camera: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    png = tmp_path / "out.png"
    asked = ("--psf", camera.psf, "-o", png, "--prior", "tv", "--iterations", 7, "--tolerance", 0)
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.setenv(name, "1")
    done = run("reconstruct", camera.raw, *asked, "--json")
    assert done.code == 0 and done.err == ""
    assert done.out.count("\n") == 1
    summary = json.loads(done.out)
    assert set(summary) == SUMMARY
    assert summary["method"] == "admm"
    assert summary["iterations"] == 7 and summary["stop_reason"] == "iteration limit"
    assert summary["device"] in ("cpu", "cuda")
    assert 0 < summary["objective"] < 0.5
    assert summary["seconds"] > 0
    assert summary["outputs"] == [str(png), str(tmp_path / "out.json")]


def test_pictures_agree(camera: Camera, tmp_path: Path) -> None:
    base = ("reconstruct", camera.raw, "--psf", camera.psf, "--support", SUPPORT, *QUICK)
    linear, deep, png = (tmp_path / name for name in ("f.tif", "deep.tiff", "p.PNG"))
    assert run(*base, "-o", linear, "--tiff-bits", 32).code == 0
    assert run(*base, "-o", deep, "-o", png).code == 0
    radiance = read_frame(linear).counts
    assert radiance.shape == (3, *SCENE) and radiance.min() >= 0
    with tifffile.TiffFile(deep) as tiff:
        note = json.loads(tiff.pages.first.description)
        stored = torch.from_numpy(tiff.asarray().astype(np.float64)).movedim(-1, 0)
    # The rule: the 99.5th percentile of the brightest channel is white.
    brightest = radiance.amax(0).flatten().sort().values
    white = float(brightest[int(np.ceil(0.995 * brightest.numel())) - 1])
    assert note["white"] == pytest.approx(white)
    assert note["per_count"] == pytest.approx(white / 65535)
    assert stored.max() == 65535
    radiance = radiance.double()
    assert torch.allclose(stored, (radiance / white).clamp(0, 1) * 65535, atol=0.51)
    shown = read_frame(png).counts.double()
    assert torch.allclose(shown, srgb_from_linear(radiance / white) * 255, atol=0.51)


def test_grey_pictures_have_one_channel_and_missing_colours_are_black(
    camera: Camera, tmp_path: Path
) -> None:
    base = ("reconstruct", camera.raw, "--psf", camera.psf, "--support", SUPPORT, *QUICK)
    png = tmp_path / "out.png"
    for channels, mode in (("grey", "L"), ("g", "L"), ("rg", "RGB"), ("all", "RGB")):
        assert run(*base, "-o", png, "--channels", channels).code == 0
        with Image.open(png) as picture:
            assert picture.mode == mode, channels
            if channels == "rg":
                assert np.array(picture)[..., 2].max() == 0
                assert np.array(picture)[..., :2].max() == 255


def test_record(camera: Camera, tmp_path: Path) -> None:
    png = tmp_path / "out.png"
    asked = ("--psf", camera.psf, "--support", SUPPORT, "--iterations", 12, "--tolerance", 0)
    done = run("reconstruct", camera.raw, *asked, "-o", png, "--json")
    record = json.loads((tmp_path / "out.json").read_text())
    assert record["result"] == json.loads(done.out)
    for role, path in (("measurement", camera.raw), ("psf", camera.psf)):
        data = path.read_bytes()
        assert record["inputs"][role] == {
            "path": str(path), "size": len(data), "sha256": hashlib.sha256(data).hexdigest(),
        }  # fmt: skip
    assert set(record["inputs"]) == {"measurement", "psf"}
    for package in ("nolens", "torch", "numpy", "scipy"):
        assert record["versions"][package] == version(package)
    parameters = record["parameters"]
    # Not given, and told all the same: the strongest of what predicts left-out pixels best.
    weights = parameters["weights"]
    assert min(each["excess"] for each in weights) == 0
    assert weights[-1]["tau"] < parameters["tau"] == record["result"]["tau"] <= weights[0]["tau"]
    assert parameters["iterations"] == 12 and parameters["tolerance"] == 0
    assert parameters["method"] == "admm" and parameters["prior"] == "auto"
    assert record["result"]["prior"] == "tv"
    assert parameters["support"] == f"{SUPPORT}+12+16" and parameters["balance"] is True
    assert parameters["relaxation"] is None and parameters["penalties"] is None
    assert parameters["channel_names"] == ["R", "G", "B"]
    # The version before called it period.
    assert parameters["fft_grid"] == parameters["period"] and min(parameters["fft_grid"]) > 24
    history = record["history"]
    assert [row["iteration"] for row in history] == [4, 8, 12]
    for row in history:
        assert row["objective"] > 0
        assert row["primal_residual"] > 0 and row["dual_residual"] > 0
        assert min(row[f"penalty_{k}"] for k in (1, 2, 3)) > 0
    assert history[-1]["objective"] < history[0]["objective"]
    assert record["warnings"] == []
    assert record["started"].count("T") == 1


@pytest.mark.parametrize(("method", "limit"), [("admm", 200), ("fista", 300), ("wiener", 1)])
def test_record_resolves_what_each_method_takes(
    method: str, limit: int, camera: Camera, tmp_path: Path
) -> None:
    asked = ("--psf", camera.psf, "-o", tmp_path / "o.png", "--method", method)
    assert run("reconstruct", camera.raw, *asked, "--tolerance", 0.05).code == 0
    record = json.loads((tmp_path / "o.json").read_text())
    assert record["parameters"]["tau"] > 0 and record["parameters"]["weights"]
    assert record["parameters"]["iterations"] == limit
    reason = "one shot" if method == "wiener" else "converged"
    assert record["result"]["stop_reason"] == reason
    assert record["result"]["method"] == method


def test_warnings_are_said_and_recorded(camera: Camera, tmp_path: Path) -> None:
    asked = ("--psf", camera.psf, "-o", tmp_path / "o.png", "--tau", 8e-3, "--iterations", 3)
    done = run("reconstruct", camera.raw, *asked, "--white", 2500)
    assert done.code == 0
    assert done.err.startswith("nolens: warning: ") and "saturated" in done.err
    psf, measurement = json.loads((tmp_path / "o.json").read_text())["warnings"]
    assert psf in done.err and "psf.dng is saturated" in psf
    assert measurement in done.err and "raw.dng cannot be used" in measurement


def test_a_grey_file_beside_one_in_colour(camera: Camera, tmp_path: Path) -> None:
    """What a grey PSF costs colours is said in a line; of a grey measurement nothing is lost."""

    def green(name: str, path: Path) -> Path:
        return save(tmp_path / name, read_frame(path).counts[:, ::2, 1::2])

    asked = "-o", tmp_path / "o.png", "--tau", 8e-3, "--iterations", 2
    done = run("reconstruct", camera.raw, "--psf", green("p.tif", camera.psf), *asked)
    assert done.code == 0 and "p.tif is grey and serves all colours" in done.err
    assert "a PSF in colour, of white light, balances them" in done.err
    done = run("reconstruct", green("m.tif", camera.raw), "--psf", camera.psf, *asked)
    assert done.code == 0 and "is grey and serves" not in done.err
    assert "the measurement is grey: so is the PSF" in done.err


def test_name_that_is_no_utf8(camera: Camera, tmp_path: Path) -> None:
    png = tmp_path / "M\udcfcller.png"
    raw = save(tmp_path / "M\udcfcller.tif", read_frame(camera.raw).counts)
    asked = ("--mosaic", "RGGB", "--tau", 8e-3, "--iterations", 2)
    done = run("reconstruct", raw, "--psf", camera.psf, "-o", png, *asked)
    assert done.code == 0, done.err
    assert png.exists() and "M�ller.png" in done.out.encode().decode()
    record = json.loads(png.with_suffix(".json").read_text())
    assert record["inputs"]["measurement"]["path"].endswith("M�ller.tif")
    assert run("info", raw).out.encode()


def test_earlier_picture_is_replaced(camera: Camera, tmp_path: Path) -> None:
    png = tmp_path / "out.png"
    png.write_bytes(b"old")
    (tmp_path / "out.json").write_text("old")
    assert run("reconstruct", camera.raw, "--psf", camera.psf, "-o", png, *QUICK).code == 0
    with Image.open(png) as picture:
        assert picture.size == (64, 48)
    assert sorted(listing(tmp_path)) == ["out.json", "out.png"]
