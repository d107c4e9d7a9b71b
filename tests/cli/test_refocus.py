"""`nolens refocus`: from a photograph and a camera's folder to pictures at any depth."""

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
from PIL import Image
from running import Done, check_refused, listing, read_terminal, run, start

import nolens as nl
from depth_spots import (
    CELL_UM,
    FAR_UM,
    NEAR_UM,
    REDUCED_UM,
    SCENE,
    SENSOR,
    light,
    noisy,
    objects,
    spots,
    two_objects,
    write_raw,
    write_set,
)
from nolens import jobs
from nolens.camera import PsfEntry, preset
from nolens.errors import OptionError
from nolens.files import read_frame, read_psf_set, write_camera, write_psfs
from nolens.quantities import Length
from patience import PATIENCE_S

SUPPORT = ("--support", "30x48")
QUICK = (*SUPPORT, "--tau", "1e-3", "--iterations", 40)
COARSE = (*QUICK[:-1], 3)
FOCUSED = {"focused.png", "focused.tif", "refocus.json"}
STACKED = {
    "stack.tif", "sweep.png", "sweep.html", "all-in-focus.png", "depth.png", "depth.tif",
    "refocus.json",
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("refocus")
    write_set(folder / "camera", (15, 60, 1000))
    write_raw(folder / "raw.tif", noisy(two_objects(), 0.002))
    return folder


def refocus(made: Path, out: Path, *more: object, psfs: Path | None = None) -> Done:
    return run("refocus", made / "raw.tif", "--psfs", psfs or made / "camera", "-o", out, *more)


def told(done: Done) -> dict[str, Any]:
    assert done.code == 0, done.err
    assert done.out.count("\n") == 1
    summary: dict[str, Any] = json.loads(done.out)
    return summary


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def refused(made: Path, tmp_path: Path, *more: object, words: tuple[str, ...], **how: Any) -> None:
    before = listing(tmp_path)
    check_refused(refocus(made, tmp_path / "out", *more, **how), *words)
    assert listing(tmp_path) == before


def test_each_object_where_a_person_points(made: Path, tmp_path: Path) -> None:
    """Both depths within the depth of focus, in the picture as it is shown: turned over too."""
    for depth, at, flip in ((NEAR_UM, "14,11", "none"), (FAR_UM, "15,11", "both")):
        summary = told(
            refocus(
                made,
                tmp_path / flip,
                *QUICK,
                "--at",
                at,
                "--flip",
                flip,
                "--search",
                "15mm,20cm",
                "--json",
            )
        )
        off = 1e3 / summary["depth_mm"] - 1e6 / depth
        assert abs(off) < summary["depth_of_focus_per_m"] / 2
        assert summary["sharp_from_mm"] < depth * 1e-3 < summary["sharp_to_mm"]
        assert names(tmp_path / flip) == FOCUSED
        assert summary["psf_distances_mm"] == [15, 60, 1000]
        assert summary["mask_to_sensor_um"] == pytest.approx(REDUCED_UM, rel=0.02)
    record = json.loads((tmp_path / "both" / "refocus.json").read_text())
    assert record["result"] == summary and record["parameters"]["at"] == [15, 11]
    assert set(record["inputs"]) == {
        "measurement", "list of PSFs", "PSF psf-15mm.tif", "PSF psf-60mm.tif", "PSF psf-1000mm.tif",
    }  # fmt: skip


def test_turned_over(made: Path, tmp_path: Path) -> None:
    pictures = {}
    for flip in ("none", "vertical", "horizontal", "both"):
        done = refocus(made, tmp_path / flip, *COARSE, "--depth", "2cm", "--flip", flip)
        assert done.code == 0
        pictures[flip] = read_frame(tmp_path / flip / "focused.tif").counts
    for flip, axes in (("vertical", (1,)), ("horizontal", (2,)), ("both", (1, 2))):
        turned = pictures["none"].flip(axes)
        assert torch.equal(turned, pictures[flip]) and not torch.equal(turned, pictures["none"])


def test_depth_that_is_asked_for(made: Path, tmp_path: Path) -> None:
    """What `reconstruct` gives with the PSF of that depth, which is not in the set."""
    done = refocus(made, tmp_path / "out", *QUICK, "--depth", "20mm")
    assert done.code == 0 and done.err == ""
    assert done.out.startswith("2 cm; sharp from ")
    entry = PsfEntry.model_validate({
        "file": "own.tif", "cell": f"{CELL_UM} um", "channels": ("grey",), "distance": "20 mm",
    })  # fmt: skip
    write_psfs(tmp_path / "own", {entry: spots(20e3)})
    other = run(
        "reconstruct", made / "raw.tif", "--psf", tmp_path / "own" / "own.tif",
        "--psf-extent", "wide", *QUICK, "-o", tmp_path / "other.tif",
    )  # fmt: skip
    assert other.code == 0, other.err
    one, two = (read_frame(tmp_path / each).counts for each in ("out/focused.tif", "other.tif"))
    assert float((one - two).norm() / two.norm()) < 0.05


def test_weight_is_chosen_at_the_depth_and_said(made: Path, tmp_path: Path) -> None:
    """The picture is the one that the weight gives when it is stated."""
    asked = (*SUPPORT, "--depth", "60mm", "--iterations", 20)
    tau = told(refocus(made, tmp_path / "auto", *asked, "--json"))["tau"]
    assert 0 < tau < 0.1
    stated = told(refocus(made, tmp_path / "stated", *asked, "--tau", tau, "--json"))
    assert stated["tau"] == tau
    pictures = [(tmp_path / each / "focused.tif").read_bytes() for each in ("auto", "stated")]
    assert pictures[0] == pictures[1]


def test_whole_picture(made: Path, tmp_path: Path) -> None:
    left, _ = objects()
    raw = write_raw(tmp_path / "one.tif", noisy(light({25e3: left}), 0.002))
    done = run(
        "refocus", raw, "--psfs", made / "camera", *QUICK, "-o", tmp_path / "out", "--search",
        "15mm,50mm", "--json",
    )  # fmt: skip
    summary = told(done)
    apart = abs(1e3 / summary["depth_mm"] - 1e3 / 25)
    assert apart < 0.3 * summary["depth_of_focus_per_m"]
    depths = [each["depth_mm"] for each in summary["tried"]]
    assert depths == sorted(depths) and depths[0] == 15 and depths[-1] == 50


def test_stack(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    summary = told(refocus(made, out, *QUICK, "--stack", "14mm,infinity", "--steps", 7, "--json"))
    assert names(out) == STACKED
    assert summary["stack_mm"][0] == 14 and summary["stack_mm"][-1] == "infinity"
    per_m = np.array([1e3 / each for each in summary["stack_mm"][:-1]] + [0])
    assert np.allclose(np.diff(per_m), -per_m[0] / 6, rtol=1e-3)
    with tifffile.TiffFile(out / "stack.tif") as stack:
        assert stack.is_imagej and len(stack.pages) == 7
        assert stack.asarray().shape == (7, *SCENE)
    millimetres = tifffile.imread(out / "depth.tif")
    assert millimetres.shape == SCENE
    for depth, (row, column) in ((NEAR_UM, (14, 11)), (FAR_UM, (14, 36))):
        window = millimetres[row - 5 : row + 5, column - 4 : column + 4]
        assert abs(1e3 / np.median(window) - 1e6 / depth) < 14
    with Image.open(out / "all-in-focus.png") as picture:
        assert picture.size == SCENE[::-1]
    both = told(
        refocus(
            made,
            tmp_path / "both",
            *QUICK,
            "--stack",
            "14mm,1m",
            "--steps",
            2,
            "--depth",
            "2cm",
            "--json",
        )
    )
    assert names(tmp_path / "both") == STACKED | FOCUSED and both["depth_mm"] == 20


def test_in_colour(tmp_path: Path) -> None:
    """Three channels, a flipped stack, and the text for people."""
    values = two_objects()
    colours = torch.cat([values, 0.6 * values, 0.3 * values])
    counts = (64 + 3600 * colours / colours.max()).round()
    tifffile.imwrite(tmp_path / "raw.tif", counts.movedim(0, -1).numpy().astype(np.uint16))
    entry = PsfEntry.model_validate({
        "file": "psf.tif", "cell": "10 um", "channels": ("R", "G", "B"), "distance": "60 mm",
        "kind": "stitched",
    })  # fmt: skip
    near = entry.model_copy(update={"file": "near.tif", "distance": Length("15", "mm")})
    write_psfs(
        tmp_path / "camera",
        {entry: spots(60e3).expand(3, -1, -1), near: spots(15e3).expand(3, -1, -1)},
    )
    done = refocus(
        tmp_path, tmp_path / "out", *QUICK, "--black", 64, "--stack", "14mm,100mm", "--steps", 3,
        "--flip", "vertical",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert "3 depths from 1.4 cm to 10 cm" in done.out and "sweep.html" in done.out
    with tifffile.TiffFile(tmp_path / "out" / "stack.tif") as stack:
        pages = stack.asarray()
        assert stack.imagej_metadata is not None and stack.imagej_metadata["channels"] == 3
    assert pages.shape == (3, 3, *SCENE)
    means = pages.astype(float).mean(axis=(0, 2, 3))
    assert means[0] > means[1] > means[2]
    green = refocus(
        tmp_path, tmp_path / "g", *QUICK, "--black", 64, "--depth", "2cm", "--channels", "g"
    )
    assert green.code == 0
    assert read_frame(tmp_path / "g" / "focused.tif").counts.shape[0] == 1


def test_from_the_camera_when_there_is_one_psf(made: Path, tmp_path: Path) -> None:
    camera = little_camera(tmp_path / "one", (40,))
    summary = told(refocus(made, tmp_path / "out", *QUICK, "--depth", "2cm", "--json", psfs=camera))
    assert summary["mask_to_sensor_um"] == pytest.approx(REDUCED_UM, rel=1e-6)
    reference = refocus(made, tmp_path / "set", *QUICK, "--depth", "2cm")
    assert reference.code == 0
    one, two = (read_frame(tmp_path / each / "focused.tif").counts for each in ("out", "set"))
    assert float((one - two).norm() / two.norm()) < 0.05


def little_camera(folder: Path, distances_mm: tuple[float, ...], thickness: float = 4.0) -> Path:
    """A folder with a camera.toml whose mask is so many mm of air above the sensor."""
    small = preset("small")
    layer = small.layers[-1].model_copy(update={"thickness": Length.of(thickness, "mm")})
    sensor = small.sensor.model_copy(
        update={"rows": SENSOR[0], "columns": SENSOR[1], "pitch": Length("10", "um")}
    )
    write_camera(folder, small.model_copy(update={"layers": (layer,), "sensor": sensor}))
    return write_set(folder, distances_mm)


def test_warnings(made: Path, tmp_path: Path) -> None:
    beyond = refocus(made, tmp_path / "a", *COARSE, "--depth", "8mm")
    assert beyond.code == 0 and "the PSFs are of 15.0 mm to 1000.0 mm; beyond" in beyond.err
    other = little_camera(tmp_path / "other", (15, 60), thickness=2.0)
    contradicts = refocus(made, tmp_path / "b", *COARSE, "--depth", "2cm", psfs=other)
    assert contradicts.code == 0 and "by camera.toml it is 2 mm" in contradicts.err
    gap = write_set(tmp_path / "gap", (15,))
    far = PsfEntry.model_validate({
        "file": "far.tif", "cell": "10 um", "channels": ("grey",), "distance": "1 m",
        "kind": "stitched",
    })  # fmt: skip
    write_psfs(gap, {far: spots(1e6) + 2 * spots(1e6, seed=8)})
    unlike = refocus(made, tmp_path / "c", *COARSE, "--depth", "15mm", psfs=gap)
    assert unlike.code == 0 and "the depth set has a gap" in unlike.err
    asked = (made, tmp_path / "gapped", *COARSE)
    before = listing(tmp_path)
    for more, words in (
        (("--depth", "2cm"), ("--depth 2 cm: the depth set has a gap", "that of 20 mm cannot")),
        (("--depth", "8mm"), ("that of 8 mm cannot", "15 mm, 1000 mm")),
        (
            ("--stack", "15mm,1m", "--steps", 9),
            ("--stack 15 mm,1 m", "PSFs of 15 mm and 1000 mm are alike to", "and 2 more"),
        ),
    ):
        check_refused(refocus(*asked, *more, psfs=gap), *words, "Calibrate one there", "--distance")
    volume = ("reconstruct", made / "raw.tif", "--psf", gap, *SUPPORT, "-o", tmp_path / "gapped")
    check_refused(run(*volume, "--depths", "15mm,2cm"), "--depths: the depth set", "of 20 mm")
    psfs = {str(each.distance): nl.load(gap / each.file) for each in read_psf_set(gap).psf}
    with pytest.raises(OptionError, match="distance 2cm: the depth set has a gap"):
        nl.refocus(made / "raw.tif", psfs, "2cm", support=SCENE)
    assert listing(tmp_path) == before
    narrow = write_set(tmp_path / "narrow", (15, 60), kind="captured", cells=SENSOR)
    edges = refocus(made, tmp_path / "d", *COARSE, "--depth", "2cm", psfs=narrow)
    assert edges.code == 0 and "light up to the sensor's edges" in edges.err
    alike = refocus(made, tmp_path / "e", *COARSE, "--search", "50mm,60mm")
    assert alike.code == 0 and "within one depth of focus" in alike.err
    record = json.loads((tmp_path / "e" / "refocus.json").read_text())
    assert any("within one depth of focus" in each for each in record["warnings"])


def test_wide_ones_are_taken(made: Path, tmp_path: Path) -> None:
    """Those of the sensor's size are left out where wider ones are known."""
    mixed = write_set(tmp_path / "mixed", (15, 60))
    write_set(mixed, (30,), kind="captured", cells=SENSOR)
    assert len(read_psf_set(mixed).psf) == 3
    summary = told(
        refocus(
            made,
            tmp_path / "out",
            *COARSE,
            "--depth",
            "3cm",
            "--json",
            psfs=mixed,
        )
    )
    assert summary["psf_distances_mm"] == [15, 60]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--depth", "8"), ("8 has no unit", "8 mm")),
        (("--depth", "-2cm"), ("0.1 µm to",)),
        (("--depth", "2cm", "--at", "3,4"), ("--depth 2 cm says the depth", "--at")),
        (("--at", "3;4"), ("row and column", "120,200")),
        (("--at", "30,4", *SUPPORT), ("beside the picture", "30×48", "up to 29")),
        (("--at", "3,48", *SUPPORT), ("beside the picture", "up to 47")),
        (("--search", "5cm"), ("nearest and the farthest", "8cm,50cm")),
        (("--search", "50cm,8cm"), ("the first depth must be nearer",)),
        (("--stack", "8,50"), ("8 has no unit",)),
        (("--stack", "8cm,50cm", "--steps", 1), ("steps is 1", "2 to 200")),
        (("--steps", 5), ("--steps 5", "--stack 8cm,50cm")),
        (("--stack", "2cm,5cm", "--search", "2cm,5cm"), ("--search", "--stack")),
        (("--support", "400x400"), ("--support 400x400", "larger than")),
        (("--channels", "q"), ("'q'",)),
        (("--bin", 200), ("bin is 200", "1 to 64")),
        (("--iterations", 0), ("iterations is 0",)),
    ],
)
def test_bad_options(
    made: Path, tmp_path: Path, more: tuple[object, ...], words: tuple[str]
) -> None:
    refused(made, tmp_path, *more, words=words)


def test_bad_input(made: Path, tmp_path: Path) -> None:
    refused(made, tmp_path, psfs=made, words=("psfs.toml", "nolens calibrate"))
    one = write_set(tmp_path / "one", (40,))
    refused(made, tmp_path, "--depth", "2cm", psfs=one, words=("one PSF only", "camera.toml"))
    camera = little_camera(tmp_path / "described", (40,))
    refused(made, tmp_path, psfs=camera, words=("one distance only", "--search"))
    aside = tmp_path / "aside"
    entry = read_psf_set(one).psf[0].model_copy(update={"angle": ("20 deg", "0 deg")})
    write_psfs(aside, {PsfEntry.model_validate(entry.model_dump(mode="json")): spots(40e3)})
    refused(made, tmp_path, psfs=aside, words=("beside the axis",))
    small = write_set(tmp_path / "small", (15, 60), cells=(50, 60))
    refused(made, tmp_path, psfs=small, words=("at least as large",))
    captured = write_set(tmp_path / "captured", (15, 60), kind="captured")
    refused(made, tmp_path, psfs=captured, words=("was captured with", "60×80"))
    other = little_camera(tmp_path / "readout", (15, 60))
    cut = write_raw(tmp_path / "cut.tif", two_objects()[:, 4:-4])
    before = listing(tmp_path)
    done = run("refocus", cut, "--psfs", other, "-o", tmp_path / "out")
    check_refused(done, "52×80 pixels", "60×80 of the PSFs'")
    (tmp_path / "file").write_text("x")
    check_refused(refocus(made, tmp_path / "file"), "is a file")
    (tmp_path / "file").unlink()
    assert listing(tmp_path) == before
    for arguments, words in (
        ((), ("no measurement is given",)),
        ((made / "raw.tif",), ("no psfs is given", "--psfs")),
        ((made / "raw.tif", "--psfs", made), ("no output is given", "-o")),
        ((made / "raw.tif", "x", "--psfs", made), ("more than refocus takes",)),
    ):
        check_refused(run("refocus", *arguments), *words)


def test_a_file_of_the_set_is_gone(made: Path, tmp_path: Path) -> None:
    folder = write_set(tmp_path / "camera", (15, 60))
    (folder / "psf-60mm.tif").unlink()
    refused(made, tmp_path, psfs=folder, words=("psf-60mm.tif",))


def test_nothing_of_the_input_is_overwritten(made: Path, tmp_path: Path) -> None:
    folder = write_set(tmp_path / "camera", (15, 60))
    raw = write_raw(folder / "focused.tif", two_objects())
    before = listing(tmp_path)
    check_refused(
        run("refocus", raw, "--psfs", folder, "-o", folder, "--depth", "2cm"), "would overwrite"
    )
    assert listing(tmp_path) == before


def test_a_picture_that_is_ended_is_said_to_be(made: Path, tmp_path: Path) -> None:
    """Then the stack that was to follow is not begun either."""
    values = {"measurement": made / "raw.tif", "psfs": made / "camera", "output": tmp_path / "out"}
    depths = {"depth": "14mm", "stack": "14mm,1m", "support": "30x48"}
    options = jobs.RefocusOptions.gather({**values, **depths})

    class Ended(jobs.Reporter):
        def step(self, what: str, done: int, limit: int, result: str) -> bool:
            return True

    summary = jobs.refocus(options, Ended()).summary
    assert summary["stop_reason"] == "interrupted" and "stack_mm" not in summary
    assert names(tmp_path / "out") == FOCUSED


def test_ctrl_c_keeps_the_depths_that_are_done(made: Path, tmp_path: Path) -> None:
    """The installed command, stopped in a stack that would take a long time."""
    out = tmp_path / "out"
    ours, theirs = pty.openpty()
    with start(
        "refocus", made / "raw.tif", "--psfs", made / "camera", *QUICK[:-1], 60,
        "--stack", "14mm,1m", "--steps", 200, "-o", out, "--json", stderr=theirs,
    ) as process:  # fmt: skip
        os.close(theirs)
        read_terminal(ours, r"iteration [1-9]\d\d+/12000")
        process.send_signal(signal.SIGINT)
        shown = read_terminal(ours, "")
        told_out = process.communicate(timeout=PATIENCE_S)[0]
    os.close(ours)
    assert process.returncode == 130
    assert "the depths so far will be written" in shown
    summary = json.loads(told_out)
    assert summary["stop_reason"] == "interrupted"
    assert 1 <= len(summary["stack_mm"]) < 200
    assert names(out) == STACKED
