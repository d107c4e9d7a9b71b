"""Long tables of what is refused, by the same code in this process."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from little_camera import Camera, as_counts, expose_dng, measured, save, spots
from running import check_refused, listing, run

VALUES: list[tuple[list[object], list[str]]] = [
    (["--tau", "nan"], ["tau is", "finite"]),
    (["--tau", "inf"], ["tau is", "finite"]),
    (["--tau", "much"], ["--tau", "much", "valid number", "auto"]),
    (["--tau", -1e-9, "--method", "fista"], ["tau is", "-1e-09", "it must be 0 to 1000000"]),
    (["--tau", 0, "--method", "wiener"], ["tau is 0", "Wiener"]),
    (["--tolerance", -1], ["tolerance is -1", "it must be 0 to 1"]),
    (["--tolerance", "nan"], ["tolerance is", "finite"]),
    (["--iterations", 0], ["iterations is 0", "it must be 1 to 1000000"]),
    (["--iterations", -3], ["iterations is -3", "it must be 1 to 1000000"]),
    (["--iterations", 0, "--method", "fista"], ["iterations is 0"]),
    (["--iterations", 2.5], ["--iterations", "2.5 is no whole number"]),
    (["--bin", "two"], ["--bin", "two is no whole number"]),
    (["--penalties", 1, 0, 1], ["penalties is 0", "1e-09 to"]),
    (["--penalties", 1, -2, 1], ["penalties is -2", "1e-09 to"]),
    (["--penalties", 1, "inf", 1], ["penalties", "finite"]),
    (["--penalties", 1, 2], ["--penalties", "3"]),
    (["--relaxation", 2.5], ["relaxation is 2.5", "0.01 to 1.99"]),
    (["--relaxation", 0], ["relaxation is 0", "0.01 to 1.99"]),
    (["--relaxation", "nan"], ["relaxation", "finite"]),
    (["--bin", 0], ["bin is 0", "it must be 1 to 64"]),
    (["--bin", -1], ["bin is -1", "1 to 64"]),
    (["--bin", 999], ["bin is 999", "1 to 64"]),
    (["--bin", 49], ["cannot bin", "by 49", "1 to 48"]),
    (
        ["--psf-scale", 2, "--psf-extent", "wide"],
        ["48×64", "Leave out --psf-extent wide"],
    ),
    (["--psf-scale", 0], ["psf-scale is 0", "1 to 64"]),
    (["--psf-scale", 3], ["48×64", "leave it out"]),
    (["--psf-extent", "wide"], ["48×64", "Leave out --psf-extent wide"]),
    (["--dark", "RAW", "--black", 256], ["dark frame", "black level (256)", "one of the two"]),
    (["--dark", "RAW", "--black", "auto"], ["dark frame", "one of the two"]),
    (["--dark", "missing.dng"], ["no file missing.dng"]),
    (["--flat", "missing.dng"], ["no file missing.dng"]),
    (["--black", "dark"], ["black is 'dark'", "number", "'auto'"]),
    (["--black", 4000], ["nowhere brighter", "4000", "--black"]),
    (["--black", "nan"], ["black is", "finite"]),
    (["--white", "nan"], ["white is", "finite"]),
    (["--mosaic", "RGBG"], ["'RGBG'", "RGGB, BGGR, GRBG, GBRG"]),
    (["--mosaic", "BGGR"], ["raw.dng says its mosaic is RGGB", "leave out --mosaic"]),
    (["--bgr"], ["raw.dng", "leave out --bgr"]),
    (["--channels", "x"], ["channels 'x'", "R, G, B", "give all, grey"]),
    (["--channels", "rr"], ["channels 'rr'"]),
    (["--channels", ""], ["channels ''"]),
    (["--method", "amdm"], ["amdm", "admm", "fista", "wiener"]),
    (["--prior", "tvv"], ["tvv", "isotropic-tv", "l1"]),
    (["--device", "gpu"], ["gpu", "cuda"]),
    (["--flip", "up"], ["up", "vertical", "horizontal"]),
    (["--tiff-bits", 8], ["8", "16", "32"]),
    (["--support", "24"], ["support is '24'", "HEIGHTxWIDTH", "400x400"]),
    (["--support", "24x32+1"], ["support is '24x32+1'", "+TOP+LEFT"]),
    (["--support", "0x32"], ["support is '0x32'"]),
    (["--support", "-4x32"], ["--support"]),
    (["--support", ""], ["support is ''"]),
    (["--support", "9" * 5000 + "x1"], ["support is '999", "below a million"]),
    (["--support", "10x10+500+0"], ["no light from the support", "overlaps the sensor"]),
    (["--support", "100000x100000"], ["--support 100000x100000", "at most 96x128"]),
    (["--crop", "big"], ["crop is 'big'", "HEIGHTxWIDTH", "'all'"]),
    (["--crop", "400x400"], ["--crop 400x400", "beyond the scene", "or all"]),
    (["--crop", "24x32+40+40", "--support", "24x32"], ["beyond the scene", "24×32", "+12+16"]),
    (["--crop", ""], ["crop is ''"]),
    (["--psf", "RAW"], ["--psf", "multiple times"]),
    (["extra.dng"], ["'extra.dng' is more than reconstruct takes", "nolens reconstruct RAW"]),
    (["--colour"], ["Unknown option", "--colour"]),
    (["-p", "x"], ["Unknown option", "-p"]),
    (["--config", "missing.toml"], ["cannot read missing.toml", "No such file"]),
    (["--config", "RAW"], ["raw.dng is no TOML file"]),
    (["-o", "OUT"], ["is given twice", "own name"]),
    (["-o", "FOLDER/b.jpg"], ["b.jpg", ".jpg is not known", ".png, .tif"]),
    (["-o", "FOLDER/b"], ["(none)", ".png, .tif"]),
    (["-o", "FOLDER"], ["is a folder", "name of a file in it"]),
    (["-o", "RAW/b.png"], ["b.png", "is a file, not a folder"]),
    (["-o", "FOLDER/z.png/../out.png"], ["no folder"]),
]


@pytest.mark.parametrize(
    ("options", "words"), VALUES, ids=lambda each: " ".join(map(str, each))[:80]
)
def test_value(
    options: list[object], words: list[str], camera: Camera, out: Path, tmp_path: Path
) -> None:
    names = {"RAW": camera.raw, "OUT": out, "FOLDER": tmp_path}
    given = []
    for option in map(str, options):
        start, slash, rest = option.partition("/")
        given.append(f"{names[start]}{slash}{rest}" if start in names else option)
    before = listing(camera.folder)
    done = run("reconstruct", camera.raw, "--psf", camera.psf, "-o", out, *given)
    check_refused(done, *words)
    assert listing(tmp_path) == {} and listing(camera.folder) == before


COMMANDS: list[tuple[list[object], list[str]]] = [
    (
        ["recnstruct"],
        ['Did you mean "reconstruct"', "reconstruct, refocus, "],
    ),
    (["--psf", "x"], ["--psf"]),
    (["reconstruct"], ["no measurement is given", "nolens reconstruct RAW --psf PSF -o out.png"]),
    (["reconstruct", "raw.dng"], ["no psf is given", "--psf FILE"]),
    (["reconstruct", "raw.dng", "--psf", "p.dng"], ["no output is given", "-o out.png"]),
    (["reconstruct", "raw.dng", "--psf"], ["--psf requires an argument"]),
    (["reconstruct", "", "--psf", "p.dng", "-o", "x.png"], ["give the name of a folder"]),
    (["info"], ["no FILE is given", "nolens info FILE"]),
    (["info", "a.dng", "b.dng"], ["'b.dng' is more than info takes"]),
    (["info", "."], ["is a folder", "name of a file in it"]),
    (["info", "missing.dng"], ["no file missing.dng"]),
    (["info", "/dev/null"], ["no file but a device"]),
    (["info", "a.dng", "--jsn"], ["--jsn", "Did you mean --json?"]),
    (["demo", "-o", __file__], ["is a file", "give the name of a folder"]),
    (["demo", "here"], ["'here' is more than demo takes", "demo -o FOLDER"]),
]


@pytest.mark.parametrize(("arguments", "words"), COMMANDS, ids=lambda each: " ".join(each))
def test_command(
    arguments: list[object], words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    check_refused(run(*arguments), *words)
    assert listing(tmp_path) == {}


def npy(path: Path) -> Path:
    np.save(path, as_counts(measured(spots()), seed=1).numpy().astype(np.uint16))
    return path


MAKERS: dict[str, Callable[[Path], Path]] = {
    ".dng": lambda path: expose_dng(path, measured(spots()), seed=1),
    ".tif": lambda path: save(path, as_counts(measured(spots()), seed=1)),
    ".png": lambda path: save(path, as_counts(measured(spots()), seed=1)),
    ".npy": npy,
}


@pytest.mark.parametrize("role", ["measurement", "psf", "dark", "flat"])
@pytest.mark.parametrize("suffix", MAKERS)
def test_truncated(suffix: str, role: str, camera: Camera, tmp_path: Path) -> None:
    cut = MAKERS[suffix](tmp_path / f"cut{suffix}")
    data = cut.read_bytes()
    lengths = [0, len(data) // 3, len(data) - 1]
    if role == "measurement":  # All are read alike.
        lengths += [1, 7, 30, 100, len(data) - 3000]
    for length in lengths:
        cut.write_bytes(data[:length])
        raw, psf = (cut if role == each else path for each, path in
                    (("measurement", camera.raw), ("psf", camera.psf)))  # fmt: skip
        more = [f"--{role}", cut] if role in ("dark", "flat") else []
        done = run("reconstruct", raw, "--psf", psf, "-o", tmp_path / "out.png", *more)
        check_refused(done, f"cut{suffix}")
        assert list(listing(tmp_path)) == [cut.name]
        check_refused(run("info", cut), f"cut{suffix}")


def spoilt(kind: str) -> torch.Tensor:
    values = as_counts(spots(), seed=2)
    if kind == "infinite":
        values[0, 3, 4] = float("inf")
    elif kind == "constant":
        values[:] = 700
    elif kind == "dark channel":
        values[1] = 0
    return values


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("infinite", ["1 values that are NaN or infinite"]),
        ("constant", ["is 700 everywhere"]),
        ("dark channel", ["channel G", "zero everywhere", "--channels"]),
    ],
)
@pytest.mark.parametrize("role", ["measurement", "psf"])
def test_data(kind: str, words: list[str], role: str, camera: Camera, tmp_path: Path) -> None:
    bad = save(tmp_path / "bad.npy", spoilt(kind))
    raw, psf = (bad, camera.psf) if role == "measurement" else (camera.raw, bad)
    done = run("reconstruct", raw, "--psf", psf, "-o", tmp_path / "out.png")
    check_refused(done, "bad.npy", *words)
    assert list(listing(tmp_path)) == ["bad.npy"]


@pytest.mark.parametrize("role", ["psf", "dark", "flat"])
@pytest.mark.parametrize("link", [False, True])
def test_output_over_any_input(role: str, link: bool, camera: Camera, tmp_path: Path) -> None:
    read = save(tmp_path / "read.tif", as_counts(spots(), seed=2))
    written = read
    if link:
        written = tmp_path / "link.tif"
        written.symlink_to(read)
    files = {"--psf": camera.psf, f"--{role}": read}
    options = [each for pair in files.items() for each in pair]
    before = listing(tmp_path)
    done = run("reconstruct", camera.raw, *options, "-o", tmp_path / "out.png", "-o", written)
    check_refused(done, f"{written} would overwrite the {role} {read}", "another name (-o)")
    assert listing(tmp_path) == before


def test_record_over_the_configuration(camera: Camera, tmp_path: Path) -> None:
    config = tmp_path / "out.json"
    config.write_text("iterations = 3\n")
    asked = ("--psf", camera.psf, "--config", config)
    done = run("reconstruct", camera.raw, *asked, "-o", tmp_path / "out.png")
    check_refused(done, "record of the run", "would overwrite the configuration", "another name")
    assert config.read_text() == "iterations = 3\n"


def test_record_where_a_folder_is(camera: Camera, tmp_path: Path) -> None:
    (tmp_path / "out.json").mkdir()
    done = run("reconstruct", camera.raw, "--psf", camera.psf, "-o", tmp_path / "out.png")
    check_refused(done, "out.json is a folder")
    assert list(listing(tmp_path)) == ["out.json"]
