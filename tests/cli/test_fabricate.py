"""`nolens fabricate`: a camera's files for the workshop."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
import trimesh
from running import check_refused, listing, run

from nolens.camera import Camera, material, preset
from nolens.errors import FileError
from nolens.files import read_camera, write_camera
from nolens.jobs import FabricateOptions
from nolens.twin import Twin

QUICK = ("--crop", "0.3x0.2mm", "--triangles", 4000)
FILES = ["fabricate.json", "frame.3mf", "frame.stl", "mask.gds", "mask.oas", "mask.tif",
         "sheet.html", "sheet.pdf"]  # fmt: skip


def made(*arguments: object) -> dict[str, Any]:
    done = run("fabricate", *arguments, *QUICK, "--json")
    assert done.code == 0, done.err
    told: dict[str, Any] = json.loads(done.out)
    return told


def changed(folder: Path, **update: Any) -> Path:
    """The preset small with other parts, as a folder."""
    small = preset("small")
    write_camera(folder, Camera.model_validate({**small.model_dump(mode="json"), **update}))
    return folder


def test_papers_camera(tmp_path: Path) -> None:
    out = tmp_path / "workshop" / "paper"
    told = made("paper", "-o", out)
    assert told["frame"]["outer_mm"] == [12.98, 11.15, 3.0]
    assert sorted(path.name for path in out.iterdir()) == sorted([*FILES, "relief-master.stl"])
    assert sorted(told["outputs"]) == sorted(str(path) for path in out.iterdir())
    for name in ("frame.stl", "frame.3mf"):
        found = trimesh.load_mesh(out / name)
        found = found.to_mesh() if isinstance(found, trimesh.Scene) else found
        assert found.is_volume
        assert found.volume == pytest.approx(told["frame"]["volume_mm3"], rel=1e-5)
        assert found.extents == pytest.approx([12.98, 11.15, 3.0], abs=1e-5)
    resin, pua = told["resin"], material("pua311")
    cavity = 10.98 * 9.15 * 3 - 10.78 * 8.95 * 1.94
    assert resin["cavity_mm3"] == pytest.approx(cavity, abs=1e-4)
    assert resin["cavity_mg"] == pytest.approx(cavity * float(pua.density_g_cm3 or 0), abs=1e-2)
    assert resin["material"] == "pua311"
    record = json.loads((out / "fabricate.json").read_text())
    assert record["result"] == told and record["inputs"] == {}
    assert record["parameters"]["wall"] == "1 mm" and record["parameters"]["camera"] == "paper"
    assert any("placeholder" in warning for warning in record["warnings"])
    assert record["versions"]["nolens"]


def test_heights_are_the_twins(tmp_path: Path) -> None:
    """The file holds what is simulated: turned over, rows upwards, it is the twin's relief."""
    told = made("small", "-o", tmp_path)
    heights = Twin.of(read_camera("small")).mask.relief.height_um.numpy()
    note = note_of(tmp_path / "mask.tif")
    counts = tifffile.imread(tmp_path / "mask.tif")[::-1].astype(float)
    rows, columns = told["mask"]["points"]
    assert counts.shape == (rows, columns) and note["pitch_um"] == 1.55
    assert (columns - 1) * 1.55 <= 300 and (rows - 1) * 1.55 <= 200
    top, left = ((whole - part) // 2 for whole, part in zip(heights.shape, counts.shape,
                                                            strict=True))  # fmt: skip
    kept = heights[top : top + rows, left : left + columns]
    back = note["um_at_zero"] + note["um_per_count"] * counts
    assert np.abs(back - kept).max() <= 0.51 * note["um_per_count"]
    assert told["mask"]["heights_um"] == [float(kept.min()), float(kept.max())]


def note_of(path: Path) -> dict[str, Any]:
    with tifffile.TiffFile(path) as file:
        note: dict[str, Any] = json.loads(file.pages[0].description)
    return note


@pytest.mark.parametrize(
    ("surface", "lies"),
    [("master", ["--mirror"]), ("mould", ["--invert", "--turn", 180])],
)
def test_heights_go_back_into_a_camera(surface: str, lies: list[object], tmp_path: Path) -> None:
    """mask.tif is how one sees the surface itself, which `camera relief` can be told."""
    made("small", "-o", tmp_path, "--surface", surface)
    note = note_of(tmp_path / "mask.tif")
    span = note["um_per_count"] * 65535
    done = run(
        "camera", "relief", "small", tmp_path / "mask.tif", "--full-scale", f"{span}um",
        *lies, "--keep-tilt", "--tile", "-o", tmp_path / "again",
    )  # fmt: skip
    assert done.code == 0, done.err
    again = read_camera(tmp_path / "again").relief_um
    assert again is not None
    rows, columns = tifffile.imread(tmp_path / "mask.tif").shape
    heights = Twin.of(read_camera("small")).mask.relief.height_um

    def middle(of: torch.Tensor) -> torch.Tensor:
        top, left = ((whole - part) // 2 for whole, part in zip(of.shape, (rows, columns),
                                                                strict=True))  # fmt: skip
        cut = of[top : top + rows, left : left + columns]
        return cut - cut.mean()

    assert torch.allclose(middle(again), middle(heights), atol=0.02)


@pytest.mark.parametrize("surface", ["mould", "replica"])
def test_surface_is_said_in_every_file(surface: str, tmp_path: Path) -> None:
    told = made("small", "-o", tmp_path, "--surface", surface, "--levels", 4)
    assert told["mask"]["surface"] == surface
    word = surface.upper().encode()
    for name in ("mask.tif", "mask.gds", "mask.oas", f"relief-{surface}.stl"):
        assert word in (tmp_path / name).read_bytes(), name


def test_text_for_people(tmp_path: Path) -> None:
    done = run("fabricate", "small", "-o", tmp_path, *QUICK)
    assert done.code == 0
    for words in ("frame 12.98 × 11.15 × 3.00 mm", "pour 129.3 mm³, 135 mg of pua311", "g base",
                  "(6:1)", "mask MASTER", "16 levels", "relief of", "frame.stl"):  # fmt: skip
        assert words in done.out, words
    assert "measure the sensor before printing" in done.err and "aperture" in done.err


def test_every_option_counts(tmp_path: Path) -> None:
    told = made(
        "small", "-o", tmp_path, "--package", "9x8mm", "--glass-top", "1.5mm", "--wall", "1.5mm",
        "--clearance", "200um", "--rim", "0.4mm", "--vents", 2, "--vent-width", "1mm",
        "--vent-depth", "0.3mm", "--mark", "1mm", "--printer-shrinkage", "1%", "--crown", "0.05mm",
        "--dish", "4x3cm", "--mould-thickness", "4mm", "--mould-shrinkage", "2%", "--pitch", "3um",
        "--levels", 8, "--base", "2mm",
    )  # fmt: skip
    frame = told["frame"]
    assert frame["outer_mm"] == [12.4, 11.4, 2.56] and frame["inner_mm"] == [9.4, 8.4]
    assert (frame["rim_mm"], frame["vents"], frame["vent_width_mm"]) == (0.4, 2, 1)
    assert (frame["vent_depth_mm"], frame["mark_mm"]) == (0.3, 1)
    printed = trimesh.load_mesh(tmp_path / "frame.stl")
    assert printed.extents * 0.99 == pytest.approx([12.4, 11.4, 2.56], abs=1e-5)
    assert frame["printed_larger"] == pytest.approx(1 / 0.99, abs=1e-6)
    assert told["mould"]["dish_mm"] == [40, 30] and told["mould"]["thickness_mm"] == 4
    assert told["mask"]["pitch_um"] == 3 and told["mask"]["levels"] == 8
    assert told["relief"]["pitch_um"] > 1.55 / 0.98 and told["relief"]["base_mm"] == 2
    crown = told["resin"]["meniscus_mm3"]
    again = made("small", "-o", tmp_path, "--package", "9x8mm", "--glass-top", "1.5mm",
                 "--clearance", "200um", "--rim", "0.4mm", "--crown", "0.1mm")  # fmt: skip
    assert again["resin"]["meniscus_mm3"] == pytest.approx(2 * crown, rel=1e-3)


@pytest.mark.parametrize("package", ["12.98mmx11.15mm", "12.98x11.15mm", "1.298cm×11150um"])
def test_two_lengths_in_one_option(package: str) -> None:
    given = {"camera": "small", "output": "out", "package": package, "glass_top": "1.9mm"}
    found = FabricateOptions.gather(given).package
    assert found is not None
    assert [length.mm for length in found] == [12.98, 11.15]


def test_same_options_same_files(tmp_path: Path) -> None:
    found = []
    for name in ("a", "b"):
        made("small", "-o", tmp_path / name)
        found.append(listing(tmp_path / name))
        found[-1].pop("fabricate.json")
    assert found[0] == found[1]


def test_resin_that_little_is_known_of(tmp_path: Path) -> None:
    layers = [{"name": "resin", "thickness": "1 mm", "index": 1.5},
              *preset("small").model_dump(mode="json")["layers"][1:]]  # fmt: skip
    camera = changed(tmp_path / "camera", layers=layers)
    told = made(camera, "-o", tmp_path / "out")
    assert told["resin"]["mass_mg"] is None and told["resin"]["material"] is None
    record = json.loads((tmp_path / "out" / "fabricate.json").read_text())
    assert any("density" in warning for warning in record["warnings"])
    assert record["inputs"]["camera"]["path"].endswith("camera.toml")
    done = run("fabricate", camera, "-o", tmp_path / "out", *QUICK)
    assert "pour" in done.out and " mg" not in done.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["papr"], ["no camera 'papr'", "'paper'"]),
        (["paper-film"], ["film with air", "poured"]),
        (["small", "--wall", "1"], ["wall", "has no unit", "1 mm"]),
        (["small", "--wall", "0mm"], ["wall", "1 nm to 10 m"]),
        (["small", "--wall", "0.2mm"], ["wall of 0.2 mm", "--smallest"]),
        (["small", "--rim", "1mm"], ["rim of 1 mm leaves nothing"]),
        (["small", "--rim", "-1mm"], ["rim", "0 mm to 10 m"]),
        (["small", "--vents", "200"], ["200 vents"]),
        (["small", "--vent-depth", "2mm"], ["run out", "--vent-depth"]),
        (["small", "--package", "10mm", "--glass-top", "1mm"], ["package", "WIDTHxHEIGHT"]),
        (["small", "--package", "10x9", "--glass-top", "1mm"], ["package", "has no unit"]),
        (["small", "--package", "10x9mm"], ["--glass-top", "belong together"]),
        (["small", "--package", "0.1x9mm", "--glass-top", "1mm"], ["smaller than the sensor's"]),
        (["small", "--bed", "5x5mm"], ["bed of 5 × 5 mm"]),
        (["small", "--printer-shrinkage", "60%"], ["printer-shrinkage is '60%'", "0 % to 49 %"]),
        (["small", "--mould-shrinkage", "0.1"], ["--mould-shrinkage", "has no unit"]),
        (["small", "--crown", "3mm"], ["runs over", "at most"]),
        (["small", "--contact-angle", "0deg"], ["--contact-angle is", "0.1 deg to 90 deg"]),
        (["small", "--dish", "12x12mm"], ["does not cover"]),
        (["small", "--surface", "mold"], ["mold"]),
        (["small", "--crop", "5x5mm"], ["crop of 5 × 5 mm", "1.70"]),
        (["small", "--pitch", "1um"], ["finer than the relief's 1.55 µm"]),
        (["small", "--levels", "1"], ["levels is 1", "2 to 250"]),
        (["small", "--levels", "2.5"], ["2.5"]),
        (["small", "--triangles", "3"], ["--triangles", "or more"]),
        (["small", "--base", "0mm"], ["base"]),
        (["small", "--lvels", "4"], ["--lvels", "--levels"]),
        (["small", "extra"], ["'extra'", "fabricate CAMERA -o FOLDER"]),
    ],
)  # fmt: skip
def test_refused(arguments: list[str], words: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    check_refused(run("fabricate", *arguments, "-o", out), *words)
    assert not out.exists()


def test_no_output(tmp_path: Path) -> None:
    check_refused(run("fabricate", "small"), "-o folder")
    check_refused(run("fabricate"), "nolens fabricate CAMERA -o FOLDER")


def test_folders_that_cannot_be(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    check_refused(run("fabricate", "small", "-o", file, *QUICK), "is a file")
    check_refused(run("fabricate", "small", "-o", file / "below", *QUICK), "is a file")
    assert file.read_text() == "mine"


def test_without_a_package(tmp_path: Path) -> None:
    sensor = {**preset("small").sensor.model_dump(mode="json"), "package": None}
    camera = changed(tmp_path / "camera", sensor=sensor)
    done = run("fabricate", camera, "-o", tmp_path / "out", *QUICK)
    check_refused(done, "[sensor.package]", "--package 12.98mmx11.15mm", "--glass-top")
    made(camera, "-o", tmp_path / "out", "--package", "5x5mm", "--glass-top", "1mm")


def test_flat_mask(tmp_path: Path) -> None:
    camera = changed(tmp_path / "camera", mask={"surface": 0, "relief": {"kind": "flat"}})
    check_refused(run("fabricate", camera, "-o", tmp_path / "out"), "is flat", "nolens design mask")


def test_relief_of_the_camera_is_not_overwritten(tmp_path: Path) -> None:
    camera = preset("small").model_dump(mode="json")
    camera["mask"] = {"surface": 0, "relief": {"kind": "file", "file": "mask.tif", "grid": "2 um"}}
    row = torch.arange(300.0)
    heights = torch.sin(row[:, None] / 30) * torch.sin(row / 20)
    write_camera(tmp_path, Camera.model_validate(camera), heights)
    before = listing(tmp_path)
    check_refused(run("fabricate", tmp_path, "-o", tmp_path), "mask.tif", "would overwrite")
    assert listing(tmp_path) == before
    told = made(tmp_path, "-o", tmp_path / "out")
    assert told["mask"]["pitch_um"] == 2
    record = json.loads((tmp_path / "out" / "fabricate.json").read_text())
    assert set(record["inputs"]) == {"camera", "camera's mask.tif"}


@pytest.mark.parametrize("error", [FileError("disk full"), KeyboardInterrupt()])
@pytest.mark.parametrize("there", [False, True])
def test_nothing_is_half_written(
    there: bool, error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "new" / "out"
    if there:
        made("small", "-o", out)
    before = listing(tmp_path)

    def fail(path: Path, library: object) -> None:
        raise error

    monkeypatch.setattr("nolens.files.workshop.write_oasis", fail)
    done = run("fabricate", "small", "-o", out, "--levels", 3, *QUICK)
    assert done.code != 0 and done.out == ""
    assert listing(tmp_path) == before


def test_step_needs_its_library(tmp_path: Path) -> None:
    try:
        import build123d  # noqa: F401
    except ImportError:
        done = run("fabricate", "small", "-o", tmp_path / "out", "--step", *QUICK)
        check_refused(done, "--step", "nolens[step]")
        assert not (tmp_path / "out").exists()
    else:
        made("small", "-o", tmp_path / "out", "--step")
        assert (tmp_path / "out" / "frame.step").stat().st_size > 1000


def test_budget_from_a_study(tmp_path: Path) -> None:
    """Its lines stand on the sheet, and what it allows of t′ is the target's ±."""
    study = tmp_path / "study"
    asked = ("--model", "rays", "--trials", 50, "--limit", "30um")
    done = run("design", "tolerance", "small", *asked, "-o", study)
    assert done.code == 0, done
    # The version before called the yield's fraction its share, and has no other key for it.
    stored = json.loads((study / "tolerance.json").read_text())
    fraction = stored["result"]["yield"].pop("fraction")
    (study / "tolerance.json").write_text(json.dumps(stored))
    out = tmp_path / "workshop"
    told = made("small", "--tolerances", study, "--surface", "mould", "-o", out)
    sheet = (out / "sheet.html").read_text()
    lines = json.loads((study / "tolerance.json").read_text())["result"]["budget"]
    assert len(lines) > 5 and all(line["effect"] in sheet for line in lines)
    assert f"line-width by rays, 50 cameras drawn; {100 * fraction:.3g} % meet the limit" in sheet
    assert "1.06 ± 0.05 mm" in sheet
    assert "relief-mould.stl" in sheet and "relief-master.stl" not in sheet
    record = json.loads((out / "fabricate.json").read_text())
    assert record["inputs"]["tolerances"]["path"] == str(study / "tolerance.json")
    assert told["outputs"]


def test_refused_studies(tmp_path: Path) -> None:
    study, other, text = (tmp_path / name for name in ("study", "other", "notes.json"))
    run("design", "tolerance", "paper", "--model", "rays", "--trials", 20, "-o", study)
    run("design", "mask", "random-lenslets", "--camera", "small", "-o", other)
    text.write_text("{}")
    out = tmp_path / "out"
    for given, words in (
        (study, ["study of 'paper', not of 'small'"]),
        (other / "mask.json", ["no study of tolerances"]),
        (text, ["no record of a run"]),
        (tmp_path / "none.json", ["cannot read"]),
    ):
        check_refused(run("fabricate", "small", "--tolerances", given, "-o", out), *words)
        assert not out.exists()


def test_levels_too_far_apart_are_said(tmp_path: Path) -> None:
    """The sensor's shortest light, 400 nm at 50°, is turned by a quarter over 158 nm."""
    told = made("small", "--levels", 6, "-o", tmp_path / "few")
    record = json.loads((tmp_path / "few" / "fabricate.json").read_text())
    step_um = told["mask"]["step_um"]
    (said,) = (text for text in record["warnings"] if "levels lie" in text)
    assert step_um > 0.16 and f"{step_um:.2g} µm apart" in said
    needed = int(said.split("--levels ")[1].split()[0])
    assert needed == int(np.ceil(5 * step_um / 0.15844)) + 1
    made("small", "--levels", needed, "-o", tmp_path / "enough")
    record = json.loads((tmp_path / "enough" / "fabricate.json").read_text())
    assert not any("levels lie" in text for text in record["warnings"])
