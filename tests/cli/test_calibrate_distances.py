"""`nolens calibrate distances`: PSFs of other distances from a measured one."""

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from point_frames import bench
from running import check_refused, listing, run
from torch import Tensor

from nolens.camera import PsfEntry, preset
from nolens.files import read_psf, read_psf_set, write_camera, write_psfs
from nolens.optics import PointSource


def entry(name: str, distance: str, **more: object) -> PsfEntry:
    given = {"file": name, "cell": "3.1 um", "channels": ("R", "G", "B"), "distance": distance}
    return PsfEntry.model_validate({**given, **more})


@cache
def simulated(distance_mm: float, cells: tuple[int, int] | None = None) -> Tensor:
    return bench().psf(PointSource(distance_um=distance_mm * 1e3), cells)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The small camera with a PSF of 300 mm and one from the side."""
    made = tmp_path / "camera"
    write_camera(made, preset("small"))
    write_psfs(made, {
        entry("psf-300mm.tif", "300 mm"): simulated(300),
        entry("side.tif", "300 mm", angle=("20 deg", "0 deg"), frame="sensor"): simulated(300),
    })  # fmt: skip
    return made


def distances(folder: Path, *arguments: object) -> dict[str, Any]:
    done = run("calibrate", "distances", folder, *arguments, "--json")
    assert done.code == 0, done.err
    told: dict[str, Any] = json.loads(done.out)
    assert all(f"warning: {each}" in done.err for each in told["warnings"])
    return told


def alike(one: Tensor, other: Tensor) -> float:
    a, b = (each.double() - each.double().mean() for each in (one, other))
    return float((a * b).sum() / (a.norm() * b.norm()))


def test_as_the_twin_simulates(folder: Path) -> None:
    told = distances(folder, "--at", "8cm", "--at", "20cm", "--at", "infinity")
    assert told["reduced_thickness_mm"] == pytest.approx(1.277, abs=1e-3)
    listed = {each.file: each for each in read_psf_set(folder).psf}
    for row, z in zip(told["psfs"], (80.0, 200.0, math.inf), strict=True):
        made = listed[row["file"]]
        assert made.kind == "scaled" and made.distance_um == z * 1e3 and made.on_axis
        near, far = 1 + 1.27696 / z, 1 + 1.27696 / 300
        assert row["magnification"] == pytest.approx(near / far, abs=1e-5)
        assert row["from"] == "psf-300mm.tif" and row["from_distance"] == "300 mm"
        psf = read_psf(folder, made)
        assert alike(psf, simulated(z)) > 0.9998
        assert alike(psf, simulated(z)) > alike(simulated(300), simulated(z))
    assert len(told["warnings"]) == 1 and "PSF of infinity lies beyond" in told["warnings"][0]
    assert 0 < told["psfs"][2]["unknown_fraction"] < 0.05
    record = json.loads((folder / "distances.json").read_text())
    assert record["result"] == told and record["parameters"]["at"] == ["8 cm", "20 cm", "infinity"]
    assert set(record["inputs"]) == {"PSF psf-300mm.tif", "camera"}


def test_equal_steps(folder: Path) -> None:
    told = distances(folder, "--between", "10cm,infinity", "--count", 5)
    names = [each["file"] for each in told["psfs"]]
    places = ["100mm", "133.33mm", "200mm", "400mm", "infinity"]
    assert names == [f"scaled-{each}.tif" for each in places]
    sizes = torch.tensor([each["magnification"] for each in told["psfs"]], dtype=torch.float64)
    assert float(sizes.diff().diff().abs().max()) < 5e-6


def test_the_widest_and_nearest_is_taken(folder: Path) -> None:
    wide = {entry("wide.tif", "300 mm", kind="stitched"): simulated(300, (160, 200)),
            entry("psf-60mm.tif", "60 mm"): simulated(60)}  # fmt: skip
    write_psfs(folder, wide)
    told = distances(folder, "--at", "infinity", "--at", "7cm")
    assert [each["from"] for each in told["psfs"]] == ["wide.tif", "psf-60mm.tif"]
    made = {each.file: each for each in read_psf_set(folder).psf}
    assert read_psf(folder, made["scaled-infinity.tif"]).shape == (3, 160, 200)
    told = distances(folder, "--at", "7cm", "--from", "30cm")
    assert told["psfs"][0]["from"] == "wide.tif"


def test_without_a_camera(folder: Path) -> None:
    known = distances(folder, "--at", "8cm")
    first = read_psf(folder, read_psf_set(folder).psf[-1])
    (folder / "camera.toml").unlink()
    told = distances(folder, "--at", "80mm", "--reduced", "1.27696mm")
    wanted = known["psfs"][0]["magnification"]
    assert told["psfs"][0]["magnification"] == pytest.approx(wanted, abs=2e-6)
    assert alike(first, read_psf(folder, read_psf_set(folder).psf[-1])) > 0.999999
    assert [each.distance_um for each in read_psf_set(folder).psf] == [300e3, 300e3, 80e3]


def test_too_near(folder: Path) -> None:
    told = distances(folder, "--at", "15mm")
    assert len(told["warnings"]) == 1 and "15 mm is so near" in told["warnings"][0]


def test_text_for_people(folder: Path) -> None:
    done = run("calibrate", "distances", folder, "--at", "8cm")
    assert done.code == 0 and done.err == "", done
    for words in ("as thick to rays as 1.277 mm", "scaled-80mm.tif: 1.0116", str(folder)):
        assert words in done.out, words


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["no folder is given", "the camera's PSFs"]),
        (["camera"], ["no distance is given", "--at 8cm"]),
        (["camera", "--at", "8"], ["8 has no unit"]),
        (["camera", "--at", "-8cm"], ["0.1 µm to 1000000 m"]),
        (["camera", "--at", "8cm", "--at", "80mm"], ["80mm is given twice"]),
        (["camera", "--at", "30cm"], ["30 cm is in camera already"]),
        (["camera", "--at", "8cm", "--from", "20cm"], ["--from 20 cm", "300 mm"]),
        (["camera", "--between", "8cm,1m"], ["--count go together"]),
        (["camera", "--between", "8cm", "--count", "3"], ["two distances"]),
        (["camera", "--between", "1m,8cm", "--count", "3"], ["the nearer distance first"]),
        (["camera", "--between", "8cm,1m", "--count", "1"], ["count"]),
        (["camera", "--at", "8cm", "--reduced", "1.28mm"], ["camera.toml", "Leave --reduced out"]),
        (["bare", "--at", "8cm"], ["--reduced 1.28mm"]),
        (["bare", "--at", "8cm", "--reduced", "0mm"], ["1 nm to 10 m"]),
        (["empty", "--at", "8cm"], ["psfs.toml", "nolens calibrate"]),
        (["side", "--at", "8cm", "--reduced", "1.28mm"], ["no measured PSF", "straight ahead"]),
    ],
    ids=lambda each: " ".join(each)[-50:],
)
def test_refused(
    arguments: list[str], words: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder.parent)
    write_psfs("bare", {entry("psf.tif", "300 mm"): torch.ones(3, 8, 8)})
    side = entry("psf.tif", "300 mm", angle=("9 deg", "0 deg"), frame="sensor")
    write_psfs("side", {side: torch.ones(3, 8, 8)})
    Path("empty").mkdir()
    before = listing(folder.parent)
    check_refused(run("calibrate", "distances", *arguments), *words)
    assert listing(folder.parent) == before
