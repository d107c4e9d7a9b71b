"""PNG, TIFF and npy: known values come back, everything else is refused."""

import io
import struct
import zlib

import imagecodecs
import numpy as np
import pytest
import tifffile
from damage import check_truncated, garbled, read_or_refuse
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from nolens.errors import FileError, OptionError
from nolens.files import read_frame

GREY8 = np.arange(35, dtype=np.uint8).reshape(5, 7) * 7
GREY16 = GREY8.astype(np.uint16) * 257 + 1
RGB8 = np.stack([GREY8, 255 - GREY8, GREY8 // 2], axis=-1)
RGB16 = np.stack([GREY16, 65535 - GREY16, GREY16 // 2], axis=-1)


def counts(path, **options) -> np.ndarray:
    return read_frame(path, **options).counts.numpy()


def planes(array: np.ndarray) -> np.ndarray:
    return array[None] if array.ndim == 2 else np.moveaxis(array, -1, 0)


def write_png(path, array: np.ndarray) -> None:
    path.write_bytes(imagecodecs.png_encode(array))


PNGS = [GREY8, GREY16, RGB8, RGB16]


@pytest.mark.parametrize("array", PNGS)
def test_png(tmp_path, array):
    write_png(tmp_path / "a.png", array)
    frame = read_frame(tmp_path / "a.png")
    assert np.array_equal(frame.counts.numpy(), planes(array))
    assert frame.stored_as == array.dtype.name
    assert frame.white == np.iinfo(array.dtype).max
    assert frame.channels == (("grey",) if array.ndim == 2 else ("R", "G", "B"))


@pytest.mark.parametrize("array", PNGS)
def test_alpha_is_dropped(tmp_path, array):
    solid = array if array.ndim == 3 else array[..., None]
    alpha = np.full_like(solid[..., :1], 77)
    write_png(tmp_path / "a.png", np.concatenate([solid, alpha], -1))
    assert np.array_equal(counts(tmp_path / "a.png"), planes(array))


@pytest.mark.parametrize("transparent", [False, True])
def test_palette_is_expanded(tmp_path, transparent):
    palette = [(3, 2, 1), (60, 50, 40), (200, 210, 220)]
    index = np.array([[0, 1, 2], [2, 1, 0]], np.uint8)
    picture = Image.fromarray(index).convert("P")
    picture.putpalette(np.array(palette, np.uint8).tobytes())
    extra = {"transparency": bytes((0, 128, 255))} if transparent else {}
    picture.save(tmp_path / "a.png", **extra)
    assert np.array_equal(counts(tmp_path / "a.png"), planes(np.array(palette)[index]))


def test_one_bit_png_is_refused(tmp_path):
    Image.new("1", (8, 8)).save(tmp_path / "a.png")
    with pytest.raises(FileError, match="PNG of 1 bits"):
        read_frame(tmp_path / "a.png")


TIFFS = [
    GREY8,
    GREY16,
    RGB8,
    RGB16,
    GREY16.astype(np.float32) / 7,
    RGB16.astype(np.float32) - 3e4,
    GREY16.astype(np.float64),
    GREY8.astype(np.float16),
]
WAYS = [
    {},
    {"byteorder": ">"},
    {"rowsperstrip": 2},
    {"tile": (16, 16)},
    {"compression": "deflate"},
    {"compression": "deflate", "predictor": True, "rowsperstrip": 2},
    {"compression": "deflate", "tile": (16, 16)},
    {"compression": "lzw", "predictor": True},
    {"compression": "zstd", "predictor": True, "tile": (16, 16)},
    {"compression": "packbits"},
    {"compression": "lzma"},
    {"compression": "jpeg2000", "tile": (16, 16)},
]


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize(("array", "way"), [(a, w) for a in TIFFS for w in WAYS])
def test_tiff(tmp_path, array, planar, way):
    if way.get("compression") == "jpeg2000" and array.dtype.kind == "f":
        return
    stored = np.moveaxis(array, -1, 0) if planar and array.ndim == 3 else array
    kind = {"photometric": "rgb" if array.ndim == 3 else "minisblack"}
    if array.ndim == 3:
        kind["planarconfig"] = "separate" if planar else "contig"
    tifffile.imwrite(tmp_path / "a.tif", stored, **kind, **way)
    frame = read_frame(tmp_path / "a.tif")
    assert np.array_equal(frame.counts.numpy(), planes(array).astype(np.float32))
    assert frame.stored_as == array.dtype.name
    assert frame.white == (np.iinfo(array.dtype).max if array.dtype.kind == "u" else None)


def test_tiff_alpha_is_dropped(tmp_path):
    four = np.concatenate([RGB16, RGB16[..., :1]], -1)
    tifffile.imwrite(tmp_path / "a.tif", four, photometric="rgb", extrasamples=["unassalpha"])
    assert np.array_equal(counts(tmp_path / "a.tif"), planes(RGB16))
    tifffile.imwrite(tmp_path / "a.tif", four, photometric="rgb", extrasamples=["unspecified"])
    with pytest.raises(FileError, match=r"\(4, 5, 7\)"):
        read_frame(tmp_path / "a.tif")


@pytest.mark.parametrize(
    ("array", "options", "message"),
    [
        (np.zeros((3, 20, 20), np.uint16), {"photometric": "minisblack"}, r"3 frames.*a\.tif#1"),
        (GREY16.astype(np.complex64), {}, "complex64"),
        (GREY16.astype(np.int64), {}, "int64"),
        (GREY16.astype(np.uint32), {}, "uint32"),
        (GREY16.astype(np.int16), {}, "int16"),
        (GREY16 > 9, {"photometric": "minisblack"}, "bits for a value"),
        (GREY16, {"photometric": "miniswhite"}, "kind MINISWHITE"),
        (GREY16, {"photometric": "cfa"}, r"rename it to a\.dng"),
        (GREY8, {"photometric": "palette", "colormap": np.zeros((3, 256), np.uint16)}, "PALETTE"),
    ],
)
def test_tiff_refused(tmp_path, array, options, message):
    if options.get("photometric") == "cfa":
        options = options | {
            "extratags": [(33421, 3, 2, (2, 2), True), (33422, 1, 4, bytes((0, 1, 1, 2)), True)]
        }
    tifffile.imwrite(tmp_path / "a.tif", array, **options)
    with pytest.raises(FileError, match=message):
        read_frame(tmp_path / "a.tif")


@pytest.mark.parametrize("coding", ["jpeg", "webp", "png"])
def test_codings_that_cannot_be_read_are_named(tmp_path, coding):
    tifffile.imwrite(tmp_path / "a.tif", GREY8 if coding == "jpeg" else RGB8, compression=coding)
    with pytest.raises(FileError, match=rf"compressed with {coding.upper()}.*LZW.*tiffcp"):
        read_frame(tmp_path / "a.tif")


SHAPES = st.sampled_from([(4, 6), (4, 6, 1), (4, 6, 3), (1, 4, 6), (3, 4, 6)])
TYPES = st.sampled_from(["u1", "<u2", ">u2", "<f2", "<f4", ">f4", "<f8"])


@settings(deadline=None)
@given(
    array=SHAPES.flatmap(lambda s: TYPES.flatmap(lambda t: hnp.arrays(t, s))), order=st.booleans()
)
def test_npy(tmp_path_factory, array, order):
    path = tmp_path_factory.mktemp("npy") / "a.npy"
    np.save(path, np.asfortranarray(array) if order else array)
    with np.errstate(over="ignore"):
        expected = array.astype(np.float32)
    if array.ndim == 2:
        expected = expected[None]
    elif array.shape[2] in (1, 3):
        expected = np.moveaxis(expected, -1, 0)
    assert np.array_equal(counts(path), expected, equal_nan=True)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros(5), r"shape \(5,\)"),
        (np.zeros((2, 4, 6)), r"shape \(2, 4, 6\)"),
        (np.zeros((2, 4, 6, 3)), r"2 frames.*a\.npy#1"),
        (np.zeros((3, 4, 3)), "first axis or the last"),
        (np.zeros((4, 6), bool), "bool"),
        (np.zeros((4, 6), np.int64), "int64"),
        (np.zeros((4, 6), complex), "complex128"),
        (np.zeros((0, 6)), r"\(1, 0, 6\)"),
        (np.array([["a", "b"]]), "str"),
        (np.array([[None, 1]]), "holds objects"),
    ],
)
def test_npy_refused(tmp_path, array, message):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(FileError, match=message):
        read_frame(tmp_path / "a.npy")


def test_bgr(tmp_path):
    np.save(tmp_path / "a.npy", RGB8)
    assert np.array_equal(counts(tmp_path / "a.npy", bgr=True), planes(RGB8)[::-1])
    np.save(tmp_path / "b.npy", GREY8)
    with pytest.raises(OptionError, match="--bgr"):
        read_frame(tmp_path / "b.npy", bgr=True)


def test_mosaic_can_be_declared(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", GREY16)
    frame = read_frame(tmp_path / "a.tif", mosaic="GRBG")
    assert (frame.mosaic, frame.channels) == ("GRBG", ("mosaic",))
    np.save(tmp_path / "b.npy", RGB8)
    with pytest.raises(OptionError, match="Leave out --mosaic"):
        read_frame(tmp_path / "b.npy", mosaic="RGGB")
    with pytest.raises(OptionError, match="accepted are RGGB, BGGR, GRBG, GBRG"):
        read_frame(tmp_path / "a.tif", mosaic="rggb")


def test_mosaic_of_a_raw_file_is_its_own(tmp_path):
    from nolens.files import write_dng

    write_dng(tmp_path / "a.dng", np.ones((30, 30)), pattern="BGGR", black=0, white=9)
    assert read_frame(tmp_path / "a.dng", mosaic="BGGR").mosaic == "BGGR"
    with pytest.raises(OptionError, match="its mosaic is BGGR, not RGGB"):
        read_frame(tmp_path / "a.dng", mosaic="RGGB")


def test_paths_that_are_no_picture(tmp_path):
    (tmp_path / "capture.tif").write_bytes(b"")
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff")
    (tmp_path / "notes.txt").write_text("nothing")
    for name, message in [
        ("captur.tif", r"there is no file .*captur\.tif\. Did you mean .*/capture\.tif\?"),
        ("zzz.png", "there is no file"),
        ("none/zzz.png", "and no folder"),
        ("", "is a folder"),
        ("capture.tif", "is empty"),
        ("photo.jpg", "not proportional to light.*Accepted"),
        ("notes.txt", r"suffix \.txt is not known. Accepted"),
        ("capture.tif/a.png", "cannot read|no folder"),
        ("a" * 300 + ".png", "cannot read"),
        ("a\0.png", "cannot read"),
    ]:
        with pytest.raises(FileError, match=message):
            read_frame(tmp_path / name)


def contents() -> dict[str, bytes]:
    picture, jpeg, tiff, array = io.BytesIO(), io.BytesIO(), io.BytesIO(), io.BytesIO()
    Image.fromarray(GREY8).save(picture, "PNG")
    Image.fromarray(GREY8).save(jpeg, "JPEG")
    tifffile.imwrite(tiff, GREY8)
    np.save(array, GREY8)
    noise = np.random.default_rng(0).bytes(5000)
    return {
        "PNG": picture.getvalue(),
        "JPEG": jpeg.getvalue(),
        "TIFF": tiff.getvalue(),
        "npy": array.getvalue(),
        "no": noise,
    }


@pytest.mark.parametrize("kind", contents())
@pytest.mark.parametrize("suffix", [".png", ".tif", ".npy", ".dng"])
def test_the_content_is_checked(tmp_path, kind, suffix):
    own = {".png": "PNG", ".tif": "TIFF", ".npy": "npy"}.get(suffix)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(contents()[kind])
    if kind == own:
        assert np.array_equal(counts(path)[0], GREY8)
        return
    with pytest.raises(FileError, match=f"a {kind} file|no {own} file|plain TIFF|camera raw"):
        read_frame(path)


def big(kind: str) -> np.ndarray:
    chance = np.random.default_rng(3)
    shape = (40, 30, 3) if kind == "colour" else (40, 30)
    return chance.integers(1, 65535, shape, dtype=np.uint16)


def write(path, how: str) -> None:
    kind = "colour" if "colour" in how else "grey"
    if how == "png8":
        Image.fromarray(big(kind).astype(np.uint8)).save(path)
    elif how.startswith("png"):
        write_png(path, big(kind))
    elif how == "npy":
        np.save(path, big(kind))
    else:
        way = {"compression": "deflate"} if "deflate" in how else {}
        way |= {"tile": (16, 16)} if "tiles" in how else {"rowsperstrip": 7}
        tifffile.imwrite(path, big(kind), photometric="rgb" if kind == "colour" else None, **way)


EVERY = [
    "png8.png", "png grey.png", "png colour.png", "npy.npy", "tiff.tif", "tiff colour tiles.tif",
    "tiff deflate.tif", "tiff deflate tiles.tif",
]  # fmt: skip


@pytest.mark.parametrize("name", EVERY)
def test_truncated(tmp_path, capfd, name):
    write(tmp_path / name, name.partition(".")[0])
    check_truncated(tmp_path / name)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", EVERY)
def test_damaged_header(tmp_path, capfd, name):
    write(tmp_path / name, name.partition(".")[0])
    for path in garbled(tmp_path / name, 8, 400, 150):
        read_or_refuse(path)
    for path in garbled(tmp_path / name, 0, 10**9, 50):
        read_or_refuse(path)
    assert capfd.readouterr().err == ""


def test_header_of_a_huge_picture(tmp_path):
    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", 2_000_000, 2_000_000, 16, 2, 0, 0, 0)
    (tmp_path / "a.png").write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")
    )
    np.save(tmp_path / "a.npy", GREY8)
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data.replace(b"(5, 7), }       ", b"(5000000, 70000)}"[:16]))
    for name in ("a.png", "a.npy"):
        with pytest.raises(FileError):
            read_frame(tmp_path / name)
