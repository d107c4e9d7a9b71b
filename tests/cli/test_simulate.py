"""`nolens simulate`: its files fit each other, and `nolens reconstruct`."""

import json
import math
import os
import pty
import signal
from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile
import torch
from running import listing, read_terminal, run, start
from simulated import QUICK, plain, scene, simulated, values

from nolens.camera import linear_from_srgb, preset, preset_text, to_toml
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_frame
from patience import PATIENCE_S


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    return scene(tmp_path / "scene.png")


def test_picture_comes_back(picture: Path, tmp_path: Path) -> None:
    """Through files alone: simulate, psf, reconstruct with the support that simulate names."""
    raw, point, out = (tmp_path / name for name in ("raw.dng", "psf.dng", "out.tif"))
    truth, response = tmp_path / "truth.tif", tmp_path / "response.tif"
    told = simulated(picture, *QUICK, "-o", raw, "--truth", truth, "--response", response)
    done = run("psf", "--camera", "small", "--pixels", "512x640", "--wavelengths", 1, "-o", point)
    assert done.code == 0, done.err
    asked = ("--psf", point, "--psf-extent", "wide", "--support", told["support"], "--tau", 2e-4)
    done = run("reconstruct", raw, *asked, "-o", out, "--tiff-bits", 32)
    assert done.code == 0, done.err
    expected = values(truth) * values(response)
    white = float(expected.max())  # One scale for all channels: the colours are right.
    assert psnr(scale_fit(values(out), expected), expected, white) > 30
    for found, wanted in zip(values(out)[:, None], expected[:, None], strict=True):
        assert psnr(scale_fit(found, wanted), wanted, float(wanted.max())) > 30
    flipped = values(out).flip(-1)[:1]
    assert psnr(scale_fit(flipped, expected[:1]), expected[:1], float(expected.max())) < 15


def test_what_is_written_and_told(picture: Path, tmp_path: Path) -> None:
    raw, truth, response = (tmp_path / name for name in ("r.dng", "t.tif", "s.tif"))
    told = simulated(picture, *QUICK, "-o", raw, "--truth", truth, "--response", response)
    assert told["outputs"] == [str(path) for path in (raw, truth, response, tmp_path / "r.json")]
    size = tuple(int(side) for side in told["support"].split("x"))
    assert values(truth).shape == (3, *size) and values(response).shape == (1, *size)
    # A picture of 4:3 whose width fills 15°: its diagonal is 5/4 of that.
    corner = math.degrees(math.atan(1.25 * math.tan(math.radians(7.5))))
    assert told["largest_angle_deg"] == pytest.approx(corner, abs=1e-3)
    assert told["pixels"] == [128, 160] and told["field_error"] is None
    assert 0.99 < float(values(response).max()) <= 1 and float(values(response).min()) > 0.8
    # The patches are there, in linear light: this is what is white.
    brightest = float(linear_from_srgb(torch.tensor(230 / 255)))
    assert float(values(truth)[0].max()) == pytest.approx(brightest, rel=1e-3)
    sensor = preset("small").sensor
    assert told["brightest_electrons"] == pytest.approx(0.9 * sensor.clip_electrons)
    frame = read_frame(raw)
    assert (frame.mosaic, frame.black, frame.white) == ("RGGB", (256.0,), 4095.0)
    assert frame.exposure_s == pytest.approx(told["exposure_s"], rel=1e-4)
    record = json.loads((tmp_path / "r.json").read_text())
    assert record["result"] == told and record["warnings"] == []
    assert record["inputs"]["scene"]["path"] == str(picture)
    assert record["parameters"]["camera"] == "small"
    assert record["parameters"]["camera_description"]["sensor"]["rows"] == 256
    assert record["parameters"]["angle"] == ["15 deg"]


def test_text_for_people(picture: Path, tmp_path: Path) -> None:
    done = run("simulate", picture, *QUICK[:-3], 3, "--angle", "15deg", "-o", tmp_path / "r.tif")
    assert done.code == 0 and done.err == ""
    for words in (
        "exposed", "electrons", "saturated", "3×3 field points: off by", "of the noise",
        "reconstruct with --support", "off the axis", "s on cpu", "r.tif", "r.json",
    ):  # fmt: skip
        assert words in done.out, words


def test_dng_and_tiff_hold_the_same_counts(picture: Path, tmp_path: Path) -> None:
    for name in ("a.dng", "a.tif"):
        simulated(picture, *QUICK, "--seed", 4, "-o", tmp_path / name)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        developed = np.array(raw.raw_image_visible)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        stored, note = tiff.asarray(), json.loads(tiff.pages.first.description)
    assert stored.dtype == np.uint16 and np.array_equal(developed, stored)
    assert note["mosaic"] == "RGGB" and note["black"] == 256 and note["white"] == 4095
    assert note["exposure_s"] > 0
    simulated(picture, *QUICK, "--seed", 5, "-o", tmp_path / "b.tif")
    other = tifffile.imread(tmp_path / "b.tif").astype(float)
    assert not np.array_equal(other, stored)
    # Two frames of one scene differ by their noise only.
    assert np.abs(other - stored).mean() < 0.1 * stored.std()


def test_counts_follow_the_exposure_until_they_clip(picture: Path, tmp_path: Path) -> None:
    means = []
    for milliseconds in (50, 100, 100_000):
        out = tmp_path / f"{milliseconds}.tif"
        told = simulated(picture, *QUICK, "--exposure", f"{milliseconds}ms", "-o", out)
        assert told["exposure_s"] == milliseconds / 1000
        means.append(float(values(out).mean()) - 256)
    assert means[1] == pytest.approx(2 * means[0], rel=0.02)
    assert told["saturated_fraction"] > 0.5 and int(values(out).max()) == 4095
    bright = ("--exposure", "50ms", "--luminance", "400 cd/m2")
    simulated(picture, *QUICK, *bright, "-o", tmp_path / "bright.tif")
    assert float(values(tmp_path / "bright.tif").mean()) - 256 == pytest.approx(means[1], rel=0.02)


def test_absurd_exposure_is_only_saturated(picture: Path, tmp_path: Path) -> None:
    told = simulated(
        picture, *QUICK, "--exposure", "1e6s", "--luminance", "1e12 nit", "-o", tmp_path / "r.dng"
    )
    assert told["saturated_fraction"] > 0.9


def test_lines_see_a_moving_scene_while_they_are_exposed(tmp_path: Path) -> None:
    """Dark, then bright: only the lower lines of "down" begin late enough to see it."""
    frames, raw, truth = (tmp_path / name for name in ("frames", "raw.dng", "truth.tif"))
    frames.mkdir()
    plain(frames / "9.png", 0, 0, 0)
    plain(frames / "10.png", 255, 255, 255)
    asked = ("--exposure", "50us", "--luminance", "1e6 nit", "-o", raw, "--truth", truth)
    told = simulated(frames, *QUICK, *asked)
    assert told["exposure_s"] == 5e-5 and read_frame(raw).exposure_s == pytest.approx(5e-5)
    lines = read_frame(raw).counts[0].mean(dim=-1) - 256
    assert float(lines[:127].abs().max()) < 1 and float(lines[131:].min()) > 20
    shown = tifffile.imread(truth)
    assert shown.shape[:2] == (2, 3) and not shown[0].any() and shown[1].mean() > 0.9
    done = run("simulate", frames, *QUICK, *asked, "--frame-duration", "1ms")
    lines = read_frame(raw).counts[0].mean(dim=-1) - 256
    assert done.code == 0 and float(lines[:33].abs().max()) < 1 and float(lines[37:].min()) > 20


def test_near_picture_hides_the_far_one(tmp_path: Path) -> None:
    far = plain(tmp_path / "far.png", 255, 0, 0)
    near = plain(tmp_path / "near.png", 0, 0, 255)
    truth = tmp_path / "truth.tif"

    def seen(*given: object) -> torch.Tensor:
        simulated(*given, *QUICK[:-2], "-o", tmp_path / "r.tif", "--truth", truth)
        return values(truth)

    distances = ("--distance", "1m", "--distance", "200mm")
    both = seen(far, near, *distances, "--angle", "15deg", "--angle", "8deg")
    height, width = both.shape[1:]
    middle, corner = both[:, height // 2, width // 2], both[:, 3, 3]
    assert middle.tolist() == [0, 0, 1] and corner.tolist() == pytest.approx([1, 0, 0])
    # What is near hides what is far, in whatever order they are given.
    turned = seen(near, far, *distances[2:], *distances[:2], "--angle", "8deg", "--angle", "15deg")
    assert torch.equal(turned, both)
    glass = plain(tmp_path / "glass.png", 0, 0, 255, 51)
    through = seen(far, glass, *distances, "--angle", "15deg", "--angle", "8deg")
    assert through[:, height // 2, width // 2].tolist() == pytest.approx([0.8, 0, 0.2], abs=1e-3)


def test_too_few_field_points_are_said(picture: Path, tmp_path: Path) -> None:
    part = preset_text("small").replace("rows = 256", "rows = 32")
    part = part.replace("columns = 320", "columns = 64")
    (tmp_path / "camera.toml").write_text(part)
    done = run(
        "simulate", picture, "--camera", tmp_path, "--light", "535nm", "--angle", "60deg",
        "--distance", "12mm", "--field-points", 3, "-o", tmp_path / "r.tif", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert json.loads(done.out)["field_error"]["of_noise"] > 0.3
    warning = done.err.removeprefix("nolens: warning: ").strip()
    assert warning.startswith("between the 3×3 field points the simulation is off by 0.")
    assert warning.endswith("of the noise: try --field-points 5")
    assert json.loads((tmp_path / "r.json").read_text())["warnings"] == [warning]


def test_grey_sensor(picture: Path, tmp_path: Path) -> None:
    camera = preset("small")
    curve = camera.sensor.quantum_efficiency.model_copy(
        update={"values": {"grey": camera.sensor.quantum_efficiency.values["G"]}}
    )
    sensor = camera.sensor.model_copy(
        update={"mosaic": "none", "rows": 101, "columns": 121, "quantum_efficiency": curve}
    )
    text = to_toml(camera.model_copy(update={"sensor": sensor}))
    (tmp_path / "camera.toml").write_text(text)
    given = (picture, "--camera", tmp_path, *QUICK[2:], "--truth", tmp_path / "truth.tif")
    told = simulated(*given, "-o", tmp_path / "raw.tif")
    assert values(tmp_path / "raw.tif").shape == (1, 101, 121) and told["pixels"] == [101, 121]
    truth = values(tmp_path / "truth.tif")
    dark = linear_from_srgb(torch.tensor(20 / 255))
    assert truth.shape[0] == 1 and float(truth[0, 2, 2]) == pytest.approx(float(dark), rel=1e-3)
    record = json.loads((tmp_path / "raw.json").read_text())
    assert record["inputs"]["camera"]["path"] == str(tmp_path / "camera.toml")


def test_linear_pictures(tmp_path: Path) -> None:
    light = np.full((90, 120), 0.25, np.float32)
    light[30:60] = 4.0
    np.save(tmp_path / "scene.npy", light)
    tifffile.imwrite(tmp_path / "scene.tif", light)
    for name in ("scene.npy", "scene.tif"):
        truth = tmp_path / "truth.tif"
        simulated(tmp_path / name, *QUICK, "-o", tmp_path / "r.dng", "--truth", truth)
        found = values(truth)
        assert float(found.max()) == pytest.approx(4)
        assert float(found[0, 2, 2]) == pytest.approx(0.25)
        assert torch.equal(found[0], found[2])


def test_ctrl_c_on_a_terminal_writes_nothing(picture: Path, tmp_path: Path) -> None:
    before = listing(tmp_path)
    ours, theirs = pty.openpty()
    asked = ("--camera", "small", "--field-points", 51, "-o", tmp_path / "r.dng")
    with start("simulate", picture, *asked, stderr=theirs) as process:
        os.close(theirs)
        shown = read_terminal(ours, r"scene \S* *[1-9]\d? %.*\d+:\d\d")
        process.send_signal(signal.SIGINT)
        shown += read_terminal(ours, "")
        out = process.communicate(timeout=PATIENCE_S)[0]
    os.close(ours)
    assert process.returncode == 130 and out == ""
    assert "stopped at once" in shown and "Traceback" not in shown
    assert listing(tmp_path) == before
