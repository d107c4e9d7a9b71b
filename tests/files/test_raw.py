"""Camera raw: our DNG writer against rawpy, our reader against known files."""

from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile
import torch
from damage import check_truncated, garbled, read_or_refuse
from hypothesis import given, settings
from hypothesis import strategies as st

from nolens.camera import MOSAICS
from nolens.errors import DataError, FileError, OptionError
from nolens.files import read_frame, write_dng


def counts_of(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 65536, (height, width), dtype=np.uint16)


@settings(max_examples=30, deadline=None)
@given(
    height=st.integers(22, 70),
    width=st.integers(22, 70),
    pattern=st.sampled_from(MOSAICS),
    black=st.integers(0, 4000),
    white=st.integers(4001, 65535),
    exposure=st.none() | st.floats(1e-6, 4e9),
)
def test_dng_as_rawpy_reads_it(tmp_path_factory, height, width, pattern, black, white, exposure):
    path = tmp_path_factory.mktemp("dng") / "a.dng"
    counts = counts_of(height, width)
    write_dng(path, counts, pattern=pattern, black=black, white=white, exposure_s=exposure)
    with rawpy.imread(str(path)) as raw:
        assert np.array_equal(raw.raw_image_visible, counts)
        assert "".join(chr(raw.color_desc[i]) for i in raw.raw_pattern.flat) == pattern
        assert raw.black_level_per_channel == [black] * 4
        assert raw.white_level == white
        assert raw.other.shutter_speed == pytest.approx(exposure or 0, rel=1e-3)
    frame = read_frame(path)
    assert np.array_equal(frame.counts[0].numpy(), counts)
    assert (frame.mosaic, frame.channels) == (pattern, ("mosaic",))
    assert (frame.black, frame.white) == ((float(black),), float(white))
    assert frame.stored_as == "uint16"
    assert frame.exposure_s == (None if exposure is None else pytest.approx(exposure, rel=1e-3))


def test_dng_can_be_developed_by_others(tmp_path):
    # A red, a green and a blue band must come out of LibRaw's own development as such.
    counts = np.full((90, 60), 256, np.uint16)
    counts[0:30:2, 0::2] = 4095
    counts[30:60:2, 1::2] = counts[31:60:2, 0::2] = 4095
    counts[61:90:2, 1::2] = 4095
    write_dng(tmp_path / "a.dng", counts, black=256, white=4095)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        picture = raw.postprocess(half_size=True, use_camera_wb=True, no_auto_bright=True)
    for band, row in enumerate((7, 22, 37)):
        assert picture[row, 15].argmax() == band
        assert picture[row, 15].max() > 250


@pytest.mark.parametrize(
    ("counts", "options", "error"),
    [
        (np.full((30, 30), 0.5), {}, DataError),
        (np.full((30, 30), -1), {}, DataError),
        (np.full((30, 30), 70000), {}, DataError),
        (np.zeros((3, 30, 30)), {}, DataError),
        (np.zeros((21, 30)), {}, DataError),
        (np.zeros((30, 30)), {"pattern": "RGBG"}, OptionError),
        (np.zeros((30, 30)), {"black": 4095}, OptionError),
        (np.zeros((30, 30)), {"white": 65536}, OptionError),
    ],
)
def test_no_dng_of_that(tmp_path, counts, options, error):
    with pytest.raises(error):
        write_dng(tmp_path / "a.dng", counts, **({"black": 0, "white": 4095} | options))
    assert not list(tmp_path.iterdir())


def test_tensors_can_be_written(tmp_path):
    counts = torch.from_numpy(counts_of(30, 40).astype(np.int32))
    write_dng(tmp_path / "a.dng", counts, black=0, white=65535)
    assert torch.equal(read_frame(tmp_path / "a.dng").counts[0], counts.float())


BASE_TAGS = {
    271: (2, 0, "maker"),
    272: (2, 0, "model"),
    33421: (3, 2, (2, 2)),
    33422: (1, 4, bytes((0, 1, 1, 2))),
    50706: (1, 4, bytes((1, 4, 0, 0))),
    50707: (1, 4, bytes((1, 1, 0, 0))),
    50708: (2, 0, "model"),
    50717: (4, 1, 4095),
}


def foreign_dng(path: Path, counts: np.ndarray, tags: dict, kind: str = "cfa") -> Path:
    """A DNG as another program might write it."""
    known = BASE_TAGS | tags
    extra = [(code, *tag, True) for code, tag in sorted(known.items()) if tag is not None]
    tifffile.imwrite(path, counts, byteorder="<", photometric=kind, metadata=None, extratags=extra)
    return path


def test_black_level_of_every_cell(tmp_path):
    tags = {
        50713: (3, 2, (2, 2)),
        50714: (4, 4, (10, 20, 30, 40)),
        33422: (1, 4, bytes((2, 1, 1, 0))),
    }
    frame = read_frame(foreign_dng(tmp_path / "a.dng", counts_of(30, 40), tags))
    assert frame.mosaic == "BGGR"
    assert frame.black == (10, 20, 30, 40)


def test_mosaic_is_that_of_the_visible_area(tmp_path):
    # The pattern of a DNG starts at its active area; LibRaw cuts a little more off.
    counts = counts_of(60, 80)
    path = foreign_dng(tmp_path / "a.dng", counts, {50829: (4, 4, (3, 5, 57, 77))})
    frame = read_frame(path)
    seen = frame.counts[0].numpy()
    height, width = seen.shape
    offsets = [(y, x) for y in range(60 - height + 1) for x in range(80 - width + 1)]
    ((top, left),) = (
        (y, x) for y, x in offsets if np.array_equal(seen, counts[y : y + height, x : x + width])
    )
    rows = {(0, 0): "RGGB", (0, 1): "GRBG", (1, 0): "GBRG", (1, 1): "BGGR"}
    assert frame.mosaic == rows[(top - 3) % 2, (left - 5) % 2]


def test_linear_colour(tmp_path):
    counts = np.stack([counts_of(30, 40, seed) for seed in range(3)], axis=-1)
    tags = {33421: None, 33422: None, 50714: (4, 3, (5, 6, 7)), 50717: (4, 3, (4095,) * 3)}
    frame = read_frame(foreign_dng(tmp_path / "a.dng", counts, tags, "linear_raw"))
    assert np.array_equal(frame.counts.numpy(), np.moveaxis(counts, -1, 0))
    assert (frame.channels, frame.mosaic, frame.black) == (("R", "G", "B"), None, (5, 6, 7))


def test_monochrome(tmp_path):
    counts = counts_of(30, 40)
    path = foreign_dng(tmp_path / "a.dng", counts, {33421: None, 33422: None}, "minisblack")
    data = path.read_bytes()
    grey, linear_raw = (
        bytes((6, 1, 3, 0, 1, 0, 0, 0)) + n.to_bytes(2, "little") for n in (1, 34892)
    )
    path.write_bytes(data.replace(grey, linear_raw))
    frame = read_frame(path)
    assert np.array_equal(frame.counts[0].numpy(), counts)
    assert (frame.channels, frame.mosaic) == (("grey",), None)


XTRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"


@pytest.mark.parametrize(
    ("size", "cell"), [((6, 6), XTRANS), ((4, 4), "RRGGRRGGGGBBGGBB"), ((2, 2), "RGBG")]
)
def test_other_mosaics_are_refused(tmp_path, size, cell):
    numbers = bytes("RGB".index(colour) for colour in cell)
    tags = {33421: (3, 2, size), 33422: (1, len(cell), numbers)}
    with pytest.raises(FileError, match="RGGB, BGGR, GRBG, GBRG"):
        read_frame(foreign_dng(tmp_path / "a.dng", counts_of(36, 48), tags))


@pytest.mark.parametrize("suffix", [".dng", ".nef", ".raw"])
def test_a_plain_tiff_is_no_raw_file(tmp_path, suffix):
    tifffile.imwrite(tmp_path / f"a{suffix}", counts_of(60, 80))
    with pytest.raises(FileError, match=r"plain TIFF.*rename it to a\.tif.*--mosaic"):
        read_frame(tmp_path / f"a{suffix}")


def test_garbage(tmp_path, capfd):
    path = tmp_path / "a.cr2"
    path.write_bytes(np.random.default_rng(0).bytes(100_000))
    with pytest.raises(FileError, match="cannot be read as camera raw"):
        read_frame(path)
    assert capfd.readouterr().err == ""


def test_truncated(tmp_path, capfd):
    write_dng(tmp_path / "a.dng", counts_of(40, 50), black=256, white=4095)
    check_truncated(tmp_path / "a.dng")
    assert capfd.readouterr().err == ""


def test_damaged_header(tmp_path, capfd):
    write_dng(tmp_path / "a.dng", counts_of(40, 50), black=256, white=4095)
    for path in garbled(tmp_path / "a.dng", 0, 700, 400):
        read_or_refuse(path)
    assert capfd.readouterr().err == ""
