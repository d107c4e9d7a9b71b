"""`nolens measure psf`: figures of PSFs with known ones, on files of every kind."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from little_camera import save
from PIL import Image
from running import check_refused, listing, run
from torch import Tensor

from nolens.camera import PsfEntry, preset
from nolens.files import write_camera, write_dng, write_psfs
from nolens.quantities import Length
from nolens.twin import mosaic

SIGMA, SIDE, PITCH = 2.0, 192, 24.0
FWHM = 2 * math.sqrt(2 * math.log(2)) * math.sqrt(2) * SIGMA


def spots(cells: tuple[int, int] = (SIDE, SIDE), sigma: float = SIGMA) -> Tensor:
    """Gaussian spots on a square lattice, 1 at their tops, (1, rows, columns)."""
    rows, columns = (torch.arange(count, dtype=torch.float64) for count in cells)
    lines = [
        torch.exp(-(((each + PITCH / 2) % PITCH - PITCH / 2) ** 2) / (2 * sigma**2))
        for each in (rows, columns)
    ]
    return (lines[0][:, None] * lines[1])[None].float()


def measured(*arguments: object) -> dict[str, Any]:
    done = run("measure", "psf", *arguments, "--json")
    assert done.code == 0, done
    assert done.out.count("\n") == 1
    told: dict[str, Any] = json.loads(done.out)
    return told


@pytest.fixture
def psf(tmp_path: Path) -> Path:
    return save(tmp_path / "psf.npy", spots())


@pytest.mark.parametrize("name", ["psf.npy", "psf.tif", "psf.png"])
def test_figures_of_known_spots(name: str, tmp_path: Path) -> None:
    scale = 1.0 if name.endswith("npy") else 50_000.0
    path = save(tmp_path / name, scale * spots())
    told = measured(path, "--pixel", "3.1um")
    assert told["fwhm_um"] == pytest.approx(FWHM * 3.1, rel=0.01)
    assert told["line_width_um"] == pytest.approx(FWHM * 3.1 / math.sqrt(2), rel=0.01)
    assert told["pitch_um"] == pytest.approx(PITCH * 3.1, rel=0.01)
    assert told["pixels"] == [SIDE, SIDE] and told["pixel_um"] == 3.1
    assert told["line_deg"] is None and told["warnings"] == [] and told["camera"] is None
    assert set(told["curves"]["direction_magnitude"]) == {"0", "90", "180", "270"}
    assert len(told["curves"]["lag_um"]) == len(told["curves"]["autocorrelation"])
    assert listing(tmp_path).keys() == {name}


def test_a_raw_file_has_cells_of_two_pixels(tmp_path: Path) -> None:
    """The camera's angles are those of its layers: Σ t/n = 1.28 mm."""
    sensor = preset("small").sensor
    light = spots((128, 160)).expand(3, -1, -1).repeat_interleave(2, 1).repeat_interleave(2, 2)
    counts = (256 + 3000 * mosaic(light.contiguous(), "RGGB")).round()
    write_dng(tmp_path / "psf.dng", counts, pattern="RGGB", black=256, white=4095)
    told = measured(tmp_path / "psf.dng", "--pixel", sensor.pitch, "--camera", "small")
    assert told["pixel_um"] == 3.1 and told["pixels"] == [128, 160]
    assert told["fwhm_um"] == pytest.approx(FWHM * 3.1, rel=0.01)
    assert told["camera"] == "small"
    reduced = told["reduced_thickness_mm"]
    assert reduced == pytest.approx(1.06 / 1.47 + 0.49 / 1.52 + 0.235, rel=0.01)
    angle = math.degrees(math.atan(told["line_width_um"] * 1e-3 / reduced))
    assert told["line_deg"] == pytest.approx(angle, rel=1e-4)
    aperture = told["pitch_um"] * 1e-3 / (2 * reduced)
    assert told["lenslet_aperture"] == pytest.approx(aperture, rel=1e-4)
    assert told["depth_of_focus_mm"] == pytest.approx(0.55e-3 / aperture**2, rel=1e-4)


def test_channels(tmp_path: Path) -> None:
    """Each has its own figures, and grey is the mean."""
    planes = [spots(sigma=sigma)[0] for sigma in (1.4, 1.7, 2.0)]
    path = save(tmp_path / "psf.npy", torch.stack(planes))
    widths = {c: measured(path, "--pixel", "1um", "--channels", c)["fwhm_um"] for c in "rgb"}
    assert [round(w / FWHM * SIGMA, 2) for w in widths.values()] == [1.4, 1.7, 2.0]
    assert widths["r"] < measured(path, "--pixel", "1um")["fwhm_um"] < widths["b"]


def test_noise_and_black_are_taken_as_given(psf: Path, tmp_path: Path) -> None:
    told = measured(psf, "--pixel", "1um", "--noise", "0.01")
    assert told["noise"] == 0.01 and told["noise_known"]
    assert not measured(psf, "--pixel", "1um")["noise_known"]
    raised = save(tmp_path / "raised.npy", spots() + 0.2)
    assert measured(raised, "--pixel", "1um")["background_fraction"] > 0.5
    told = measured(raised, "--pixel", "1um", "--black", "0.2")
    assert abs(told["background_fraction"]) < 1e-3


def test_plot_and_record(psf: Path, tmp_path: Path) -> None:
    done = run("measure", "psf", psf, "--pixel", "3.1um", "--plot", tmp_path / "fig.png")
    assert done.code == 0 and done.err == "", done
    for words in ("FWHM 20.6", "line width 14.5", "pitch 74.", "fig.png", "fig.json"):
        assert words in done.out, (words, done.out)
    record = json.loads((tmp_path / "fig.json").read_text())
    assert record["inputs"]["PSF"]["path"] == str(psf)
    assert record["result"]["outputs"] == [str(tmp_path / "fig.png"), str(tmp_path / "fig.json")]
    picture = np.asarray(Image.open(tmp_path / "fig.png").convert("L"))
    assert picture.shape[1] > 2 * picture.shape[0] and picture.std() > 20


def entry(**more: Any) -> PsfEntry:
    given = {"file": "psf-300mm.tif", "cell": Length("3.1", "um"), "channels": ("grey",)}
    return PsfEntry(**{**given, "distance": Length("300", "mm"), **more})


def test_a_folder_knows_its_cells_and_its_camera(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    write_camera(folder, preset("small"))
    write_psfs(folder, {entry(): spots((128, 160))})
    told = measured(folder / "psf-300mm.tif")
    assert told["pixel_um"] == 3.1 and told["camera"] == "small"
    check_refused(
        run("measure", "psf", folder / "psf-300mm.tif", "--pixel", "1.55um"),
        "--pixel 1.55 um", "psfs.toml says", "3.1 um apart",
    )  # fmt: skip
    check_refused(run("measure", "psf", folder), "is a folder", "psf-300mm.tif")


def test_a_black_level_that_is_not_stated(tmp_path: Path) -> None:
    light = torch.nn.functional.pad(spots(), (20,) * 4)
    lifted = save(tmp_path / "psf.npy", light + 0.1)
    (warning,) = measured(lifted, "--pixel", "1um")["warnings"]
    assert "--black auto" in warning
    bare = measured(save(tmp_path / "bare.npy", light), "--pixel", "1um")
    told = measured(lifted, "--pixel", "1um", "--black", "auto")
    assert told["warnings"] == bare["warnings"]
    assert told["contrast"] == pytest.approx(bare["contrast"], rel=0.02)


def test_clipped_is_a_warning(tmp_path: Path) -> None:
    clipped = (5000 * spots() / 0.7).clamp(max=4095)
    told = measured(save(tmp_path / "float.npy", clipped), "--pixel", "1um")
    assert "seems to be clipped" in told["warnings"][0]
    done = run("measure", "psf", tmp_path / "float.npy", "--pixel", "1um")
    assert done.code == 0 and done.err.startswith("nolens: warning: ") and "clipped" in done.err


def test_clipped_counts_of_a_raw_file_are_a_warning(tmp_path: Path) -> None:
    light = spots((144, 144)).expand(3, -1, -1).repeat_interleave(2, 1).repeat_interleave(2, 2)
    counts = (256 + 6000 * mosaic(light.contiguous(), "RGGB")).round().clamp(max=4095)
    write_dng(tmp_path / "psf.dng", counts, pattern="RGGB", black=256, white=4095)
    told = measured(tmp_path / "psf.dng", "--pixel", "1.55um")
    assert len(told["warnings"]) == 1 and "is saturated" in told["warnings"][0]


def test_lines_finer_than_cells_and_no_pitch_are_warnings(tmp_path: Path) -> None:
    one = torch.zeros(1, 64, 64)
    one[0, 30:33, 30:33] = torch.tensor([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4.0
    path = save(tmp_path / "one.npy", one)
    warnings = " ".join(measured(path, "--pixel", "1um", "--noise", "0")["warnings"])
    assert "no second peak" in warnings and "less than two pixels" in warnings


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("no pitch", "--pixel 3.1um")),
        (("--pixel", "3.1"), ("3.1 has no unit",)),
        (("--pixel", "0um"), ("50 nm to 10 mm",)),
        (("--pixel", "3.1um", "--channels", "all"), ("--channels all", "grey")),
        (("--pixel", "3.1um", "--noise", "-1"), ("noise is -1", "0 to 1000000000")),
        (("--pixel", "3.1um", "--plot", "fig.jpg"), ("suffix .jpg",)),
        (("--pixel", "2um", "--camera", "small"), ("does not fit", "3.1 µm")),
        (("--pixel", "3.1um", "--camera", "smal"), ("Did you mean",)),
    ],
)
def test_refused(arguments: tuple[str, ...], words: tuple[str, ...], tmp_path: Path) -> None:
    path = save(tmp_path / "psf.npy", spots((128, 160)))
    before = listing(tmp_path)
    check_refused(run("measure", "psf", path, *arguments), *words)
    assert listing(tmp_path) == before


def test_no_pattern_is_refused(tmp_path: Path) -> None:
    noise = 100 + torch.randn(1, 64, 64, generator=torch.manual_seed(0))
    path = save(tmp_path / "noise.npy", noise)
    plot = tmp_path / "fig.png"
    check_refused(
        run("measure", "psf", path, "--pixel", "1um", "--plot", plot),
        "nothing above its background",
    )
    assert listing(tmp_path).keys() == {"noise.npy"}
    check_refused(run("measure", "psf", tmp_path / "none.npy", "--pixel", "1um"), "none.npy")
    check_refused(run("measure", "psf"), "nolens measure psf PSF --pixel 3.1um")
