"""What `simulate` and `psf` refuse: code 2, one message with what would work, nothing written."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image
from running import check_refused, command, listing, run
from simulated import plain, scene

from nolens.camera import preset_text

SIMULATE: list[tuple[list[object], list[str]]] = [
    (["--distance", "300"], ["distance is '300'", "no unit", "300 mm", "nm, um, mm", "'infinity'"]),
    (["--angle", "60"], ["angle is '60'", "no unit", "60 deg", "units: deg, rad, mrad"]),
    (["--exposure", "40"], ["exposure is '40'", "no unit", "40 ms", "units: us, ms, s"]),
    (["--luminance", "100"], ["luminance is '100'", "no unit", "100 cd/m2"]),
    (["--fill", "0.9"], ["fill is '0.9'", "no unit", "90 %"]),
    (["--angle", "60mm"], ["angle is '60mm'", "unit 'mm' is unknown", "deg, rad, mrad"]),
    (["--distance", "far"], ["distance is 'far'", "not a length", "'infinity'"]),
    (["--fill", "0%"], ["fill is '0%'", "it must be 0.001 % to 10000 %"]),
    (["--exposure", "-1ms"], ["exposure is '-1ms'", "0.001 µs to 1000000 s"]),
    (["--luminance", "0cd/m2"], ["luminance is '0cd/m2'", "0.000001 cd/m2 to"]),
    (["--exposure", "1e10s"], ["exposure is '1e10s'", "to 1000000 s"]),
    (["--luminance", "1e13nit"], ["luminance is '1e13nit'", "to 1000000000000 cd/m2"]),
    (["--fill", "10001%"], ["fill is '10001%'", "to 10000 %"]),
    (["--fill", "50%", "--exposure", "1ms"], ["--fill 50 %", "--exposure 1 ms", "leave one out"]),
    (["--distance", "1m", "--distance", "2m"], ["--distance", "2 times for 1 scene", "once"]),
    (["--angle", "9deg", "--angle", "8deg"], ["--angle", "2 times for 1 scene", "once"]),
    (["--angle", "100deg"], ["56.1 deg off the axis", "holds to 50 deg", "at most 87.2deg"]),
    (["--angle", "0deg"], ["angle is '0deg'", "0.001 deg to 179.9 deg"]),
    (["--angle", "179deg"], ["holds to 50 deg", "at most 87.2deg"]),
    (["--distance", "0.5mm"], ["0.5 mm is nearer than the mask's near limit", "1 mm or more"]),
    (["--distance", "-1m"], ["distance is '-1m'", "0.1 µm to 1000000 m or 'infinity'"]),
    (["--field-points", "4"], ["4 field points", "odd", "5 or 9"]),
    (["--field-points", "0"], ["field-points is 0", "1 to 101"]),
    (["--field-points", "2.5"], ["2.5 is no whole number"]),
    (["--wavelengths", "0"], ["wavelengths is 0", "1 to 100"]),
    (["--seed", "-1"], ["seed is -1", "0 to 9223372036854775807"]),
    (["--light", "red"], ["unknown light 'red'", "white-led, daylight", "535nm"]),
    (["--light", "900nm"], ["sees nothing of the light 900nm", "400 to 700 nm", "--light"]),
    (["--camera", "smal"], ["no camera 'smal'", "Did you mean the preset 'small'?"]),
    (["--camera", "."], ["holds no camera.toml"]),
    (["--truth", "t.png"], ["t.png", ".tif"]),
    (["--response", "raw.dng"], ["raw.dng", ".tif"]),
    (["--truth", "t.tif", "--response", "t.tif"], ["response t.tif is given twice", "--response"]),
    (["--truth", "none/t.tif"], ["no folder none"]),
    (["--lite", "535nm"], ["--lite", "Did you mean --light?"]),
]

PSF: list[tuple[list[object], list[str]]] = [
    (["--angle", "20deg"], ["angle is '20deg'", "two angles", "20deg,0deg"]),
    (["--angle", "20,0"], ["angle is '20'", "no unit", "20 deg"]),
    (["--angle", "-95deg,0deg"], ["angle is '-95deg'", "-89.9 deg to 89.9 deg"]),
    (["--angle", "45deg,45deg"], ["54.7 deg off the axis", "holds to 50 deg"]),
    (["--distance", "80"], ["distance is '80'", "no unit", "80 mm", "'infinity'"]),
    (["--distance", "0.9mm"], ["0.9 mm is nearer", "1 mm or more"]),
    (["--size", "50"], ["size is '50'", "no unit", "50 mm"]),
    (["--size", "-1um"], ["size is '-1um'", "0 µm to 10 m"]),
    (["--size", "9um", "--distance", "infinity"], ["--size 9 um at infinity", "Leave --size out"]),
    (["--size", "10m"], ["GB of memory", "the machine has"]),
    (["--pixels", "9"], ["pixels is '9'", "HEIGHTxWIDTH"]),
    (["--pixels", "99999999999999x9"], ["pixels is", "HEIGHTxWIDTH"]),
    (["--pixels", "0x9"], ["pixels is '0x9'", "HEIGHTxWIDTH"]),
    (["--pixels", "65535x65535"], ["GB of memory", "the machine has", "fewer --pixels"]),
    (["--bin", "0"], ["bin is 0", "1 to 64"]),
    (["--bin", "400"], ["bin is 400", "1 to 64"]),
    (["--fill", "90%"], ["--fill 90 %", "without exposure", "out.dng"]),
    (["--seed", "3"], ["--seed 3", "without exposure", "out.dng"]),
    (["-o", "psf.dng", "--bin", "2"], ["--bin 2", "every pixel", "psf.tif"]),
    (["-o", "psf.dng", "--pixels", "33x40"], ["--pixels 33x40", "even numbers"]),
    (["-o", "psf.jpg"], ["psf.jpg", ".dng, .tif", ".png"]),
    (["--frame", "sky"], ["--frame", "sky", "chief-ray"]),
    (["psf.tif"], ["'psf.tif' is more than psf takes"]),
]


def refuses(folder: Path, words: list[str], *arguments: object) -> None:
    before = listing(folder)
    done = run(*arguments)
    check_refused(done, *words)
    assert listing(folder) == before


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(("options", "words"), SIMULATE, ids=lambda each: " ".join(map(str, each)))
def test_simulate(options: list[object], words: list[str], tmp_path: Path) -> None:
    given = [] if "--camera" in options else ["--camera", "small"]
    refuses(tmp_path, words, "simulate", scene(tmp_path / "s.png"), *given, "-o", "x.dng", *options)


@pytest.mark.parametrize(("options", "words"), PSF, ids=lambda each: " ".join(map(str, each)))
def test_psf(options: list[object], words: list[str], tmp_path: Path) -> None:
    output = [] if "-o" in options else ["-o", "out.tif"]
    refuses(tmp_path, words, "psf", "--camera", "small", *output, *options)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate"], ["no scene is given", "nolens simulate SCENE -o raw.dng"]),
        (["simulate", "s.png"], ["no output is given", "-o raw.dng"]),
        (["simulate", "none.png", "-o", "x.dng"], ["there is no file none.png"]),
        (["simulate", ".", "-o", "x.dng"], [". is a moving scene", "--exposure 2ms"]),
        (
            ["simulate", "s.png", "--frame-duration", "1ms", "-o", "x.dng"],
            ["--frame-duration 1 ms", "is for a moving scene"],
        ),
        (["simulate", "s.png", "-o", "x.png"], ["x.png", ".dng, .tif"]),
        (["simulate", "s.png", "-o", "s.png/x.dng"], ["is a file, not a folder"]),
        (["psf"], ["no output is given", "-o x.tif"]),
    ],
)
def test_what_is_needed(arguments: list[object], words: list[str], tmp_path: Path) -> None:
    scene(tmp_path / "s.png")
    refuses(tmp_path, words, *arguments)


def test_output_over_an_input(tmp_path: Path) -> None:
    Image.new("RGB", (40, 30)).save(tmp_path / "scene.tif")
    words = ["the output scene.tif would overwrite the scene scene.tif", "another name (-o)"]
    refuses(tmp_path, words, "simulate", "scene.tif", "--camera", "small", "-o", "scene.tif")
    words = ["the truth scene.tif would overwrite the scene scene.tif", "another name (--truth)"]
    asked = ("simulate", "scene.tif", "--camera", "small", "-o", "x.dng", "--truth", "scene.tif")
    refuses(tmp_path, words, *asked)


SPOILT: dict[str, tuple[Callable[[str], str], list[str]]] = {
    "zero thickness": (
        lambda text: text.replace('"0.49 mm"', '"0 mm"'),
        ["layers[1].thickness is '0 mm'", "zero or negative thickness", "0.5 mm"],
    ),
    "negative thickness": (
        lambda text: text.replace('"0.49 mm"', '"-0.49 mm"'),
        ["layers[1].thickness is '-0.49 mm'", "zero or negative thickness"],
    ),
    "thickness without a unit": (
        lambda text: text.replace('"0.49 mm"', "0.49"),
        ["layers[1].thickness is 0.49", "no unit", "nm, um, mm, cm, m"],
    ),
    "unknown material": (
        lambda text: text.replace('"cover-glass"', '"cover-gloss"'),
        ["layers[1].material is 'cover-gloss'", "cover-glass"],
    ),
    "relief too coarse": (
        lambda text: text.replace('"0.67 mm"', '"0.05 mm"'),
        ["a point every 1.55 µm, too coarse", "a grid of 0.2", "µm or finer would do"],
    ),
    "lenslets finer than the grid": (
        lambda text: text.replace('"70 um"', '"2 um"'),
        ["a lenslet every 2 um", "a point only every 1.55 um", "a grid of 0.2 µm"],
    ),
    "more memory than there is": (
        lambda text: re.sub("rows = 256\ncolumns = 320", "rows = 60000\ncolumns = 60000", text),
        ["GB of memory", "the machine has", "fewer"],
    ),
    "pixels without end": (
        lambda text: text.replace('pitch = "1.55 um"', 'pitch = "1e-25 m"'),
        ["sensor.pitch is '1e-25 m'", "50 nm to 10 mm"],
    ),
    "relief that ends": (
        lambda text: text[: text.index("[mask.aperture]")].replace('"0.6 mm"', '"0.1 mm"'),
        ["beyond the sensor", "relief of 'small' has ended", "an overhang of", "an aperture"],
    ),
    "a figure beyond any sensor": (
        lambda text: text.replace("read_noise_electrons = 3", "read_noise_electrons = 1e39"),
        ["sensor.read_noise_electrons is 1e+39", "0 to 1000000"],
    ),
    "DNG without a whole black level": (
        lambda text: text.replace("black_counts = 256", "black_counts = 256.5"),
        ["x.dng would be a DNG with a whole black level", "256.5", "x.tif"],
    ),
}


@pytest.mark.parametrize("name", SPOILT)
@pytest.mark.parametrize("asked", ["simulate", "psf"])
def test_camera(asked: str, name: str, tmp_path: Path) -> None:
    spoil, words = SPOILT[name]
    text = preset_text("small")
    assert spoil(text) != text
    (tmp_path / "camera.toml").write_text(spoil(text))
    given = [scene(tmp_path / "s.png"), "--angle", "80deg"]
    if asked == "psf":
        given = ["--angle", "40deg,0deg"]
    more = ("--camera", "camera.toml", "--light", "535nm", "-o", "x.dng")
    refuses(tmp_path, words, asked, *given, *more)


def test_coarse_relief_of_a_file(tmp_path: Path) -> None:
    text = preset_text("small")
    start, end = text.index("[mask.relief]"), text.index("[mask.aperture]")
    relief = '[mask.relief]\nkind = "file"\nfile = "relief.tif"\ngrid = "1.55 um"\n\n'
    (tmp_path / "camera.toml").write_text(text[:start] + relief + text[end:])
    heights = np.random.default_rng(0).uniform(0, 2, (400, 400)).astype(np.float32)
    tifffile.imwrite(tmp_path / "relief.tif", heights)
    words = ["too coarse", "µm or finer would do"]
    refuses(tmp_path, words, "psf", "--camera", tmp_path, "-o", "psf.tif")
    words = ["relief.tif would overwrite the camera's relief.tif", "another name (-o)"]
    refuses(tmp_path, words, "psf", "--camera", tmp_path, "-o", "relief.tif")
    (tmp_path / "relief.tif").unlink()
    refuses(tmp_path, ["no file", "relief.tif"], "psf", "--camera", tmp_path, "-o", "psf.tif")


def test_dng_without_a_mosaic(tmp_path: Path) -> None:
    curve = preset_text("small").replace('mosaic = "RGGB"', 'mosaic = "none"')
    text = re.sub(r"\nR = (\[.*?\])\nG = .*?\n\n", r"\ngrey = \1\n\n", curve, flags=re.DOTALL)
    (tmp_path / "camera.toml").write_text(text)
    words = ["x.dng would be a DNG, which holds a colour mosaic", "has none: write x.tif"]
    refuses(tmp_path, words, "psf", "--camera", tmp_path, "-o", "x.dng")


def test_black_scene(tmp_path: Path) -> None:
    given = ("simulate", plain(tmp_path / "s.png", 0, 0, 0), "--camera", "small")
    more = ("--field-points", 1, "--wavelengths", 1, "-o", "x.dng")
    words = ["no light reaches the sensor", "scene is black", "--exposure 40ms"]
    refuses(tmp_path, words, *given, *more)
    assert run(*given, *more, "--exposure", "40ms").code == 0


def test_angle_that_no_pixel_accepts(tmp_path: Path) -> None:
    text = preset_text("small").replace("0.89, 0.76, 0.56, 0.32, 0.12]", "0, 0, 0, 0, 0]")
    (tmp_path / "camera.toml").write_text(text)
    words = ["no light from 40 deg off the axis", "do not accept it", "smaller angle"]
    for name in ("psf.tif", "psf.dng"):
        refuses(tmp_path, words, "psf", "--camera", tmp_path, "--angle", "40deg,0deg", "-o", name)


def test_no_cuda(tmp_path: Path) -> None:
    """By the installed command, as all else that the process decides."""
    before = listing(tmp_path)
    hidden = {"CUDA_VISIBLE_DEVICES": ""}
    done = command("psf", "--device", "cuda", "-o", tmp_path / "x.tif", env=hidden)
    check_refused(done, "--device cuda", "no CUDA device", "cpu or auto")
    assert listing(tmp_path) == before
