"""Public data sets, in small files of exactly their layouts."""

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import torch
from PIL import Image
from pyarrow import parquet
from torch import Tensor

from nolens.camera import linear_from_srgb
from nolens.errors import FileError
from nolens.files import read_frame, read_picture, write_tiff16, write_tiff32
from nolens.files.picture_sets import open_pictures
from nolens.files.sequences import open_sequence

GENERATOR = np.random.default_rng(2)
PIXELS = [GENERATOR.integers(0, 255, (12, 18, 3), dtype=np.uint8) for _ in range(5)]


def radiance(pixels: np.ndarray) -> Tensor:  # type: ignore[type-arg]
    return linear_from_srgb(torch.from_numpy(pixels).permute(2, 0, 1) / 255)


def png(pixels: np.ndarray) -> bytes:  # type: ignore[type-arg]
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()


@pytest.mark.parametrize(
    "folders", [("diffuser_images", "ground_truth_lensed"), ("diffuser", "lensed")]
)
def test_diffusercam_mirflickr(tmp_path: Path, folders: tuple[str, str]) -> None:
    """imN.npy, float, B, G, R; a list of a split names im3.jpg.tiff."""
    for folder in folders:
        (tmp_path / folder).mkdir()
        for number, pixels in enumerate(PIXELS):
            stored = pixels[..., ::-1].astype(np.float32) / 255
            np.save(tmp_path / folder / f"im{number}.npy", stored)
    (tmp_path / "dataset_test.csv").write_text("im3.jpg.tiff\nim1.jpg.tiff\n")
    found = open_pictures(tmp_path)
    assert sorted(found.names) == [f"im{number}" for number in range(5)]
    assert torch.equal(found.read("im2"), torch.from_numpy(PIXELS[2]).permute(2, 0, 1) / 255)
    test = open_pictures(tmp_path / "dataset_test.csv")
    assert test.names == ("im3", "im1")
    assert torch.equal(test.read("im3"), found.read("im3"))


@pytest.mark.parametrize("named", [True, False])
def test_parquet_of_hugging_face(tmp_path: Path, named: bool) -> None:
    """Shards of splits, with row groups; columns lensless, lensed and the mask's number."""
    (tmp_path / "data").mkdir()
    for number, (split, rows) in enumerate((("test", [0, 1]), ("train", [2, 3, 4]))):
        columns = {
            column: [
                {"bytes": png(PIXELS[row] if column == "lensed" else 255 - PIXELS[row]),
                 "path": f"im{row}.png" if named else None}
                for row in rows
            ]
            for column in ("lensless", "lensed")
        }  # fmt: skip
        table = pa.table({**columns, "mask_label": rows})
        where = tmp_path / "data" / f"{split}-00000-of-00001.parquet"
        parquet.write_table(table, where, row_group_size=2)
        assert number < 2
    found = open_pictures(tmp_path)
    names = [f"im{row}" for row in range(5)] if named else [
        "test-00000", "test-00001", "train-00000", "train-00001", "train-00002"
    ]  # fmt: skip
    assert list(found.names) == names
    for name, pixels in zip(names, PIXELS, strict=True):
        assert torch.allclose(found.read(name), radiance(pixels))
    train = tmp_path / "data" / "train-00000-of-00001.parquet"
    measured = open_sequence(Path(f"{train}:/lensless"))
    assert list(measured.names) == names[2:]
    for number, pixels in enumerate(PIXELS[2:]):
        counts = measured.read(number).counts
        assert torch.equal(counts, torch.from_numpy(255.0 - pixels).permute(2, 0, 1))
    with pytest.raises(FileError, match=r"lensless, lensed. Name the one, such as .*:/lensless"):
        read_frame(f"{train}#2")
    with pytest.raises(FileError, match="no pictures in a column 'mask_label'"):
        read_frame(f"{train}:/mask_label#2")
    alone = open_pictures(train)
    assert torch.allclose(alone.read(names[4]), radiance(PIXELS[4]))
    bare = pa.table({"lensed": [png(PIXELS[1])]})
    parquet.write_table(bare, tmp_path / "bare.parquet")
    assert torch.allclose(
        open_pictures(tmp_path / "bare.parquet").read("bare-00000"), radiance(PIXELS[1])
    )
    second = tmp_path / "data" / "train-00001-of-00001.parquet"
    parquet.write_table(pa.table({"lensless": [png(PIXELS[0]), b"\xff\xd8\xff"]}), second)
    more = open_sequence(second)
    assert more.names == ("train-00003", "train-00004") and more.read(0).white == 255
    with pytest.raises(FileError, match=r"train-00001.* is a JPEG"):
        more.read(1)
    parquet.write_table(pa.table({"lensed": [3]}), tmp_path / "numbers.parquet")
    with pytest.raises(FileError, match="numbers"):
        open_pictures(tmp_path / "numbers.parquet").read("numbers-00000")
    (tmp_path / "damaged.parquet").write_bytes(b"PAR1" + bytes(200))
    with pytest.raises(FileError, match="cannot be read as Parquet"):
        open_pictures(tmp_path / "damaged.parquet")
    parquet.write_table(pa.table({"image": [1]}), tmp_path / "other.parquet")
    with pytest.raises(FileError, match="has the columns image, and none lensed"):
        open_pictures(tmp_path / "other.parquet")


def test_flatnet_and_phlatcam(tmp_path: Path) -> None:
    """caps_1cap/n0/n0_7..png with two dots, raw; orig/n0/n0_7.JPEG."""
    for number, pixels in enumerate(PIXELS[:2]):
        for folder, suffix in (("caps_1cap", "..png"), ("orig", ".JPEG")):
            path = tmp_path / folder / f"n0{number}" / f"n0{number}_7{suffix}"
            path.parent.mkdir(parents=True)
            Image.fromarray(pixels).save(path)
    found = open_pictures(tmp_path)
    assert found.names == ("n00_7", "n01_7")
    assert found.read("n01_7").shape == (3, 12, 18)
    captured = open_pictures(tmp_path / "caps_1cap" / "n00")
    assert captured.names == ("n00_7",)


def test_folder_takes_the_linear_file_of_a_picture(tmp_path: Path) -> None:
    picture = radiance(PIXELS[0])
    Image.fromarray(PIXELS[1]).save(tmp_path / "a.png")
    write_tiff16(tmp_path / "a.tif", picture)
    write_tiff32(tmp_path / "b.tif", picture - 0.1)
    Image.fromarray(PIXELS[1]).save(tmp_path / "c.png")
    np.savez(tmp_path / "c.npz", picture)
    (tmp_path / "a.json").write_text("{}")
    found = open_pictures(tmp_path)
    assert found.names == ("a", "b", "c")
    assert torch.equal(found.read("c"), picture)
    bright = picture < torch.quantile(picture, 0.99)
    assert torch.allclose(found.read("a")[bright], picture[bright], atol=1e-4)
    assert torch.allclose(found.read("b"), picture - 0.1)
    with pytest.raises(FileError, match="negative"):
        read_picture(tmp_path / "b.tif")
    (tmp_path / "none").mkdir()
    with pytest.raises(FileError, match="holds no picture"):
        open_pictures(tmp_path / "none")
