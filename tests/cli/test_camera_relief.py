"""`nolens camera relief`: a measured map gives the pattern of the part that was measured."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from numpy.typing import NDArray
from running import check_refused, listing, run

from nolens.camera import preset, to_toml
from nolens.errors import OptionError
from nolens.fabricate.surface import SurfaceName, made_surface
from nolens.files import read_camera
from nolens.files.workshop import write_height_map
from nolens.optics import Grid, MaskSurface, PointSource, Relief
from nolens.twin import Light, Twin, point_spread

sys.path.append(str(Path(__file__).parents[1] / "files"))
from height_maps import (
    write_gwyddion,
    write_imagej,
    write_points,
    write_sdf,
    write_table,
    write_tagged,
)

PITCH = (1.1, 1.1)
SHAPE = (440, 510)
GREEN = Light("535nm")
Heights = NDArray[np.float64]


def pattern(given: str | Path) -> torch.Tensor:
    twin = Twin.of(read_camera(given))
    source = PointSource((0.0, 0.0), 300e3)
    return point_spread(twin, source, (96, 120), superpixel=2, light=GREEN)[1].double()


def alike(one: torch.Tensor, other: torch.Tensor) -> float:
    """Correlation of two patterns."""
    return float(torch.corrcoef(torch.stack([one.ravel(), other.ravel()]))[0, 1])


@pytest.fixture(scope="module")
def truth() -> torch.Tensor:
    return pattern("small")


@pytest.fixture(scope="module")
def heights() -> Heights:
    """What a microscope would measure of the small camera's mask, a little beyond its aperture."""
    relief = Twin.of(read_camera("small")).mask.relief
    return relief.sample(Grid(*SHAPE, PITCH[0])).double().numpy()


def replaced(map_: Path, out: Path, *arguments: object) -> dict[str, Any]:
    done = run("camera", "relief", "small", map_, *arguments, "-o", out, "--json")
    assert done.code == 0, done.err
    told: dict[str, Any] = json.loads(done.out)
    return told


def counts(heights: Heights) -> NDArray[np.uint16]:
    return np.rint((heights + 10) / 20 * 65535).astype(np.uint16)


FORMATS = {
    "floats.tif": (lambda p, h: write_tagged(p, h.astype(np.float32), PITCH), ["--unit", "um"]),
    "counts.tif": (lambda p, h: write_tagged(p, counts(h), PITCH), ["--full-scale", "20um"]),
    "imagej.tif": (lambda p, h: write_imagej(p, (h * 1e3).astype(np.float32), PITCH),
                   ["--unit", "nm"]),
    "table.csv": (lambda p, h: write_table(p, h, ","), ["--unit", "um", "--pitch", "1.1um"]),
    "points.xyz": (lambda p, h: write_points(p, h, PITCH), ["--unit", "um"]),
    "matrix.txt": (lambda p, h: write_gwyddion(p, h, PITCH), []),
    "profiles.sdf": (lambda p, h: write_sdf(p, h, PITCH), []),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMATS)
def test_pattern_of_the_part_that_was_measured(
    name: str, heights: Heights, truth: torch.Tensor, tmp_path: Path
) -> None:
    write, options = FORMATS[name]
    told = replaced(write(tmp_path / name, heights), tmp_path / "made", *options)
    assert alike(pattern(tmp_path / "made"), truth) > 0.999
    assert told["map"]["points"] == list(SHAPE) and told["map"]["bad_points"] == 0
    assert told["map"]["pitch_um"] == pytest.approx(PITCH)
    for key in ("rms_um", "peak_to_valley_um", "steepest", "radius_um"):
        assert told["measured"][key] == pytest.approx(told["described"][key], rel=0.3), key


@pytest.mark.parametrize(
    ("lying", "options"),
    [
        (lambda h: -h[::-1], ["--invert", "--mirror"]),
        (lambda h: h[::-1], ["--mirror"]),
        (lambda h: -h, ["--invert"]),
        (lambda h: h[::-1, ::-1], ["--turn", "180"]),
        (lambda h: -h[::-1][:, ::-1], ["--invert", "--turn", "180"]),
        (lambda h: np.rot90(h, -1), ["--turn", "90"]),
        (lambda h: np.rot90(h, -1)[::-1], ["--mirror", "--turn", "90"]),
        (lambda h: np.rot90(h), ["--turn", "270"]),
        (lambda h: h + 0.022 * np.arange(510) - 0.011 * np.arange(440)[:, None], []),
    ],
    ids=["mould", "mirrored", "inverted", "upside-down", "mould-turned", "on-its-side", "both",
         "other-side", "tilted"],
)  # fmt: skip
def test_however_it_lies(
    lying: Any, options: list[str], heights: Heights, truth: torch.Tensor, tmp_path: Path
) -> None:
    write_tagged(tmp_path / "map.tif", lying(heights).astype(np.float32), PITCH)
    told = replaced(tmp_path / "map.tif", tmp_path / "made", "--unit", "um", *options)
    assert alike(pattern(tmp_path / "made"), truth) > 0.999
    if lying(np.zeros(SHAPE)).any():
        assert told["map"]["tilt_mrad"] == pytest.approx([-10, 20], abs=0.5)
        made = replaced(tmp_path / "map.tif", tmp_path / "left", "--unit", "um", "--keep-tilt")
        assert not made["map"]["tilt_removed"]
        # (n − 1) · tilt turns the light; it then passes layers as thick as 1.28 mm of air.
        left = Twin.of(read_camera(tmp_path / "left")).mask.relief.height_um
        assert float(left.diff(dim=1).mean()) / 1.55 == pytest.approx(0.02, abs=1e-3)


@pytest.mark.parametrize("options", [["--invert"], ["--mirror"], ["--turn", "180"]])
def test_what_is_wrongly_said_shows(
    options: list[str], heights: Heights, truth: torch.Tensor, tmp_path: Path
) -> None:
    write_tagged(tmp_path / "map.tif", heights.astype(np.float32), PITCH)
    replaced(tmp_path / "map.tif", tmp_path / "made", "--unit", "um", *options)
    assert alike(pattern(tmp_path / "made"), truth) < 0.7


def test_bad_points_are_filled(heights: Heights, truth: torch.Tensor, tmp_path: Path) -> None:
    broken = heights.copy()
    broken[np.random.default_rng(0).uniform(size=broken.shape) < 0.02] = np.nan
    bad = int(np.isnan(broken).sum())
    write_tagged(tmp_path / "map.tif", broken.astype(np.float32), PITCH)
    done = run("camera", "relief", "small", tmp_path / "map.tif", "--unit", "um",
               "-o", tmp_path / "made")  # fmt: skip
    assert done.code == 0
    assert f"warning: {bad} points of the map (2 %) are marked as bad" in done.err
    assert alike(pattern(tmp_path / "made"), truth) > 0.999
    record = json.loads((tmp_path / "made" / "relief.json").read_text())
    assert record["result"]["map"]["bad_points"] == bad and len(record["warnings"]) == 1
    assert record["inputs"]["map"]["path"] == str(tmp_path / "map.tif")


def test_a_finer_grid(heights: Heights, truth: torch.Tensor, tmp_path: Path) -> None:
    write_tagged(tmp_path / "map.tif", heights.astype(np.float32), PITCH)
    told = replaced(tmp_path / "map.tif", tmp_path / "made", "--unit", "um", "--grid", "0.9 um")
    assert told["grid_um"] == 0.9
    assert read_camera(tmp_path / "made").camera.mask.relief.grid.um == 0.9  # type: ignore[union-attr]
    assert alike(pattern(tmp_path / "made"), truth) > 0.999


def open_camera(folder: Path) -> Path:
    """The small camera without its aperture, with a curve in a file in a folder of its own."""
    camera = preset("small")
    mask = camera.mask.model_copy(update={"aperture": None})
    text = to_toml(camera.model_copy(update={"mask": mask}))
    at = text.index("[sensor.acceptance]"), text.index("[sensor.package]")
    curve = '[sensor.acceptance]\nfile = "curves/angles.csv"\n\n'
    (folder / "curves").mkdir(parents=True)
    (folder / "camera.toml").write_text(text[: at[0]] + curve + text[at[1] :])
    (folder / "curves" / "angles.csv").write_text("angle_deg,response\n0,1\n60,0.5\n")
    return folder


def test_a_small_patch_is_continued(heights: Heights, tmp_path: Path) -> None:
    given = open_camera(tmp_path / "given")
    write_tagged(tmp_path / "map.tif", heights.astype(np.float32), PITCH)
    arguments = ("camera", "relief", given, tmp_path / "map.tif", "--unit", "um",
                 "-o", tmp_path / "made")  # fmt: skip
    refused = run(*arguments)
    check_refused(refused, "too small for a sensor of 0.397 × 0.496 mm", "--tile")
    words = refused.err.split()
    at = words.index("through")
    needed = float(words[at + 1]), float(words[at + 3])
    assert not (tmp_path / "made").exists()
    done = run(*arguments, "--tile")
    assert done.code == 0, done.err
    assert "warning: the map of 0.482 × 0.56 mm is continued by reflection" in done.err
    made = read_camera(tmp_path / "made")
    assert made.acceptance.response == (1, 0.5)
    assert (tmp_path / "made" / "curves" / "angles.csv").is_file()
    record = json.loads((tmp_path / "made" / "relief.json").read_text())
    assert min(record["result"]["extent_deg"]) > 45
    assert set(record["inputs"]) == {"map", "camera", "camera's curves/angles.csv"}
    twin = Twin.of(made)
    for axis, angle in enumerate(record["result"]["extent_deg"]):
        sensor = made.camera.sensor
        grid = Grid(sensor.rows, sensor.columns, sensor.pitch.um)
        tangent = np.tan(np.deg2rad(angle)).item()
        twin.check_extent(PointSource((tangent, 0) if axis == 0 else (0, tangent)), grid)
    # What was said to be needed is enough, and not much more than that.
    sensor = made.camera.sensor
    for less_mm, enough in ((0.0, True), (0.1, False)):
        rows, columns = (round(1e3 * (side - less_mm) / 1.55) + 1 for side in needed)
        relief = Relief(twin.mask.relief.sample(Grid(rows, columns, 1.55)), 1.55)
        smaller = replace(twin, mask=MaskSurface(relief))
        grid = Grid(sensor.rows, sensor.columns, sensor.pitch.um)
        if enough:
            smaller.check_extent(PointSource((0.0, 0.0)), grid)
        else:
            with pytest.raises(OptionError, match="beyond the sensor"):
                smaller.check_extent(PointSource((0.0, 0.0)), grid)
    # As rough as the patch, on average.
    assert record["result"]["measured"]["rms_um"] == pytest.approx(float(heights.std()), rel=0.15)


def test_text_for_people(heights: Heights, tmp_path: Path) -> None:
    write_tagged(tmp_path / "map.tif", heights.astype(np.float32), PITCH)
    done = run("camera", "relief", "small", tmp_path / "map.tif", "--unit", "um",
               "-o", tmp_path / "made")  # fmt: skip
    assert done.code == 0 and done.err == ""
    for words in ("TIFF of float32: 440×510 points 1.1 µm apart (the file)", "mrad", "bow of",
                  "measured: 0.482 × 0.56 mm, rms 0.", "tops with a radius of",
                  "described: 0.7", str(tmp_path / "made" / "camera.toml")):  # fmt: skip
        assert words in done.out, words
    assert sorted(listing(tmp_path / "made")) == ["camera.toml", "relief.json", "relief.tif"]
    camera = read_camera(tmp_path / "made").camera
    assert camera.name == "small, relief of map.tif"
    assert camera.note.endswith("Its relief was measured: map.tif.")
    assert camera.layers == preset("small").layers
    assert camera.mask.aperture == preset("small").mask.aperture


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["small"], ["no map is given", "nolens camera relief CAMERA MAP -o FOLDER"]),
        (["small", "map.tif"], ["no output is given", "-o folder"]),
        (["smal", "map.tif", "-o", "made"], ["Did you mean the preset 'small'"]),
        (["small", "no.tif", "-o", "made"], ["there is no file no.tif"]),
        (["small", "map.tif", "-o", "made"], ["give --unit um"]),
        (["small", "map.tif", "-o", "made", "--unit", "inch"], ["unit", "inch"]),
        (["small", "map.tif", "-o", "made", "--pitch", "0.5"], ["0.5 has no unit"]),
        (["small", "map.tif", "-o", "made", "--pitch", "0um"], ["pitch", "1 nm to 10 m"]),
        (["small", "map.tif", "-o", "made", "--unit", "um", "--turn", "45"], ["turn", "45"]),
        (
            ["small", "map.tif", "-o", "made", "--unit", "um", "--grid", "9nm"],
            ["million points", "coarser --grid"],
        ),
        (["small", "map.tif", "-o", "made", "--unit", "um", "--grid", "1mm"], ["finer --grid"]),
        (["small", "map.tif", "-o", "made", "--unit", "mm"], ["too coarse", "--grid", "noise"]),
        (["small", "map.tif", "-o", "file.txt", "--unit", "um"], ["file.txt is a file", "-o"]),
        (
            ["small", "narrow.tif", "-o", "made", "--unit", "um"],
            ["aperture is 0.2 × 0.25 mm", "--tile"],
        ),
        (
            ["small", "holes.tif", "-o", "made", "--unit", "um"],
            ["10 % of the points", "marked as bad", "5 %"],
        ),
        (["given", "map.tif", "-o", "given", "--unit", "um"], ["would overwrite the camera"]),
    ],
    ids=lambda each: " ".join(each)[-40:],
)
def test_refused(
    arguments: list[str], words: list[str], heights: Heights, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    write_tagged(Path("map.tif"), heights.astype(np.float32), PITCH)
    write_tagged(Path("narrow.tif"), heights[:, :220].astype(np.float32), PITCH)
    holes = heights.astype(np.float32)
    holes[::10] = np.nan
    write_tagged(Path("holes.tif"), holes, PITCH)
    Path("file.txt").touch()
    open_camera(Path("given"))
    before = listing(tmp_path)
    check_refused(run("camera", "relief", *arguments), *words)
    assert listing(tmp_path) == before


def test_nothing_is_half_written(
    heights: Heights, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_tagged(tmp_path / "map.tif", heights.astype(np.float32), PITCH)
    (tmp_path / "made").mkdir()
    before = listing(tmp_path)

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tifffile, "imwrite", fail)
    done = run("camera", "relief", "small", tmp_path / "map.tif", "--unit", "um",
               "-o", tmp_path / "made")  # fmt: skip
    check_refused(done, "No space left")
    assert listing(tmp_path) == before
    shutil.rmtree(tmp_path / "made")


@pytest.mark.parametrize(
    ("surface", "options"),
    [("replica", ["--mirror"]), ("master", ["--mirror"]), ("mould", ["--invert", "--turn", "180"])],
)
def test_what_is_to_be_made_gives_the_cameras_pattern(
    surface: SurfaceName, options: list[str], truth: torch.Tensor, tmp_path: Path
) -> None:
    """mask.tif is as a microscope sees the surface; its tags say pitch and heights."""
    relief = Twin.of(read_camera("small")).mask.relief
    write_height_map(tmp_path / "mask.tif", made_surface(relief, surface, "small").coarser(2.0))
    told = replaced(tmp_path / "mask.tif", tmp_path / "made", *options)
    assert told["map"]["pitch_um"] == pytest.approx([2, 2])
    assert told["map"]["pitch_from"] == "the file"
    assert alike(pattern(tmp_path / "made"), truth) > 0.999
