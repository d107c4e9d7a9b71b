"""npz, mat, HDF5, Zarr and OpenEXR: the frames in them, and which data set they are."""

import struct
import zlib

import h5py
import numpy as np
import OpenEXR
import pytest
import scipy.io
import zarr
from damage import check_truncated, garbled, read_or_refuse
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nolens.errors import FileError
from nolens.files import is_sequence, open_sequence, read_frame, read_picture

STACK = np.random.default_rng(2).integers(0, 4096, (5, 20, 32, 3), dtype=np.uint16)
PLANES = np.moveaxis(STACK, -1, 1)


def npz(path, arrays, coded=True):
    (np.savez_compressed if coded else np.savez)(path, **arrays)


def mat(path, arrays, coded=True):
    scipy.io.savemat(path, arrays, do_compression=coded)


def hdf5(path, arrays, coded=True):
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            way = {"compression": "gzip", "shuffle": True} if coded and array.ndim > 1 else {}
            file.create_dataset(f"take/{name}", data=array, **way)


def zarr3(path, arrays, version=3):
    group = zarr.create_group(path, zarr_format=version)
    for name, array in arrays.items():
        made = group.create_array(name, shape=array.shape, dtype=array.dtype, chunks=array.shape)
        made[...] = array


WAYS = {
    "coded.npz": npz,
    "plain.npz": lambda path, arrays: npz(path, arrays, coded=False),
    "coded.mat": mat,
    "plain.mat": lambda path, arrays: mat(path, arrays, coded=False),
    "coded.h5": hdf5,
    "plain.hdf5": lambda path, arrays: hdf5(path, arrays, coded=False),
    "three.zarr": zarr3,
    "two.zarr": lambda path, arrays: zarr3(path, arrays, version=2),
    "packed.zip": lambda path, arrays: zarr3(zarr.storage.ZipStore(path, mode="w"), arrays),
}


def read_all(path) -> np.ndarray:
    frames = open_sequence(path)
    return np.stack([frames.read(number).counts.numpy() for number in range(len(frames))])


@pytest.mark.parametrize("name", WAYS)
def test_frames_among_other_data(tmp_path, name):
    """The one array that can be frames is taken; of two, the one that is named."""
    path = tmp_path / name
    others = {"exposure": np.array([[0.01]]), "times": np.arange(5.0)}
    WAYS[name](path, {"frames": STACK, **others})
    assert is_sequence(path) and np.array_equal(read_all(path), PLANES)
    frame = read_frame(f"{path}#3")
    assert np.array_equal(frame.counts, PLANES[2])
    assert (frame.stored_as, frame.white, frame.channels) == ("uint16", 65535, ("R", "G", "B"))
    second = tmp_path / f"second-{name}"
    WAYS[name](second, {"frames": STACK, "psf": STACK[0].astype(np.float32), **others})
    inside = "take/" if name.endswith(("h5", "hdf5")) else ""
    with pytest.raises(
        FileError, match=rf"2 data sets that can be .*frames \(5×20×32×3, uint16\).*:/{inside}"
    ):
        open_sequence(second)
    assert np.array_equal(read_frame(f"{second}:/{inside}psf").counts, PLANES[0])
    assert np.array_equal(read_frame(f"{second}:/{inside}frames#5").counts, PLANES[4])
    with pytest.raises(FileError, match="has no data set 'none'; it has :/"):
        read_frame(f"{second}:/none")
    WAYS[name](tmp_path / f"none-{name}", others)
    with pytest.raises(FileError, match=r"no data set that can be frames; it has .*times"):
        read_frame(tmp_path / f"none-{name}")


ARRAYS = st.sampled_from(["u1", "u2", "f4", "f8"]).flatmap(
    lambda kind: hnp.arrays(kind, st.sampled_from([(4, 6), (4, 6, 3), (4, 20, 32), (2, 4, 6, 3)]))
)


@settings(deadline=None, max_examples=25)
@given(array=ARRAYS, name=st.sampled_from(["coded.npz", "coded.h5", "three.zarr"]))
def test_what_is_written_comes_back(tmp_path_factory, array, name):
    path = tmp_path_factory.mktemp("written") / name
    WAYS[name](path, {"a": array})
    with np.errstate(over="ignore"):
        expected = array.astype(np.float32)
    expected = {
        (4, 6): lambda: expected[None, None],
        (4, 6, 3): lambda: np.moveaxis(expected, -1, 0)[None],
        (4, 20, 32): lambda: expected[:, None],
        (2, 4, 6, 3): lambda: np.moveaxis(expected, -1, 1),
    }[array.shape]()
    assert np.array_equal(read_all(path), expected, equal_nan=True)


def test_mat_has_the_axes_of_matlab(tmp_path):
    """Rows, columns, colours, frames; version 7.3 is HDF5 with all of them turned round."""
    ours = np.moveaxis(STACK, 0, -1)
    mat(tmp_path / "five.mat", {"frames": ours, "name": "a text"})
    with h5py.File(tmp_path / "seven.mat", "w", userblock_size=512) as file:
        file.create_dataset("frames", data=ours.T, compression="gzip")
        text = file.create_dataset("name", data=np.zeros((9, 3), np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("#refs#/a", data=ours.T)
    with (tmp_path / "seven.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    for name in ("five", "seven"):
        assert np.array_equal(read_all(tmp_path / f"{name}.mat"), PLANES)
    mat(tmp_path / "grey.mat", {"frames": np.moveaxis(STACK[..., 0], 0, -1)})
    assert np.array_equal(read_all(tmp_path / "grey.mat"), PLANES[:, :1])


def test_axes_of_ome_zarr(tmp_path):
    """Times × channels × depths, in versions 0.4 and 0.5; of the pyramid, the finest."""
    grid = np.random.default_rng(3).integers(0, 99, (2, 3, 4, 20, 32), dtype=np.uint16)
    scales = [{
        "axes": [{"name": each} for each in "tczyx"],
        "datasets": [{"path": "0"}, {"path": "1"}],
    }]  # fmt: skip
    for version, told in ((2, {"multiscales": scales}), (3, {"ome": {"multiscales": scales}})):
        path = tmp_path / f"{version}.ome.zarr"
        zarr3(path, {"0": grid, "1": grid[..., ::2, ::2]}, version)
        zarr.open(path, mode="r+").attrs.update(told)
        expected = grid.transpose(0, 2, 1, 3, 4).reshape(8, 3, 20, 32)
        assert np.array_equal(read_all(path), expected)
    alone = zarr.create_array(
        tmp_path / "alone.zarr", shape=(20, 3, 32), dtype="u2", dimension_names=["y", "c", "x"]
    )
    alone[...] = np.moveaxis(STACK[0], -1, 1)
    assert np.array_equal(read_frame(tmp_path / "alone.zarr").counts, PLANES[0])


def exr(path, **channels):
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))


def test_exr(tmp_path):
    """Linear floats, 0 is no light: a finished PSF, and a scene or truth with 1 for white."""
    values = (STACK[0] / 4096).astype(np.float32)
    exr(tmp_path / "a.exr", RGB=values)
    frame = read_frame(tmp_path / "a.exr")
    assert np.array_equal(frame.counts, np.moveaxis(values, -1, 0))
    assert frame.is_linear and frame.white is None
    assert np.array_equal(read_picture(tmp_path / "a.exr").radiance, frame.counts)
    exr(tmp_path / "half.exr", Y=values[..., 0].astype(np.float16), A=values[..., 1])
    half = read_frame(tmp_path / "half.exr")
    assert np.array_equal(half.counts[0], values[..., 0].astype(np.float16)) and half.is_linear
    exr(tmp_path / "depth.exr", Z=values[..., 0])
    with pytest.raises(FileError, match="has the channels Z; accepted are R, G and B, or Y"):
        read_frame(tmp_path / "depth.exr")


def test_floats_are_scenes(tmp_path):
    npz(tmp_path / "a.npz", {"scene": STACK[0].astype(np.float32)})
    assert np.array_equal(read_picture(tmp_path / "a.npz").radiance, PLANES[0])
    npz(tmp_path / "b.npz", {"scene": STACK[0]})
    with pytest.raises(FileError, match="holds uint16, of which it is not known what white is"):
        read_picture(tmp_path / "b.npz")


@pytest.mark.parametrize("name", ["coded.npz", "plain.npz", "coded.mat", "coded.h5", "a.exr"])
def test_damaged(tmp_path, name, capfd):
    if name == "a.exr":
        exr(tmp_path / name, RGB=STACK[0].astype(np.float32))
    else:
        WAYS[name](tmp_path / name, {"frames": STACK[0]})
    size = (tmp_path / name).stat().st_size
    for path in garbled(tmp_path / name, 0, size, 60):
        read_or_refuse(path)
    check_truncated(tmp_path / name)
    assert capfd.readouterr() == ("", "")


def test_values_in_other_files_and_parts_that_grow(tmp_path):
    """HDF5 would read any file of the system, and decode whatever comes of a chunk."""
    (tmp_path / "secret").write_bytes(bytes(20 * 32))
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("a", (20, 32), "u1", external=[(str(tmp_path / "secret"), 0, 640)])
    with pytest.raises(FileError, match="has its values in other files"):
        read_frame(path)
    with h5py.File(path, "w") as file:
        file["linked"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/a")
    with pytest.raises(FileError, match="no data set that can be frames; it has none"):
        read_frame(path)
    with h5py.File(path, "w") as file:
        made = file.create_dataset("a", (20, 32), "u1", chunks=(20, 32), compression="gzip")
        made.id.write_direct_chunk((0, 0), zlib.compress(bytes(10**7)))
    with pytest.raises(FileError, match="a part of it becomes larger than it says"):
        read_frame(path)
    mat(tmp_path / "a.mat", {"a": STACK[0]})
    head = (tmp_path / "a.mat").read_bytes()[:128]
    bomb = zlib.compress(struct.pack("<II", 14, 2**31) + bytes(10**6))
    (tmp_path / "a.mat").write_bytes(head + struct.pack("<II", 15, len(bomb)) + bomb)
    with pytest.raises(FileError, match=r"holds \d+ values, for which 8.59 GB are needed"):
        read_frame(tmp_path / "a.mat")
