"""`nolens simulate --bands` and `reconstruct --bands`: against the truth."""

import csv
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
from little_camera import little_twin
from running import check_refused, listing, run

import nolens as nl
from nolens.camera import Camera, from_mapping
from nolens.files import read_camera, write_camera

TILE = [["0", "1"], ["3", "2"]]
WAVELENGTHS = "500nm,515nm,530nm,545nm"
FILTERS = "wavelength_nm,0,1,2,3\n" + "".join(
    f"{500 + 15 * k},{','.join('1' if j == k else '0.1' for j in range(4))}\n" for k in range(4)
)
POLARISERS = {str(k): {"angle": f"{45 * k} deg", "extinction": 50} for k in range(4)}


def filtered(folder: Path, **filters: object) -> Path:
    """A folder with a camera of 96×128 grey pixels behind filters."""
    folder.mkdir()
    mapping = tomllib.loads(little_twin(folder).read_text())
    curve = {"source": "test", "wavelength_nm": [400, 700], "values": {"grey": [0.7, 0.7]}}
    mapping["sensor"] |= {"mosaic": "none", "quantum_efficiency": curve, "filters": filters}
    (folder / "filters.csv").write_text(FILTERS)
    write_camera(folder, from_mapping(Camera, mapping, "test"))
    return folder


def scene(path: Path, count: int = 4) -> Path:
    """At most four bands: areas of one and of all, and one of the first and the third alone."""
    bands = np.full((4, 40, 48), 0.2, np.float32)
    bands[0, 4:16, 4:20] = bands[2, 4:16, 4:20] = 1
    bands[1, 4:16, 4:20] = bands[3, 4:16, 4:20] = 0
    bands[:, 22:36, 8:22] = np.array([0.9, 0.6, 0.3, 0])[:, None, None]
    bands[:, 10:34, 28:42] = 0.8
    np.save(path, bands[:count])
    return path


def measured(folder: Path, camera: Path, bands: str) -> tuple[Path, str, np.ndarray]:
    """Raw counts of the scene, the support, and the bands that a reconstruction is to show."""
    raw, picture = folder / "raw.tif", scene(folder / "scene.npy", len(bands.split(",")))
    done = run(
        "simulate", picture, "--camera", camera, "--bands", bands,
        "--angle", "4deg", "--field-points", 1, "--wavelengths", 1, "-o", raw,
        "--truth", folder / "truth.tif", "--response", folder / "response.tif",
    )  # fmt: skip
    assert done.code == 0, done.err
    support = done.out.split("--support ")[1].split()[0]
    truth = tifffile.imread(folder / "truth.tif").squeeze()
    return raw, support, truth * tifffile.imread(folder / "response.tif")


def list_psfs(camera: Path) -> None:
    """A PSF of a wavelength near the bands, and a wrong one of a wavelength far from them."""
    done = run(
        "psf", "--camera", camera, "--distance", "300mm", "--light", "520nm", "--wavelengths", 1,
        "-o", camera / "near.tif",
    )  # fmt: skip
    assert done.code == 0, done.err
    tifffile.imwrite(camera / "far.tif", tifffile.imread(camera / "near.tif")[::-1, ::-1])
    entry = '[[psf]]\nfile = "{}.tif"\npixel = "1.55 um"\nchannels = ["grey"]\n'
    entry += 'distance = "300 mm"\nwavelength = "{} nm"\n'
    (camera / "psfs.toml").write_text(entry.format("far", 900) + entry.format("near", 520))


def cosine(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    norms = np.linalg.norm(found, axis=0) * np.linalg.norm(truth, axis=0)
    return (found * truth).sum(axis=0) / np.maximum(norms, 1e-9)


def test_spectra_through_filters_are_those_of_the_scene(tmp_path, monkeypatch):
    camera = filtered(tmp_path / "camera", tile=TILE, transmission={"file": "filters.csv"})
    raw, support, truth = measured(tmp_path, camera, WAVELENGTHS)
    list_psfs(camera)
    cube = tmp_path / "cube"
    done = run(
        "reconstruct", raw, "--psf", camera, "--bands", WAVELENGTHS, "--support", support,
        "--tau", 3e-4, "--spectrum-at", "10,12", "-o", cube, "--device", "cpu",
    )  # fmt: skip
    assert done.code == 0, done.err
    with tifffile.TiffFile(cube / "cube.ome.tif") as file:
        found, about = file.asarray().squeeze(), file.ome_metadata
    assert [f'EmissionWavelength="{nm}' in about for nm in (500, 515, 530, 545)] == [True] * 4
    lit = truth.max(axis=0) > 0.1
    angles = np.degrees(np.arccos(np.clip(cosine(found, truth)[lit], -1, 1)))
    assert angles.mean() < 4
    # Two lines 30 nm apart, with a band between them.
    with (cube / "spectrum.csv").open() as file:
        lines = [float(row["radiance"]) for row in csv.DictReader(file)]
    assert lines[1] < 0.3 * min(lines[0], lines[2])
    assert lines == pytest.approx(found[:, 10, 12].tolist(), rel=1e-4, abs=1e-6)

    places = WAVELENGTHS.split(",")
    shot = nl.simulate(
        np.load(tmp_path / "scene.npy"), nl.Camera(camera), bands=places, angle="4deg",
        field_points=1,
    )  # fmt: skip
    counts = shot.frame.counts[0].numpy()
    # The luminance is another, and rounds a few counts to the other side.
    assert np.mean(counts != tifffile.imread(raw)) < 1e-3
    shot = replace(shot, frame=replace(shot.frame, counts=nl.load(raw).counts))
    mine = nl.reconstruct_cube(shot, camera, places, tau=3e-4)
    assert np.array_equal(mine, found) and mine.wavelengths_nm == (500, 515, 530, 545)
    kept = mine.save(tmp_path / "mine")
    assert {path.name for path in kept.iterdir()} == {"cube.ome.tif", "false-colour.png"}
    for name in ("cube.ome.tif", "false-colour.png"):
        assert (kept / name).read_bytes() == (cube / name).read_bytes()
    assert mine._repr_png_() == (cube / "false-colour.png").read_bytes()

    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(total=5.001e8))
    done = run(
        "reconstruct", raw, "--psf", camera, "--bands", WAVELENGTHS, "--support", support,
        "-o", tmp_path / "none", "--device", "cpu",
    )  # fmt: skip
    check_refused(done, "not even 2 bands would fit", "a smaller --support")


def test_psfs_of_superpixels_serve_as_those_of_all_pixels(tmp_path):
    """Behind a colour mosaic; of what a scene pixel of two by two pixels shows."""
    simulated, listed = tmp_path / "simulated", tmp_path / "listed"
    bands = (470, 610)
    for folder in (simulated, listed):
        folder.mkdir()
        little_twin(folder)
    entry = '[[psf]]\nfile = "{0}.tif"\npixel = "3.1 um"\nchannels = ["R", "G", "B"]\n'
    entry += 'distance = "300 mm"\nwavelength = "{0} nm"\n'
    for nm in bands:
        done = run(
            "psf", "--camera", listed / "camera.toml", "--distance", "300mm", "--light", f"{nm}nm",
            "--wavelengths", 1, "-o", listed / f"{nm}.tif",
        )  # fmt: skip
        assert done.code == 0, done.err
    (listed / "psfs.toml").write_text("".join(map(entry.format, bands)))
    named = ",".join(f"{nm}nm" for nm in bands)
    raw, support, truth = measured(tmp_path, simulated / "camera.toml", named)
    lit, psnr_db, said = truth.max(axis=0) > 0.1, {}, {}
    for folder in (simulated, listed):
        cube = tmp_path / f"cube-{folder.name}"
        done = run(
            "reconstruct", raw, "--psf", folder, "--bands", named, "--support", support,
            "--distance", "300mm", "--tau", 3e-4, "--iterations", 40, "-o", cube, "--device", "cpu",
        )  # fmt: skip
        assert done.code == 0, done.err
        found = tifffile.imread(cube / "cube.ome.tif").squeeze()
        found = found.reshape(2, *(n for side in truth.shape[1:] for n in (side, 2))).mean((2, 4))
        found *= (found * truth).sum() / (found * found).sum()
        psnr_db[folder] = -10 * np.log10(np.mean((found - truth) ** 2) / truth.max() ** 2)
        said[folder] = done.err
        angles = np.degrees(np.arccos(np.clip(cosine(found, truth)[lit], -1, 1)))
        assert angles.mean() < 2
    assert psnr_db[simulated] > 25
    assert psnr_db[listed] == pytest.approx(psnr_db[simulated], abs=0.2)
    assert said[listed].count("of superpixels, and are interpolated") == 1
    assert "interpolated" not in said[simulated]


def test_polarisation_is_that_of_the_scene(tmp_path):
    camera = filtered(tmp_path / "camera", tile=TILE, polarisers=POLARISERS)
    angles = "0deg,45deg,90deg,135deg"
    raw, support, truth = measured(tmp_path, camera, angles)
    cube = tmp_path / "cube"
    done = run(
        "reconstruct", raw, "--psf", camera, "--bands", 6, "--support", support, "--tau", 3e-4,
        "-o", cube,
    )  # fmt: skip
    assert done.code == 0, done.err
    s0, s1, s2, degree, angle = tifffile.imread(cube / "cube.ome.tif").squeeze()
    stokes = np.stack([truth.sum(0), truth[0] - truth[2], truth[1] - truth[3]])
    lit = stokes[0] > 0.3
    scale = (s0 * stokes[0]).sum() / (s0 * s0).sum()
    for one, other in ((s1, stokes[1]), (s2, stokes[2])):
        assert np.sqrt(np.mean((scale * one - other)[lit] ** 2)) < 0.06 * stokes[0].max()
    # Light of 0.9 at 0 deg, 0.6 at 45, 0.3 at 90.
    inside = np.s_[28:32, 12:18]
    assert degree[inside].mean() == pytest.approx(np.hypot(0.6, 0.6) / 1.8, abs=0.08)
    assert angle[inside].mean() == pytest.approx(22.5, abs=5)


def test_a_map_of_filters_has_integers_of_any_size_for_each_pixel(tmp_path):
    camera = filtered(tmp_path / "camera", tile=TILE, transmission={"file": "filters.csv"})
    text = (camera / "camera.toml").read_text()
    start, end = text.index("tile = ["), text.index("[sensor.filters.transmission]")
    (camera / "camera.toml").write_text(text[:start] + 'map = "map.npy"\n' + text[end:])
    numbers = np.array(TILE, dtype=int).repeat(48, axis=0).repeat(64, axis=1)
    np.save(camera / "map.npy", numbers)
    tifffile.imwrite(camera / "map.tif", numbers.astype(np.int32))
    description = (camera / "camera.toml").read_text()
    for name in ("map.tif", "map.npy"):
        (camera / "camera.toml").write_text(description.replace("map.npy", name))
        assert np.array_equal(read_camera(camera).filters.numbers, numbers)
    np.save(camera / "map.npy", np.zeros((96, 100), int))
    raw = tmp_path / "raw.tif"
    tifffile.imwrite(raw, np.ones((96, 128), np.uint16))
    before = listing(tmp_path)
    done = run("reconstruct", raw, "--psf", camera, "--bands", 4, "-o", tmp_path / "cube")
    check_refused(done, "map.npy", "96×100", "96×128")
    np.save(camera / "map.npy", np.full((96, 128), 4, dtype=int))
    done = run("reconstruct", raw, "--psf", camera, "--bands", 4, "-o", tmp_path / "cube")
    check_refused(done, "map.npy", "4 filters", "0 to 3")
    assert listing(tmp_path).keys() == before.keys()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--bands", "500nm,400nm"], ["500nm,400nm", "increasing"]),
        (["--bands", "0deg,45deg"], ["see these bands alike", "polarisers"]),
        (["--bands", "900nm,950nm"], ["no pixel", "900 nm, 950 nm"]),
        (["--bands", "500nm", "-o", "picture.png"], ["folder", "picture.png"]),
        (["--bands", "4", "--channels", "g"], ["--channels", "--bands"]),
        (["--spectrum-at", "3,4"], ["--spectrum-at", "--bands"]),
    ],
)
def test_options_that_do_not_fit_bands_are_refused(tmp_path, options, words):
    camera = filtered(tmp_path / "camera", tile=TILE, transmission={"file": "filters.csv"})
    raw = tmp_path / "raw.tif"
    tifffile.imwrite(raw, np.arange(96 * 128, dtype=np.uint16).reshape(96, 128))
    output = [] if "-o" in options else ["-o", tmp_path / "cube"]
    done = run("reconstruct", raw, "--psf", camera, *options, *output)
    check_refused(done, *words)
