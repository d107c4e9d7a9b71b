"""Every option changes what it says it changes."""

import json
from pathlib import Path

import pytest
import torch
from little_camera import (
    BLACK,
    QUICK,
    SCENE,
    SENSOR,
    SUPPORT,
    WHITE,
    Camera,
    as_counts,
    expose_dng,
    measured,
    quality,
    save,
    spots,
    truth,
)
from running import check_refused, reconstruct, run

from nolens.files import read_frame
from nolens.operators import CroppedConvolution, PixelRectangle

GOOD = 36.0


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """Measurement and PSF as 16-bit PNG, which state no black level."""
    raw = save(tmp_path / "raw.png", as_counts(measured(spots()), seed=1))
    return raw, save(tmp_path / "psf.png", as_counts(spots(), seed=2))


def test_dark_frame(files: tuple[Path, Path], out: Path) -> None:
    raw, psf = files
    glow = torch.linspace(0, 400, SENSOR[1]).expand(3, *SENSOR).round()
    for path in files:
        save(path, read_frame(path).counts + glow)
    dark = save(out.with_name("dark.png"), glow + BLACK)
    asked = (raw, "--psf", psf, "--support", SUPPORT, *QUICK)
    assert quality(reconstruct(out, *asked, "--dark", dark)) > GOOD
    assert quality(reconstruct(out, *asked, "--black", BLACK)) < 28


def test_flat_field(files: tuple[Path, Path], out: Path) -> None:
    raw, psf = files
    vignette = torch.linspace(0.4, 1, SENSOR[0])[:, None].expand(3, *SENSOR)
    for path in files:
        counts = read_frame(path).counts
        save(path, (BLACK + (counts - BLACK) * vignette).round())
    flat = save(out.with_name("flat.png"), (BLACK + 3000 * vignette).round())
    asked = (raw, "--psf", psf, "--support", SUPPORT, "--black", BLACK, *QUICK)
    # The same sensor measured the PSF, but it is not the PSF that the flat field is given for.
    even = save(out.with_name("even.png"), as_counts(spots(), seed=2))
    with_flat = quality(reconstruct(out, raw, "--psf", even, *asked[3:], "--flat", flat))
    assert with_flat > GOOD
    assert with_flat > 8 + quality(reconstruct(out, raw, "--psf", even, *asked[3:]))


def test_black_read_off_the_psf(files: tuple[Path, Path], out: Path) -> None:
    raw, psf = files
    asked = (raw, "--psf", psf, "--support", SUPPORT, *QUICK)
    auto = reconstruct(out, *asked, "--black", "auto")
    assert quality(auto) > GOOD
    assert quality(reconstruct(out, *asked)) < 28


def test_saturated_pixels_are_left_out(files: tuple[Path, Path], out: Path) -> None:
    raw, psf = files
    asked = (raw, "--psf", psf, "--support", SUPPORT, "--black", BLACK, "--tau", 8e-3)
    good = quality(reconstruct(out, *asked))
    counts = read_frame(raw).counts
    generator = torch.Generator().manual_seed(5)
    blown = torch.rand(counts.shape, generator=generator) < 0.05
    save(raw, torch.where(blown, WHITE, counts))
    left_out = quality(reconstruct(out, *asked, "--white", WHITE))
    # So many pixels of the largest count are taken for saturated, unless --white says otherwise.
    assert quality(reconstruct(out, *asked)) == pytest.approx(left_out)
    as_data = quality(reconstruct(out, *asked, "--white", WHITE + 1))
    assert left_out > good - 2
    assert as_data < good - 15


@pytest.mark.parametrize("channels", ["g", "rb", "bgr", "grey"])
def test_channels(channels: str, camera: Camera, out: Path) -> None:
    asked = (camera.raw, "--psf", camera.psf, "--support", SUPPORT, *QUICK)
    picture = reconstruct(out, *asked, "--channels", channels)
    scene = truth()
    if channels == "grey":
        assert picture.shape[0] == 1
        assert quality(picture, scene.mean(0, keepdim=True)) > 18  # The PSFs are not alike.
    elif channels == "g":
        assert quality(picture, scene[1:2]) > GOOD
    else:
        missing = torch.tensor([letter in channels for letter in "rgb"]).float()
        assert quality(picture, scene * missing[:, None, None]) > GOOD


def test_bin(camera: Camera, out: Path) -> None:
    asked = (camera.raw, "--psf", camera.psf, "--bin", 2, "--crop", "12x16", *QUICK)
    picture = reconstruct(out, *asked)
    assert picture.shape == (3, 12, 16)
    assert quality(picture, torch.nn.functional.avg_pool2d(truth()[None], 2)[0]) > 18


def test_finer_psf(tmp_path: Path, out: Path) -> None:
    fine = spots((96, 128))
    psf = torch.nn.functional.avg_pool2d(fine[None], 2)[0]
    raw = expose_dng(tmp_path / "raw.dng", measured(psf), seed=1)
    point = expose_dng(tmp_path / "psf.dng", fine, seed=2)
    asked = (raw, "--psf", point, "--support", SUPPORT, *QUICK)
    finer = reconstruct(out, *asked, "--psf-scale", 2)
    assert quality(finer) > GOOD
    assert quality(reconstruct(out, *asked, "--psf-extent", "wide")) < 20
    without = run("reconstruct", *asked, "-o", out, "--tiff-bits", 32)
    assert "2 times finer (--psf-scale 2): " in without.err and "--psf-extent wide" in without.err
    assert torch.equal(read_frame(out).counts, finer)
    mirrored = expose_dng(tmp_path / "mirrored.dng", fine.flip(-1), seed=2)
    done = run("reconstruct", raw, "--psf", mirrored, *asked[3:], "-o", out)
    assert "2 times finer" in done.err and "left to right (--psf-flip horizontal)" in done.err
    assert quality(read_frame(out).counts) > GOOD
    trials = json.loads(out.with_suffix(".json").read_text())["parameters"]["psf"]["trials"]
    assert {each["flip"] for each in trials} == {"none", "horizontal", "vertical", "both"}


def test_wider_psf(tmp_path: Path, out: Path) -> None:
    wide = spots((72, 96))
    support = PixelRectangle.centred(*SCENE, SENSOR)
    light = CroppedConvolution(wide, SENSOR, support)(truth()).clamp_min(0)
    raw = expose_dng(tmp_path / "raw.dng", light, seed=1)
    point = expose_dng(tmp_path / "psf.dng", wide, seed=2)
    asked = (raw, "--psf", point, "--support", SUPPORT, "--tau", 8e-3)
    wanted = reconstruct(out, *asked, "--psf-extent", "wide")
    right = quality(wanted)
    assert right > GOOD
    cut = expose_dng(tmp_path / "cut.dng", wide[:, 12:60, 16:80], seed=2)
    assert quality(reconstruct(out, raw, "--psf", cut, *asked[3:])) < right - 8
    done = run("reconstruct", *asked, "-o", out, "--tiff-bits", 32)
    assert done.code == 0 and "is taken as extended (--psf-extent wide)" in done.err
    assert torch.equal(read_frame(out).counts, wanted)
    refused = run("reconstruct", *asked, "--psf-extent", "sensor", "-o", out)
    check_refused(refused, "72×96", "48×64", "--psf-extent", "wide")


def test_region_in_both_notations(camera: Camera, out: Path) -> None:
    asked = (camera.raw, "--psf", camera.psf, *QUICK, "--support")
    middle = reconstruct(out, *asked, "24x32")
    assert torch.equal(reconstruct(out, *asked, "24x32+12+16"), middle)
    assert quality(reconstruct(out, *asked, "24x32+13+16")) < 20
    part = reconstruct(out, *asked, "24x32", "--crop", "10x12+14+18")
    assert torch.equal(part, middle[:, 2:12, 2:14])


def history(out: Path) -> list[dict[str, float]]:
    rows: list[dict[str, float]] = json.loads(out.with_suffix(".json").read_text())["history"]
    return rows


def test_penalties_balance_and_relaxation(camera: Camera, out: Path) -> None:
    asked = (camera.raw, "--psf", camera.psf, "--support", SUPPORT)
    asked = (*asked, "--tau", 8e-3, "--iterations", 9, "--tolerance", 0)
    reconstruct(out, *asked, "--penalties", 0.5, 3, 0.25, "--no-balance")
    for row in history(out):
        assert [row[f"penalty_{k}"] for k in (1, 2, 3)] == [0.5, 3, 0.25]
    still = history(out)[-1]["objective"]
    reconstruct(out, *asked, "--penalties", 0.5, 3, 0.25, "--no-balance", "--relaxation", 1)
    assert history(out)[-1]["objective"] != still
    reconstruct(out, *asked, "--penalties", 0.5, 3, 0.25)
    first, last = history(out)[0], history(out)[-1]
    assert first["penalty_1"] == 0.5 and last["penalty_1"] != 0.5


def test_tau_iterations_and_tolerance(camera: Camera, out: Path) -> None:
    asked = (camera.raw, "--psf", camera.psf, "--support", SUPPORT)
    soft = reconstruct(out, *asked, "--tau", 1e-1, "--tolerance", 0)
    assert history(out)[-1]["iteration"] == 200
    sharp = reconstruct(out, *asked, "--tau", 1e-4)
    assert soft.diff(dim=-1).abs().sum() < 0.8 * sharp.diff(dim=-1).abs().sum()
    reconstruct(out, *asked, "--tau", 1e-4, "--iterations", 3)
    assert history(out)[-1]["iteration"] == 3
    reconstruct(out, *asked, "--tau", 1e-4, "--tolerance", 0.3)
    assert history(out)[-1]["iteration"] < 50


@pytest.mark.parametrize("device", ["cpu", "auto"])
def test_device(device: str, camera: Camera, out: Path) -> None:
    asked = (camera.raw, "--psf", camera.psf, "--support", SUPPORT, "-o", out)
    asked = (*asked, "--tau", 1, "--iterations", 2, "--json")
    done = run("reconstruct", *asked, "--device", device)
    expected = "cuda" if device == "auto" and torch.cuda.is_available() else "cpu"
    assert json.loads(done.out)["device"] == expected
