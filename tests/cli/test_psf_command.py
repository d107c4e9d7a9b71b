"""`nolens psf`: one point source, without noise or as the sensor captures it."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from running import listing, run
from simulated import values

from nolens.camera import preset
from nolens.files import read_camera, read_frame
from nolens.optics import PointSource
from nolens.twin import Twin

SMALL = ("--camera", "small", "--light", "535nm")


def pattern(*arguments: object) -> dict[str, Any]:
    done = run("psf", *SMALL, *arguments, "--json")
    assert done.code == 0 and done.err == "", done
    told: dict[str, Any] = json.loads(done.out)
    return told


def centre(plane: torch.Tensor) -> tuple[float, float]:
    """Row and column of the light's centre of mass, from the middle."""
    weight = plane.double() / plane.double().sum()
    rows, columns = (torch.arange(n, dtype=torch.float64) - (n - 1) / 2 for n in plane.shape)
    return float((weight.sum(1) * rows).sum()), float((weight.sum(0) * columns).sum())


def test_defaults(tmp_path: Path) -> None:
    told = pattern("-o", tmp_path / "psf.tif")
    assert told["outputs"] == [str(tmp_path / "psf.tif"), str(tmp_path / "psf.json")]
    assert told["pixels"] == [128, 160] and told["sensor_pixels_per_pixel"] == 2
    assert told["frame"] == "chief-ray" and told["shift_um"] == [0, 0] and told["angle_deg"] == 0
    found = values(tmp_path / "psf.tif")
    assert found.shape == (3, 128, 160) and float(found.min()) >= 0
    assert read_frame(tmp_path / "psf.tif").sensor == (128, 160)
    assert told["mean"] == pytest.approx(float(found.mean()))
    assert told["peak_over_mean"] == pytest.approx(float(found.max() / found.mean()))
    record = json.loads((tmp_path / "psf.json").read_text())
    assert record["result"] == told and record["parameters"]["angle"] == ["0 deg", "0 deg"]
    assert record["inputs"] == {}


ALL = ("--pixels", "700x700", "--bin", 1)


@pytest.fixture(scope="module")
def middle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("middle") / "psf.tif"
    pattern(*ALL, "--frame", "sensor", "-o", out)
    return out


@pytest.mark.parametrize(("at", "signs"), [("8deg,0deg", (0, 1)), ("0deg,8deg", (-1, 0)),
                                           ("-6deg,-6deg", (1, -1))])  # fmt: skip
def test_angles_are_the_photographers(
    at: str, signs: tuple[int, int], tmp_path: Path, middle: Path
) -> None:
    """To the right and up: the pattern moves to the right and up in the picture."""
    out, asked = tmp_path / "psf.tif", ALL
    told = pattern(*asked, "--frame", "sensor", "--angle", at, "-o", out)
    moved = [
        (there - here) * 1.55
        for here, there in zip(centre(values(middle)[0]), centre(values(out)[0]), strict=True)
    ]
    wanted = -told["shift_um"][1], told["shift_um"][0]
    for step, shift, sign in zip(moved, wanted, signs, strict=True):
        assert (abs(shift) < 1e-6) if sign == 0 else shift * sign > 100
        assert step == pytest.approx(shift, abs=8)
    # In the chief ray's frame the pattern stays where it is.
    pattern(*asked, "--angle", at, "-o", out)
    assert all(abs(a) < 8 for a in centre(values(out)[0]))


def test_shift_is_the_twins(tmp_path: Path) -> None:
    told = pattern("--angle", "20deg,-5deg", "-o", tmp_path / "psf.tif")
    tangent = [torch.tan(torch.deg2rad(torch.tensor(a, dtype=torch.float64))) for a in (5, 20)]
    source = PointSource((float(tangent[0]), float(tangent[1])))
    row, column = Twin.of(read_camera("small")).shift_um(source)
    assert told["shift_um"] == pytest.approx([column, -row], abs=1e-3)
    assert told["angle_deg"] == pytest.approx(source.angle_deg, abs=1e-3)


def test_size_of_the_light_blurs(tmp_path: Path) -> None:
    """Behind 1.28 mm of air, a light of 2 mm at 80 mm has an image of 32 um."""
    peaks = []
    for given in (("--distance", "80mm", "--size", "0um"), ("--distance", "80mm", "--size", "2mm")):
        peaks.append(pattern(*given, "--bin", 1, "-o", tmp_path / "psf.tif")["peak_over_mean"])
    assert peaks[1] < 0.4 * peaks[0]
    far = pattern("--distance", "infinity", "-o", tmp_path / "psf.tif")
    assert far["peak_over_mean"] > 10


def test_more_cells_show_what_falls_beside(tmp_path: Path) -> None:
    away = ("--angle", "10deg,0deg", "--frame", "sensor")
    pattern(*away, "-o", tmp_path / "psf.tif")
    pattern(*away, "--pixels", "256x320", "-o", tmp_path / "wide.tif")
    wide, narrow = values(tmp_path / "wide.tif"), values(tmp_path / "psf.tif")
    assert torch.allclose(wide[:, 64:192, 80:240], narrow, rtol=1e-3, atol=1e-3 * narrow.max())
    assert float(wide.sum()) > 1.01 * float(narrow.sum())


def test_superpixels_have_their_own_pixels_of_the_mosaic(tmp_path: Path) -> None:
    pattern("--bin", 1, "-o", tmp_path / "fine.tif")
    pattern("-o", tmp_path / "psf.tif")
    fine, cells = values(tmp_path / "fine.tif"), values(tmp_path / "psf.tif")
    assert fine.shape == (3, 256, 320)
    red, green, blue = fine
    own = torch.stack([red[::2, ::2], (green[::2, 1::2] + green[1::2, ::2]) / 2, blue[1::2, 1::2]])
    assert torch.allclose(own, cells, rtol=1e-3, atol=1e-3 * float(cells.max()))


def test_captured(tmp_path: Path) -> None:
    told = pattern("--fill", "50%", "-o", tmp_path / "psf.dng")
    frame, sensor = read_frame(tmp_path / "psf.dng"), preset("small").sensor
    assert frame.mosaic == "RGGB" and frame.counts.shape == (1, 256, 320)
    assert told["saturated_fraction"] == 0 and told["frame"] == "sensor"
    brightest = 0.5 * sensor.clip_electrons * sensor.counts_per_electron
    assert float(frame.counts.max()) - 256 == pytest.approx(brightest, rel=0.1)
    pattern("--fill", "50%", "--seed", 1, "-o", tmp_path / "other.dng")
    assert not torch.equal(values(tmp_path / "other.dng"), frame.counts)
    pattern("--fill", "50%", "-o", tmp_path / "again.dng")
    assert torch.equal(values(tmp_path / "again.dng"), frame.counts)


def test_captures_state_exposures_that_compare(tmp_path: Path) -> None:
    """Counts over the stated time are the light, whatever each frame is exposed to."""
    light = []
    for angle, fill in (("0deg,0deg", "90%"), ("10deg,0deg", "60%")):
        asked = ("--angle", angle, "--fill", fill, "-o", tmp_path / "psf.dng")
        told = pattern(*asked, "--pixels", "700x900")
        frame = read_frame(tmp_path / "psf.dng")
        assert frame.exposure_s == pytest.approx(told["exposure_s"], rel=1e-4)
        light.append(float((frame.counts - 256).mean()) / told["exposure_s"])
        bare = pattern(*asked[:2], "-o", tmp_path / "psf.tif", "--pixels", "350x450")["mean"]
        light[-1] /= bare
    assert light[1] == pytest.approx(light[0], rel=0.05)


def test_a_png_is_for_looking_at(tmp_path: Path) -> None:
    done = run("psf", *SMALL, "-o", tmp_path / "psf.png")
    assert done.code == 0 and "for looking at" in done.err
    assert read_frame(tmp_path / "psf.png").counts.shape == (3, 128, 160)


def test_text_for_people(tmp_path: Path) -> None:
    done = run("psf", *SMALL, "--angle", "20deg,0deg", "-o", tmp_path / "psf.tif")
    assert done.code == 0 and done.err == ""
    assert "20° off the axis: the pattern moves 45" in done.out
    for words in ("µm to the right and 0.0 µm up", "peak", "psf.tif", "psf.json"):
        assert words in done.out, words


def test_former_name_of_an_option_is_taken_with_a_note(tmp_path: Path) -> None:
    done = run("psf", "--at", "95deg,0deg", "-o", tmp_path / "psf.tif")
    assert done.code == 2 and "--angle is '95deg'" in done.err
    assert "at is called angle now" in done.err and not listing(tmp_path)
