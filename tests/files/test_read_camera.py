"""Cameras in folders, with the files they name."""

import copy
import tomllib

import numpy as np
import pytest
import tifffile
import torch

from nolens.camera import Camera, LoadedCamera, from_mapping, preset, preset_text, to_toml
from nolens.errors import DataError, FileError
from nolens.files import read_camera, read_light, write_camera

QE = "wavelength_nm,R,G,B\n400,0.1,0.2,0.3\n700,0.4,0.5,0.6\n"
ACCEPTANCE = "angle_deg,response\n0,1\n45,0.25\n"


def small(**changes):
    """The small preset; names with two underscores lead into its tables."""
    mapping = copy.deepcopy(tomllib.loads(preset_text("small")))
    for path, value in changes.items():
        *tables, key = path.split("__")
        at = mapping
        for table in tables:
            at = at[table]
        at[key] = value
    return from_mapping(Camera, mapping, "small")


def with_curves():
    return small(
        sensor__quantum_efficiency={"file": "qe.csv"}, sensor__acceptance={"file": "angles.csv"}
    )


def with_relief(name="relief.tif"):
    return small(mask__relief={"kind": "file", "file": name, "grid": "2 um"})


def put(folder, camera, **files):
    (folder / "camera.toml").write_text(to_toml(camera), encoding="utf-8")
    for name, text in files.items():
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    return folder


def test_a_preset_by_name():
    assert read_camera("paper") == LoadedCamera.of(preset("paper"))


def test_a_folder_and_a_file(tmp_path):
    write_camera(tmp_path / "new", small())
    folder = tmp_path / "new"
    assert (
        read_camera(folder) == read_camera(str(folder / "camera.toml")) == LoadedCamera.of(small())
    )
    assert (folder / "camera.toml").read_text() == preset_text("small")
    assert [path.name for path in folder.iterdir()] == ["camera.toml"]


def test_curves_from_csv(tmp_path):
    camera = read_camera(put(tmp_path, with_curves(), qe=QE, angles=ACCEPTANCE))
    assert camera.quantum_efficiency.wavelength_nm == (400, 700)
    assert camera.quantum_efficiency.at("G", np.array([550.0])) == pytest.approx(0.35)
    assert camera.quantum_efficiency.source == "qe.csv"
    assert camera.acceptance.response == (1, 0.25)
    assert camera.camera == with_curves()


def test_csv_as_spreadsheets_write_it(tmp_path):
    qe = "\ufeffwavelength_nm, B, G, R\r\n400,0.3,0.2,0.1\r\n,,,\r\n700,0.6,0.5,0.4\r\n\r\n"
    put(tmp_path, with_curves(), angles=ACCEPTANCE)
    (tmp_path / "qe.csv").write_bytes(qe.encode())
    assert read_camera(tmp_path).quantum_efficiency.values["R"] == (0.1, 0.4)


def test_grey_curve(tmp_path):
    camera = small(sensor__mosaic="none", sensor__quantum_efficiency={"file": "qe.csv"})
    put(tmp_path, camera, qe="wavelength_nm,grey\n400,0.1\n500,0.2\n")
    assert read_camera(tmp_path).quantum_efficiency.values == {"grey": (0.1, 0.2)}


@pytest.mark.parametrize(
    ("qe", "words"),
    [
        (None, "cannot read .*qe.csv: No such file.*The camera names it"),
        ("", "qe.csv holds no numbers: give a line wavelength_nm,R,G,B"),
        ("wavelength_nm,R,G,B\n", "holds no numbers"),
        ("wavelength_nm,grey\n400,1\n", "line 1: the columns are wavelength_nm,grey; accepted"),
        (QE + "800,0.5\n", "line 4 has 2 values, but there are 4 columns"),
        (QE + "800,0.5,x,0\n", "line 4: G is 'x': give a number"),
        (QE + "\n800,0.5,1.5,0\n", r"line 5: values.G\[2\] is 1.5: it must be 0 to 1"),
        (QE + "800,0.5,nan,0\n", "line 4.* is nan: it should be a finite number"),
        (QE + "\n600,0,0,0\n", "line 5: .*600 follows 700: put the values in increasing order"),
        ("wavelength_nm,R,G,B\n400,0,0,0\n", "at least 2 items"),
        (b"\xff\xfe\x00", "qe.csv is no CSV file"),
    ],
)
def test_bad_spectral_curve(tmp_path, qe, words):
    put(tmp_path, with_curves(), angles=ACCEPTANCE)
    if qe is not None:
        (tmp_path / "qe.csv").write_bytes(qe if isinstance(qe, bytes) else qe.encode())
    with pytest.raises((FileError, DataError), match=words):
        read_camera(tmp_path)


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        ("angle,response\n0,1\n", "accepted for this camera are angle_deg,response"),
        ("angle_deg,response\n1,1\n2,1\n", "line 2: .*begin at 0 degrees"),
        ("angle_deg,response\n0,0\n2,1\n", "line 2: .*its first value, at 0 degrees, is 0"),
    ],
)
def test_bad_angular_curve(tmp_path, angles, words):
    put(tmp_path, with_curves(), qe=QE, angles=angles)
    with pytest.raises((FileError, DataError), match=words):
        read_camera(tmp_path)


def test_relief_comes_back(tmp_path):
    heights = torch.rand(5, 7) * 30
    write_camera(tmp_path, with_relief("masks/relief.tif"), heights)
    found = read_camera(tmp_path).relief_um
    assert found is not None and found.dtype == torch.float32
    assert torch.equal(found, heights)


def test_whole_numbers_are_heights_in_um(tmp_path):
    put(tmp_path, with_relief())
    tifffile.imwrite(tmp_path / "relief.tif", np.array([[1, 2], [3, 4]], np.uint16))
    assert read_camera(tmp_path).relief_um.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.array([[1, np.nan]], np.float32), "relief.tif holds heights that are NaN or infinite"),
        (np.zeros((2, 3, 3), np.uint8), "(pages|channel)"),
        (np.zeros((4, 4, 3), np.uint8), "a relief has one channel"),
        (None, "there is no file .*relief.tif"),
    ],
)
def test_bad_relief(tmp_path, array, words):
    put(tmp_path, with_relief())
    if array is not None:
        kind = "rgb" if array.shape[-1] == 3 and array.ndim == 3 and len(array) == 4 else None
        tifffile.imwrite(
            tmp_path / "relief.tif", array, photometric=kind or "minisblack", metadata=None
        )
    with pytest.raises((FileError, DataError), match=words):
        read_camera(tmp_path)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("papr", "there is no camera 'papr'. Did you mean the preset 'paper'?"),
        ("nowhere/camera.toml", "one of the presets paper, paper-film, small"),
        ("folder", "holds no camera.toml"),
        ("text.txt", "is no .toml file"),
        ("a\0b", "there is no camera"),
        ("x" * 5000, "cannot read"),
        ("~nobody-at-all/camera.toml", "there is no camera"),
    ],
)
def test_no_camera(tmp_path, monkeypatch, given, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.txt").touch()
    with pytest.raises(FileError) as error:
        read_camera(given)
    assert words in str(error.value)


def test_broken_description(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_bytes(b"name = \xff")
    with pytest.raises(FileError, match="is no TOML file"):
        read_camera(path)
    path.write_text("name = ")
    with pytest.raises(DataError, match=r"camera.toml is no TOML file"):
        read_camera(path)


def test_what_cannot_be_written(tmp_path):
    with pytest.raises(DataError, match="whose relief is of kind random-lenslets"):
        write_camera(tmp_path, small(), torch.zeros(3, 3))
    with pytest.raises(DataError, match="NaN or infinite"):
        write_camera(tmp_path, with_relief(), torch.full((3, 3), torch.inf))
    with pytest.raises(DataError, match="one channel of heights"):
        write_camera(tmp_path, with_relief(), torch.zeros(1, 3, 3))
    with pytest.raises(FileError, match=r"names the file relief.tif, which is not in"):
        write_camera(tmp_path, with_relief())
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="file"):
        write_camera(tmp_path / "file", small())
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_an_emission_spectrum(tmp_path):
    path = tmp_path / "gfp.csv"
    path.write_text("wavelength_nm,power\n480,0\n510,40\n560,10\n")
    light = read_light(str(path))
    assert light.name == "gfp.csv"
    assert light.power(np.array([470.0, 495, 510, 560])).tolist() == [0, 0.5, 1, 0.25]
    for power, words in (
        ("0", "holds no light"),
        ("nan", "holds no light"),
        ("-1\n510,1", "line 2"),
    ):
        path.write_text(f"wavelength_nm,power\n480,{power}\n520,0\n")
        with pytest.raises(DataError, match=words):
            read_light(str(path))
