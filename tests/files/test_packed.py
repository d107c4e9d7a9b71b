"""Bare data of sensors: counts come back out of every packing, by tables of bits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nolens.errors import DataError, FileError, OptionError
from nolens.files import open_sequence, read_frame
from nolens.files.packed import PixelFormat

# Where the bits of a group lie, byte by byte from the lowest bit: (pixel, bit of its count).
# Linux media documentation, V4L2_PIX_FMT_SRGGB10P, 12P and 14P; PFNC 2.4, 5.2.
_MSB = {n: [[(pixel, bit) for bit in range(n - 8, n)] for pixel in range(4)] for n in (10, 12, 14)}
LAYOUTS = {
    "SRGGB10_CSI2P": [*_MSB[10], [(p, b) for p in range(4) for b in range(2)]],
    "SRGGB12P": [*_MSB[12][:2], [(p, b) for p in range(2) for b in range(4)]],
    "R14_CSI2P": [
        *_MSB[14],
        [*((0, b) for b in range(6)), (1, 0), (1, 1)],
        [*((1, b) for b in range(2, 6)), *((2, b) for b in range(4))],
        [(2, 4), (2, 5), *((3, b) for b in range(6))],
    ],
    "Mono10p": [[divmod(8 * byte + bit, 10) for bit in range(8)] for byte in range(5)],
    "BayerRG12p": [
        [(0, b) for b in range(8)],
        [*((0, b) for b in range(8, 12)), *((1, b) for b in range(4))],
        [(1, b) for b in range(4, 12)],
    ],
    "Mono12Packed": [_MSB[12][0], [*((0, b) for b in range(4)), *((1, b) for b in range(4))],
                     _MSB[12][1]],
    "BayerGB10Packed": [_MSB[10][0], [(0, 0), (0, 1), None, None, (1, 0), (1, 1)], _MSB[10][1]],
    "BayerBG8": [[(0, b) for b in range(8)]],
    "SGRBG12": [[(0, b) for b in range(8)], [(0, b) for b in range(8, 12)]],
}  # fmt: skip


def packed(counts: np.ndarray, layout) -> np.ndarray:
    """Rows of bytes, by the table; rows are filled up with zeros to whole groups."""
    pixels = 1 + max(place[0] for byte in layout for place in byte if place)
    filled = np.pad(counts, ((0, 0), (0, -counts.shape[1] % pixels)))
    groups = filled.reshape(len(counts), -1, pixels)
    data = np.zeros((*groups.shape[:2], len(layout)), np.uint8)
    for number, byte in enumerate(layout):
        for bit, place in enumerate(byte):
            if place is not None:
                data[..., number] |= (((groups[..., place[0]] >> place[1]) & 1) << bit).astype("u1")
    return data.reshape(len(counts), -1)


@settings(deadline=None, max_examples=60)
@given(name=st.sampled_from(sorted(LAYOUTS)), width=st.integers(1, 13), seed=st.integers(0, 99))
def test_every_packing(name, width, seed):
    form = PixelFormat.of(name)
    counts = np.random.default_rng(seed).integers(0, int(form.white) + 1, (3, width))
    data = packed(counts, LAYOUTS[name])
    assert data.shape[1] == form.row_bytes(width)
    assert np.array_equal(form.unpack(np.pad(data, ((0, 0), (0, 7))), width), counts)


def test_bare_files(tmp_path):
    """Three frames of a Raspberry Pi, whose rows are filled up to 32 bytes."""
    counts = np.random.default_rng(4).integers(0, 1024, (3, 20, 36), dtype=np.uint16)
    rows = packed(counts.reshape(60, 36), LAYOUTS["SRGGB10_CSI2P"])
    path = tmp_path / "take.raw"
    path.write_bytes(np.pad(rows, ((0, 0), (0, 64 - rows.shape[1]))).tobytes())
    about = 'width = 36\nheight = 20\nformat = "SRGGB10_CSI2P"\nstride = 64\n'
    (tmp_path / "take.toml").write_text(f'{about}black = 64\nexposure = "5 ms"\n')
    frames = open_sequence(path)
    assert len(frames) == 3
    for number in range(3):
        assert np.array_equal(frames.read(number).counts[0], counts[number])
    frame = read_frame(f"{path}#2")
    assert (frame.mosaic, frame.black, frame.white, frame.exposure_s) == (
        "RGGB",
        (64,),
        1023,
        0.005,
    )
    assert frame.black_stated and frame.channels == ("mosaic",)
    (tmp_path / "take.toml").rename(tmp_path / "raw.toml")
    path_bytes = path.read_bytes()
    path.rename(tmp_path / "other.bin")
    assert np.array_equal(read_frame(f"{tmp_path}/other.bin#3").counts[0], counts[2])
    for text, kind, message in [
        (
            about.replace("20", "21"),
            FileError,
            r"3840 bytes after 0, .* 21 rows of 64 bytes .*mend",
        ),
        (
            about.replace("10_CSI", "11_CSI"),
            DataError,
            r"'SRGGB11_CSI2P' is no format .*BayerRG12p",
        ),
        (about.replace("64", "40"), DataError, "a row of 36 pixels has 45 bytes"),
        ("width = 36", DataError, "height, format are missing"),
    ]:
        (tmp_path / "raw.toml").write_text(text)
        with pytest.raises(kind, match=message):
            open_sequence(tmp_path / "other.bin")
    # Of one frame, rows may be filled up unsaid.
    (tmp_path / "one.bin").write_bytes(path_bytes[: 64 * 20])
    (tmp_path / "one.toml").write_text(about.replace("stride = 64", ""))
    assert np.array_equal(read_frame(tmp_path / "one.bin").counts[0], counts[0])
    (tmp_path / "raw.toml").unlink()
    with pytest.raises(FileError, match=r"no header.*write a \.toml of the same name"):
        read_frame(tmp_path / "other.bin")
    (tmp_path / "other.bin").rename(path)
    with pytest.raises(FileError, match=r"camera raw of a known kind.*write a \.toml"):
        read_frame(path)
    with pytest.raises(OptionError, match="16 bits are not packed"):
        PixelFormat.of("Mono16p")
