"""`nolens design mask`: what it writes, what it says, and what it refuses."""

import json
import os
import pty
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from running import read_terminal, run, start

from nolens.camera import RandomLenslets
from nolens.design.masks import correlation, line_target, random_contours, spread_over
from nolens.files import read_camera
from nolens.optics import PointSource
from nolens.twin import Light, Twin, point_spread
from patience import PATIENCE_S

SMALL = ("--camera", "small", "--light", "535nm", "--overhang", "0.3mm")
QUICK = ("--period", "0.4mm", "--iterations", 25)


def designed(kind: str, folder: Path, *arguments: object) -> dict[str, Any]:
    done = run("design", "mask", kind, *SMALL, *arguments, "-o", folder, "--json")
    assert done.code == 0 and done.err == "", done
    told: dict[str, Any] = json.loads(done.out)
    return told


@pytest.fixture(scope="module")
def optimised(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A folder with a mask, and what was said of it."""
    folder = tmp_path_factory.mktemp("optimised") / "o"
    return folder, designed("optimised", folder, *QUICK, "--levels", 241)


@pytest.mark.usefixtures("undrawn")
def test_contour_mask_in_the_twin(tmp_path: Path) -> None:
    """The written camera, simulated anew without its aperture, shows the lines it is to show."""
    told = designed("contour", tmp_path / "c", *QUICK, "--spacing", "0.2mm")
    assert min(told["target_correlation"]) >= 0.8
    opened = read_camera(tmp_path / "c")
    mask = opened.camera.mask.model_copy(update={"aperture": None})
    open_camera = opened.camera.model_copy(update={"mask": mask})
    twin = Twin.of(type(opened)(open_camera, opened.quantum_efficiency, opened.acceptance, opened.relief_um))  # fmt: skip  # noqa: E501
    psf = point_spread(twin, PointSource(), twin.shape, superpixel=2, light=Light("535nm"))
    side = round(told["period_um"] / 1.55)
    lines = random_contours(side, 1.55, 200.0, seed=0)
    target = spread_over(line_target(lines, 12.0, 2), twin.shape)
    found = [float(correlation(each, target)) for each in psf]
    assert found == pytest.approx(told["target_correlation"], abs=1e-4)
    assert float(correlation(psf[1], torch.roll(target, 20, 1))) < 0.5


def test_record_and_files(optimised: tuple[Path, dict[str, Any]]) -> None:
    folder, told = optimised
    names = {"camera.toml", "relief.tif", "mask.png", "mask.json"}
    assert {path.name for path in folder.iterdir()} == names
    assert [Path(each).name for each in told["outputs"]] == [
        "camera.toml", "relief.tif", "mask.png", "mask.json",
    ]  # fmt: skip
    record = json.loads((folder / "mask.json").read_text())
    assert record["result"] == told and record["parameters"]["slope"] == "5.4 deg"
    assert record["parameters"]["kind"] == "optimised" and "line" not in record["parameters"]
    heights = tifffile.imread(folder / "relief.tif")
    np.testing.assert_allclose(heights * 20, np.round(heights * 20), atol=1e-3)
    figures, papers = told["figures"], told["paper_diffuser"]
    assert figures["height_um"] == pytest.approx(heights.max() - heights.min(), abs=1e-4)
    assert figures["width_um"] < papers["width_um"] and figures["sparsity"] > papers["sparsity"]
    assert all(
        own > theirs for own, theirs in zip(figures["magnitude"], papers["magnitude"], strict=True)
    )
    assert figures["line_um"] == pytest.approx(figures["width_um"] / 2**0.5)


@pytest.mark.usefixtures("undrawn")
def test_masks_follow_the_seed(optimised: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    for seed in (0, 1):
        designed("optimised", tmp_path / str(seed), *QUICK, "--levels", 241, "--seed", seed)
    folders = (optimised[0], tmp_path / "0", tmp_path / "1")
    one, again, other = ((each / "relief.tif").read_bytes() for each in folders)
    assert one == again != other


@pytest.mark.usefixtures("undrawn")
def test_random_lenslets_stay_a_description(tmp_path: Path) -> None:
    told = designed("random-lenslets", tmp_path / "r", "--pitch", "60um", "--seed", 7)
    relief = read_camera(tmp_path / "r").camera.mask.relief
    assert isinstance(relief, RandomLenslets) and not (tmp_path / "r" / "relief.tif").exists()
    assert relief.pitch.um == 60 and relief.seed == 7 and relief.overhang.mm == 0.3
    assert 0.55 < relief.radius.mm < 0.65
    assert 50 < told["figures"]["pitch_um"] < 70


def test_ctrl_c_keeps_the_mask_so_far(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    asked = ("--period", "0.3mm", "--iterations", 50_000, "-o", tmp_path / "m", "--json")
    with start("design", "mask", "optimised", *SMALL, *asked, stderr=theirs) as process:
        os.close(theirs)
        read_terminal(ours, r"step [1-9]\d+/50000")
        process.send_signal(signal.SIGINT)
        shown = read_terminal(ours, "")
        printed = process.communicate(timeout=PATIENCE_S)[0]
    os.close(ours)
    assert process.returncode == 130 and "the mask so far will be written" in shown
    assert json.loads(printed)["stop_reason"] == "interrupted"
    assert len(list((tmp_path / "m").iterdir())) == 4


def simulate(folder: Path) -> None:
    done = run("psf", "--camera", folder, "--light", "535nm", "-o", folder / "psf.tif")
    assert done.code == 0, done


@pytest.mark.usefixtures("undrawn")
def test_lenslet_array_can_be_simulated(tmp_path: Path) -> None:
    told = designed("lenslet-array", tmp_path / "m", "--arrangement", "square")
    assert told["kind"] == "lenslet-array"
    assert told["figures"]["pitch_um"] == pytest.approx(70, rel=0.05)
    simulate(tmp_path / "m")


@pytest.mark.usefixtures("undrawn")
def test_diffuser_can_be_simulated_and_the_kind_may_follow_options(tmp_path: Path) -> None:
    told = designed("diffuser", tmp_path / "first")
    assert told["kind"] == "diffuser"
    simulate(tmp_path / "first")
    done = run("design", "mask", *SMALL, "-o", tmp_path / "last", "--json", "diffuser")
    assert done.code == 0 and done.err == "", done
    assert json.loads(done.out)["figures"] == told["figures"]
    refused = run("design", "mask", *SMALL, "-o", "diffuser")
    assert refused.code == 2 and "no kind is given" in refused.err


@pytest.mark.usefixtures("undrawn")
def test_the_table_a_person_sees(tmp_path: Path) -> None:
    done = run("design", "mask", "lenslet-array", *SMALL, "-o", tmp_path / "m")
    assert done.code == 0 and done.err == ""
    lines = done.out.splitlines()
    assert lines[0].split() == ["this", "mask", "the", "paper's"]
    assert any(line.startswith("spectral magnitude of 1 mm² at 40/mm, %") for line in lines)
    assert lines[-1] == str(tmp_path / "m" / "mask.json")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "no kind is given; name one of random-lenslets"),
        (("-o", "m"), "contour, optimised: nolens design mask KIND -o FOLDER"),
        (("contours", "-o", "m"), "there are random-lenslets, lenslet-array, diffuser, contour"),
        (("contour",), "no output is given"),
        (("contour", "-o", "m", "--pitch", "70um"), "Unknown option: --pitch"),
        (("diffuser", "-o", "m", "--iterations", "5"), "Unknown option: --iterations"),
        (("contour", "-o", "m", "--line", "12"), "12 has no unit"),
        (("contour", "-o", "m", "--line", "0um"), "1 nm to 10 m"),
        (("diffuser", "-o", "m", "--angle", "60deg"), "0.001 deg to 44.9 deg"),
        (("optimised", "-o", "m", "--magnitude", "6%"), "6%@80/mm"),
        (("optimised", "-o", "m", "--sparsity", "100%"), "0 % to 99.99 %"),
        (("optimised", "-o", "m", "--levels", "8"), "more --levels"),
        (("optimised", "-o", "m", "--levels", "1"), "levels"),
        (("optimised", "-o", "m", "--slope", "40deg"), "smaller --slope"),
        (("optimised", "-o", "m", "--feature", "1um"), "3.1 µm or more"),
        (("optimised", "-o", "m", "--period", "20um"), "larger --period"),
        (("optimised", "-o", "m", "--period", "10m"), "smaller --period"),
        (("optimised", "-o", "m", "--camera", "papr"), "Did you mean the preset 'paper'"),
        (("lenslet-array", "-o", "m", "--radius", "20um"), "too coarse"),
        (("diffuser", "-o", "file.txt"), "is a file"),
        (("lenslet-array", "-o", "m", "--smoothing", "1m"), "give less than their --pitch"),
        (("lenslet-array", "-o", "m", "--overhang", "1m"), "smaller --smoothing or --overhang"),
        (("random-lenslets", "-o", "m", "--overhang", "1m"), "smaller --overhang"),
    ],
)
def test_bad_input(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    (tmp_path / "file.txt").write_text("kept")
    given = arguments if "--camera" in arguments else (*arguments, "--camera", "small")
    placed = [tmp_path / each if before == "-o" else each
              for before, each in zip(("", *given), given, strict=False)]  # fmt: skip
    done = run("design", "mask", *placed)
    assert done.code == 2 and words in done.err and "Traceback" not in done.err, done
    assert [path.name for path in tmp_path.iterdir()] == ["file.txt"]
