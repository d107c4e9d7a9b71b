"""Pictures of scenes: what is linear, what is opaque, and what is refused."""

from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile
import torch
from PIL import Image

from nolens.camera import linear_from_srgb
from nolens.errors import FileError
from nolens.files import read_picture

COLOURS = np.random.default_rng(0).integers(0, 256, (5, 7, 4), dtype=np.uint8)


def linear(values: np.ndarray) -> torch.Tensor:
    return linear_from_srgb(torch.from_numpy(values.astype(np.float32) / 255)).movedim(-1, 0)


def test_colour_with_alpha(tmp_path: Path) -> None:
    Image.fromarray(COLOURS).save(tmp_path / "a.png")
    found = read_picture(tmp_path / "a.png")
    assert torch.allclose(found.radiance, linear(COLOURS[..., :3]))
    assert found.opacity is not None
    assert torch.allclose(found.opacity, torch.from_numpy(COLOURS[..., 3] / 255).float())


def test_grey_is_white_light(tmp_path: Path) -> None:
    Image.fromarray(COLOURS[..., 0]).save(tmp_path / "a.png")
    Image.fromarray(COLOURS[..., [0, 3]], "LA").save(tmp_path / "b.png")
    first, second = (read_picture(tmp_path / name) for name in ("a.png", "b.png"))
    assert torch.allclose(first.radiance, linear(COLOURS[..., [0, 0, 0]]))
    assert torch.equal(first.radiance, second.radiance)
    assert first.opacity is None and second.opacity is not None


def test_palette(tmp_path: Path) -> None:
    flat = (COLOURS[..., :3] // 128) * 255
    Image.fromarray(flat).convert("P", palette=Image.Palette.ADAPTIVE).save(tmp_path / "a.png")
    assert torch.allclose(read_picture(tmp_path / "a.png").radiance, linear(flat))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_sixteen_bits(suffix: str, tmp_path: Path) -> None:
    deep = COLOURS.astype(np.uint16) * 257
    path = tmp_path / f"a{suffix}"
    if suffix == ".tif":
        tifffile.imwrite(path, deep, photometric="rgb", extrasamples=["unassalpha"])
    else:
        path.write_bytes(imagecodecs.png_encode(deep))
    found = read_picture(path)
    assert torch.allclose(found.radiance, linear(COLOURS[..., :3]), atol=1e-6)
    assert found.opacity is not None and found.opacity.shape == (5, 7)


def test_colours_that_are_multiplied_by_alpha(tmp_path: Path) -> None:
    multiplied = np.full((5, 7, 4), 0.5, np.float32)
    multiplied[..., :3] = [0.2, 0.3, 0.4]
    tifffile.imwrite(tmp_path / "a.tif", multiplied, photometric="rgb", extrasamples=["assocalpha"])
    found = read_picture(tmp_path / "a.tif")
    assert found.radiance[:, 0, 0].tolist() == pytest.approx([0.4, 0.6, 0.8])
    assert found.opacity is not None and float(found.opacity[0, 0]) == 0.5


def test_jpeg_is_turned_upright(tmp_path: Path) -> None:
    halves = np.zeros((16, 32, 3), np.uint8)
    halves[:, :16] = 255
    turned = Image.Exif()
    turned[0x0112] = 6  # To be shown turned by 90° clockwise.
    Image.fromarray(halves).save(tmp_path / "a.jpg", exif=turned, quality=95)
    found = read_picture(tmp_path / "a.jpg").radiance
    assert found.shape == (3, 32, 16)
    assert float(found[:, :14].min()) > 0.9 and float(found[:, 18:].max()) < 0.1


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
def test_floats_are_linear(kind: type, tmp_path: Path) -> None:
    light = (COLOURS[..., :3] / 16).astype(kind)
    np.save(tmp_path / "a.npy", light)
    tifffile.imwrite(tmp_path / "a.tif", light, photometric="rgb")
    for name in ("a.npy", "a.tif"):
        found = read_picture(tmp_path / name).radiance
        assert torch.equal(found, torch.from_numpy(light.astype(np.float32)).movedim(-1, 0))


def test_what_is_refused(tmp_path: Path) -> None:
    def refused(name: str, *words: str) -> None:
        with pytest.raises(FileError) as caught:
            read_picture(tmp_path / name)
        for word in (name, *words):
            assert word in str(caught.value), word

    refused("none.png", "no file")
    (tmp_path / "folder").mkdir()
    refused("folder", "is a folder", "A scene is a .png")
    (tmp_path / "a.gif").write_bytes(b"GIF89a")
    refused("a.gif", "suffix .gif is not known", "A scene is a .png, .jpg or .tif")
    Image.fromarray(COLOURS[..., :3]).save(tmp_path / "picture.jpg")
    data = (tmp_path / "picture.jpg").read_bytes()
    (tmp_path / "wrong.png").write_bytes(data)
    refused("wrong.png", "it is a JPEG file")
    (tmp_path / "cut.jpg").write_bytes(data[: len(data) // 2])
    refused("cut.jpg", "damaged or incomplete")
    (tmp_path / "empty.jpg").write_bytes(b"")
    refused("empty.jpg", "is empty")
    Image.new("CMYK", (8, 8)).save(tmp_path / "press.jpg")
    refused("press.jpg", "CMYK", "grey and RGB")
    np.save(tmp_path / "counts.npy", COLOURS[..., 0])
    refused("counts.npy", "uint8", "linear radiance as floats")
    for name, value in (("nan.npy", np.nan), ("inf.npy", np.inf), ("dark.npy", -1.0)):
        np.save(tmp_path / name, np.full((4, 4), value))
        refused(name, "NaN, infinity or negative")
    np.save(tmp_path / "bright.npy", np.full((4, 4), 1e35))
    refused("bright.npy", "values up to 1e+35")
    tifffile.imwrite(tmp_path / "whole.tif", COLOURS[..., 0].astype(np.int32))
    refused("whole.tif", "int32")
