"""`nolens calibrate stitch` and `plan`: captures at angles merged into one wide PSF."""

import json
import math
from pathlib import Path

import pytest
import torch
from running import Done, check_refused, listing, reconstruct, run
from torch import Tensor

import nolens as nl
from nolens.api.simulate import Psf
from nolens.calibrate.distances import Layers
from nolens.camera import Camera, PsfEntry, preset
from nolens.errors import DataError
from nolens.files import read_psf, read_psf_set, write_camera, write_psfs
from nolens.files.pictures import write_tiff32
from nolens.files.psf_folder import PsfFolder

SENSOR = (96, 120)
CELL_UM = 3.1
REDUCED_UM = 1280.0
ANGLES = [(right, up) for up in (6, 0, -6) for right in (-6, 0, 6)]


def wide(seed: int = 0, channels: int = 1) -> Tensor:
    """Lines about 4 cells wide on a canvas wider than any sensor here."""
    generator = torch.Generator().manual_seed(seed)
    white = torch.randn((channels, 1, 300, 340), generator=generator)
    steps = torch.arange(-8, 9)
    line = torch.exp(-(steps.square()) / 8.0)
    kernel = (line[:, None] * line)[None, None]
    smooth = torch.nn.functional.conv2d(
        white, kernel / kernel.square().sum().sqrt(), padding="same"
    )
    return (smooth[:, 0] + 3).clamp_min(0)


def moved_by(right: float, up: float) -> tuple[int, int]:
    """Whole cells along rows and columns by which a light moves the pattern."""
    across = [REDUCED_UM * math.tan(math.radians(each)) / CELL_UM for each in (-up, right)]
    return round(across[0]), round(across[1])


def view(pattern: Tensor, right: float, up: float) -> Tensor:
    """What the sensor sees of it, brighter or darker by the angle."""
    rows, columns = moved_by(right, up)
    top, left = 102 - rows, 110 - columns
    part = pattern[:, top : top + SENSOR[0], left : left + SENSOR[1]]
    return part * (1 - 0.02 * abs(right) - 0.01 * abs(up))


def entry(right: float, up: float, distance: str = "300 mm", **more: object) -> PsfEntry:
    given = {
        "file": f"psf-{distance.replace(' ', '')}-{right:g}-{up:g}.tif",
        "cell": "3.1 um",
        "channels": ("grey",),
        "distance": distance,
        "angle": (f"{right} deg", f"{up} deg"),
        "frame": "sensor" if right or up else "chief-ray",
    }
    return PsfEntry.model_validate({**given, **more})


def folder(path: Path, angles: list[tuple[float, float]] = ANGLES, off: float = 0.6) -> Path:
    """Captures whose written angles are off."""
    pattern = wide()
    psfs = {
        entry(right + (off if right or up else 0), up - (off if right or up else 0)): view(
            pattern, right, up
        )
        for right, up in angles
    }
    write_psfs(path, psfs)
    return path


def stitch(path: Path, *arguments: object) -> Done:
    return run("calibrate", "stitch", path, *arguments)


def test_added_to_the_folder(tmp_path: Path) -> None:
    made = folder(tmp_path / "made")
    done = stitch(made, "--reduced", "1.28mm", "--json")
    assert done.code == 0 and done.err == "", done
    told = json.loads(done.out)
    reach = moved_by(6, 6)[1]
    assert told["pixels"] == [SENSOR[0] + 2 * reach, SENSOR[1] + 2 * reach]
    assert told["support"] == [2 * reach, 2 * reach] and told["known_fraction"] > 0.9
    assert told["outputs"] == [
        str(made / name) for name in ("stitched-300mm.tif", "psfs.toml", "stitch-300mm.json")
    ]
    for row, (right, up) in zip(told["captures"], ANGLES, strict=True):
        rows, columns = moved_by(right, up)
        assert row["shift_um"] == pytest.approx([columns * CELL_UM, -rows * CELL_UM], abs=0.2)
        assert row["gain"] == pytest.approx([1 - 0.02 * abs(right) - 0.01 * abs(up)], rel=0.02)
        aside = 0.6 * math.sqrt(2) if right or up else 0
        assert row["off_deg"] == pytest.approx(aside, abs=0.15)
    listed = read_psf_set(made)
    found = listed.by_distance(("stitched",))
    assert [each.file for each in found] == ["stitched-300mm.tif"]
    assert found[0].frame == "chief-ray" and found[0].pixel.um == CELL_UM
    assert len(listed.psf) == len(ANGLES) + 1
    psf = read_psf(made, found[0])
    truth = wide()[:, 102 - reach : 198 + reach, 110 - reach : 230 + reach]
    inner = (..., slice(2, -2), slice(2, -2))
    assert float((psf - truth)[inner].abs().mean()) < 0.03
    record = json.loads((made / "stitch-300mm.json").read_text())
    assert record["result"] == told and len(record["inputs"]) == len(ANGLES)
    assert record["parameters"]["distance"] == "300 mm"


def test_text_and_reconstruction(tmp_path: Path) -> None:
    """What it writes is taken by nolens reconstruct as it says: with a camera, all angles."""
    made = folder(tmp_path / "made")
    camera = as_the_layers(made)
    for again in (1, 2):
        done = stitch(made)
        assert done.code == 0 and done.err == "", (again, done)
    for words in ("to the right", "overlaps agree to 0.0", "--support 86x86", "psfs.toml",
                  "9 PSFs over the field, 1.5 MB"):  # fmt: skip
        assert words in done.out, words
    points = [each for each in read_psf_set(made).psf if each.kind == "field-point"]
    assert len(points) == len(ANGLES)  # The second time they replaced those of the first.
    layers = Layers.of_camera(camera)
    places = {tuple(round(um / CELL_UM) for um in layers.shift_um(e.angle)) for e in points}
    assert places == {(moved_by(*each)[1], -moved_by(*each)[0]) for each in ANGLES}
    write_tiff32(tmp_path / "raw.tif", view(wide(), 0, 0))
    out = tmp_path / "out.tif"
    picture = reconstruct(out, tmp_path / "raw.tif", "--psf", made, "--support", "86x86",
                          "--tau", 1e-4, "--iterations", 2)  # fmt: skip
    assert json.loads(out.with_suffix(".json").read_text())["result"]["field_points"] == 9
    alone = PsfFolder(made).for_scene(None).alone
    assert alone is not None and Path(alone.source).name.startswith("stitched-")
    captured = [each for each in read_psf_set(made).psf if each.kind == "captured"]
    psfs = {each.angle: Psf(read_psf(made, each), each.channels) for each in captured}
    stitched = nl.stitch_psfs(psfs, nl.Camera(made), "3.1um")
    given = {"support": (86, 86), "tau": 1e-4, "iterations": 2}
    alike = nl.reconstruct(tmp_path / "raw.tif", stitched, **given).values
    torch.testing.assert_close(alike, picture, rtol=1e-3, atol=1e-3 * float(picture.max()))
    # One of them cut, or of another exposure, is refused.
    psf = read_psf(made, points[-1])
    for other, words in ((1.3 * psf, "1.3.* times the light"), (psf[:, 9:-9, 9:-9], "other PSFs")):
        write_tiff32(made / points[-1].file, other)
        with pytest.raises(DataError, match=words):
            PsfFolder(made).for_scene(None)


def as_the_layers(made: Path) -> Camera:
    """Give a folder a camera behind as much air as `REDUCED_UM`."""
    small = preset("small")
    green = small.sensor.quantum_efficiency.values["G"]
    fields = small.model_dump(mode="json", exclude_none=True)
    fields["layers"] = [{"name": "gap", "thickness": "1.28 mm", "material": "air"}]
    fields["sensor"] |= {"rows": SENSOR[0], "columns": SENSOR[1], "pitch": "3.1 um"}
    fields["sensor"] |= {"mosaic": "none"}
    fields["sensor"]["quantum_efficiency"]["values"] = {"grey": list(green)}
    camera = Camera.model_validate(fields)
    write_camera(made, camera)
    return camera


def test_signs_are_the_photographers(tmp_path: Path) -> None:
    """Angles with a wrong sign put the patterns where they are not."""
    pattern = wide()
    psfs = {entry(-right, up): view(pattern, right, up) for right, up in ((0, 0), (6, 0), (-6, 0))}
    write_psfs(tmp_path / "made", psfs)
    refused(tmp_path / "made", "psf-300mm--6-0.tif does not fit the others", "sign")


def refused(path: Path, *words: str, more: tuple[object, ...] = ("--reduced", "1.28mm")) -> None:
    before = listing(path) if path.exists() else None
    check_refused(stitch(path, *more), *words)
    assert (listing(path) if path.exists() else None) == before


def test_too_few(tmp_path: Path) -> None:
    alone = folder(tmp_path / "alone", [(0, 0)])
    refused(alone, "no captured PSF of a light from the side", "nolens calibrate plan")
    refused(
        alone, "only the PSF of a light straight ahead",
        more=("--reduced", "1.28mm", "--distance", "300mm"),
    )  # fmt: skip
    refused(folder(tmp_path / "aside", [(6, 0), (-6, 0)]), "no captured PSF of a light straight")
    refused(tmp_path / "nothing", "cannot read")
    check_refused(run("calibrate", "stitch"), "no folder is given")


def test_which_distance(tmp_path: Path) -> None:
    made = folder(tmp_path / "made")
    write_psfs(made, {entry(6, 0, "80 mm"): view(wide(), 6, 0)})
    refused(made, "300 mm, 80 mm", "--distance")
    refused(made, "no captured PSF of a light straight ahead at 80 mm",
            more=("--reduced", "1.28mm", "--distance", "80mm"))  # fmt: skip
    refused(made, "has captured PSFs of", more=("--distance", "1m", "--reduced", "1.28mm"))
    refused(made, "no unit", more=("--distance", "300", "--reduced", "1.28mm"))
    done = stitch(made, "--reduced", "1.28mm", "--distance", "30cm", "--json")
    assert done.code == 0 and len(json.loads(done.out)["captures"]) == len(ANGLES), done


def test_what_does_not_fit(tmp_path: Path) -> None:
    made = folder(tmp_path / "made", off=0.0)
    refused(made, "--reduced 1.28mm", more=())
    other = entry(6, 6)
    write_psfs(made, {other: view(wide(1), 6, 6)})
    refused(made, other.file, "does not fit the others", "another camera")
    write_psfs(made, {other: view(wide(), 6, 6)[:, :-2]})
    refused(made, other.file, "94×120 pixels")
    write_psfs(made, {entry(6, 6, frame="chief-ray"): view(wide(), 6, 6)})
    refused(made, other.file, "was moved to the middle")
    write_psfs(made, {other: torch.zeros(1, *SENSOR)})
    refused(made, other.file, "is dark")


def test_doubts(tmp_path: Path) -> None:
    made = folder(tmp_path / "made", [(0, 0), (6, 0), (6, 6)], off=1.6)
    done = stitch(made, "--reduced", "1.28mm")
    assert done.code == 0
    for words in ("about 2.", "the opposite angles", "in none of the captures"):
        assert words in done.err, words
    assert done.err.count("warning: ") == 4


def test_plan() -> None:
    done = run("calibrate", "plan", "paper", "--angle", "56deg", "--json")
    told = json.loads(done.out)
    assert len(told["angles_deg"]) == 9 and [0, 0] in told["angles_deg"]
    assert [29, -29] in told["angles_deg"] and told["corner_deg"] < 50
    # The support of a scene of 56° through the same layers, as nolens simulate has it.
    assert told["support"] == [414, 414] and told["pixels"] == [1934, 2442]
    done = run("calibrate", "plan", "--angle", "30deg,20deg")
    assert done.code == 0 and done.out.count("--angle") == 5
    assert "--angle -16deg,11deg" in done.out
    done = run("calibrate", "plan", "small", "--angle", "20deg", "--error", "2%")
    assert done.code == 0 and done.out.count("--angle") == 9, done
    assert "with 5, PSFs in between are off by up to 2.4" in done.out


def test_plans_that_cannot_be() -> None:
    check_refused(run("calibrate", "plan", "paper"), "no angle is given")
    check_refused(run("calibrate", "plan", "small", "--angle", "20deg", "--error", "0%"), "by 49")
    check_refused(run("calibrate", "plan", "paper", "--angle", "56"), "no unit")
    check_refused(run("calibrate", "plan", "paper", "--angle", "0deg"), "0.001 deg to 179.9 deg")
    check_refused(run("calibrate", "plan", "paper", "--angle", "90deg"), "choose a smaller angle")
    check_refused(run("calibrate", "plan", "nocamera", "--angle", "56deg"), "nocamera")
    check_refused(
        run("calibrate", "plan", "--angle", "1deg,2deg,3deg"), "width and height: 56deg or"
    )
