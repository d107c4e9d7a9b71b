"""`nolens psf --field-points` fills a camera's folder, and `nolens reconstruct --psf FOLDER` uses
its PSFs over the field.
"""

import json
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from little_camera import little_twin
from PIL import Image
from running import Done, check_refused, listing, reconstruct, run

import nolens as nl
from nolens.camera import FieldPsf, PsfEntry, develop
from nolens.errors import DataError, OptionError
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import read_camera, read_frame, read_psf, read_psf_set, write_psfs
from nolens.files.pictures import write_tiff32
from nolens.files.psf_folder import PsfFolder
from nolens.jobs import ReconstructOptions
from nolens.jobs import reconstruct as job
from nolens.jobs.run import Reporter
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.optics.magnification import magnified
from nolens.solvers import Method, Progress, Reconstructor, stop_of
from nolens.twin import FieldMap, Light, Rectification, Twin, preview_model

GREEN, SIDE = "535nm", 146
QUICK = ("--support", f"{SIDE}x{SIDE}", "--tau", 1e-4, "--iterations", 8, "--channels", "g",
         "--bin", 1, "--device", "cpu")  # fmt: skip
COARSE = ("--support", "73x73", "--tau", 1e-3, "--channels", "g", "--bin", 2)


@dataclass(frozen=True)
class Open:
    """A camera without an aperture, its folder of 9 PSFs, and what it measured of 20°."""

    camera: Path
    folder: Path
    raw: Path

    def copy(self, path: Path) -> Path:
        return Path(shutil.copytree(self.folder, path))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Open:
    base = tmp_path_factory.mktemp("open")
    camera = little_twin(base)
    text = re.sub(r"\[mask\.aperture\][^\[]*", "", camera.read_text())
    camera.write_text(text.replace('overhang = "0.1 mm"', 'overhang = "0.5 mm"'))
    scene = np.zeros((146, 146, 3), np.uint8)
    scene[8::26, 5::27] = 255
    Image.fromarray(scene).save(base / "scene.png")
    asked = ("--camera", camera, "--light", GREEN, "--distance", "80mm", "--field-points", 3)
    done = run("psf", *asked, "--field", "20deg", "-o", base / "mine")
    assert done.code == 0 and "9 PSFs of 194×210 pixels" in done.out, done
    done = run("simulate", base / "scene.png", *asked, "--wavelengths", 1, "--angle", "20deg",
               "-o", base / "raw.dng")  # fmt: skip
    assert done.code == 0, done
    return Open(camera, base / "mine", base / "raw.dng")


def test_psfs_of_the_folder_are_the_cameras(made: Open) -> None:
    entries = read_psf_set(made.folder).psf
    assert {each.kind for each in entries} == {"extended"}
    assert {each.frame for each in entries} == {"chief-ray"}
    assert (made.folder / "psf-80mm.tif").is_file() and (made.folder / "camera.toml").is_file()
    record = json.loads((made.folder / "psf-80mm.json").read_text())
    assert record["result"]["support"] == f"{SIDE}x{SIDE}"
    twin = Twin.of(read_camera(made.camera))
    corner = next(each for each in entries if min(angle.deg for angle in each.angle) > 5)
    right, up = (np.tan(each.rad) for each in corner.angle)
    source = PointSource((-up, right), 80e3, 50.0)
    expected = VirtualExperiment(twin, Light(GREEN), 3).psf(source, (194, 210))
    psf = read_psf(made.folder, corner)
    assert torch.allclose(psf / psf.mean(), expected / expected.mean(), atol=2e-2)


def test_psfs_of_other_sizes_or_exposures_are_refused(made: Open, tmp_path: Path) -> None:
    """Of each in turn; unlike a fall of light towards the edges, and kinds of different sizes."""
    folder = made.copy(tmp_path / "folder")
    entries = read_psf_set(folder).psf
    planes = {each: read_psf(folder, each) for each in entries}

    def store(changed: dict[PsfEntry, torch.Tensor]) -> None:
        for entry, plane in changed.items():
            write_tiff32(folder / entry.file, plane)

    def check(*words: str) -> None:
        with pytest.raises(DataError) as refused:
            PsfFolder(folder).for_scene(None)
        for each in (*words, "or remove its entry from psfs.toml"):
            assert each in str(refused.value)

    for entry in entries:
        for factor in (1.3, 1 / 1.3, 5):
            store({entry: factor * planes[entry]})
            check(f"{folder / entry.file} has ", "times the light that the other PSFs of 80 mm")
        store({entry: planes[entry]})
    for power in (3, 6):
        store({each: each.cosine**power * plane for each, plane in planes.items()})
        assert len(PsfFolder(folder).for_scene(None).entries) == 9
    listed = (folder / "psfs.toml").read_text()
    (folder / "psfs.toml").write_text(listed.replace('kind = "extended"', 'kind = "captured"'))
    store({each: plane[..., 73:121, 73:137] for each, plane in planes.items()})
    assert len(PsfFolder(folder).for_scene(None).entries) == 9
    side = entries[0]
    store({side: planes[side][..., 85:109, 89:121]})
    said = f"{folder / side.file} has 24×32 pixels, but the sensor of camera.toml has 48×64"
    check(said)
    before = listing(tmp_path)
    done = run("reconstruct", made.raw, "--psf", folder, *QUICK, "-o", tmp_path / "out.png")
    check_refused(done, said)
    assert listing(tmp_path) == before


def psf_of(made: Open) -> nl.Psf:
    """The folder's PSFs at the places of a grid over the scene."""
    twin = Twin.of(read_camera(made.camera))
    field = FieldMap(twin, PixelRectangle.centred(SIDE, SIDE, twin.shape))
    nodes = [0, SIDE // 2, SIDE - 1]
    places = [field.place_um(row, column) for row in nodes for column in nodes]
    planes = [read_psf(made.folder, each) for each in read_psf_set(made.folder).psf]
    psfs = FieldPsf.of(planes, torch.tensor(places) / twin.pixel_um)
    return nl.Psf(psfs.on_axis, ("R", "G", "B"), field_psf=psfs)


def test_psfs_of_another_wavelength_stay_apart(made: Open, tmp_path: Path) -> None:
    entries = PsfFolder(made.folder).for_scene(None).entries
    both = made.copy(tmp_path / "both")
    listed = (both / "psfs.toml").read_text()
    others = listed.replace("distance =", 'wavelength = "450 nm"\ndistance =')
    (both / "psfs.toml").write_text(listed + others.replace('file = "', 'file = "blue-'))
    assert PsfFolder(both).for_scene(None).entries == entries and len(entries) == 9


def direct(made: Open) -> torch.Tensor:
    """Green, by the solver itself."""
    psfs = psf_of(made).field_psf
    assert psfs is not None
    psfs = FieldPsf(psfs.values[:, 1:2], psfs.places)
    support = PixelRectangle.centred(SIDE, SIDE, develop(read_frame(made.raw)).size)
    stop = stop_of(Method.ADMM, iterations=8)
    solver = Reconstructor(psfs.on_axis, support, 1e-4, stop=stop, field_psf=psfs)
    return solver.solve(develop(read_frame(made.raw), channels="g")).photograph


def test_picture_is_that_of_all_psfs(made: Open, out: Path) -> None:
    """By the command and in Python; with one PSF it is another."""
    expected = direct(made)
    size = float(expected.norm())
    asked = (made.raw, "--psf", made.folder, *QUICK)
    picture = reconstruct(out, *asked)[:1]
    assert float((picture - expected).norm()) < 5e-3 * size
    record = json.loads(out.with_suffix(".json").read_text())
    assert record["result"]["field_points"] == 9
    assert "9 PSFs over the field" in record["result"]["report"]["lines"][-1][1]
    assert len(record["inputs"]) == 12 and "layers of the camera" in record["inputs"]
    assert record["inputs"]["psf"]["path"] == str(made.folder / "psfs.toml")
    given = {"support": (SIDE, SIDE), "tau": 1e-4, "iterations": 8, "channels": "g", "bin_by": 1}
    both = nl.reconstruct(made.raw, made.folder, **given)
    assert torch.allclose(both.values, picture, atol=1e-4 * float(picture.max()))
    one = reconstruct(out, *asked, "--field-points", 1)[:1]
    assert float((one - expected).norm()) > 0.03 * size


def test_few_psfs_are_spread_and_a_sweep_has_them_too(made: Open, out: Path) -> None:
    done = run("reconstruct", made.raw, "--psf", made.folder, *COARSE[:2], *COARSE[4:],
               "--tau", 1e-4, "--iterations", 8, "--field-points", 5, "--sweep", "prior",
               "-o", out, "--json")  # fmt: skip
    assert done.code == 0, done
    record = json.loads(out.with_suffix(".json").read_text())
    used = sorted(name for name in record["inputs"] if name.startswith("PSF "))
    assert "PSF psf-80mm.tif" in used and record["result"]["field_points"] == 5
    assert all(name.count("deg") == 2 and "0deg" not in name.split("-") for name in used[:-1])
    assert len(record["result"]["sweep"]) == 8


class Ended(Reporter):
    def progress(self, progress: Progress, limit: int) -> bool:
        return True


def test_state_of_other_psfs_is_refused(made: Open, tmp_path: Path) -> None:
    options = ReconstructOptions(
        measurement=made.raw, psf=made.folder, support="73x73", tau=1e-3, channels="g", bin=2,
        output=(tmp_path / "out.tif",),
    )  # fmt: skip
    job(options, Ended())
    asked = ("reconstruct", made.raw, "--psf", made.folder, *COARSE, "-o", tmp_path / "x.tif",
             "--iterations", 8, "--resume", tmp_path / "out.state.npz")  # fmt: skip
    done = run(*asked, "--field-points", 5)
    assert done.code == 2 and "state of a run with another field_points" in done.err
    assert run(*asked).code == 0


def test_what_a_folder_lacks_is_said(made: Open, tmp_path: Path) -> None:
    """The picture is made with what there is."""

    def notes(folder: Path, *more: object) -> str:
        done = run("reconstruct", made.raw, "--psf", folder, *QUICK[2:], *(more or QUICK[:2]),
                   "-o", tmp_path / "out.png", "--json")  # fmt: skip
        assert done.code == 0, done
        used = json.loads(done.out)["field_points"]
        return f"{used} used; {done.err}"

    bare = made.copy(tmp_path / "bare")
    (bare / "camera.toml").unlink()
    assert "1 used; nolens: 8 PSFs" in (said := notes(bare)) and "no camera.toml" not in said
    assert "camera.toml, which is not there" in said
    moved = made.copy(tmp_path / "moved")
    listed = (moved / "psfs.toml").read_text()
    (moved / "psfs.toml").write_text(listed.replace("angle =", 'frame = "sensor"\nangle ='))
    assert "calibrate stitch" in notes(moved)
    # Nothing is stated of a scene that goes on beyond the PSFs.
    narrow = made.copy(tmp_path / "narrow")
    beside = {each.file for each in read_psf_set(narrow).psf if each.angle[0].deg != 0}
    head, *blocks = (narrow / "psfs.toml").read_text().split("[[psf]]")
    kept = [each for each in blocks if not any(f'"{name}"' in each for name in beside)]
    (narrow / "psfs.toml").write_text("[[psf]]".join([head, *kept]))
    said = notes(narrow, "--support", "auto")
    assert "3 used" in said and "to the right (the PSFs to 0°)" in said
    asked = (*QUICK[2:], "--field-points", 3, "-o", tmp_path / "asked.png")
    done = run("reconstruct", made.raw, "--psf", narrow, *asked)
    assert done.code == 2 and "--field-points 3: the scene goes on" in done.err
    assert not (tmp_path / "asked.png").exists()


def test_depths_and_videos_use_them_too(made: Open, tmp_path: Path) -> None:
    small = (*COARSE, "--iterations", 2, "--device", "cpu")
    for more in (
        ("--depths", "60mm,80mm", "-o", tmp_path / "volume"),
        ("--frames", 3, "--exposure", "0.5ms", "-o", tmp_path / "video.tif"),
    ):
        done = run("reconstruct", made.raw, "--psf", made.folder, *small, *more)
        assert done.code == 0 and "s on cpu, 9 PSFs over the field" in done.out, done
        assert "the scene goes on" not in done.err
    volume = nl.reconstruct_volume(
        *(made.raw, made.folder, ["60mm", "80mm"]),
        support=(73, 73), bin=2, channels="g", tau=1e-3, iterations=2,
    )  # fmt: skip
    assert volume.figures["field_points"] == 9


def test_scene_that_is_asked_for_beyond_the_psfs_is_refused(made: Open, tmp_path: Path) -> None:
    wide = ("--support", "105x105", *COARSE[2:], "--iterations", 2, "--device", "cpu")
    beyond = "the scene goes on to 14° to the right (the PSFs to 10°)"
    before = listing(tmp_path)
    folder = ("reconstruct", made.raw, "--psf", made.folder)
    refocus = ("refocus", made.raw, "--psfs", made.folder)

    def check(done: Done, *words: str) -> None:
        *_, last = done.err.splitlines()  # Notes on how files are read come before.
        check_refused(replace(done, err=f"{last}\n"), *words)

    for command in (
        (*folder, *wide, "-o", tmp_path / "out.png"),
        (*folder, "--depths", "60mm,80mm", *wide, "-o", tmp_path / "out"),
        (*folder, "--frames", 3, "--exposure", "0.5ms", *wide, "-o", tmp_path / "out.tif"),
        (*refocus, "--depth", "60mm", *wide, "-o", tmp_path / "out"),
    ):
        check(run(*command), f"--support 105x105: {beyond}", "nolens calibrate plan", "smaller")
    # Two of the folder's PSFs, from straight ahead and from a corner.
    two = run(*folder, *COARSE, "--field-points", 2, "-o", tmp_path / "out.png")
    said = "--support 73x73 and --field-points 2: the scene goes on"
    check(two, said, "(the PSFs to 0°)", "takes all PSFs")
    given = {"bin_by": 2, "channels": "g", "tau": 1e-3, "iterations": 2}
    with pytest.raises(OptionError, match=r"support \(105, 105\) and field_points 9: the scene"):
        nl.reconstruct(made.raw, made.folder, support=(105, 105), field_points=9, **given)
    assert listing(tmp_path) == before


def test_sequence_has_the_pictures_of_single_frames(made: Open, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    shutil.copy(made.raw, frames)
    asked = ("--psf", made.folder, *COARSE)
    done = run("reconstruct", frames, *asked, "-o", tmp_path / "pictures", "--json")
    assert done.code == 0 and json.loads(done.out)["field_points"] == 9, done
    picture = reconstruct(tmp_path / "one.png", made.raw, *asked)
    assert torch.equal(read_frame(tmp_path / "pictures" / "raw.png").counts, picture)


def test_refused(made: Open, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = made.folder / "psf-80mm.tif"
    two = made.copy(tmp_path / "two")
    entry = PsfEntry.model_validate(
        {"file": "near.tif", "pixel": "3.1 um", "channels": ["R", "G", "B"], "distance": "50 mm"}
    )
    write_psfs(two, {entry: torch.ones(3, 4, 4)})
    empty = tmp_path / "empty"
    empty.mkdir()
    before = listing(tmp_path)
    for psf, more, words in (
        (one, ("--field-points", 9), ("--field-points 9", "one PSF", "psfs.toml")),
        (one, ("--distance", "80mm"), ("--distance 80 mm", "one PSF")),
        (empty, (), ("psfs.toml", "nolens calibrate")),
        (two, (), ("several distances (50 mm, 80 mm)", "--distance 50mm")),
        (two, ("--distance", "1m"), ("50 mm, 80 mm", "choose one")),
        (made.folder, ("--field-points", 4, "--quality", "draft"), ("--field-points 4", "draft")),
        (made.folder, ("--field-points", 0), ("--field-points", "1")),
    ):
        asked = ("--psf", psf, *more, "-o", tmp_path / "out.png")
        check_refused(run("reconstruct", made.raw, *asked), *words)
    with pytest.raises(OptionError, match="single PSF"):
        nl.reconstruct(made.raw, one, field_points=9)
    asked = ("psf", "--camera", made.camera, "-o", tmp_path / "new")
    for more, words in (
        (("--field-points", 3), ("--field 60deg",)),
        (("--field", "20deg"), ("--field-points 3",)),
        (("--field", "20deg", "--field-points", 4), ("4",)),
        (("--field", "20deg", "--field-points", 3, "--angle", "2deg,0deg"), ("--angle",)),
        (("--field", "20deg", "--field-points", 3, "-o", tmp_path / "a.tif"), ("a.tif", "folder")),
    ):
        check_refused(run(*(asked[:3] if "-o" in more else asked), *more), *words)
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(total=2e8))
    asked += ("--field", "20deg", "--field-points", 3, "--device", "cpu")
    check_refused(run(*asked), "0.2 GB", "--field-points")
    assert listing(tmp_path) == before


def test_shading_and_distortion_are_undone(made: Open, tmp_path: Path) -> None:
    """The picture over what the layers say; refused where no layers are known."""
    plain, both = tmp_path / "plain.tif", tmp_path / "both.tif"
    asked = (made.raw, "--psf", made.folder, "--field-points", 1, *QUICK)
    picture = reconstruct(plain, *asked)
    rectified = reconstruct(both, *asked, "--flatten", "--undistort")
    record = json.loads(both.with_suffix(".json").read_text())["parameters"]["rectification"]
    twin = preview_model(read_camera(made.folder / "camera.toml"))
    rectification = Rectification(twin, PixelRectangle.centred(SIDE, SIDE, twin.shape))
    expected = rectification.undistorted(rectification.flattened(picture))
    torch.testing.assert_close(rectified, expected, rtol=1e-4, atol=1e-5)
    assert record == pytest.approx(rectification.row())
    # A PSF in the folder has the camera beside it.
    file = made.folder / "psf-80mm.tif"
    same = reconstruct(both, made.raw, "--psf", file, *QUICK, "--flatten", "--undistort")
    torch.testing.assert_close(same, rectified, rtol=1e-4, atol=1e-5)
    one = made.copy(tmp_path / "one")
    (one / "camera.toml").unlink()
    asked = (made.raw, "--psf", one, "--field-points", 1, *QUICK)
    done = run("reconstruct", *asked, "--undistort", "-o", tmp_path / "none.png")
    check_refused(done, "--camera", "layers")
    done = run("reconstruct", *asked, "--camera", "paper", "--flatten", "-o", tmp_path / "none.png")
    assert done.code == 2 and "--flatten" in done.err and "1520×2028" in done.err, done


def test_refocusing_uses_them_too(
    made: Open, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the depth of the PSFs it is the picture of `reconstruct`; at another they are larger.

    Also from files, and in Python.
    """
    picture = reconstruct(tmp_path / "picture.tif", made.raw, "--psf", made.folder, *QUICK)[0]

    def refocused(depth: str, *more: object, note: str = "") -> torch.Tensor:
        folder = tmp_path / "refocused"
        asked = ("--depth", depth, *QUICK, *more, "-o", folder)
        done = run("refocus", made.raw, "--psfs", made.folder, *asked)
        assert done.code == 0 and note in done.err, done
        return read_frame(folder / "focused.tif").counts[0]

    def alike(one: torch.Tensor) -> float:
        return float(torch.corrcoef(torch.stack([one.flatten(), picture.flatten()]))[0, 1])

    assert alike(refocused("80mm", "--field-points", 1)) < 0.98
    assert alike(refocused("60mm")) < 0.98
    given = {"support": (SIDE, SIDE), "tau": 1e-4, "iterations": 8}
    psf, reduced = psf_of(made), 2.0
    larger = magnified(psf.values, (1 + reduced / 50) / (1 + reduced / 80))
    psfs = {"80mm": psf, "50mm": larger}
    assert alike(nl.refocus(made.raw, psfs, "80mm", **given).values[1]) > 0.99
    monkeypatch.setattr("nolens.jobs.run.check_memory", lambda *_: True)
    assert alike(refocused("80mm", note="temporary file")) > 0.985
