"""A resolution target of another package is measured, listed and drawn like the built-in ones."""

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from plugin_process import INSTALLED, Command
from scipy.ndimage import gaussian_filter1d

from nolens.files import read_picture
from nolens.jobs.measuring.resolution import TARGETS

PIXEL_DEG = 0.1


def bars(period_cells: float, contrast: float, blur_cells: float = 0.0, side: int = 150) -> object:
    """Bars in a picture, finely drawn, blurred, and averaged over each cell."""
    fine = 32
    at = (np.arange(side * fine) + 0.5) / fine
    wave = np.where((at / period_cells + 0.13) % 1 < 0.5, 1 + contrast, 1 - contrast)
    if blur_cells:
        wave = gaussian_filter1d(wave, blur_cells * fine, mode="nearest")
    return np.tile(wave.reshape(side, fine).mean(1).astype(np.float32), (40, 1))


@pytest.mark.parametrize(
    ("period_cells", "contrast", "blur_cells"), [(9.7, 0.6, 0.0), (12.3, 1.0, 2.0), (7.4, 0.3, 1.0)]
)
def test_contrast_of_bars(
    period_cells: float, contrast: float, blur_cells: float, nolens: Command, tmp_path: Path
) -> None:
    np.save(tmp_path / "bars.npy", bars(period_cells, contrast, blur_cells))
    cell = math.tan(math.radians(PIXEL_DEG))
    period_deg = math.degrees(2 * math.atan(period_cells * cell / 2))
    done = nolens(
        "measure", "resolution", "bars", tmp_path / "bars.npy", "--period", f"{period_deg}deg",
        "--pixel-angle", f"{PIXEL_DEG}deg", "--plot", tmp_path / "out.png", "--json",
    )  # fmt: skip
    assert done.returncode == 0 and done.stderr == "", done
    told = json.loads(done.stdout)
    frequency = math.pi / period_cells
    blurred = math.exp(-2 * (frequency * blur_cells) ** 2) * math.sin(frequency) / frequency
    assert told["contrast"] == pytest.approx(contrast * blurred, rel=0.01)
    assert told["target"] == "bars" and told["iterations"] is None and told["warnings"] == []
    assert (tmp_path / "out.png").read_bytes()[:4] == b"\x89PNG"
    record = json.loads((tmp_path / "out.json").read_text())
    assert record["result"] == told and list(record["inputs"]) == ["frame"]


def test_bars_of_a_simulated_camera(nolens: Command) -> None:
    """The seam has the simulation of the built-in targets: wider bars have more contrast."""
    contrasts = []
    for period in ("0.6deg", "1.2deg"):
        done = nolens(
            "measure", "resolution", "bars", "--simulate", "small", "--light", "535nm", "--period",
            period, "--iterations", 30, "--json",
        )  # fmt: skip
        assert done.returncode == 0, done
        contrasts.append(json.loads(done.stdout)["contrast"])
    assert 0 < contrasts[0] < contrasts[1] < 1.1


def test_bars_are_listed_and_drawn(nolens: Command, tmp_path: Path) -> None:
    listed = nolens("measure", "resolution", "--help")
    assert listed.returncode == 0
    for words in ("bars", "Measure the contrast of upright bars", "two-points", "siemens", "edge"):
        assert words in listed.stdout
    done = nolens(
        "measure", "target", "bars", "-o", tmp_path / "bars.png", "--pixels", 120, "--pairs", 5
    )
    assert done.returncode == 0 and done.stdout == f"{tmp_path / 'bars.png'}\n", done
    drawn = read_picture(tmp_path / "bars.png").radiance
    assert drawn.shape[1:] == (120, 120)
    assert [round(float(each)) for each in drawn[0, 60, 6::12]] == [1, 0] * 5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("resolution", "bars", "bars.npy", "--pixel-angle", "0.1deg"), "no period is given"),
        (("resolution", "bars", "bars.npy", "--period", "1", "--pixel-angle", "0.1deg"), "no unit"),
        (("resolution", "bars", "bars.npy", "--period", "1deg"), "--pixel-angle"),
        (("resolution", "bars", "--period", "1deg"), "nothing to measure"),
        (("resolution", "bars", "none.npy", "--period", "1deg", "--pixel-angle", "1deg"), "none"),
        (("resolution", "bars", "bars.npy", "--period", "9deg", "--pixel-angle", "0.1deg"),
         "half of all"),
        (("resolution", "bars", "bars.npy", "--period", "1deg", "--spokes", "4"), "--spokes"),
        (("target", "bars", "-o", "bars.png", "--tilt", "4deg"),
         "--tilt is none of a target of kind bars"),
        (("target", "siemens", "-o", "star.png", "--pairs", "4"),
         "--pairs is none of a target of kind siemens"),
    ],
)  # fmt: skip
def test_bad_input(
    arguments: tuple[str, ...],
    words: str,
    nolens: Command,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("bars.npy", bars(8.0, 0.6))
    assert words in nolens("measure", *arguments).refusal
    assert [each.name for each in tmp_path.iterdir()] == ["bars.npy"]


def test_package_that_cannot_be_loaded(tmp_path: Path) -> None:
    """Only its own target is refused; the others are measured as ever."""
    packages = tmp_path / "packages"
    shutil.copytree(INSTALLED, packages)
    (packages / "nolens_example" / "bars.py").write_text("import nowhere\n")
    given = ("bars.npy", "--period", "1deg", "--pixel-angle", "0.1deg")
    edge = ("edge", "-o", tmp_path / "edge.png", "--pixels", 100)
    with Command(packages) as nolens:
        said = nolens("measure", "resolution", "bars", *given).refusal
        assert "nolens-example" in said.replace("_", "-") and "No module named 'nowhere'" in said
        listed = nolens("measure", "resolution", "--help").printed
        assert "siemens" in listed and "bars" in listed
        assert nolens("measure", "target", *edge).returncode == 0


def test_built_in_targets() -> None:
    for name in TARGETS.names:
        target = TARGETS.load(name)
        assert target.job.options.__doc__ and target.job.__doc__
