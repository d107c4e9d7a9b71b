"""What a header announces is refused before it is decoded, and what --read-limit does to it."""

import json
import re
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image

from nolens.errors import FileError, OptionError
from nolens.files import read_frame, read_picture, write_dng
from nolens.files.input import READ_LIMIT, check_size, read_limit, set_read_limit

CORPUS = Path(__file__).parents[1] / "corpus"
SPARSE = 5 * 10**9


def sparse(path: Path, start: bytes = b"") -> None:
    with path.open("wb") as file:
        file.write(start)
        file.truncate(SPARSE)


def npy(path: Path) -> None:
    with path.open("wb") as file:
        header = {"descr": "<f4", "fortran_order": False, "shape": (25_000, 50_000)}
        np.lib.format.write_array_header_1_0(file, header)
        file.truncate(SPARSE + 128)


def tiff(path: Path) -> None:
    tifffile.imwrite(path, shape=(25_000, 50_000), dtype=np.float32, metadata=None)


def tiff_of_pages(path: Path) -> None:
    """Each directory has no tag, and the place of the next one."""
    places = range(8, 8 + 6 * 10_001, 6)
    pages = b"".join(struct.pack("<HI", 0, place + 6) for place in places)
    path.write_bytes(b"II*\0" + struct.pack("<I", 8) + pages + struct.pack("<HI", 0, 0))


def tiff_in_one_strip(path: Path) -> None:
    """0.6 MB of deflate for a strip of 144 MB that its header says to be 16 kB."""
    tifffile.imwrite(
        path, np.zeros((12_000, 12_000), np.uint8), compression="deflate",
        compressionargs={"level": 1}, rowsperstrip=12_000, metadata=None,
    )  # fmt: skip
    with tifffile.TiffFile(path, mode="r+b") as file:
        for name in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            file.pages.first.tags[name].overwrite(128)


def jpeg(path: Path) -> None:
    Image.new("RGB", (16, 16)).save(path, quality=5)
    data = bytearray(path.read_bytes())
    at = data.find(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", 12_000, 12_000)
    path.write_bytes(data)


def dng(path: Path) -> None:
    write_dng(path, np.ones((64, 64)), pattern="RGGB", black=0, white=9)
    with tifffile.TiffFile(path, mode="r+b") as file:
        for name in ("ImageWidth", "ImageLength"):
            file.pages.first.tags[name].overwrite(60_000)


PNG = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR"
Make = Callable[[Path], None]
BOMBS: dict[str, tuple[str, Make, str]] = {
    "sparse.png": ("read_frame", lambda path: sparse(path, PNG), "has 5 GB, for which 5 GB are"),
    "sparse.dng": ("read_frame", lambda path: sparse(path, b"II*\0"), "has 5 GB"),
    "sparse.jpg": ("read_picture", lambda path: sparse(path, b"\xff\xd8\xff"), "has 5 GB"),
    "sparse.txt": ("read_height_map", sparse, "has 5 GB, for which 50 GB are needed"),
    "sparse.toml": ("read_camera", sparse, "more than 16 million bytes"),
    "array.npy": ("read_frame", npy, "holds 25000×50000 values, for which 5 GB are needed"),
    "pages.tif": ("read_frame", tiff_of_pages, "more than 10000 pages"),
    "plain.tif": ("read_frame", tiff, "holds 25000×50000 values"),
    "heights.tif": ("read_height_map", tiff, "holds 25000×50000 values"),
    "strip.tif": ("read_frame", tiff_in_one_strip, ""),
    "large.jpg": ("read_picture", jpeg, "holds 12000×12000×3 values"),
    "large.dng": ("read_frame", dng, "60000×60000 values|camera raw"),
    # These are small files.
    "info-png-12000x12000-rgb16.png": ("read_frame", Path.exists, "12000×12000×3 values, for"),
    "info-png-13300x13300-rgba8.png": ("read_picture", Path.exists, "--read-limit 2.9GB"),
    "info-tiff-200-strips-at-one-place.tif": ("read_frame", Path.exists, "200 parts .* share"),
    "info-tiff-2000-strips-at-one-place.tif": ("read_frame", Path.exists, "is incomplete"),
    "info-tiff-tag-of-500-million-values.tif": ("read_frame", Path.exists, "500000000 values"),
    "info-dng-tag-of-500-million-values.dng": ("read_frame", Path.exists, "500000000 values"),
    "info-tiff-tile-larger-than-picture.tif": ("read_frame", Path.exists, "65520×65520 values"),
    "simulate-jpeg-65000x65000.jpg": ("read_picture", Path.exists, "65000×65000×3 values"),
    "simulate-jpeg-300-scans.jpg": ("read_picture", Path.exists, "301 scans"),
}
CHILD = """
import json, sys
from pathlib import Path
from nolens import files
from nolens.errors import NolensError
import nolens.files.frames, nolens.files.pictures, nolens.files.height_maps
import nolens.files.cameras, imagecodecs, rawpy
imagecodecs.png_decode, imagecodecs.zlib_decode
def peak():
    # Not what getrusage says: a process takes that over from the one that started it.
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
for name, path in json.loads(sys.argv[1]):
    before = peak()
    try:
        getattr(files, name)(Path(path))
        said = ""
    except NolensError as error:
        said = str(error)
    grown = (peak() - before) // 1000
    print(json.dumps([path, said, grown]), flush=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="sparse files, and memory in kB")
def test_bombs_are_refused_before_they_are_decoded(tmp_path):
    asked = []
    for name, (reader, make, _) in BOMBS.items():
        path = tmp_path / name if make is not Path.exists else CORPUS / name
        make(path)
        asked.append((reader, str(path)))
    done = subprocess.run(
        [sys.executable, "-c", CHILD, json.dumps(asked)], capture_output=True, text=True, check=True
    )
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(told) == len(BOMBS) and done.stderr == ""
    for (_, _, message), (path, said, megabytes) in zip(BOMBS.values(), told, strict=True):
        assert megabytes < 100, (path, megabytes)
        assert re.search(message, said) and len(said) < 400, (path, said)
        assert "--read-limit" in said or "needed" not in said


@pytest.fixture
def small_limit():
    set_read_limit("1MB")
    yield
    set_read_limit(READ_LIMIT)


@pytest.mark.usefixtures("small_limit")
@pytest.mark.parametrize("suffix", ["png", "tif", "npy", "jpg", "dng"])
def test_the_limit_can_be_raised(tmp_path, suffix):
    picture = np.full((400, 800), 7, np.uint8)
    path = tmp_path / f"a.{suffix}"
    match suffix:
        case "png":
            path.write_bytes(imagecodecs.png_encode(picture))
        case "tif":
            tifffile.imwrite(path, picture)
        case "npy":
            np.save(path, picture.astype(np.float32))
        case "jpg":
            Image.fromarray(picture).save(path)
        case "dng":
            write_dng(path, picture, pattern="RGGB", black=0, white=255)
    read = read_picture if suffix == "jpg" else read_frame
    with pytest.raises(FileError, match=r"1.28 MB are needed; one read may take 1 MB.*1\d*MB|2MB"):
        read(path)
    set_read_limit("2MB")
    read(path)


@pytest.mark.usefixtures("small_limit")
def test_what_is_a_limit():
    for size, message in [("4", "no unit"), ("1kB", "unknown"), ("1 B", "1MB to"), (0, "1MB to")]:
        with pytest.raises(OptionError, match=message):
            set_read_limit(size)
    assert read_limit() == 10**6
    check_size((250, 1000), 1, "a")
    with pytest.raises(FileError, match="a holds 125001×1 values"):
        check_size((125_001, 1), 8, "a")
    # Numpy's own integers would overflow.
    with pytest.raises(FileError, match="a holds"):
        check_size(tuple(np.full(4, 2**30, np.int32)), 1, "a")
