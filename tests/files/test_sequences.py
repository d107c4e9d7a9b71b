"""Sequences of frames: what there is of a folder, a pattern, a list or a stack, and its order."""

import os
import pickle
import time

import numpy as np
import pytest
import tifffile

from nolens.errors import FileError
from nolens.files import Address, is_sequence, open_sequence, read_frame

FRAMES = np.random.default_rng(1).integers(0, 4096, (24, 20, 32), dtype=np.uint16)
"""2 times × 4 depths × 3 channels, as they are written below."""


def read_all(path) -> np.ndarray:
    """All frames, through a copy of the sequence as a worker process gets it."""
    frames = pickle.loads(pickle.dumps(open_sequence(path)))
    return np.stack([frames.read(number).counts.numpy() for number in range(len(frames))])


def test_folder_pattern_and_list(tmp_path):
    folder = tmp_path / "raw"
    (folder / "sub").mkdir(parents=True)
    for number in (2, 10, 1):
        np.save(folder / f"take {number}.npy", FRAMES[number])
    np.save(folder / "sub/take 1.npy", FRAMES[5])
    (folder / "notes.toml").write_text("")
    wanted = tmp_path / "wanted.txt"
    wanted.write_text("# of Monday\nraw/take 10.npy\n\nraw/take 1.npy\nraw/sub/take 1.npy\n")
    assert open_sequence(folder).names == ("take 1", "take 2", "take 10")
    assert np.array_equal(read_all(folder)[:, 0], FRAMES[[1, 2, 10]])
    assert np.array_equal(read_all(folder / "take 1*.npy")[:, 0], FRAMES[[1, 10]])
    assert np.array_equal(read_all(wanted)[:, 0], FRAMES[[10, 1, 5]])
    names = open_sequence(wanted).names
    assert (
        names[0] == "take 10" and len(set(names)) == 3 and names[2].endswith("raw-sub-take 1-npy")
    )
    for path in (folder, folder / "*.npy", wanted):
        assert is_sequence(path)
    empty = tmp_path / "empty.txt"
    empty.write_text("# nothing\n")
    for path, message in [
        (folder / "b*.npy", r"no frame has a name like .*its files can be .*\.npy"),
        (empty, "lists no file: write a path on each line"),
        (tmp_path / "none.npy", "there is no file"),
        (tmp_path, "holds no frame"),
    ]:
        with pytest.raises(FileError, match=message):
            open_sequence(path)


def test_a_folder_of_thousands_opens_at_once(tmp_path):
    for number in range(5000):
        os.mknod(tmp_path / f"frame {number}.npy")
    before = time.process_time()
    frames = open_sequence(tmp_path)
    assert time.process_time() - before < 1
    assert (len(frames), frames.names[9], frames.names[-1]) == (5000, "frame 9", "frame 4999")


def test_ome_tiff_and_imagej_by_their_axes(tmp_path):
    """The order of planes in the file is not that of the frames; tifffile wrote and knows it."""
    grid = FRAMES.reshape(2, 4, 3, 20, 32)
    path = tmp_path / "a.ome.tif"
    tifffile.imwrite(path, grid, photometric="minisblack", metadata={"axes": "TZCYX"})
    assert np.array_equal(read_all(path), FRAMES.reshape(8, 3, 20, 32))
    assert np.array_equal(read_frame(f"{path}#6").counts, grid[1, 1])
    # Depths run slower than times, and channels slowest.
    turned = grid.transpose(2, 1, 0, 3, 4)
    tifffile.imwrite(path, turned, photometric="minisblack", metadata={"axes": "CZTYX"})
    assert np.array_equal(read_all(path), FRAMES.reshape(8, 3, 20, 32))
    colour = np.moveaxis(grid[:, 0], 1, -1)
    tifffile.imwrite(path, colour, photometric="rgb", metadata={"axes": "TYXS"})
    assert np.array_equal(read_all(path), grid[:, 0])
    tifffile.imwrite(path, grid[:, 0], imagej=True, metadata={"axes": "TCYX"})
    assert np.array_equal(read_all(path), grid[:, 0])
    tifffile.imwrite(path, grid[0].reshape(6, 2, 20, 32), photometric="minisblack",
                     metadata={"axes": "TCYX"})  # fmt: skip
    assert np.array_equal(read_all(path), grid[0].reshape(12, 1, 20, 32))  # Bands, one by one.
    data = path.read_bytes()
    path.write_bytes(data.replace(b'SizeT="6"', b'SizeT="9"').replace(b'SizeC="2"', b'SizeC="3"'))
    with pytest.raises(FileError, match=r"27 planes, of which 12 are in it"):
        open_sequence(path)


def test_channels_of_other_sizes_are_named(tmp_path):
    path = tmp_path / "a.ome.tif"
    tifffile.imwrite(path, FRAMES[:3], photometric="minisblack", metadata={"axes": "CYX"})
    with tifffile.TiffFile(path) as file:
        tag = file.pages[1].tags["ImageWidth"]
    with path.open("r+b") as raw:
        raw.seek(tag.valueoffset)
        raw.write((16).to_bytes(2, "little"))
    with pytest.raises(FileError, match=r"these have 20×16 and 20×32 pixels: they need one size"):
        read_all(path)


def test_imagej_stack_behind_one_directory(tmp_path):
    """As ImageJ writes more than 4 GB: all pages but the first have no directory."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, FRAMES, imagej=True, metadata={"axes": "TYX"})
    with tifffile.TiffFile(path) as file:
        first = file.pages.first
        assert first.is_contiguous and first.dataoffsets[0] + FRAMES.nbytes <= path.stat().st_size
        after = first.offset + 2 + 12 * len(first.tags)
    with path.open("r+b") as raw:
        raw.seek(after)
        raw.write(bytes(4))
    assert np.array_equal(read_all(path)[:, 0], FRAMES)
    path.write_bytes(path.read_bytes()[:-30_000])
    with pytest.raises(FileError, match="announces 24 pages"):
        open_sequence(path)


def test_one_of_many_is_named(tmp_path):
    """FILE#3 is the third; a file whose name looks like that is itself."""
    np.save(tmp_path / "psf.npy", FRAMES.reshape(8, 20, 32, 3))
    frame = read_frame(tmp_path / "psf.npy#3")
    assert np.array_equal(frame.counts, np.moveaxis(FRAMES.reshape(8, 20, 32, 3)[2], -1, 0))
    assert frame.source == str(tmp_path / "psf.npy#3") and not is_sequence(tmp_path / "psf.npy#3")
    np.save(tmp_path / "one.npy", FRAMES[:3].reshape(1, 20, 32, 3))
    assert read_frame(tmp_path / "one.npy").size == (20, 32)
    for name, message in [
        ("psf.npy", r"8 frames, and which one to take is not said: name it, such as .*psf\.npy#1"),
        ("psf.npy#9", r"psf\.npy has 8 frames, counted from 1"),
        ("psf.npy:/a#1", "has no data sets: leave :/a out"),
        ("none.npy#1", r"there is no file .*none\.npy"),
    ]:
        with pytest.raises(FileError, match=message):
            read_frame(tmp_path / name)
    np.save(tmp_path / "psf#1.npy", FRAMES[0])
    assert Address.of(tmp_path / "psf#1.npy").number is None
    assert read_frame(tmp_path / "psf#1.npy").size == (20, 32)
