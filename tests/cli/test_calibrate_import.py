"""`nolens calibrate import`: other people's PSFs into a folder that the other commands take."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from captured_scene import SENSOR, captured_set
from captured_scene import wide as without_aperture
from little_camera import SUPPORT, Camera, quality
from point_frames import light_of
from running import check_refused, listing, reconstruct, run

import nolens as nl
from depth_spots import CELL_UM, NEAR_UM, SCENE, noisy, spots, two_objects, write_raw
from nolens.camera import Camera as Description
from nolens.camera import PsfEntry, PsfSet, from_mapping, preset
from nolens.documents import parse_toml
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_psf, read_psf_set, write_camera
from real_data import real_data

BLACK = 200


def save(path: Path, psf: torch.Tensor, *, black: float = BLACK, top: float = 50000) -> Path:
    """16-bit TIFF of a PSF, as others have it: it says nothing of its black level."""
    counts = (black + (top - black) * psf / psf.max()).round().clamp(max=65535)
    array = counts.movedim(0, -1).numpy().astype(np.uint16)
    tifffile.imwrite(path, array if array.shape[-1] == 3 else array[..., 0])
    return path


def imported(*arguments: object) -> dict[str, Any]:
    done = run("calibrate", "import", *arguments, "--json")
    assert done.code == 0 and done.err == "", done.err
    summary: dict[str, Any] = json.loads(done.out)
    return summary


def test_depths_for_refocus(tmp_path: Path) -> None:
    """Extended PSFs of three distances: the one that explains the measurement is found."""
    distances = (15, 60, 1000)
    files = [save(tmp_path / f"{z}.tif", spots(1e3 * z)) for z in distances]
    at = [part for z in distances for part in ("--distance", f"{z}mm")]
    folder = tmp_path / "theirs"
    summary = imported(
        *files, *at, "--pixel", f"{CELL_UM:g}um", "--psf-extent", "wide", "--black", BLACK,
        "-o", folder,
    )  # fmt: skip
    names = [f"extended-{z}mm.tif" for z in distances]
    assert [each["file"] for each in summary["psfs"]] == names
    assert {path.name for path in folder.iterdir()} == {*names, "psfs.toml", "import-15mm.json"}
    record = json.loads((folder / "import-15mm.json").read_text())
    assert record["result"] == summary and sorted(record["inputs"]) == ["PSF 1", "PSF 2", "PSF 3"]
    raw = write_raw(tmp_path / "raw.tif", noisy(two_objects(), 0.002))
    size = f"{SCENE[0]}x{SCENE[1]}"
    done = run(
        "refocus", raw, "--psfs", folder, "-o", tmp_path / "out", "--support", size, "--tau",
        "1e-3", "--iterations", 40, "--at", "14,11", "--search", "15mm,3cm", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    focused = json.loads(done.out)
    off = 1e3 / focused["depth_mm"] - 1e6 / NEAR_UM
    assert abs(off) < focused["depth_of_focus_per_m"] / 2


def test_colours_for_reconstruct(camera: Camera, tmp_path: Path) -> None:
    """A raw file that states its black level, and no camera: the picture is the same."""
    summary = imported(
        camera.psf, "--distance", "300mm", "--pixel", "1.55um", "-o", tmp_path / "theirs"
    )
    (psf,) = summary["psfs"]
    assert psf["pixel"] == "3.1 um" and psf["channels"] == ["R", "G", "B"]
    assert psf["black_stated"] and psf["background_counts"] == [0, 0, 0]
    pictures = [
        reconstruct(tmp_path / f"{number}.tif", camera.raw, "--psf", each, "--support", SUPPORT)
        for number, each in enumerate((camera.psf, tmp_path / "theirs" / "psf-300mm.tif"))
    ]
    assert psnr(scale_fit(*pictures), pictures[1], float(pictures[1].max())) > 40
    assert quality(pictures[1]) > 20


def test_square_saturated_psf_of_a_wider_sensor(tmp_path: Path) -> None:
    """A quarter of it clipped and its sides cut off: taken, with what was done to it."""
    light = light_of(300.0)[None]
    square = light[..., 32:288]
    bright = save(tmp_path / "bright.tif", square, top=50000)
    level = float(np.quantile(tifffile.imread(bright), 0.73))
    tifffile.imwrite(bright, np.minimum(tifffile.imread(bright), int(level)))
    given = (bright, "--distance", "300mm", "--pixel", "1.55um")
    check_refused(run("calibrate", *given, "-o", tmp_path / "no"), "saturated", "calibrate import")
    folder = tmp_path / "theirs"
    done = run("calibrate", "import", *given, "--sensor", "256x320", "-o", folder)
    assert done.code == 0
    assert "saturated, and what is put there is a guess" in done.err
    for words in (
        "256×320 pixels of 1.55 um",
        "% saturated, continued from around",
        "64 dark columns are added around its middle",
        "psfs.toml",
    ):
        assert words in done.out
    # Its neighbour, at another distance and with a dark area, is not clipped.
    other = save(tmp_path / "other.tif", light_of(80.0)[None])
    (psf,) = imported(other, "--distance", "8cm", "--pixel", "1.55um", "-o", folder)["psfs"]
    assert psf["background_counts"] == [pytest.approx(BLACK, abs=5)] and not psf["black_stated"]
    assert psf["saturated_fraction"] == 0 and psf["saturated_raised"] == 1
    far, near = (read_psf(folder, each) for each in read_psf_set(folder).psf)
    assert far.shape == near.shape == (1, 256, 320)
    assert psnr(scale_fit(near, light_of(80.0)[None]), light_of(80.0)[None], 1.0) > 40


def test_camera_angles_and_centre(tmp_path: Path) -> None:
    """The camera says pitch, size and mosaic; one at an angle stays as the sensor saw it."""
    folder = tmp_path / "theirs"
    light = light_of(300.0)[None]
    files = [
        save(tmp_path / "ahead.tif", light),
        save(tmp_path / "side.tif", light_of(300.0, (4.0, 1.0))[None]),
    ]
    angles = ("--angle", "0deg,0deg", "--angle", "4deg,1deg")
    summary = imported(*files, "--distance", "30cm", *angles, "--camera", "small", "-o", folder)
    assert summary["camera"] == preset("small").name
    assert [each["pixels"] for each in summary["psfs"]] == [[128, 160]] * 2
    assert [each["frame"] for each in summary["psfs"]] == ["chief-ray", "sensor"]
    assert {each["pixel"] for each in summary["psfs"]} == {"3.1 um"}
    assert (folder / "psf-300mm-4deg-1deg.tif").exists() and (folder / "camera.toml").exists()
    # The same light 6 pixels lower and 4 to the left, from nearer: laid over the first one.
    moved = save(tmp_path / "moved.tif", light_of(200.0)[None].roll((6, -4), (-2, -1)))
    (psf,) = imported(moved, "--distance", "20cm", "--centre", "light", "-o", folder)["psfs"]
    assert psf["centred_by"] == "psf-300mm.tif" and psf["correlation"] > 0.98
    assert psf["shift_um"] == pytest.approx([-4 * 1.55, -6 * 1.55], abs=1.0)


def test_extrapolation_is_offered(tmp_path: Path) -> None:
    """Where a PSF of the sensor's size has light up to its edges, and nowhere else."""
    rows, columns = SENSOR
    psf = without_aperture()[:, 26 : 26 + rows, 28 : 28 + columns]
    file, folder = save(tmp_path / "psf.tif", psf, black=0), tmp_path / "theirs"
    given = (file, "--distance", "30cm", "--pixel", "3.1um", "--black", 0, "-o", folder)
    offered = f"nolens calibrate extrapolate {folder} --support HEIGHTxWIDTH"
    done = run("calibrate", "import", *given)
    assert done.code == 0 and offered in done.err and done.err.count("\n") == 1
    # As the command says that it is measured, and extrapolated.
    assert offered in run("measure", "psf", folder / "psf-300mm.tif").err
    assert run("calibrate", "extrapolate", folder, "--support", "20x24").code == 0
    assert "extrapolate" not in run("measure", "psf", folder / "extended-300mm.tif").err
    imported(*given, "--psf-extent", "wide")
    done = run("calibrate", file, *given[1:5], "-o", tmp_path / "mine")
    assert done.code == 0 and "nolens calibrate extrapolate" in done.err


def test_hand(tmp_path: Path) -> None:
    """A measured PSF of 16 bits, whose black level of some 50 counts no file states."""
    path = real_data("diffusercam-hand/psf_sample.tif")
    given = ("--distance", "30cm", "--pixel", "3.45um", "-o", tmp_path / "theirs")
    (psf,) = imported(path, *given)["psfs"]
    assert psf["pixels"] == [1200, 1600] and psf["channels"] == ["grey"]
    assert 40 < psf["background_counts"][0] < 110
    assert 0 < psf["saturated_fraction"] < 1e-3 and 1 < psf["saturated_raised"] < 2
    values = read_psf(tmp_path / "theirs", read_psf_set(tmp_path / "theirs").psf[0])
    assert -100 < float(values.min()) < 0 and abs(float(values[..., -50:].mean())) < 20
    assert torch.equal(nl.import_psf(path).values, values)


def test_what_is_no_point_source_is_said(tmp_path: Path) -> None:
    """A measurement of a scene in place of the PSF; test_hand has a PSF without a warning."""
    path = real_data("diffusercam-hand/rawdata_hand_sample.tif")
    given = ("--distance", "30cm", "--pixel", "3.45um", "--channels", "grey", "-o", tmp_path / "it")
    done = run("calibrate", "import", path, *given)
    assert done.code == 0 and f"warning: {path} shows no point source: its fine" in done.err, done
    assert done.err.count("\n") == 1 and "nolens reconstruct" in done.err


def test_pattern_of_filters_is_divided_out(tmp_path: Path) -> None:
    """Four filters on the pixels, the last of which passes little of the light."""
    camera = tmp_path / "camera"
    names = ("a", "b", "c", "d")
    fields = preset("small").model_dump(mode="json", exclude_none=True)
    curve = {"source": "test", "wavelength_nm": [400, 700]}
    fields["sensor"] |= {
        "mosaic": "none",
        "quantum_efficiency": {**curve, "values": {"grey": [0.7, 0.7]}},
        "filters": {
            "tile": [names[:2], names[2:]],
            "transmission": {**curve, "values": {each: [1, 1] for each in names}},
        },
    }
    write_camera(camera, from_mapping(Description, fields, "test"))
    passed = torch.tensor([[0.9, 0.4], [0.6, 0.1]]).tile(128, 160)
    light = light_of(300.0)[None]
    frame = save(tmp_path / "point.tif", light * passed, black=256, top=3800)
    even = save(tmp_path / "even.tif", passed[None], black=256, top=3800)
    made = tmp_path / "made"
    given = (frame, "--distance", "30cm", "--camera", camera, "-o", made)
    for asked in (("calibrate",), ("calibrate", "import")):
        done = run(*asked, *given)
        assert done.code == 0 and done.err.count("filters of the sensor's pixels") == 1, done
        assert "psf-300mm.tif" in done.err and "--flat EVEN" in done.err
    imported(*given, "--black", 256, "--flat", even)
    (entry,) = read_psf_set(made).psf
    psf = read_psf(made, entry)
    tiles = [
        [each[..., r::2, c::2].mean() for r in (0, 1) for c in (0, 1)] for each in (psf, light)
    ]
    shares = [torch.stack(each) / sum(each) for each in tiles]
    torch.testing.assert_close(*shares, atol=0.01, rtol=0)
    assert psnr(scale_fit(psf, light), light, float(light.max())) > 40


def test_page_has_every_key() -> None:
    """The lists of PSFs in docs/camera-folder.md are ones, and its table names all keys."""
    page = Path(__file__).parents[2] / "docs" / "camera-folder.md"
    text = page.read_text()
    lists = [part.split("```")[0] for part in text.split("```toml")[1:]]
    assert len(lists) == 2
    for each in lists:
        PsfSet.model_validate(parse_toml(each, str(page)))
    for name in (*PsfEntry.model_fields, "schema_version"):
        assert f"| `{name}` |" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--distance", "1m"], ["no psf is given", "nolens calibrate import PSF"]),
        (["a.tif"], ["no distance is given"]),
        (["a.tif", "--distance", "1m"], ["the pixels is not known", "--pixel"]),
        (["a.tif", "b.tif", "--distance", "1m"], ["a.tif and b.tif are both of 1000mm"]),
        (["a.tif", "b.tif", "--distance", "1m", "--distance", "100cm"], ["both of 1000mm"]),
        (
            ["a.tif", "--distance", "1m", "--distance", "2m"],
            ["--distance is given 2 times for 1 PSFs"],
        ),
        (["a.tif", "--distance", "1m", "--angle", "20"], ["20deg,0deg"]),
        (["a.tif", "--distance", "1m", "--pixel", "3um", "--sensor", "10x10+1+1"], ["alone"]),
        (["a.tif", "--distance", "1m", "--pixel", "3um", "--sensor", "24x32"], ["--bin 2"]),
        (
            ["a.tif", "--distance", "1m", "--sensor", "48x64", "--psf-extent", "wide"],
            ["--sensor", "--psf-extent wide", "leave one"],
        ),
        (
            ["a.tif", "rgb.tif", "--distance", "1m", "--distance", "2m", "--pixel", "3um"],
            ["rgb.tif has the channels R, G, B", "--channels grey"],
        ),
        (
            ["a.tif", "--dark", "b.tif", "--black", "3", "--distance", "1m", "--pixel", "3um"],
            ["one of the two"],
        ),
        (["a.tif", "--distance", "30"], ["--distance is '30': 30 has no unit", "or 'infinity'\n"]),
        (["noise.tif", "--distance", "1m", "--pixel", "3um"], ["nothing above its background"]),
        (["a.tif", "--distance", "1m", "--camera", "small"], ["48×64", "128×160"]),
        (["no.tif", "--distance", "1m", "--pixel", "3um"], ["no.tif", "No such file"]),
    ],
    ids=lambda each: " ".join(each)[-50:],
)
def test_refused(
    arguments: list[str], words: list[str], kit: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(kit)
    before = listing(kit)
    check_refused(run("calibrate", "import", *arguments, "-o", "theirs"), *words)
    assert listing(kit) == before


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("import")
    psf = spots(NEAR_UM, SENSOR)
    for name in ("a.tif", "b.tif"):
        save(folder / name, psf)
    save(folder / "rgb.tif", psf.expand(3, -1, -1))
    noise = torch.randn((1, *SENSOR), generator=torch.Generator().manual_seed(2))
    save(folder / "noise.tif", (noise + 8).clamp_min(0), top=1000)
    return folder


def test_what_is_in_the_folder_must_fit(tmp_path: Path) -> None:
    folder = captured_set(tmp_path / "made")
    before = listing(folder)
    psf = save(tmp_path / "psf.tif", spots(NEAR_UM, SENSOR))
    small = save(tmp_path / "small.tif", spots(NEAR_UM, (24, 32)))
    colour = save(tmp_path / "rgb.tif", spots(NEAR_UM, SENSOR).expand(3, -1, -1))
    for arguments, words in (
        ((psf, "--pixel", "5um"), ("--pixel 5 um", "is 3.1 um wide, not 5 um")),
        ((psf, "--sensor", "60x80"), ("--sensor 60x80", "48x64")),
        ((small,), ("24×32", "48×64", "binned by 2")),
        ((colour,), ("grey", "R, G, B", "--channels grey")),
    ):
        done = run("calibrate", "import", *arguments, "--distance", "1m", "-o", folder)
        check_refused(done, *words)
        assert listing(folder) == before
    (psf_row,) = imported(
        colour, "--channels", "grey", "--black", BLACK, "--distance", "1m", "-o", folder
    )["psfs"]
    assert psf_row["channels"] == ["grey"] and psf_row["pixel"] == "3.1 um"
