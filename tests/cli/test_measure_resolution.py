"""`nolens measure resolution`: frames, pictures and simulations of targets."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from running import check_refused, listing, run
from scipy.ndimage import gaussian_filter
from torch import Tensor

from nolens.camera import PsfEntry, develop
from nolens.evaluate import siemens_star, slanted_edge, star_contrast
from nolens.experiments.resolution import TAU, AngularScale
from nolens.experiments.virtual_experiment import VirtualExperiment, solved
from nolens.files import (
    read_camera,
    read_frame,
    read_picture,
    write_frame,
    write_png,
    write_psfs,
    write_tiff32,
)
from nolens.files.cameras import camera_copies
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.quantities import Angle, Length
from nolens.twin import FieldMap, Twin

DISTANCE_MM = 180.0
SEPARATIONS_MM = (1.2, 1.6, 2.0, 2.6)
SUPPORT = PixelRectangle.centred(40, 40, (128, 160))
COMMAND = ("measure", "resolution")


def measured(*arguments: object) -> dict[str, Any]:
    done = run(*COMMAND, *arguments, "--json")
    assert done.code == 0, done
    told: dict[str, Any] = json.loads(done.out)
    return told


@pytest.fixture(scope="module")
def bench() -> VirtualExperiment:
    return VirtualExperiment.of(read_camera("small"), light="535nm")


@pytest.fixture(scope="module")
def captured(bench: VirtualExperiment, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Raw frames of two points at some separations, the PSF, and one reconstructed picture."""
    folder = tmp_path_factory.mktemp("frames")
    distance_um = DISTANCE_MM * 1e3
    psf = bench.psf(PointSource((0.0, 0.0), distance_um))
    write_tiff32(folder / "psf.tif", psf)
    for number, separation in enumerate(SEPARATIONS_MM):
        half = separation / DISTANCE_MM / 2
        light = torch.zeros(())
        for column in (-half, half):
            light = light + bench.light_of(PointSource((0.0005, column + 0.0007), distance_um))
        frame = bench.exposed(light, 0.9, number)
        write_frame(folder / f"raw{number}.dng", frame)
        seen = develop(frame, channels="grey")
        picture = solved(seen, psf.mean(0, keepdim=True), SUPPORT, iterations=100, tau=TAU)
        write_tiff32(folder / f"picture{number}.tif", picture)
    return folder


def frames(folder: Path, name: str) -> list[object]:
    given: list[object] = [folder / name.format(number) for number in range(len(SEPARATIONS_MM))]
    for each in SEPARATIONS_MM:
        given += ["--separation", f"{each}mm"]
    return [*given, "--distance", f"{DISTANCE_MM}mm"]


def test_psfs_over_the_field(captured: Path, tmp_path: Path) -> None:
    """Of a folder; where they are alike, points are as far apart as with one."""
    psf = read_frame(captured / "psf.tif").counts
    camera = read_camera("small")
    entry = PsfEntry(
        file="psf.tif", pixel=Length("3.1", "um"), channels=camera.camera.sensor.channels,
        distance=Length("180", "mm"),
    )  # fmt: skip
    aside = entry.model_copy(update={"file": "b.tif", "angle": (Angle.of(9, "deg"),) * 2})
    write_psfs(tmp_path, {entry: psf, aside: psf}, more=camera_copies("small", camera))
    asked = ("two-points", captured / "raw3.dng", "--separation", "2.6mm", "--distance", "180mm",
             "--support", "40x40", "--plot", tmp_path / "two.png")  # fmt: skip
    (dip,) = (each["dip"] for each in measured(*asked, "--psf", tmp_path)["separations"])
    assert dip > 0.9
    assert "PSF b.tif" in json.loads((tmp_path / "two.json").read_text())["inputs"]


def test_two_points_on_raw_frames(captured: Path, tmp_path: Path) -> None:
    plot = tmp_path / "two.png"
    told = measured(
        "two-points", *frames(captured, "raw{}.dng"), "--psf", captured / "psf.tif",
        "--camera", "small", "--support", "40x40", "--plot", plot,
    )  # fmt: skip
    angles = [each["separation_deg"] for each in told["separations"]]
    wanted = [math.degrees(2 * math.atan(each / DISTANCE_MM / 2)) for each in SEPARATIONS_MM]
    assert angles == pytest.approx(wanted, rel=1e-4)
    dips = [each["dip"] for each in told["separations"]]
    assert dips == sorted(dips) and dips[0] == 0 and dips[-1] > 0.9
    # 14 um wide lines 1.28 mm behind the mask: 0.63 deg; noise and solver shift it.
    assert 0.5 < told["resolved_deg"] < 0.65
    between = (angles[2] - angles[1]) / 2
    assert told["plus_minus_deg"] == pytest.approx(between, rel=1e-3)
    assert told["outputs"] == [str(plot), str(tmp_path / "two.json")]
    record = json.loads((tmp_path / "two.json").read_text())
    assert record["result"] == told and len(record["inputs"]) == 5 and record["warnings"] == []
    assert plot.read_bytes()[:4] == b"\x89PNG"
    # The same pictures give the same dips, whoever reconstructed them.
    for scale in (("--camera", "small"), ("--pixel-angle", "0.13908deg")):
        again = measured("two-points", *frames(captured, "picture{}.tif"), *scale)
        for one, other in zip(told["separations"], again["separations"], strict=True):
            assert one["dip"] == pytest.approx(other["dip"], abs=0.01)
        assert again["iterations"] is None and again["outputs"] == []


def test_two_points_simulated(captured: Path) -> None:
    told = measured(
        "two-points", "--simulate", "small", "--light", "535nm", "--distance", "180mm",
        "--draws", 1,
    )  # fmt: skip
    low, high = told["largest_unresolved_deg"], told["smallest_resolved_deg"]
    assert low < told["resolved_deg"] < high and high - low < 0.2 * 0.14
    assert told["plus_minus_deg"] == pytest.approx((high - low) / 2, rel=0.01)
    assert 0.48 < told["resolved_deg"] < 0.65
    assert told["iterations"] == 100 and told["tau"] == 5e-6 and told["simulated"] == "small"
    # Frames of the same camera, solved by themselves, agree within what both are uncertain by.
    from_frames = measured(
        "two-points", *frames(captured, "picture{}.tif"), "--pixel-angle", "0.139deg"
    )
    apart = abs(from_frames["resolved_deg"] - told["resolved_deg"])
    assert apart < from_frames["plus_minus_deg"] + told["plus_minus_deg"]


def test_words_for_people(captured: Path) -> None:
    given = frames(captured, "picture{}.tif")
    done = run(*COMMAND, "two-points", *given, "--camera", "small")
    assert done.code == 0 and done.err == ""
    assert "0.828 deg: dip" in done.out and "resolved" in done.out
    assert "smallest resolved angle: 0.5" in done.out and "dip of 26.5 %" in done.out
    all_seen = run(*COMMAND, "two-points", captured / "picture3.tif", "--separation", "2.6mm",
                   "--distance", "180mm", "--camera", "small")  # fmt: skip
    assert all_seen.code == 0 and "is 0.828 deg or less" in all_seen.err
    none_seen = run(*COMMAND, "two-points", captured / "picture0.tif", "--separation", "1.2mm",
                    "--distance", "180mm", "--camera", "small")  # fmt: skip
    assert none_seen.code == 0 and "0.382 deg, is not resolved" in none_seen.err


def written(path: Path, picture: Tensor) -> Path:
    write_tiff32(path, picture.float()[None])
    return path


def blurred_star(sigma: float = 2.0, spokes: int = 24, side: int = 160) -> Tensor:
    fine = 4
    sharp = siemens_star(side * fine, spokes).numpy()
    blurred = gaussian_filter(sharp, sigma * fine, mode="nearest")
    return torch.from_numpy(blurred.reshape(side, fine, side, fine).mean((1, 3)))


@pytest.mark.usefixtures("undrawn")
def test_siemens_on_a_picture(tmp_path: Path) -> None:
    """A Gaussian blur's contrast of a share c is at the period πσ√(2/ln(1/c))."""
    star, sigma = written(tmp_path / "star.tif", blurred_star()), 2.0
    plot = tmp_path / "out.png"
    told = measured("siemens", star, "--pixel-angle", "0.1deg", "--plot", plot)
    assert told["spokes"] == 24 and told["centre"] == pytest.approx([79.5, 79.5], abs=0.02)
    assert told["diameter_deg"] == pytest.approx(0.96 * 16, rel=0.02)
    share = 0.1 * told["contrast_of_wide_spokes"]
    cells = math.pi * math.sqrt(sigma**2 + 1 / 12) * math.sqrt(2 / math.log(1 / share))
    assert told["resolved_deg"] == pytest.approx(0.1 * cells, rel=0.02)
    assert told["spoke_deg"] == pytest.approx(told["resolved_deg"] / 2, rel=1e-3)
    assert len(told["directions"]) == 8
    for each in told["directions"]:
        assert each["resolved_deg"] == pytest.approx(0.1 * cells, rel=0.02)
        contrast = np.interp(1 / told["resolved_deg"], each["cycles_per_deg"][::-1],
                             each["contrast"][::-1])  # fmt: skip
        assert contrast == pytest.approx(share, abs=0.01)
    coarser = measured("siemens", star, "--pixel-angle", "0.1deg", "--threshold", "50%")
    halved = math.pi * math.sqrt(sigma**2 + 1 / 12) * math.sqrt(2 / math.log(1 / (5 * share)))
    assert coarser["resolved_deg"] == pytest.approx(0.1 * halved, rel=0.02)
    record = json.loads((tmp_path / "out.json").read_text())
    assert record["result"] == told and plot.exists()


def test_screen_is_flat_by_snells_law() -> None:
    """A star on a screen, its cells where the camera's chief rays fall, is round again."""
    twin = Twin.of(read_camera("small"))
    field = FieldMap.covering(twin, (0.55, 0.6))
    rows, columns = field.tangents()
    away, spokes = torch.hypot(rows - 0.05, columns + 0.1), 16
    turn = torch.atan2(-(rows - 0.05), columns + 0.1)
    picture = (away < 0.4) * (1 + torch.cos(spokes * turn)) / 2
    scale = AngularScale.of_camera(twin, field.support)
    flat = scale.flat(picture)
    found = star_contrast(flat.values, periods=spokes)
    step = flat.tangent
    assert found.place.radius * step == pytest.approx(0.4, abs=1.5 * step)
    middle = [
        (each - axis) * step for each, axis in zip(found.place.centre, flat.axis, strict=True)
    ]
    assert middle == pytest.approx([0.05, -0.1], abs=0.1 * step)
    # Without the camera the field is bent: the star's centre is not where it is for all rings.
    wide = found.contrast[:, found.radii > 30]
    assert float((wide - math.pi / 4).abs().max()) < 0.01
    angle = flat.angle_deg(found.place.centre, (0.0, 1.0), 1.0)
    right = math.degrees(math.atan(-0.1 + step / 2) - math.atan(-0.1 - step / 2))
    cosine = math.cos(math.atan(0.05))
    assert angle == pytest.approx(right * cosine, rel=0.01)


@pytest.mark.usefixtures("undrawn")
def test_siemens_simulated(tmp_path: Path) -> None:
    told = measured(
        "siemens", "--simulate", "small", "--light", "535nm", "--angle", "11deg", "--spokes", 18,
        "--iterations", 100, "--plot", tmp_path / "star.png",
    )  # fmt: skip
    assert told["diameter_deg"] == pytest.approx(11, rel=0.03) and told["spokes"] == 18
    assert told["contrast_of_wide_spokes"] > 0.8
    assert 0.5 < told["resolved_deg"] < 0.9
    assert told["resolved_deg"] == max(each["resolved_deg"] for each in told["directions"])
    assert (tmp_path / "star.png").exists()


@pytest.mark.usefixtures("undrawn")
def test_edge_on_a_picture(tmp_path: Path) -> None:
    fine, sigma = 4, 1.5
    sharp = slanted_edge(72 * fine, 6.0).numpy()
    blurred = gaussian_filter(sharp, sigma * fine, mode="nearest")
    picture = torch.from_numpy(blurred.reshape(72, fine, 72, fine).mean((1, 3)))
    given = written(tmp_path / "edge.tif", picture)
    told = measured("edge", given, "--pixel-angle", "0.139deg", "--plot", tmp_path / "out.png")
    spread = math.sqrt(sigma**2 + 1 / 12)
    for name, level in (("half_contrast_per_deg", 0.5), ("tenth_contrast_per_deg", 0.1)):
        wanted = math.sqrt(math.log(1 / level) / 2) / (math.pi * spread) / 0.139
        assert told[name] == pytest.approx(wanted, rel=0.015)
    assert told["resolved_deg"] == pytest.approx(1 / told["tenth_contrast_per_deg"], rel=1e-4)
    assert told["tilt_deg"] == pytest.approx(6.0, abs=0.05)
    assert (tmp_path / "out.png").exists()


def test_edge_simulated() -> None:
    done = run(*COMMAND, "edge", "--simulate", "small", "--light", "535nm", "--angle", "6deg",
               "--iterations", 60)  # fmt: skip
    assert done.code == 0 and done.err == ""
    for words in ("edge at 5.", "contrast of one half at", "cycles/deg", "60 iterations"):
        assert words in done.out or words.replace("5.", "4.9") in done.out, words


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that nothing may be done to."""
    tmp_path = tmp_path_factory.mktemp("bad")
    (tmp_path / "star.json").mkdir()
    star = blurred_star()
    write_tiff32(tmp_path / "star.tif", star.float()[None])
    noise = torch.rand((1, 90, 90), generator=torch.Generator().manual_seed(0))
    write_tiff32(tmp_path / "noise.tif", noise)
    write_png(tmp_path / "star.png", star.float()[None])
    return tmp_path


CELL = ("--pixel-angle", "0.1deg")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("siemens",), ("nothing to measure", "--simulate CAMERA")),
        (("siemens", "star.tif", "--simulate", "small"), ("are both given",)),
        (("siemens", "star.tif"), ("--camera FOLDER", "--pixel-angle")),
        (("siemens", "star.tif", *CELL, "--camera", "small"), ("leave one out",)),
        (("siemens", "star.tif", "--pixel-angle", "0.1"), ("has no unit", "0.1 deg")),
        (("siemens", "star.tif", "--pixel-angle", "0deg"), ("to 10 deg",)),
        (("siemens", "star.tif", *CELL, "--spokes", "36"), ("24 bright spokes, not 36",)),
        (("siemens", "star.tif", *CELL, "--spokes", "2"), ("spokes", "4 to 200")),
        (("siemens", "star.tif", *CELL, "--angle", "20deg"), ("deg wide, not 20 deg",)),
        (("siemens", "noise.tif", *CELL), ("no Siemens star",)),
        (("siemens", "star.tif", "noise.tif", *CELL), ("2 frames are given",)),
        (("siemens", "star.png", *CELL), ("no linear picture", "--psf")),
        (("siemens", "missing.tif", *CELL), ("missing.tif",)),
        (("siemens", "star.tif", *CELL, "--plot", "out.jpg"), (".png",)),
        (("siemens", "star.tif", *CELL, "--plot", "star.png"), ("star.json",)),
        (("siemens", "star.tif", *CELL, "--light", "535nm"), ("--light goes with --simulate",)),
        (("siemens", "star.tif", *CELL, "--distance", "1m"), ("--distance goes with --simulate",)),
        (("siemens", "star.tif", *CELL, "--tau", "1e-5"), ("give --psf too",)),
        (("siemens", "star.tif", *CELL, "--support", "160x160"), ("matters with --camera only",)),
        (("siemens", "star.tif", *CELL, "--threshold", "0%"), ("0.01 % to 99.99 %",)),
        (("siemens", "--simulate", "small", "--psf", "star.tif"), ("--psf goes with frames",)),
        (("siemens", "--simulate", "small", "--angle", "89deg"), ("beyond the model",)),
        (("siemens", "--simulate", "small", "--distance", "300"), ("has no unit",)),
        (("siemens", "--simulate", "small", "--distance", "0.5mm"), ("nearer than",)),
        (("siemens", "--simulate", "nowhere"), ("nowhere",)),
        (("siemens", "--simulate", "small", "--light", "blue"), ("unknown light",)),
        (("edge", "noise.tif", *CELL), ("no straight edge",)),
        (("edge", "star.tif", *CELL, "--angle", "5deg"), ("--angle goes with --simulate",)),
        (("two-points", "star.tif", *CELL), ("--separation is given 0 times for 1 frames",)),
        (("two-points", "star.tif", "--separation", "1mm", *CELL), ("--distance",)),
        (("two-points", "star.tif", "--separation", "1", "--distance", "180mm", *CELL),
         ("has no unit",)),
        (("two-points", "star.tif", "--separation", "1mm", "--distance", "180mm", *CELL),
         ("no two point sources",)),
        (("two-points", "--simulate", "small", "--separation", "1mm"), ("with frames only",)),
        (("two-points", "--simulate", "small", "--draws", "0"), ("draws",)),
    ],
)  # fmt: skip
def test_bad_input(
    arguments: tuple[str, ...], words: tuple[str, ...], bad: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(bad)
    before = listing(bad)
    check_refused(run(*COMMAND, *arguments), *words)
    assert listing(bad) == before


def test_bad_frames(captured: Path, tmp_path: Path) -> None:
    raw, picture = captured / "raw3.dng", captured / "picture3.tif"
    given = ("--separation", "2.6mm", "--distance", "180mm")
    check_refused(
        run(*COMMAND, "two-points", raw, *given, "--camera", "small"), "--psf, raw frames"
    )
    check_refused(
        run(*COMMAND, "two-points", picture, "--separation", "1.2mm", "--distance", "300mm",
            "--camera", "small"), "point sources 6.", "check the separation",
    )  # fmt: skip
    check_refused(
        run(*COMMAND, "two-points", picture, *given, "--camera", "small", "--support", "50x50"),
        "shows 40×40",
    )
    check_refused(
        run(*COMMAND, "two-points", picture, *given, "--camera", "small", "--plot",
            captured / "picture3.png", "--dip", "100%"), "to 99.99 %",
    )  # fmt: skip
    assert not list(tmp_path.iterdir())


def test_options_from_a_file(tmp_path: Path) -> None:
    """Frames start from the file's folder, and what goes with simulations only is refused."""
    written(tmp_path / "star.tif", blurred_star())
    config = tmp_path / "star.toml"
    config.write_text('frames = ["star.tif"]\ncell-angle = "0.1deg"\nthreshold = "50%"\n')
    told = measured("siemens", "--config", config, "--spokes", 24)
    assert told["spokes"] == 24 and told["contrast_needed"] > 0.3
    config.write_text('frames = "star.tif"\npixel_angle = "0.1deg"\nlight = "535nm"\n')
    check_refused(run(*COMMAND, "siemens", "--config", config), "--light goes with --simulate only")


def test_target_to_show_on_a_screen(tmp_path: Path) -> None:
    """The picture is the target that the simulation draws, with the curve of a screen."""
    path = tmp_path / "star.png"
    done = run("measure", "target", "siemens", "-o", path, "--pixels", 200, "--spokes", 12)
    assert done.code == 0 and done.out == f"{path}\n", done
    star = read_picture(path).radiance
    assert torch.allclose(star[0], siemens_star(200, 12), atol=0.01)
    done = run("measure", "target", "edge", "-o", path, "--pixels", 200, "--tilt", "4deg")
    assert torch.allclose(read_picture(path).radiance[1], slanted_edge(200, 4.0), atol=0.01)
    done = run("measure", "target", "edge", "-o", path, "--json")
    told = json.loads(done.out)
    assert told["target"] == "edge" and told["outputs"] == [str(path)] and told["warnings"] == []
    for words, given in (
        (("no kind", "siemens"), ()),
        (("no output",), ("siemens",)),
        (("--tilt",), ("siemens", "-o", path, "--tilt", "4deg")),
        (("spokes", "4 to 200"), ("siemens", "-o", path, "--spokes", 3)),
        ((".png",), ("edge", "-o", tmp_path / "edge.tif")),
    ):
        check_refused(run("measure", "target", *given), *words)
