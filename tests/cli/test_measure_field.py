"""`nolens measure field`: on folders of PSFs, on pictures of dots, and simulated."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from running import check_refused, listing, run
from torch import Tensor

from nolens.camera import PsfEntry, preset
from nolens.files import read_camera, write_camera, write_psfs, write_tiff32
from nolens.optics import PointSource
from nolens.quantities import Angle, Length
from nolens.twin import preview_model

CELLS = (128, 160)
CELL_UM = 3.1


def measured(*arguments: object) -> dict[str, Any]:
    done = run("measure", "field", *arguments, "--json")
    assert done.code == 0, done
    assert done.out.count("\n") == 1
    told: dict[str, Any] = json.loads(done.out)
    return told


def texture() -> Tensor:
    """Smoothed noise, wider than the sensor, not negative."""
    noise = torch.rand(1, 1, 400, 500, generator=torch.manual_seed(4))
    line = torch.exp(-(torch.arange(-6, 7.0) ** 2) / 8)
    kernel = (line[:, None] * line / line.sum() ** 2)[None, None]
    found = torch.nn.functional.conv2d(noise, kernel, padding=6)[0, 0]
    return (found - found.min()).clamp_min(0)


def entry(degrees: tuple[float, float], **more: Any) -> PsfEntry:
    right, up = degrees
    given: dict[str, Any] = {
        "file": f"psf-{right:g}-{up:g}.tif",
        "cell": Length("3.1", "um"),
        "channels": ("grey",),
        "distance": Length("300", "mm"),
        "angle": (Angle.of(right, "deg"), Angle.of(up, "deg")),
        "frame": "sensor",
    }
    return PsfEntry(**{**given, **more})


def captured(degrees: tuple[float, float], share: float) -> Tensor:
    """What the sensor sees of a pattern that moves by Snell's law and changes by a share."""
    twin = preview_model(read_camera("small"), fresnel=False)
    right, up = (math.tan(math.radians(each)) for each in degrees)
    down, across = (round(each / CELL_UM) for each in twin.shift_um(PointSource((-up, right))))
    wide = share * texture() + (1 - share) * texture().flip(0, 1)
    return wide[150 - down :, 180 - across :][: CELLS[0], : CELLS[1]][None].contiguous()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Central PSF, and one each at the right, above and at the lower left that has changed."""
    found = tmp_path / "mine"
    write_camera(found, preset("small"))
    shares = {(0.0, 0.0): 1.0, (6.0, 0.0): 1.0, (0.0, 9.0): 0.8, (-8.0, -8.0): 0.55}
    write_psfs(found, {entry(at): captured(at, share) for at, share in shares.items()})
    return found


def test_folder(folder: Path) -> None:
    """Each frame loses what leaves it; the overlap, what has changed alone."""
    told = measured(folder)
    assert told["camera"] == "small" and told["distance_mm"] == 300 and told["warnings"] == []
    corner = math.degrees(math.atan(math.hypot(*[math.tan(math.radians(8))] * 2)))
    assert [each["angle_deg"] for each in told["angles"]] == pytest.approx(
        [0, 6, 9, corner], rel=1e-4
    )
    for each, share in zip(told["angles"], (1.0, 1.0, 0.8, 0.55), strict=True):
        # Two textures of one deviation, mixed.
        mixed = share / math.hypot(share, 1 - share)
        assert each["correlation_overlap"] == pytest.approx(mixed, abs=0.06)
        assert each["shift_um"] == pytest.approx(each["expected_shift_um"], abs=0.7 * CELL_UM)
        assert each["light"] is None and 0.9 < each["expected_light"] <= 1
    side, above = told["angles"][1:3]
    assert side["correlation"] == pytest.approx(side["overlap_width"], abs=0.08)
    assert above["overlap_height"] < above["overlap_width"]
    assert above["correlation"] < 0.85 * above["correlation_overlap"]
    falls = told["correlation_falls_to_deg"]
    assert 6 < falls["0.6"] < 10 and (falls["0.3"] is None or falls["0.3"] > falls["0.6"])


def test_folder_without_a_camera(tmp_path: Path) -> None:
    write_psfs(tmp_path / "psfs", {entry(at): captured(at, 1) for at in ((0.0, 0.0), (6.0, 0.0))})
    told = measured(tmp_path / "psfs")
    assert told["camera"] is None
    assert told["angles"][1]["overlap_width"] is None and told["angles"][1]["correlation"] > 0.5
    done = run("measure", "field", tmp_path / "psfs", "--camera", "small")
    assert done.code == 0 and "nowhere to 0.6" in done.out


def test_folder_that_cannot_be_measured(tmp_path: Path) -> None:
    one, side = captured((0.0, 0.0), 1), captured((6.0, 0.0), 1)
    write_psfs(tmp_path / "one", {entry((0.0, 0.0)): one})
    check_refused(run("measure", "field", tmp_path / "one"), "no captured PSF", "from the side")
    write_psfs(tmp_path / "side", {entry((6.0, 0.0)): side})
    check_refused(run("measure", "field", tmp_path / "side"), "straight ahead")
    apart = entry((6.0, 0.0), distance=Length("100", "mm"))
    write_psfs(tmp_path / "apart", {entry((0.0, 0.0)): one, apart: side})
    check_refused(run("measure", "field", tmp_path / "apart"), "from the side at the distance")
    followed = entry((6.0, 0.0), frame="chief-ray")
    write_psfs(tmp_path / "followed", {entry((0.0, 0.0)): one, followed: side})
    check_refused(run("measure", "field", tmp_path / "followed"), "no captured PSF")
    coarse = {"cell": Length("6.2", "um")}
    write_psfs(
        tmp_path / "coarse", {entry((0.0, 0.0), **coarse): one, entry((6.0, 0.0), **coarse): side}
    )
    check_refused(
        run("measure", "field", tmp_path / "coarse", "--camera", "small"), "6.2 um", "--camera"
    )
    check_refused(run("measure", "field", tmp_path / "none"), "psfs.toml")
    check_refused(run("measure", "field", tmp_path / "one" / "psfs.toml"), "psfs.toml")


def test_clipped_psf_is_a_warning(tmp_path: Path) -> None:
    frames = {at: captured(at, 1) for at in ((0.0, 0.0), (6.0, 0.0))}
    top = float(frames[(6.0, 0.0)].max()) * 0.8
    frames[(6.0, 0.0)] = frames[(6.0, 0.0)].clamp(max=top)
    write_psfs(tmp_path / "psfs", {entry(at): frame for at, frame in frames.items()})
    told = measured(tmp_path / "psfs")
    assert len(told["warnings"]) == 1 and "psf-6-0.tif" in told["warnings"][0]
    assert "clipped" in told["warnings"][0]


def test_plot_and_record(folder: Path, tmp_path: Path) -> None:
    done = run("measure", "field", folder, "--plot", tmp_path / "field.png")
    assert done.code == 0 and done.err == ""
    for words in ("6.00°", "correlation of the frames falls to 0.6 at", "field.png", "field.json"):
        assert words in done.out, words
    picture = np.asarray(Image.open(tmp_path / "field.png").convert("L"))
    assert picture.shape[1] > 2 * picture.shape[0] and picture.std() > 20
    record = json.loads((tmp_path / "field.json").read_text())
    assert record["inputs"]["PSFs"]["path"] == str(folder / "psfs.toml")
    assert len(record["result"]["angles"]) == 4


def dots(pitch_mm: float = 24.0) -> Tensor:
    """Dots of a grid at 300 mm up to 30°, where the small camera's layers put them."""
    twin = preview_model(read_camera("small"), fresnel=False)
    found = torch.zeros(480, 480)
    most = int(0.5 / (pitch_mm / 300))
    at = torch.arange(480.0)
    for i in range(-most, most + 1):
        for j in range(-most, most + 1):
            tangent = i * pitch_mm / 300, j * pitch_mm / 300
            if math.hypot(*tangent) > math.tan(math.radians(30)):
                continue
            row, column = (240 + each / CELL_UM for each in twin.shift_um(PointSource(tangent)))
            found += torch.exp(-(((at[:, None] - row) ** 2 + (at - column) ** 2) / 4))
    return found[None]


def test_picture_of_dots(tmp_path: Path) -> None:
    write_tiff32(tmp_path / "dots.tif", dots())
    asked = ("--dot-pitch", "24mm", "--distance", "300mm", "--camera", "small", "--extent", "29deg")
    told = measured("--dots", tmp_path / "dots.tif", *asked, "--plot", tmp_path / "plot.png")
    assert told["measured_pitch_mm"] == pytest.approx(24, rel=2e-3)
    assert told["good_deg"] == pytest.approx(29, abs=2) and told["lost_deg"] is None
    assert len(told["dots"]) > 100 and max(d["error_pixels"] for d in told["dots"]) < 0.2
    assert (tmp_path / "plot.png").exists() and (tmp_path / "plot.json").exists()
    done = run("measure", "field", "--dots", tmp_path / "dots.tif", *asked)
    assert done.code == 0 and f"{len(told['dots'])} dots: " in done.out
    assert "lost: nowhere" in done.out


def test_another_target_is_refused(tmp_path: Path) -> None:
    write_tiff32(tmp_path / "dots.tif", dots(16.0))
    asked = ("--dot-pitch", "24mm", "--distance", "300mm", "--camera", "small")
    before = listing(tmp_path)
    plot = tmp_path / "plot.png"
    check_refused(
        run("measure", "field", "--dots", tmp_path / "dots.tif", *asked, "--plot", plot),
        "lie 16 mm apart", "not 24 mm",
    )  # fmt: skip
    assert listing(tmp_path) == before


def test_simulated_points_of_light(tmp_path: Path) -> None:
    told = measured("--simulate", "small", "--angles", "0deg,5deg,20deg", "--distance", "infinity")
    near, side, far = told["angles"]
    assert near["correlation"] > 0.99 and 0.8 < side["correlation"] < 0.995
    assert side["correlation_overlap"] > 0.99 and side["light"] > 0.9
    # The aperture and the sensor's edge leave nothing of the pattern at 20°.
    assert far["light"] < 0.1 and far["correlation"] < 0.5
    assert told["distance_mm"] is None and told["camera"] == "small"
    done = run("measure", "field", "--simulate", "small", "--angles", "0deg,5deg")
    assert done.code == 0 and "correlation of the overlap falls nowhere to 0.6" in done.out


def test_simulated_dots_are_found_again_in_their_picture(tmp_path: Path) -> None:
    grid = ("--dot-pitch", "25mm", "--extent", "10deg")
    out = tmp_path / "dots.tif"
    done = run("measure", "field", "--simulate", "small", *grid, "--simulated-psfs", 5, "-o", out)
    assert done.code == 0 and "between 5×5 simulated PSFs the simulation is off by 0." in done.out
    assert done.out.splitlines()[-2:] == [str(out), str(tmp_path / "dots.json")]
    told = json.loads((tmp_path / "dots.json").read_text())["result"]
    assert told["simulated_psfs"] == 5 and 0 < told["field_error"]["of_contrast"] < 0.01
    assert len(told["dots"]) == 13 and told["good_deg"] == pytest.approx(9.46, abs=0.1)
    again = measured("--dots", out, *grid, "--distance", "300mm", "--camera", "small")
    assert again["dots"] == told["dots"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("nothing is given", "--simulate CAMERA", "--dots PICTURE")),
        (("FOLDER", "--simulate", "small"), ("PSFS and --simulate are given",)),
        (("FOLDER", "--angles", "0deg,5deg"), ("--angles means nothing with PSFS",)),
        (("--simulate", "small", "--camera", "paper"), ("--camera means nothing",)),
        (("--simulate", "small", "--angles", "0,5"), ("0 has no unit",)),
        (("--simulate", "small", "--angles", "5deg,0deg"), ("rising",)),
        (("--simulate", "small", "--angles", "0deg,55deg"), ("beyond the model", "50 deg")),
        (("--simulate", "small", "--extent", "10deg"), ("--extent is about a grid", "--dot-pitch")),
        (("--simulate", "small", "-o", "x.tif"), ("-o is about a grid",)),
        (("--simulate", "small", "--simulated-psfs", "5"), ("--simulated-psfs is about a grid",)),
        (
            ("--simulate", "small", "--dot-pitch", "20mm", "--simulated-psfs", "4"),
            ("4 field points", "an odd number"),
        ),
        (
            ("--simulate", "paper", "--dot-pitch", "60mm", "--field-points", "101"),
            ("of memory, and the machine has", "fewer PSFs (--field-points)"),
        ),
        (("--simulate", "small", "--dot-pitch", "20"), ("20 has no unit",)),
        (("--simulate", "small", "--dot-pitch", "20mm", "--angles", "0deg"), ("two things",)),
        (
            ("--simulate", "small", "--dot-pitch", "20mm", "--extent", "60deg"),
            ("beyond the model",),
        ),
        (("--simulate", "small", "--dot-pitch", "0.1mm"), ("20000", "larger pitch")),
        (("--simulate", "small", "--dot-pitch", "900mm"), ("only one",)),
        (
            ("--simulate", "small", "--dot-pitch", "20mm", "--distance", "infinity"),
            ("--distance infinity",),
        ),
        (("--simulate", "none"), ("there is no camera 'none'",)),
        (("--dots", "PICTURE"), ("--dot-pitch and --distance",)),
        (("--dots", "PICTURE", "--dot-pitch", "20mm"), ("give --distance",)),
        (("--dots", "PICTURE", "--dot-pitch", "20mm", "--distance", "-1mm"), ("0.1 µm to",)),
        (
            ("--dots", "PICTURE", "--dot-pitch", "1mm", "--distance", "300mm"),
            ("pixels apart", "1.5 mm"),
        ),
        (
            ("--dots", "none.tif", "--dot-pitch", "20mm", "--distance", "300mm"),
            ("none.tif",),
        ),
        (
            ("--dots", "PICTURE", "--dot-pitch", "20mm", "--distance", "300mm", "--plot", "a.pdf"),
            ("suffix .pdf",),
        ),
    ],
)
def test_refused(arguments: tuple[str, ...], words: tuple[str, ...], tmp_path: Path) -> None:
    write_tiff32(tmp_path / "dots.tif", torch.rand(1, 60, 60))
    named = {"FOLDER": str(tmp_path), "PICTURE": str(tmp_path / "dots.tif")}
    before = listing(tmp_path)
    check_refused(run("measure", "field", *(named.get(each, each) for each in arguments)), *words)
    assert listing(tmp_path) == before
