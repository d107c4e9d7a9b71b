"""`nolens calibrate`: frames of a point source in files become PSFs in a folder."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from point_frames import (
    OFF_AXIS_DEG,
    bench,
    captured,
    dark_frames,
    light_of,
    smaller,
    truth,
)
from running import check_refused, listing, run

from nolens.calibrate.distances import Layers
from nolens.calibrate.exposures import superpixels
from nolens.camera import preset, to_toml
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_camera, read_psf, read_psf_set, write_frame
from nolens.optics.magnification import magnified
from nolens.quantities import Angle


def calibrate(folder: Path, *arguments: object, warnings: tuple[str, ...] = ()) -> dict[str, Any]:
    done = run("calibrate", *arguments, "-o", folder, "--json")
    assert done.code == 0, done.err
    told: dict[str, Any] = json.loads(done.out)
    assert len(told["warnings"]) == len(warnings), told["warnings"]
    for text, words in zip(told["warnings"], warnings, strict=True):
        assert words in text and text in done.err
    return told


def decibels(found: torch.Tensor, wanted: torch.Tensor) -> float:
    inner = (slice(None), slice(4, -4), slice(4, -4))
    found, wanted = found[inner], wanted[inner]
    return psnr(scale_fit(found, wanted), wanted, float(wanted.max()))


def test_depths_and_angles(tmp_path: Path) -> None:
    """Two depths share one centre, though the light stood elsewhere; one from the side stays."""
    folder, frames = tmp_path / "camera", tmp_path / "frames"
    darks = ["--dark", *dark_frames(frames)]  # As a shell makes it of --dark dark*.dng.
    far = captured(frames, "far", light_of(300.0, OFF_AXIS_DEG))
    told = calibrate(
        folder, *far, *darks, "--distance", "300mm", "--camera", "small",
        warnings=("dark frames of 10 ms",),
    )  # fmt: skip
    assert told["file"] == "psf-300mm.tif" and told["frame"] == "chief-ray"
    assert told["frames"] == 8 and told["unit"] == "counts per second"
    assert [each["ms"] for each in told["exposures"]] == pytest.approx([10, 40])
    assert [each["dark_frames"] for each in told["exposures"]] == [2, 2]
    assert told["exposures"][0]["clipped_fraction"] == 0 < told["exposures"][1]["clipped_fraction"]
    assert told["saturated_fraction"] == 0 and told["pixel"] == "3.1 um"
    assert told["frame_noise"]["from"] == "frames" and min(told["snr_db"]) > 40
    assert max(told["energy"]) == 1 and 0.3 < told["dark_fraction"] < 0.8
    # The paper's light is 0.2° off: through the layers, 4.5 um to the right and 2.2 um down.
    by_snell = Layers.of_camera(preset("small")).shift_um(
        (Angle.of(OFF_AXIS_DEG[0], "deg"), Angle.of(OFF_AXIS_DEG[1], "deg"))
    )
    assert told["centred_by"] == "centroid"
    assert told["shift_um"] == pytest.approx(by_snell, abs=0.8)
    assert sorted(path.name for path in folder.iterdir()) == [
        "calibrate-300mm.json", "camera.toml", "psf-300mm.tif", "psfs.toml",
    ]  # fmt: skip
    assert read_camera(folder).camera == preset("small")
    record = json.loads((folder / "calibrate-300mm.json").read_text())
    assert record["result"] == told and len(record["inputs"]) == 10
    assert record["warnings"] == told["warnings"]

    near = captured(frames, "near", light_of(80.0))
    told = calibrate(folder, *near, "--distance", "8cm")
    assert told["file"] == "psf-80mm.tif" and told["centred_by"] == "psf-300mm.tif"
    layers = Layers.of_camera(preset("small"))
    expected = layers.magnification(80e3) / layers.magnification(300e3)
    assert told["expected_magnification"] == pytest.approx(expected, abs=1e-6)
    assert told["magnification"] - 1 == pytest.approx(expected - 1, rel=0.05)
    assert told["correlation"] > 0.99

    side = captured(frames, "side", light_of(300.0, (4.0, 1.0)), fills=(0.5,))
    told = calibrate(folder, *side, "--distance", "300mm", "--angle", "4deg,1deg")
    assert told["file"] == "psf-300mm-4deg-1deg.tif" and told["frame"] == "sensor"
    assert told["shift_um"] == pytest.approx(told["expected_shift_um"], abs=2)

    listed = read_psf_set(folder).psf
    assert [(each.distance_um, each.on_axis, each.frame, each.kind) for each in listed] == [
        (300e3, True, "chief-ray", "captured"),
        (80e3, True, "chief-ray", "captured"),
        (300e3, False, "sensor", "captured"),
    ]
    assert all(each.usable_per_mm is not None for each in listed)
    psfs = [read_psf(folder, each) for each in listed]
    # Both are centred on the light of the first one, which lies beside the truth's middle.
    cells = tuple(each / 3.1 for each in by_snell)
    seen = json.loads((folder / "calibrate-300mm.json").read_text())["result"]["shift_um"]
    left = (-(seen[1] / 3.1 - cells[1]), seen[0] / 3.1 - cells[0])
    for psf, distance in zip(psfs[:2], (300.0, 80.0), strict=True):
        centred = magnified(truth(distance), 1.0, moved=(-left[0], -left[1]))
        assert decibels(psf, centred) > 50
    sideways = light_of(300.0, (4.0, 1.0))
    frame = bench().exposed(sideways, 0.1, 0)
    assert decibels(psfs[2], superpixels(sideways[None], frame)) > 50
    # The noise of the dark is kept, so that it adds no light.
    assert all(float(psf.min()) < 0 for psf in psfs[:2])


def test_again_replaces(tmp_path: Path) -> None:
    frames = captured(tmp_path, "a", light_of(300.0), fills=(0.5,), count=2)
    for text in ("300mm", "30cm"):
        calibrate(tmp_path / "camera", *frames, "--distance", text, "--pixel", "1.55um")
    assert [each.file for each in read_psf_set(tmp_path / "camera").psf] == ["psf-300mm.tif"]


def test_without_camera_or_times(tmp_path: Path) -> None:
    """A plain 16-bit TIFF says nothing; the magnification is then seen, not foretold."""
    plain = []
    for distance in (300.0, 60.0):
        dng = captured(tmp_path, f"p{distance:g}", light_of(distance), fills=(0.5,), count=2)
        for path in dng:
            counts = bench().exposed(light_of(distance), 0.5, len(plain)).counts[0]
            tiff = path.with_suffix(".tif")
            tifffile.imwrite(tiff, counts.numpy().astype(np.uint16), photometric="minisblack")
            plain.append(tiff)
    given = ("--pixel", "1.55um", "--mosaic", "RGGB")
    darks = [part for each in plain_darks(tmp_path) for part in ("--dark", each)]
    told = calibrate(tmp_path / "camera", *plain[:2], *given, *darks, "--distance", "300mm")
    assert told["camera"] is None and told["exposures"][0]["ms"] is None
    assert told["unit"] == "counts of one frame"
    told = calibrate(tmp_path / "camera", *plain[2:], "--mosaic", "RGGB", *darks,
                     "--distance", "60mm")  # fmt: skip
    assert told["expected_magnification"] is None
    expected = (1 + 1.277 / 60) / (1 + 1.277 / 300)
    assert told["magnification"] - 1 == pytest.approx(expected - 1, rel=0.06)
    done = run("calibrate", *plain[:2], *given, "--distance", "1m", "-o", tmp_path / "dim")
    assert done.code == 0 and "does not say which count is black" in done.err
    # The camera says what the files do not.
    told = calibrate(tmp_path / "known", *plain[:2], "--camera", "small", "--distance", "300mm")
    assert told["channels"] == ["R", "G", "B"] and told["exposures"][0]["dark_frames"] == 0


def plain_darks(folder: Path) -> list[Path]:
    paths = []
    for number in range(3):
        frame = bench().exposed(torch.ones(256, 320), 1e-9, 90 + number)
        path = folder / f"dark{number}.tif"
        tifffile.imwrite(path, frame.counts[0].numpy().astype(np.uint16), photometric="minisblack")
        paths.append(path)
    return paths


def test_warnings(tmp_path: Path) -> None:
    few = captured(tmp_path, "few", light_of(300.0), fills=(1.15,), count=2)
    told = calibrate(
        tmp_path / "camera", *few, "--distance", "300mm", "--camera", "small",
        warnings=("saturated in every exposure",),
    )  # fmt: skip
    assert 0 < told["saturated_fraction"] < 1e-3
    aside = captured(tmp_path, "aside", light_of(300.0, (4.0, 0.0)), fills=(0.5,), count=2)
    calibrate(
        tmp_path / "aside", *aside, "--distance", "300mm", "--camera", "small",
        warnings=("beside the middle, as of a light 4.0° off the axis",),
    )  # fmt: skip
    calibrate(
        tmp_path / "wrong", *aside, "--distance", "300mm", "--camera", "small",
        "--angle", "0deg,6deg", warnings=("Check the angle",),
    )  # fmt: skip
    dim = captured(tmp_path, "dimmer", light_of(300.0), fills=(0.5,), count=1)
    dim += captured(tmp_path, "dim", 0.8 * light_of(300.0), fills=(0.4,), count=1)
    calibrate(
        tmp_path / "flicker", *dim, "--distance", "300mm", "--camera", "small",
        "--exposure", "10ms", warnings=("differ by 20 % in brightness",),
    )  # fmt: skip


def test_text_for_people(tmp_path: Path) -> None:
    frames = captured(tmp_path, "a", light_of(300.0), count=2)
    done = run("calibrate", *frames, "--distance", "300mm", "--camera", "small",
                   "-o", tmp_path / "camera")  # fmt: skip
    assert done.code == 0 and done.err == "", done
    for words in ("2 frames of 10 ms", "2 frames of 40 ms, ", "% clipped",
                  "0 % saturated in all of them",
                  "counts to the electron (from the frames)", "128×160 pixels of 3.1 um",
                  "of the sensor is dark", "centred by centroid", "lines to the mm",
                  str(tmp_path / "camera" / "psf-300mm.tif")):  # fmt: skip
        assert words in done.out, words


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--distance", "300mm"], ["no frame is given", "nolens calibrate FRAME"]),
        (["a.dng"], ["no distance is given"]),
        (["a.dng", "--distance", "300"], ["300 has no unit"]),
        (["a.dng", "--distance", "0mm"], ["0.1 µm to 1000000 m"]),
        (["a.dng", "--distance", "300mm", "--angle", "20"], ["angle", "20deg,0deg"]),
        (["a.dng", "--distance", "300mm", "--angle", "20,0"], ["20 has no unit"]),
        (["a.dng", "--distance", "300mm", "--pixel", "1.55"], ["1.55 has no unit"]),
        (["a.dng", "--distance", "300mm", "--exposure", "10"], ["10 has no unit"]),
        (["a.dng", "--distance", "300mm", "--exposure", "0ms"], ["0.001 µs to 1000000 s"]),
        (
            ["a.dng", "b.dng", "a40.dng", "--distance", "300mm", "--exposure", "1ms",
             "--exposure", "2ms"],
            ["2 times for 3 frames"],
        ),
        (["a.dng", "a.dng", "--distance", "300mm"], ["a.dng is given twice"]),
        (["a.dng", "--dark", "a.dng", "--distance", "300mm"], ["a.dng is given twice"]),
        (["no.dng", "--distance", "300mm", "--pixel", "1.55um"], ["there is no file no.dng"]),
        (["a.dng", "--distance", "300mm"], ["the pixels is not known", "--pixel 1.55um"]),
        (
            ["a.dng", "--distance", "300mm", "--camera", "small", "--pixel", "3.1um"],
            ["--pixel 3.1 um", "3.1 um wide", "2 of its pixels are 6.2 um"],
        ),
        (
            ["smaller.dng", "--distance", "300mm", "--camera", "small"],
            ["240×320 pixels", "'small' has 256×320"],
        ),
        (["a.dng", "smaller.dng", "--distance", "300mm", "--pixel", "1.55um"], ["240×320 pixels"]),
        (["a.dng", "turned.tif", "--distance", "300mm", "--pixel", "1.55um"], ["mosaic BGGR"]),
        (
            ["a.dng", "untimed.tif", "--distance", "300mm", "--pixel", "1.55um"],
            ["says no exposure time", "--exposure"],
        ),
        (
            ["untimed.tif", "bright.tif", "--distance", "300mm", "--pixel", "1.55um"],
            ["do not say their exposure times", "--exposure"],
        ),
        (["long.dng", "--distance", "300mm", "--pixel", "1.55um"],
         ["saturated in every exposure", "shorter"]),
        (["dark.dng", "--distance", "300mm", "--pixel", "1.55um"], ["nothing above its noise"]),
        (["even.dng", "--distance", "300mm", "--pixel", "1.55um"], ["no point source"]),
        (["dark.dng", "--dark", "a.dng", "--distance", "300mm", "--pixel", "1.55um"],
         ["dark frame a.dng is brighter"]),
        (
            ["a40.dng", "--dark", "dark.dng", "--dark", "dark20.dng", "--distance", "300mm",
             "--pixel", "1.55um"],
            ["no dark frame of 40 ms", "10 ms, 20 ms"],
        ),
        (["a.dng", "--distance", "300mm", "--camera", "smal"], ["Did you mean the preset 'small'"]),
    ],
    ids=lambda each: " ".join(each)[-50:],
)  # fmt: skip
def test_refused(
    arguments: list[str], words: list[str], kit: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(kit)
    before = listing(kit)
    check_refused(run("calibrate", *arguments, "-o", "camera"), *words)
    assert listing(kit) == before


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames that fit, and frames that do not."""
    folder = tmp_path_factory.mktemp("kit")
    light = light_of(300.0)

    def one(name: str, light: torch.Tensor, fill: float, timed: bool = True) -> None:
        suffix = Path(name).suffix
        made = captured(folder, "x", light, fills=(fill,), count=1, timed=timed, suffix=suffix)
        made[0].rename(folder / name)

    one("a.dng", light, 0.5)
    one("b.dng", light, 0.5)
    one("a40.dng", light, 2.0)
    one("long.dng", light, 3.0)
    one("untimed.tif", light, 0.4, timed=False)
    one("bright.tif", light, 0.6, timed=False)
    rows, columns = (torch.linspace(-1, 1, n) for n in (256, 320))
    one("even.dng", 1 - 0.3 * rows[:, None].square() - 0.1 * columns.square(), 0.8)
    smaller(folder)
    for ms, name in ((10.0, "dark.dng"), (20.0, "dark20.dng")):
        dark_frames(folder, ms, 1)[0].rename(folder / name)
    turned = replace(bench().exposed(light, 0.5, 1), mosaic="BGGR", exposure_s=0.01)
    write_frame(folder / "turned.tif", turned)
    return folder


def test_what_is_in_the_folder_must_fit(tmp_path: Path) -> None:
    frames = captured(tmp_path, "a", light_of(300.0), fills=(0.5,), count=2)
    folder = tmp_path / "camera"
    calibrate(folder, *frames, "--distance", "300mm", "--camera", "small")
    before = listing(tmp_path)
    near = captured(tmp_path / "more", "n", light_of(80.0).flip(0), fills=(0.5,), count=2)
    before = listing(tmp_path)
    for arguments, words in (
        ((*frames, "--distance", "1m", "--camera", "paper"), "is not the camera"),
        ((*frames, "--distance", "1m", "--pixel", "1.5um"), "--pixel 1.5 um"),
        ((*near, "--distance", "8cm"), "the PSF is not that of"),
    ):
        check_refused(run("calibrate", *arguments, "-o", folder), words)
        assert listing(tmp_path) == before
    plain = tmp_path / "plain"
    plain.mkdir()
    (plain / "camera.toml").write_text("name = 3")
    check_refused(run("calibrate", *frames, "--distance", "1m", "-o", plain), "camera.toml")
    file = tmp_path / "file.txt"
    file.touch()
    check_refused(run("calibrate", *frames, "--distance", "1m", "-o", file), "file.txt is a file")


def test_a_camera_with_files_is_copied_whole(tmp_path: Path) -> None:
    given = tmp_path / "given"
    (given / "curves").mkdir(parents=True)
    text = to_toml(preset("small"))
    at = text.index("[sensor.acceptance]"), text.index("[sensor.package]")
    curve = '[sensor.acceptance]\nfile = "curves/angles.csv"\n\n'
    (given / "camera.toml").write_text(text[: at[0]] + curve + text[at[1] :])
    (given / "curves" / "angles.csv").write_text("angle_deg,response\n0,1\n60,0.5\n")
    frames = captured(tmp_path, "a", light_of(300.0), fills=(0.5,), count=2)
    told = calibrate(tmp_path / "camera", *frames, "--distance", "300mm", "--camera", given)
    assert read_camera(tmp_path / "camera").acceptance.response == (1, 0.5)
    assert str(tmp_path / "camera" / "curves" / "angles.csv") in told["outputs"]
    other = tmp_path / "other"
    (other / "curves").mkdir(parents=True)
    (other / "curves" / "angles.csv").write_text("mine")
    done = run("calibrate", *frames, "--distance", "300mm", "--camera", given, "-o", other)
    check_refused(done, "would overwrite", "angles.csv")
