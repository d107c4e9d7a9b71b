"""`import nolens as nl`: from a scene to a measurement to a photograph, without files."""

import io
import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image as Pillow
from scipy.ndimage import gaussian_filter

import nolens as nl
from nolens.camera import RandomLenslets
from nolens.errors import DataError, OptionError
from nolens.evaluate import slanted_edge
from nolens.files import write_png
from nolens.jobs import (
    MeasureFieldOptions,
    PsfOptions,
    ReconstructOptions,
    Reporter,
    SiemensOptions,
    ThicknessOptions,
    design_mask,
    design_thickness,
    measure_field,
    measure_siemens,
    reconstruct,
    simulate_psf,
)
from nolens.jobs.designing.mask import MASK_KINDS
from nolens.quantities import Angle, Length

ROOT = Path(nl.__file__).parents[2]
SIDE = 96
LEVELS = np.linspace(30, 250, 12).astype(np.uint8)


def scene() -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """A chart of 12 patches in colour, as a picture file holds it."""
    chart = np.zeros((SIDE, SIDE, 3), np.uint8)
    step = SIDE // 4
    for number, level in enumerate(LEVELS):
        row, column = divmod(number, 4)
        patch = chart[row * step : (row + 1) * step, column * step : (column + 1) * step]
        patch[...] = 20
        patch[4:-4, 4:-4, number % 3] = level
    return chart


@pytest.fixture(scope="module")
def camera() -> nl.Camera:
    return nl.Camera("small")


@pytest.fixture(scope="module")
def shot(camera: nl.Camera) -> nl.SimulatedMeasurement:
    return nl.simulate(scene(), camera, angle="12deg", distance="300mm", field_points=3)


@pytest.fixture(scope="module")
def psf(camera: nl.Camera, shot: nl.SimulatedMeasurement) -> nl.Psf:
    return nl.psf(camera, "300mm", support=shot.support, wavelengths=1)


@pytest.fixture(scope="module")
def photo(shot: nl.SimulatedMeasurement, psf: nl.Psf) -> nl.Photograph:
    return nl.reconstruct(shot, psf, tau=1e-5)


def test_from_scene_to_photograph(
    shot: nl.SimulatedMeasurement, photo: nl.Photograph, capfd: pytest.CaptureFixture[str]
) -> None:
    assert nl.psnr(photo, shot.expected) > 22
    assert nl.ssim(photo, shot.expected) > 0.6
    expected = np.asarray(shot.expected) / np.max(np.asarray(shot.expected))
    assert nl.compare(photo, expected).figures["psnr_db"] > nl.psnr(photo, shot.expected)
    assert photo.result.stop_reason == "converged" and photo.tau == 1e-5
    assert capfd.readouterr() == ("", "")


def test_support_of_larger_pixels(shot: nl.SimulatedMeasurement, psf: nl.Psf) -> None:
    """Is that of the simulated scene, and a pixel around it."""
    photo = nl.reconstruct(shot, psf, tau=1e-5, bin_by=2, iterations=24)
    assert photo.size == tuple(side // 2 + 2 for side in shot.expected.shape[1:])
    expected = torch.nn.functional.avg_pool2d(shot.expected, 2)
    assert nl.psnr(photo.values[:, 1:-1, 1:-1], expected) > 20


def test_command_gives_the_same(
    shot: nl.SimulatedMeasurement, psf: nl.Psf, photo: nl.Photograph, tmp_path: Path
) -> None:
    """From the same values in files."""
    np.save(tmp_path / "raw.npy", np.asarray(shot))
    np.save(tmp_path / "psf.npy", np.asarray(psf))
    support = shot.support
    options = ReconstructOptions(
        measurement=tmp_path / "raw.npy",
        psf=tmp_path / "psf.npy",
        psf_extent="wide",
        support=f"{support.height}x{support.width}",
        tau=1e-5,
        output=(tmp_path / "photo.png",),
        device="cpu",
    )
    theirs = reconstruct(options, Reporter()).value
    values = nl.reconstruct(np.asarray(shot), psf, support=support, tau=1e-5).values
    assert torch.equal(values, theirs)
    # Without the frame no pixel is known to be saturated; nothing else differs.
    torch.testing.assert_close(photo.values, values, rtol=1e-3, atol=1e-3 * float(values.max()))
    again = nl.reconstruct(
        tmp_path / "raw.npy", tmp_path / "psf.npy", support=support, psf_extended=True, tau=1e-5
    )
    assert torch.equal(again.values, theirs)
    with Pillow.open(photo.save(tmp_path / "mine.png")) as saved:
        assert saved.size == photo.size[::-1]


def test_psf_is_that_of_the_command(camera: nl.Camera, tmp_path: Path) -> None:
    options = PsfOptions.gather(
        {
            "camera": "small",
            "distance": "200mm",
            "angle": "2deg,1deg",
            "device": "cpu",
            "output": tmp_path / "p.tif",
        }
    )
    theirs = simulate_psf(options, Reporter()).value
    assert torch.equal(nl.psf(camera, "200mm", angle=("2deg", "1deg")).values, theirs)


def test_designs_are_those_of_the_commands(camera: nl.Camera, tmp_path: Path) -> None:
    diffuser = MASK_KINDS.load("diffuser")
    given = {"camera": "small", "angle": "2deg", "output": tmp_path / "designed"}
    theirs = design_mask(diffuser.gather(given), Reporter()).value
    shares: list[float] = []
    mine = nl.design_mask("diffuser", camera, angle="2deg", progress=shares.append)
    assert theirs.relief_um is not None and mine.loaded.relief_um is not None
    assert torch.equal(mine.loaded.relief_um, theirs.relief_um)
    assert (mine.name, mine.pixels) == ("small, diffuser mask", camera.pixels)
    with pytest.raises(OptionError, match=r"there is no option 'anlge'. Did you mean 'angle'"):
        nl.design_mask("diffuser", anlge="2deg")

    options = ThicknessOptions.gather({"film": "0.305mm", "material": "pua311"})
    summary = design_thickness(options, Reporter()).summary
    design = nl.design_thickness(film="0.305mm", material="pua311")
    found = summary["materials"][0]["thickness_mm"]["value"]
    assert design.figures["materials"] == summary["materials"]
    assert design.thickness_mm == {"pua311": found} and f"{found:.2f} mm" in str(design)
    layers = design.camera.loaded.camera.layers
    assert any(abs(layer.thickness.mm - found) < 1e-3 for layer in layers)


def test_random_lenslets_are_on_a_grid_that_carries_all_of_them() -> None:
    """A patch of these is carried by 1.55 µm; the steepest of all are not."""
    made = nl.design_mask("random-lenslets", "small", pitch="121um", overhang="1.2mm")
    relief = made.loaded.camera.mask.relief
    assert isinstance(relief, RandomLenslets) and relief.grid.um == 0.775
    assert made.twin.coarsest_pitch_um() > 0.775


def test_what_no_memory_holds_is_refused() -> None:
    paper = nl.Camera("paper")
    with pytest.raises(OptionError, match=r"of memory.*a smaller size"):
        nl.psf(paper, "300mm", size=(400_000, 400_000))
    camera = paper.loaded.camera
    sensor = camera.sensor.model_copy(update={"rows": 10**6, "columns": 10**6})
    vast = nl.Camera(replace(paper.loaded, camera=camera.model_copy(update={"sensor": sensor})))
    with pytest.raises(OptionError, match=r"of memory.*a smaller angle"):
        nl.simulate(scene(), vast, angle="70deg", field_points=101)
    shot, point = torch.rand(1, 30, 40), torch.zeros(1, 30, 40)
    point[0, 15, 20] = 1.0
    for method in ("admm", "fista", "wiener"):
        with pytest.raises(OptionError, match=r"of memory.*a smaller support"):
            nl.reconstruct(shot, point, support=(10**6, 10**6), method=method)


def test_arrays_of_all_kinds(shot: nl.SimulatedMeasurement, psf: nl.Psf) -> None:
    """NumPy and torch, double and transposed, give one photograph."""
    data, point = np.asarray(shot), np.asarray(psf)
    given = [
        (data, point),
        (torch.from_numpy(data.copy()), torch.from_numpy(point.copy())),
        (data.astype(np.float64), np.asfortranarray(point)),
    ]
    first, *others = (
        nl.reconstruct(a, b, support=shot.support, method="wiener").values for a, b in given
    )
    assert all(torch.equal(first, each) for each in others)


def test_scenes_of_all_kinds(camera: nl.Camera, tmp_path: Path) -> None:
    """A file, sRGB and linear radiance of one picture give one measurement."""
    write_png(tmp_path / "scene.png", srgb := linear(scene()), 1.0)
    first, *others = (
        nl.simulate(each, camera, angle="12deg", field_points=1).frame.counts
        for each in (scene(), tmp_path / "scene.png", srgb, srgb.numpy())
    )
    assert all(torch.equal(first, each) for each in others)


def linear(pixels: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> torch.Tensor:
    """IEC 61966-2-1, written out."""
    encoded = torch.from_numpy(pixels).permute(2, 0, 1).float() / 255
    return torch.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_notebook_shows_it(photo: nl.Photograph, shot: nl.SimulatedMeasurement) -> None:
    for image in (photo, shot):
        png = Pillow.open(io.BytesIO(image._repr_png_()))
        assert png.size == image.size[::-1] and png.mode == "RGB"
        assert np.array_equal(np.asarray(png), image.srgb())
    assert re.fullmatch(r"Photograph\(\d+×\d+, R, G, B\)", repr(photo))


def test_progress_is_for_who_asks(shot: nl.SimulatedMeasurement, psf: nl.Psf) -> None:
    told: list[float] = []
    nl.reconstruct(shot, psf, iterations=12, progress=told.append)
    assert told == sorted(told) and len(told) > 2 and told[-1] == 1.0


def test_refocus_finds_the_distance(camera: nl.Camera) -> None:
    """Of a chart at 60 mm, from the PSFs of 40 and 200 mm."""
    near = nl.simulate(scene(), camera, angle="12deg", distance="60mm", field_points=1)
    psfs = {
        each: nl.psf(camera, each, support=near.support, wavelengths=1) for each in ("40mm", "20cm")
    }
    photo = nl.refocus(near, psfs, tau=1e-5, iterations=20)
    assert photo.distance_um == pytest.approx(60e3, rel=0.25)
    known = nl.refocus(near, psfs, "60mm", tau=1e-5, iterations=8)
    assert nl.psnr(known, near.expected) > 15


def test_psf_is_measured(psf: nl.Psf) -> None:
    figures = nl.measure_psf(psf, "3.1um", channel=1)
    assert 5 < figures.line_width_um < 60
    with pytest.raises(DataError, match="channel is 3; the PSF has 3"):
        nl.measure_psf(psf, "3.1um", channel=3)


def test_resolution_is_that_of_the_command(camera: nl.Camera, tmp_path: Path) -> None:
    """Of a simulated camera, and of the picture that the simulation gave."""
    options = SiemensOptions.gather(
        {"simulate": "small", "angle": "11deg", "spokes": 18, "iterations": 16, "light": "535nm"}
    )
    theirs = measure_siemens(options, Reporter())
    resolution = nl.measure_resolution(
        camera, "siemens", angle="11deg", spokes=18, iterations=16, light="535nm"
    )
    assert resolution.resolved_deg == theirs.value.resolved_everywhere_deg
    assert resolution.figures.keys() <= theirs.summary.keys()
    star = resolution.measured.picture
    again = nl.measure_resolution(
        star.values, pixel_angle=Angle(str(math.degrees(math.atan(star.tangent))), "deg")
    )
    assert again.resolved_deg == pytest.approx(resolution.resolved_deg, rel=1e-3)
    assert Pillow.open(io.BytesIO(again._repr_png_())).size[0] > 500
    assert repr(again) == f"Resolution(siemens, {again.resolved_deg:.3f}°)"


def test_edge_and_points_in_pictures(camera: nl.Camera) -> None:
    edge = nl.measure_resolution(slanted_edge(72, 5.0), "edge", pixel_angle="0.1deg")
    # The mean over square pixels: sinc(f), a tenth at 0.906 cycles, beyond half a cycle.
    assert edge.resolved_deg is None and edge.figures["tilt_deg"] == pytest.approx(5, abs=0.02)
    assert edge.figures["half_contrast_per_deg"] is None
    pictures = {}
    for pixels in (2, 4, 6):
        points = np.zeros((40, 40))
        points[20, [17, 17 + pixels]] = 1
        pictures[f"{pixels / 10}deg"] = gaussian_filter(points, 1.0)
    found = nl.measure_resolution(pictures, "two-points", pixel_angle="0.1deg")
    assert 0.2 < found.resolved_deg < 0.4
    for each in (edge, found):
        assert Pillow.open(io.BytesIO(each._repr_png_())).size[0] > 500


def test_field_of_view_is_that_of_the_command(camera: nl.Camera, psf: nl.Psf) -> None:
    options = MeasureFieldOptions.gather({"simulate": "small", "angles": "0deg,8deg"})
    theirs = measure_field(options, Reporter())
    field = nl.measure_field(camera, angles=("0deg", "8deg"))
    assert field.psfs == theirs.value.psfs and repr(field) == "FieldOfView(2 PSFs up to 8.0°)"
    assert Pillow.open(io.BytesIO(field._repr_png_())).size[0] > 500
    side = np.roll(np.asarray(nl.psf(camera, "300mm")), 12, axis=2)
    captured = nl.measure_field(
        {"0deg": nl.psf(camera, "300mm"), "2deg": side}, pixel=Length("3.1", "um")
    )
    assert captured.psfs[0].correlation == pytest.approx(1, abs=1e-5)
    assert captured.psfs[1].shift_um == pytest.approx(12 * 3.1, rel=0.01)
    with pytest.raises(OptionError, match="give the central PSF"):
        nl.measure_field({"2deg": side}, pixel="3.1um")
    with pytest.raises(OptionError, match="give rising angles"):
        nl.measure_field(camera, angles=("8deg", "0deg"))


def test_dots_of_a_simulated_camera(camera: nl.Camera) -> None:
    field = nl.measure_field(camera, dot_pitch="12mm", extent="6deg", prior="l1")
    assert field.grid is not None and len(field.figures["dots"]) == len(field.grid.dots) > 5
    # ℓ1 leaves nothing between the points.
    assert float((field.grid.picture == 0).double().mean()) > 0.6
    assert Pillow.open(io.BytesIO(field._repr_png_())).size[0] > 500


REFUSED = {
    "target": (lambda shot, psf: nl.measure_resolution(shot, "bars"), "give one of siemens, edge"),
    "no scale": (lambda shot, psf: nl.measure_resolution(shot), "pixel_angle"),
    "odd": (lambda shot, psf: nl.Camera("paper", pixels=(380, 507)), "even numbers"),
    "no star": (lambda shot, psf: nl.measure_resolution(shot, pixel_angle="0.1deg"), "no Siemens"),
    "no angles": (lambda shot, psf: nl.measure_resolution(shot, "two-points"), "for each angle"),
    "both sizes": (lambda shot, psf: nl.reconstruct(shot, psf, quality="draft", method="admm"),
                   "both choose"),
    "quality": (lambda shot, psf: nl.reconstruct(shot, psf, quality="best"), "give one of draft"),
    "channels": (lambda shot, psf: nl.reconstruct(np.ones((4, 9, 9)), psf), "4 channels"),
    "same": (lambda shot, psf: nl.reconstruct(psf.values, psf.values),
             "^the measurement and the PSF array hold the same values"),
    "support": (lambda shot, psf: nl.reconstruct(shot, psf, support="9x9"), "or None for no limit"),
    "one psf": (lambda shot, psf: nl.refocus(shot, {"8cm": psf}), "two distances"),
    "no unit": (lambda shot, psf: nl.refocus(shot, {"8": psf, "50cm": psf}), "unit"),
    "sizes": (lambda shot, psf: nl.psnr(shot, psf), "of one size"),
    "fill": (lambda shot, psf: nl.simulate(scene(), nl.Camera("small"), fill=90), "fill is 90"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case: str, shot: nl.SimulatedMeasurement, psf: nl.Psf) -> None:
    call, words = REFUSED[case]
    with pytest.raises((DataError, OptionError), match=words):
        call(shot, psf)


def test_loads_only_what_is_used() -> None:
    """And all names that are listed are there, and in docs/api.md.

    No module starts a thread of torch, with which no process can be copied (`worker_context`).
    """
    code = (
        "import sys, psutil, nolens as nl;"
        "print(sorted({'torch', 'numpy', 'PIL'} & {*sys.modules}));"
        "print(*dir(nl)); [getattr(nl, each) for each in dir(nl)];"
        "import nolens.studio.live_process, nolens.studio.job_process;"
        "print(psutil.Process().num_threads(), sys.modules['torch'].cuda.is_initialized())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={**os.environ, "OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    heavy, names, threads = done.stdout.splitlines()
    assert heavy == "[]" and threads == "1 False"
    page = (ROOT / "docs" / "api.md").read_text()
    assert [each for each in names.split() if f"`{each}`" not in page] == ["__version__"]
