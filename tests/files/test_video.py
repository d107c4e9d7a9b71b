"""Video: without loss it comes back count by count; what lost something is refused, or stated."""

import sys

import av
import numpy as np
import pytest

from nolens.camera import linear_from_srgb
from nolens.errors import DataError, FileError
from nolens.files import is_sequence, open_sequence, read_frame

RANDOM = np.random.default_rng(6)


def record(path, coding, form, frames) -> None:
    """Frames as they are, (height, width[, channels]) with as many bytes as the format has."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(coding, rate=10)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = form
        for each in frames:
            frame = av.VideoFrame(stream.width, stream.height, form)
            rows = each.reshape(len(each), -1).view("u1")
            plane = frame.planes[0]
            plane.update(np.pad(rows, ((0, 0), (0, plane.line_size - rows.shape[1]))).tobytes())
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def stack(bits: int, *shape: int) -> np.ndarray:
    return RANDOM.integers(0, 2**bits, (4, *shape), dtype=np.uint8 if bits == 8 else np.uint16)


@pytest.mark.parametrize(
    ("name", "coding", "form", "bits"),
    [
        ("a.mkv", "ffv1", "gray", 8),
        ("b.mkv", "ffv1", "gray12le", 12),
        ("c.mkv", "ffv1", "gray16le", 16),
        ("d.avi", "rawvideo", "gray", 8),
    ],
)
def test_grey_without_loss(tmp_path, name, coding, form, bits):
    counts = stack(bits, 32, 48)
    record(tmp_path / name, coding, form, counts)
    frames = open_sequence(tmp_path / name)
    assert len(frames) == 4 and is_sequence(tmp_path / name)
    for number in (2, 3, 0, 1, 1):
        frame = frames.read(number)
        assert np.array_equal(frame.counts[0], counts[number])
    assert frame.white == 2**bits - 1 and not frame.black_stated
    assert np.array_equal(read_frame(f"{tmp_path / name}#3").counts[0], counts[2])


def test_colours_have_their_order(tmp_path):
    """As FFmpeg itself converts them: red stays red."""
    rgb = stack(8, 32, 48, 3)
    planes = np.moveaxis(rgb, -1, 1)
    reverse = np.ascontiguousarray(rgb[..., ::-1])
    padded = np.concatenate([reverse, np.zeros_like(rgb[..., :1])], -1)
    record(tmp_path / "bgr24.avi", "rawvideo", "bgr24", reverse)
    record(tmp_path / "bgr0.mkv", "ffv1", "bgr0", padded)
    with av.open(str(tmp_path / "gbrp.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.height, stream.width, stream.pix_fmt = 32, 48, "gbrp12le"
        for each in rgb:
            frame = av.VideoFrame.from_ndarray(each, format="rgb24")
            container.mux(stream.encode(frame.reformat(format="gbrp12le")))
        container.mux(stream.encode(None))
    for name in ("bgr24.avi", "bgr0.mkv"):
        for number in range(4):
            frame = read_frame(f"{tmp_path / name}#{number + 1}")
            assert frame.channels == ("R", "G", "B") and np.array_equal(
                frame.counts, planes[number]
            )
    frame = read_frame(tmp_path / "gbrp.mkv#4")
    assert frame.white == 4095 and np.abs(frame.counts.numpy() / 16 - planes[3]).max() < 1


def test_what_lost_something(tmp_path):
    """Refused as a JPEG is, unless a .toml says the curve."""
    path = tmp_path / "take.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.height, stream.width, stream.pix_fmt, stream.bit_rate = 32, 48, "yuv420p", 10**7
        for level in (50, 120, 200):
            grey = np.full((32, 48, 3), level, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        container.mux(stream.encode(None))
    with pytest.raises(FileError, match=r"mpeg4 video of yuv420p, .*ffv1.*take\.toml: curve ="):
        open_sequence(path)
    (tmp_path / "take.toml").write_text('curve = "linear"')
    assert float(read_frame(f"{path}#2").counts.mean()) == pytest.approx(120, abs=3)
    (tmp_path / "take.toml").write_text('curve = "srgb"')
    frame = read_frame(f"{path}#3")
    expected = 255 * linear_from_srgb(frame.counts.new_tensor(200 / 255))
    assert float(frame.counts.mean()) == pytest.approx(float(expected), abs=5)
    (tmp_path / "take.toml").write_text('curve = "log"')
    with pytest.raises(DataError, match="curve"):
        open_sequence(path)


def test_damaged_and_without_the_extra(tmp_path, monkeypatch):
    record(tmp_path / "a.mkv", "ffv1", "gray", stack(8, 32, 48))
    data = (tmp_path / "a.mkv").read_bytes()
    for end in (0, 20, 300, len(data) // 2, len(data) - 200):
        cut = tmp_path / f"cut{end}.mkv"
        cut.write_bytes(data[:end])
        with pytest.raises(FileError):
            frames = open_sequence(cut)
            frames.read(3)
    (tmp_path / "list.mkv").write_bytes(b"#EXTM3U\n#EXTINF:1,\na.mkv\n")
    with pytest.raises(FileError, match="cannot be read as a video"):
        open_sequence(tmp_path / "list.mkv")
    monkeypatch.setitem(sys.modules, "av", None)
    other = tmp_path / "b.mkv"
    other.write_bytes(data)
    with pytest.raises(FileError, match=r"pip install 'nolens\[video\]'"):
        open_sequence(other)
