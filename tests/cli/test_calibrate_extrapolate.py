"""`nolens calibrate extrapolate`: a captured PSF that goes on beyond the sensor."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch
from captured_scene import SENSOR, captured_set, raw
from running import check_refused, listing, run

from nolens.files import read_psf, read_psf_set
from nolens.jobs import CalibrateExtrapolateOptions, calibrate_extrapolate


def test_mean_light_without_pictures(tmp_path: Path) -> None:
    made = captured_set(tmp_path / "made")
    done = run("calibrate", "extrapolate", made, "--support", "20x24", "--json")
    assert done.code == 0 and done.err == "", done
    told = json.loads(done.out)
    assert told["extrapolated_by"] == "mean light" and told["rounds"] == 0
    assert told["pixels"] == [SENSOR[0] + 20, SENSOR[1] + 24]
    listed = read_psf_set(made)
    (wide,) = listed.by_distance(("extended",))
    assert wide.file == "extended-300mm.tif" and wide.frame == "chief-ray"
    psf, captured = read_psf(made, wide), read_psf(made, listed.psf[0])
    assert torch.equal(psf[:, 10:-10, 12:-12], captured)
    assert torch.allclose(psf[:, :10], captured.mean(dim=(-2, -1), keepdim=True))
    record = json.loads((made / "extend-300mm.json").read_text())
    assert record["result"] == told and record["parameters"]["support"] == "20x24"


def test_by_its_former_name(tmp_path: Path) -> None:
    made = captured_set(tmp_path / "made")
    done = run("calibrate", "surround", made, "--support", "20x24", "--json")
    assert done.code == 0 and "surround is called extrapolate now" in done.err, done
    # Its figures have their former names too, and the record is the same.
    summary = json.loads(done.out)
    assert summary["extrapolated_by"] == summary["surround"] == "mean light"
    assert summary["cells"] == summary["pixels"] and summary["former_keys"]["cells"] == "pixels"
    assert json.loads((made / "extend-300mm.json").read_text())["result"] == summary
    assert "surround" not in run("calibrate", "--help").out


def test_pictures(tmp_path: Path) -> None:
    made = captured_set(tmp_path / "made")
    pictures = [raw(tmp_path / f"{seed}.tif", seed) for seed in (1, 2)]
    done = run("calibrate", "extrapolate", made, *pictures, "--support", "20x24", "--rounds", 2)
    assert done.code == 0 and "warning" not in done.err, done
    assert "extended to 68×88 pixels by pictures" in done.out and "2 rounds" in done.out
    record = json.loads((made / "extend-300mm.json").read_text())
    told = record["result"]
    assert told["residual"][-1] < 0.8 * told["residual"][0] and len(told["residual"]) == 3
    assert sorted(record["inputs"]) == ["PSF psf.tif", "picture 1", "picture 2"]
    # A grey PSF serves pictures in colour: their mean, here three times the same.
    colour = tmp_path / "colour.tif"
    tifffile.imwrite(colour, np.stack([tifffile.imread(pictures[0])] * 3, axis=-1))
    step = ("--support", "20x24", "--rounds", 1, "--json")
    residuals = []
    for each in (pictures[0], colour):
        done = run("calibrate", "extrapolate", made, each, *step)
        assert done.code == 0, done
        residuals.append(json.loads(done.out)["residual"])
    assert residuals[0] == pytest.approx(residuals[1], rel=1e-4)


def test_bad_input(tmp_path: Path) -> None:
    made = captured_set(tmp_path / "made")
    good = raw(tmp_path / "good.tif", 1)
    before = listing(made)
    for words, arguments in (
        (("no support is given", "--support 414x414"), (good,)),
        (("support is 'wide'", "400x400"), (good, "--support", "wide")),
        (("given twice",), (good, good, "--support", "20x24")),
        (
            ("46×64 pixels", "same camera"),
            (raw(tmp_path / "cut.tif", 1, (46, 64)), "--support", "20x24"),
        ),
        (
            ("overwrite the picture", "made/extended-300mm.tif:"),
            (made / "extended-300mm.tif", "--support", "20x24"),
        ),
        (("no file",), (tmp_path / "none.tif", "--support", "20x24")),
        (("--distance 1 m", "300 mm"), ("--distance", "1m", "--support", "20x24")),
        (("rounds",), ("--rounds", 0, "--support", "20x24")),
        (("from pixel 900 on", "48 pixels"), (good, "--support", "4x4+900+0")),
        (("65 pixels",), (good, "--support", "20x65")),
        (("0 everywhere",), (raw(tmp_path / "dark.tif", 1, light=0.0), "--support", "20x24")),
    ):
        check_refused(run("calibrate", "extrapolate", made, *arguments), *words)
        assert listing(made) == before
    check_refused(run("calibrate", "extrapolate"), "no folder is given")
    check_refused(run("calibrate", "extrapolate", tmp_path, "--support", "4x4"), "psfs.toml")


class Impatient:
    """Ends the work at its second step."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)

    warn = note

    def step(self, what: str, done: int, limit: int, result: str) -> bool:
        assert (what, limit, result) == ("step", 8, "the PSF")
        return done >= 2


def test_interrupted(tmp_path: Path) -> None:
    """Ctrl-C after the first round: what it found is written."""
    made = captured_set(tmp_path / "made")
    options = CalibrateExtrapolateOptions(
        folder=made, pictures=(raw(tmp_path / "raw.tif", 1),), support="20x24"
    )
    told = calibrate_extrapolate(options, Impatient()).summary  # type: ignore[arg-type]
    assert told["interrupted"] and told["rounds"] == 1 and told["extrapolated_by"] == "pictures"
    assert (made / told["file"]).exists()
