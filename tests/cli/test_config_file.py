"""Options from a TOML file, and from the command line over it."""

import json
from pathlib import Path

import pytest
import torch
from little_camera import SUPPORT, Camera
from running import check_refused, listing, reconstruct, run

from nolens.files import read_frame


@pytest.fixture
def folder(camera: Camera, tmp_path: Path) -> Path:
    """A folder with the camera's files in it, to which relative paths lead."""
    home = tmp_path / "home"
    home.mkdir()
    for path in (camera.raw, camera.psf):
        (home / path.name).write_bytes(path.read_bytes())
    return home


def write(folder: Path, text: str) -> Path:
    path = folder / "run.toml"
    path.write_text(text)
    return path


ALL = f"""
measurement = "raw.dng"
psf = "psf.dng"
output = ["out.png", "linear.tif"]
tiff-bits = 32
region = "{SUPPORT}"
method = "admm"
prior = "isotropic-tv"
tau = 2e-4
iterations = 11
tolerance = 0
penalties = [0.1, 1, 1]
balance = false
relaxation = 1.5
white = 4000
black = 250
channels = "rg"
flip = "both"
crop = "10x12"
device = "cpu"
bin = 1
bgr = false
psf_extent = "auto"
"""


def test_file_holds_any_option(folder: Path, camera: Camera, tmp_path: Path) -> None:
    done = run("reconstruct", "--config", write(folder, ALL), "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["outputs"] == [
        str(folder / name) for name in ("out.png", "linear.tif", "out.json")
    ]
    given = (
        "--support", SUPPORT, "--prior", "isotropic-tv", "--tau", 2e-4, "--iterations", 11,
        "--tolerance", 0, "--penalties", 0.1, 1, 1, "--no-balance", "--relaxation", 1.5,
        "--white", 4000, "--black", 250, "--channels", "rg", "--flip", "both", "--crop", "10x12",
        "--device", "cpu",
    )  # fmt: skip
    same = reconstruct(tmp_path / "o.tif", camera.raw, "--psf", camera.psf, *given)
    stored = read_frame(folder / "linear.tif").counts
    assert stored.shape == (3, 10, 12) and torch.equal(stored, same)
    first, second = (
        json.loads(path.read_text())["parameters"]
        for path in (folder / "out.json", tmp_path / "o.json")
    )
    # A device was given to only one, and the file names what the command line leaves out.
    paths = ("measurement", "psf", "output", "device", "options_set")
    assert {k: v for k, v in first.items() if k not in paths} == {
        k: v for k, v in second.items() if k not in paths
    }


def test_command_line_wins(folder: Path, tmp_path: Path) -> None:
    config = write(folder, ALL)
    asked = ("--iterations", 4, "--balance", "--flip", "none", "-o", tmp_path / "mine.png")
    done = run("reconstruct", "--config", config, *asked)
    assert done.code == 0, done.err
    parameters = json.loads((tmp_path / "mine.json").read_text())["parameters"]
    assert parameters["iterations"] == 4 and parameters["balance"] is True
    assert parameters["flip"] == "none" and parameters["tau"] == 2e-4
    assert not (folder / "out.png").exists()


def test_relative_paths_start_at_the_right_place(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those in the file at its folder, those of the command line where the person is."""
    write(folder, 'measurement = "../home/raw.dng"\npsf = "psf.dng"\niterations = 2\n')
    monkeypatch.chdir(tmp_path)
    done = run("reconstruct", "--config", "home/run.toml", "-o", "here.png")
    assert done.code == 0, done.err
    assert (tmp_path / "here.png").exists() and (tmp_path / "here.json").exists()


def test_home_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(folder))
    write(folder, 'psf = "~/psf.dng"\niterations = 2\n')
    done = run("reconstruct", "~/raw.dng", "--config", "~/run.toml", "-o", "~/out.png")
    assert done.code == 0, done.err
    assert (folder / "out.png").exists()
    assert run("info", "~/psf.dng").code == 0
    check_refused(run("info", "~nosuchuser/psf.dng"), "no file ~nosuchuser/psf.dng")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("iteratoins = 3", ["run.toml has the key 'iteratoins'", "Did you mean 'iterations'?"]),
        ("zzz = 3", ["the key 'zzz', which is no option", "known are measurement, psf"]),
        ("[model]\ntau = 1", ["the key 'model'"]),
        ("tau = ", ["run.toml is no TOML file", "line 1"]),
        ("tau = 'much'", ["tau in", "run.toml is 'much'", "valid number"]),
        ("tau = nan", ["tau in", "finite"]),
        ("iterations = 2.5", ["iterations in", "2.5", "integer"]),
        ("penalties = [1, 2]", ["penalties in", "run.toml"]),
        ("method = 'amdm'", ["method in", "'amdm'", "'admm', 'fista' or 'wiener'"]),
        ("black = 'dark'", ["black in", "'dark'", "number", "'auto'"]),
        ("output = 3", ["output in", "3", "the path of a file or a list of them"]),
        ("output = []", ["no output is given"]),
        ("psf = 3", ["psf in", "3", "path"]),
        ("tiff-bits = 8", ["tiff_bits in", "16 or 32"]),
        ("psf-scale = 1\npsf_scale = 2", ["key psf_scale twice"]),
        ("tau = 1\ntau = 2", ["no TOML file"]),
        (f"tau = {'[' * 3000}", ["run.toml has", "more than 40 deep"]),
        (f"tau = {'1' * 5000}", ["run.toml has a number", "5000 characters in line 1"]),
        ('output = "o\\u0000.png"', ["output", "such as NUL"]),
    ],
)
def test_what_is_refused(text: str, words: list[str], folder: Path) -> None:
    config = write(folder, text + "\n")
    before = listing(folder)
    given = () if "output" in text else ("-o", folder / "out.png")
    psf = () if "psf =" in text else ("--psf", folder / "psf.dng")
    done = run("reconstruct", folder / "raw.dng", *psf, *given, "--config", config)
    check_refused(done, *words)
    assert listing(folder) == before
