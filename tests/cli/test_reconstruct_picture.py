"""The picture comes out near the truth, and each thing done wrong is seen in it."""

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
from running import reconstruct, run
from torch import Tensor

from nolens.files import read_frame
from nolens.operators import PixelRectangle

# The right picture has about 40 dB, and the best of the mistakes below 28.2 dB.
GOOD, MISTAKEN = 36.0, 30.0


def quick(out: Path, *arguments: object) -> Tensor:
    """As `reconstruct`, where the choice of the weight is not what is tested."""
    return reconstruct(out, *arguments, *QUICK)


@pytest.mark.parametrize(("prior", "bound"), [("auto", 30.0), ("tv", GOOD)])
def test_picture_is_near_the_truth(prior: str, bound: float, camera: Camera, out: Path) -> None:
    """Its squares are what total variation is for."""
    asked = ("--psf", camera.psf, "--support", SUPPORT, "--prior", prior)
    picture = reconstruct(out, camera.raw, *asked)
    assert picture.shape == (3, *SCENE)
    assert quality(picture) > bound


def test_without_region_the_crop_shows_the_scene(camera: Camera, out: Path) -> None:
    picture = quick(out, camera.raw, "--psf", camera.psf, "--crop", SUPPORT)
    assert picture.shape == (3, *SCENE)
    assert quality(picture) > 30


MISTAKES = {
    "psf upside down": lambda psf: psf.flip(-2),
    "psf mirrored": lambda psf: psf.flip(-1),
    "psf turned": lambda psf: psf.flip(-2, -1),
    "psf one cell down": lambda psf: psf.roll(1, -2),
    "psf one cell right": lambda psf: psf.roll(1, -1),
    "psf's channels in another order": lambda psf: psf.flip(0),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_wrong_psf_is_seen(mistake: str, camera: Camera, out: Path) -> None:
    wrong = expose_dng(out.with_name("wrong.dng"), MISTAKES[mistake](spots()), seed=2)
    asked = ("--psf", wrong, "--support", SUPPORT)
    assert quality(quick(out, camera.raw, *asked, "--psf-flip", "none")) < MISTAKEN


@pytest.mark.parametrize("flip", ["vertical", "horizontal", "both"])
def test_wrong_orientation_is_seen(flip: str, camera: Camera, out: Path) -> None:
    asked = ("--psf", camera.psf, "--support", SUPPORT, "--flip")
    picture = quick(out, camera.raw, *asked, flip)
    assert quality(picture) < MISTAKEN
    axes = {"vertical": (-2,), "horizontal": (-1,), "both": (-2, -1)}[flip]
    assert torch.equal(picture.flip(axes), quick(out, camera.raw, *asked, "none"))


@pytest.mark.parametrize("black", [0, 200, 400])
def test_wrong_black_level_is_seen(black: int, camera: Camera, out: Path) -> None:
    picture = quick(out, camera.raw, "--psf", camera.psf, "--support", SUPPORT, "--black", black)
    assert quality(picture) < MISTAKEN
    right = quick(out, camera.raw, "--psf", camera.psf, "--support", SUPPORT, "--black", BLACK)
    assert quality(right) > GOOD


@pytest.mark.parametrize(("method", "bound"), [("fista", GOOD), ("wiener", 26.0)])
def test_methods(method: str, bound: float, camera: Camera, out: Path) -> None:
    asked = ("--psf", camera.psf, "--support", SUPPORT, "--method", method)
    assert quality(reconstruct(out, camera.raw, *asked)) > bound


@pytest.mark.parametrize("prior", ["tv", "isotropic-tv", "l1", "none"])
def test_priors(prior: str, camera: Camera, out: Path) -> None:
    asked = ("--psf", camera.psf, "--support", SUPPORT, "--prior", prior)
    assert quality(reconstruct(out, camera.raw, *asked)) > (GOOD if "tv" in prior else 22)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".npy"])
@pytest.mark.parametrize("channels", [1, 3])
def test_files_without_a_mosaic(suffix: str, channels: int, tmp_path: Path, out: Path) -> None:
    psf, scene = spots()[:channels], truth()[:channels]
    raw = save(tmp_path / f"raw{suffix}", as_counts(measured(psf, scene), seed=1))
    point = save(tmp_path / f"psf{suffix}", as_counts(psf, seed=2))
    asked = ("--psf", point, "--support", SUPPORT, "--black", BLACK)
    picture = quick(out, raw, *asked)
    assert picture.shape == (channels, *SCENE)
    assert quality(picture, scene) > GOOD
    if channels == 3:  # Both files are turned to B, G, R, and with them the picture.
        assert torch.allclose(quick(out, raw, *asked, "--bgr"), picture.flip(0), rtol=1e-3)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_files_in_bgr(suffix: str, tmp_path: Path, out: Path) -> None:
    raw = save(tmp_path / f"raw{suffix}", as_counts(measured(spots()), seed=1).flip(0))
    point = save(tmp_path / f"psf{suffix}", as_counts(spots(), seed=2).flip(0))
    asked = ("--psf", point, "--support", SUPPORT, "--black", BLACK)
    assert quality(quick(out, raw, *asked, "--bgr")) > GOOD
    assert quality(quick(out, raw, *asked)) < MISTAKEN


@pytest.mark.parametrize("suffix", [".png", ".tif", ".npy"])
def test_mosaic_in_a_plain_file(suffix: str, camera: Camera, tmp_path: Path, out: Path) -> None:
    raw = save(tmp_path / f"raw{suffix}", read_frame(camera.raw).counts)
    point = save(tmp_path / f"psf{suffix}", read_frame(camera.psf).counts)
    asked = ("--support", SUPPORT, "--mosaic", "RGGB", "--black", BLACK)
    right = quick(out, camera.raw, "--psf", camera.psf, "--support", SUPPORT)
    both = quick(out, raw, "--psf", point, *asked, "--white", WHITE)
    assert torch.equal(both, right)
    # A DNG says its mosaic itself, and may stand beside a file that does not.
    assert torch.equal(quick(out, raw, "--psf", camera.psf, *asked), right)
    swapped = [each.replace("RGGB", "BGGR") if isinstance(each, str) else each for each in asked]
    assert quality(quick(out, raw, "--psf", point, *swapped)) < MISTAKEN


def test_grey_psf_serves_every_channel(tmp_path: Path, out: Path) -> None:
    grey = spots().mean(0, keepdim=True)
    point = save(tmp_path / "psf.npy", grey)
    raw = expose_dng(tmp_path / "raw.dng", measured(grey), seed=1)
    picture = quick(out, raw, "--psf", point, "--support", SUPPORT)
    assert picture.shape == (3, *SCENE)
    assert quality(picture) > GOOD


def test_whole_domain_has_the_scene_in_it(camera: Camera, out: Path) -> None:
    asked = (camera.raw, "--psf", camera.psf, "--support", "full", "--crop")
    whole = quick(out, *asked, "all")
    assert whole.shape[1] > SENSOR[0] and whole.shape[2] > SENSOR[1]
    sensor = quick(out, *asked, f"{SENSOR[0]}x{SENSOR[1]}")
    assert torch.equal(sensor, quick(out, *asked[:-1]))
    part = quick(out, *asked, "5x7+12+20")
    assert torch.equal(part, sensor[:, 12:17, 20:27])
    beside = quick(out, *asked, "5x7-3-4")
    top, left = ((whole.shape[k + 1] - SENSOR[k]) // 2 for k in (0, 1))
    assert torch.equal(beside, whole[:, top - 3 : top + 2, left - 4 : left + 3])


def test_region_partly_beside_the_sensor(tmp_path: Path, out: Path) -> None:
    psf, support = spots(), PixelRectangle(-8, -5, *SCENE)
    raw = expose_dng(tmp_path / "raw.dng", measured(psf, support=support), seed=1)
    point = expose_dng(tmp_path / "psf.dng", psf, seed=2)
    asked = (raw, "--psf", point, "--support")
    assert quality(quick(out, *asked, "24x32-8-5")) > 25
    assert quality(quick(out, *asked, "24x32-7-5")) < 20
    done = run("reconstruct", *asked, "24x32-8-5", "--crop", "20x20+0+0", "-o", out)
    assert done.code == 2 and "24×32 pixels from -8-5" in done.err
