"""`nolens calibrate pairs`: files of measurements and pictures to a PSF in the camera's folder."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from running import check_refused, listing, reconstruct, run
from skimage import data
from torch import Tensor

from nolens.camera import linear_from_srgb
from nolens.files import read_frame, read_psf, read_psf_set, write_tiff32
from nolens.operators import CroppedConvolution, PixelRectangle

SENSOR, SHOWN = (40, 56), (32, 44)
PHOTOGRAPHS = {"cat": data.chelsea, "cup": data.coffee, "rocket": data.rocket}
GIVEN = ("--distance", "30cm", "--pixel", "3.1um")


def pattern() -> Tensor:
    """Seven point sources and an arc behind an aperture, (rows, columns)."""
    psf = torch.zeros(SENSOR[0] + SHOWN[0], SENSOR[1] + SHOWN[1])
    for row, column in ((-7, -9), (-6, 4), (-1, -3), (2, 8), (4, -8), (7, 0), (6, 7)):
        psf[36 + row, 50 + column] = 1
    psf[30:42, 45] = 0.4
    return psf / psf.sum()


def write(folder: Path) -> None:
    """Colour pictures as 8-bit PNG, measurements as float TIFF, brighter in blue."""
    camera = CroppedConvolution(pattern()[None], SENSOR, PixelRectangle.centred(*SHOWN, SENSOR))
    for name in ("measured", "shown"):
        (folder / name).mkdir()
    for name, photograph in PHOTOGRAPHS.items():
        picture = Image.fromarray(photograph()).resize((SHOWN[1], SHOWN[0]))
        picture.save(folder / "shown" / f"{name}.png")
        pixels = torch.from_numpy(np.array(picture)).permute(2, 0, 1) / 255
        light = camera(linear_from_srgb(pixels)) * torch.tensor([1.0, 1.5, 2.0])[:, None, None]
        write_tiff32(folder / "measured" / f"{name}.tif", light.clamp_min(0))


@pytest.fixture
def pairs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def solved(*arguments: object) -> dict[str, Any]:
    done = run("calibrate", "pairs", "measured", "shown", *GIVEN, "-o", "camera", *arguments,
               "--json")  # fmt: skip
    assert done.code == 0 and done.err == "", done
    told: dict[str, Any] = json.loads(done.out)
    return told


def alike(one: Tensor, other: Tensor) -> float:
    return float((one * other).sum() / one.norm() / other.norm())


def test_psf_record_and_reconstruction(pairs: Path) -> None:
    told = solved()
    assert told["outputs"] == [
        str(Path("camera") / name) for name in ("solved-300mm.tif", "psfs.toml", "pairs-300mm.json")
    ]
    (entry,) = read_psf_set("camera").psf
    assert (entry.kind, entry.frame, entry.channels) == ("solved", "chief-ray", ("grey",))
    assert str(entry.pixel) == "3.1 um" and entry.distance_um == 300e3
    psf = read_psf("camera", entry)
    assert psf.shape == (1, 72, 100) and float(psf.min()) >= 0
    assert alike(psf[0], pattern()) > 0.9
    assert [row["name"] for row in told["pairs"]] == ["cat", "cup", "rocket"]
    for row in told["pairs"]:
        assert row["gain"] == pytest.approx([1 / 1.5, 1, 2 / 1.5], rel=0.02)
        assert max(row["residual_varying"]) < 0.05 and max(row["residual"]) < 0.15
    record = json.loads((pairs / "camera" / "pairs-300mm.json").read_text())
    assert record["result"] == told
    assert set(record["inputs"]) == {
        f"{kind} {name}" for kind in ("measurement", "picture") for name in PHOTOGRAPHS
    }
    scene = reconstruct(
        pairs / "out.tif", "measured/cat.tif", "--psf", "camera/solved-300mm.tif",
        "--psf-extent", "wide", "--support", "32x44", "--tau", 1e-5,
    )  # fmt: skip
    with Image.open("shown/cat.png") as picture:
        truth = linear_from_srgb(torch.from_numpy(np.array(picture)).permute(2, 0, 1) / 255)
    assert alike(scene[1] - scene[1].mean(), truth[1] - truth[1].mean()) > 0.9


def test_every_channel_and_check(pairs: Path) -> None:
    told = solved("--each-channel", "--check")
    psf = read_psf("camera", read_psf_set("camera").psf[0])
    assert psf.shape[0] == 3
    light = psf.sum(dim=(-2, -1))
    assert (light / light[0]).tolist() == pytest.approx([1, 1.5, 2], rel=0.05)
    assert [row["name"] for row in told["leave_one_out"]] == ["cat", "cup", "rocket"]
    for row in told["leave_one_out"]:
        assert row["psnr_db"] > 20 and 0.6 < row["ssim"] < 1 and max(row["residual"]) < 0.15


def test_order_of_channels_and_place(pairs: Path) -> None:
    """B, G, R in both kinds of file and a support that is said give the same PSF."""
    before = solved()
    for path in (*(pairs / "measured").iterdir(), *(pairs / "shown").iterdir()):
        if path.suffix == ".png":
            with Image.open(path) as picture:
                array = np.array(picture)
            Image.fromarray(array[..., ::-1].copy()).save(path)
        else:
            write_tiff32(path, read_frame(path).counts.flip(0))
    told = solved("--bgr", "--support", "32x44+4+6")
    assert [row["gain"] for row in told["pairs"]] == [row["gain"] for row in before["pairs"]]


def test_wrong_picture_is_named(pairs: Path) -> None:
    with Image.open("shown/cup.png") as picture:
        turned = picture.rotate(180)
    turned.save("shown/cup.png")
    done = run("calibrate", "pairs", "measured", "shown", *GIVEN, "-o", "camera")
    assert done.code == 0 and "the pair cup is explained badly" in done.err, done
    assert "the pair cat" not in done.err


def test_one_pair_is_too_few(pairs: Path) -> None:
    for name in ("cup", "rocket"):
        (pairs / "measured" / f"{name}.tif").unlink()
        (pairs / "shown" / f"{name}.png").unlink()
    done = run("calibrate", "pairs", "measured", "shown", *GIVEN, "-o", "camera")
    assert done.code == 0 and "1 pair can be explained by many PSFs" in done.err
    assert "cat" in done.out and "solved-300mm.tif" in done.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["no measured is given", "the folder of measurements", "calibrate pairs"]),
        (["measured"], ["no pictures is given", "the folder of pictures"]),
        (["measured", "shown", "-o", "out"], ["no distance is given"]),
        (["measured", "shown", "--distance", "30cm"], ["no output is given"]),
        (["measured", "shown", "--distance", "30", "-o", "out"], ["30 has no unit"]),
        (["measured", "shown", "--distance", "30cm", "-o", "out"], ["--pixel 1.55um"]),
        (["measured", "shown", *GIVEN[:3], "3.1", "-o", "out"], ["3.1 has no unit"]),
        (["measured", "none", *GIVEN, "-o", "out"], ["none is no folder"]),
        (["measured", "empty", *GIVEN, "-o", "out"], ["cat.tif has no partner", "3 measurements"]),
        (["empty", "empty", *GIVEN, "-o", "out"], ["empty is empty"]),
        (["measured", "shown", *GIVEN, "-o", "out", "--support", "30x44"], ["30×44", "32×44"]),
        (["measured", "shown", *GIVEN, "-o", "out", "--support", "3"], ["--support is '3'"]),
        (["measured", "dark", *GIVEN, "-o", "out"], ["cup.png is dark"]),
        (["measured", "even", *GIVEN, "-o", "out"], ["cup.png is the same everywhere"]),
        (["measured", "small", *GIVEN, "-o", "out"], ["16×22 pixels", "32×44"]),
        (["measured", "large", *GIVEN, "-o", "out"], ["320×440 pixels", "scale the pictures"]),
        (["measured", "shown", *GIVEN, "-o", "out", "--black", "9"], ["black"]),
        (["measured", "shown", *GIVEN, "-o", "measured/cat.tif"], ["is a file"]),
    ],
    ids=lambda each: " ".join(each)[-40:],
)  # fmt: skip
def test_refused(arguments: list[str], words: list[str], pairs: Path) -> None:
    for name in ("empty", "dark", "even", "small", "large"):
        (pairs / name).mkdir()
    for name in PHOTOGRAPHS:
        for folder in ("dark", "even", "small"):
            with Image.open(pairs / "shown" / f"{name}.png") as picture:
                picture.save(pairs / folder / f"{name}.png")
        Image.effect_noise((440, 320), 60).save(pairs / "large" / f"{name}.png")
    Image.new("RGB", SHOWN[::-1]).save(pairs / "dark" / "cup.png")
    Image.new("RGB", SHOWN[::-1], (9, 9, 9)).save(pairs / "even" / "cup.png")
    Image.effect_noise((22, 16), 60).save(pairs / "small" / "cup.png")
    before = listing(pairs)
    check_refused(run("calibrate", "pairs", *arguments), *words)
    assert listing(pairs) == before


def test_other_channels_in_the_folder(pairs: Path) -> None:
    solved()
    before = listing(pairs)
    done = run("calibrate", "pairs", "measured", "shown", *GIVEN, "-o", "camera", "--each-channel")
    check_refused(done, "has the channels grey", "another folder")
    assert listing(pairs) == before


def test_an_output_is_needed(pairs: Path) -> None:
    before = listing(pairs)
    done = run("calibrate", "pairs", "measured", "shown", "--distance", "3")
    check_refused(done, "no output is given")
    assert listing(pairs) == before
