"""`nolens reconstruct --prior` with trained weights, and --uncertainty."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from little_camera import SUPPORT, Camera, quality
from PIL import Image
from running import check_refused, run

import nolens as nl
from nolens.errors import OptionError
from nolens.files import read_frame
from nolens.files.weights import denoiser, sha256_of_weights, write_weights
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.solvers import Reconstructor, Result
from nolens.solvers.uncertainty import detail_warning
from nolens.training.pictures import training_picture

ASKED = ("--support", SUPPORT, "--tau", 8e-3, "--iterations", 40)


def solved(camera: Camera, out: Path, *asked: object) -> dict[str, object]:
    done = run("reconstruct", camera.raw, "--psf", camera.psf, "-o", out, *ASKED, *asked)
    assert done.code == 0, done.err
    record: dict[str, object] = json.loads(out.with_suffix(".json").read_text())["result"]
    return record


@pytest.mark.parametrize("prior", ["ridge", "denoiser", "unrolled"])
def test_weights_that_come_with_nolens(prior: str, camera: Camera, tmp_path: Path) -> None:
    """The picture is that of `nl.reconstruct`, and the record says which weights it is by."""
    out = tmp_path / "o.tif"
    result = solved(camera, out, "--prior", prior, "--tiff-bits", 32)
    weights = Path(nl.__file__).parent / "files" / "trained" / f"{prior}.npz"
    card = json.loads(weights.with_suffix(".json").read_text())
    assert result["prior"] == prior
    assert result["weights_sha256"] == sha256_of_weights(weights) == card["sha256"]
    assert result["weights_card"] == f"{prior}.json"
    assert result["method"] == ("admm" if prior == "ridge" else "admm, plug-and-play")
    picture = read_frame(out).counts
    photograph = nl.reconstruct(
        camera.raw, camera.psf, support=(24, 32), tau=8e-3, iterations=40, prior=prior
    )
    torch.testing.assert_close(photograph.values, picture, rtol=1e-4, atol=1e-4)
    assert quality(picture) > 25


@pytest.mark.parametrize(
    ("options", "prior"),
    [
        ({}, "denoiser"),
        ({"quality": "photo", "detail": 2.0, "support": "full"}, "denoiser"),
        ({"prior": "tv"}, "tv"),
        ({"quality": "exact"}, "auto"),
        ({"method": "fista"}, "auto"),
        ({"tau": 1e-4}, "auto"),
        ({"iterations": 20}, "auto"),
        ({"sweep": "tau"}, "denoiser"),
        ({"sweep": "method"}, "auto"),
        ({"measurement": "frames"}, "auto"),
    ],
)
def test_prior_of_a_photo(options: dict[str, object], prior: str, tmp_path: Path) -> None:
    """A trained one, but where options speak of a minimiser, which is said, and of sequences."""
    (tmp_path / "frames").mkdir()
    files = {"measurement": "m.npy", "psf": "p.npy", "output": ("o.png",), **options}
    files["measurement"] = tmp_path / str(files["measurement"])
    asked = ReconstructOptions.model_validate(files)
    assert asked.photo_prior == prior
    note = asked.prior_note
    if prior == "auto" and not asked.is_sequence:
        assert note is not None and f"because of --{next(iter(options))}:" in note
    else:
        assert note is None


def test_the_default_is_trained(camera: Camera, tmp_path: Path) -> None:
    pictures = []
    for asked in ((), ("--prior", "denoiser")):
        done = run("reconstruct", camera.raw, "--psf", camera.psf, "--support", SUPPORT, *asked,
                   "-o", tmp_path / "o.tif", "--tiff-bits", 32)  # fmt: skip
        assert done.code == 0, done.err
        record = json.loads((tmp_path / "o.json").read_text())["result"]
        assert record["prior"] == "denoiser" and len(record["weights_sha256"]) == 64
        pictures.append(read_frame(tmp_path / "o.tif").counts)
    photograph = nl.reconstruct(camera.raw, camera.psf, support=(24, 32))
    assert torch.equal(*pictures)
    torch.testing.assert_close(photograph.values, pictures[0], rtol=1e-4, atol=1e-4)
    assert "plug-and-play" in str(photograph.report)
    minimised = nl.reconstruct(camera.raw, camera.psf, support=(24, 32), quality="exact")
    assert minimised.result.first is None
    assert any("because of quality" in each for each in minimised.notes)
    with pytest.raises(OptionError, match="ridge"):
        nl.reconstruct(camera.raw, camera.psf, support=(24, 32), quality="exact", prior="denoiser")


def test_detail_and_exactness_of_the_ridge(camera: Camera) -> None:
    """More detail is a weaker ridge, and exact holds for it, not only for where it starts."""
    asked: dict[str, Any] = {"support": (24, 32), "prior": "ridge"}
    smooth, plain, rough = (
        nl.reconstruct(camera.raw, camera.psf, detail=detail, **asked).values.diff().abs().mean()
        for detail in (0.2, 1.0, 5.0)
    )
    assert 1.05 * smooth < plain < rough / 1.05
    exact = nl.reconstruct(camera.raw, camera.psf, quality="exact", **asked).result
    last = exact.history[-1]
    assert exact.stop_reason == "converged"
    assert max(last["primal_residual"], last["dual_residual"]) <= 1e-4
    assert exact.first is not None and exact.first.iterations <= 200


def test_many_pixels_are_by_total_variation(
    camera: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the network would take minutes, and nobody asked for it; and that is said."""
    monkeypatch.setattr("nolens.solvers.plug_and_play.MANY_PIXELS", 100)
    monkeypatch.setattr("nolens.solvers.plug_and_play.MINUTES_PIXELS", 100)
    asked = ("reconstruct", camera.raw, "--psf", camera.psf, "--support", SUPPORT)
    done = run(*asked, "-o", tmp_path / "o.png")
    assert done.code == 0 and "by total variation" in done.err and "--prior" not in done.err
    assert json.loads((tmp_path / "o.json").read_text())["result"]["prior"] == "tv"
    photograph = nl.reconstruct(camera.raw, camera.psf, support=(24, 32))
    assert photograph.result.first is None
    assert any("by total variation" in each for each in photograph.notes)
    done = run(*asked, "--prior", "denoiser", "-o", tmp_path / "o.png")
    assert json.loads((tmp_path / "o.json").read_text())["result"]["prior"] == "denoiser"


def test_pictures_of_a_sweep_have_one_prior(
    camera: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Smaller supports are by total variation, too, where the photo itself has too many pixels."""
    seen: list[bool] = []
    solve = Reconstructor.solve

    def watched(self: Reconstructor, *asked: Any, **more: Any) -> Result:
        seen.append(self.network is not None)
        return solve(self, *asked, **more)

    monkeypatch.setattr(Reconstructor, "solve", watched)
    monkeypatch.setattr("nolens.solvers.plug_and_play.MANY_PIXELS", 6000)
    monkeypatch.setattr("nolens.solvers.plug_and_play.MINUTES_PIXELS", 6000)
    asked = ("--psf", camera.psf, "--support", "full", "--sweep", "support")
    done = run("reconstruct", camera.raw, *asked, "-o", tmp_path / "o.png")
    assert done.code == 0, done.err
    assert len(seen) >= 4 and not any(seen)


def test_weights_of_ones_own(camera: Camera, tmp_path: Path) -> None:
    mine = tmp_path / "mine.npz"
    write_weights(mine, denoiser(), {"licence": "mine"})
    pictures = {}
    for prior in (mine, "denoiser"):
        result = solved(camera, tmp_path / "o.tif", "--prior", prior)
        pictures[prior] = read_frame(tmp_path / "o.tif").counts
        assert result["prior"] == "denoiser"
    assert torch.equal(pictures[mine], pictures["denoiser"])


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (("--prior", "mine.txt"), ("--prior", "'ridge', 'denoiser' or 'unrolled'", ".npz")),
        (("--prior", "nowhere.npz"), ("nowhere.npz",)),
        (("--prior", "photo.npz"), ("photo.npz", "nolens train")),
        (("--prior", "denoiser", "--method", "wiener"), ("Wiener filter", "trained prior")),
        (("--uncertainty", 1), ("--uncertainty", "2")),
        (("--uncertainty", 4, "--depths", "8cm,20cm"), ("--uncertainty",)),
    ],
)
def test_what_cannot_be(
    asked: tuple[object, ...],
    words: tuple[str, ...],
    camera: Camera,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    np.savez("photo.npz", photo=np.zeros((3, 4)))
    out = "stack" if "--depths" in asked else "o.png"
    done = run("reconstruct", camera.raw, "--psf", camera.psf, "-o", out, *ASKED, *asked)
    check_refused(done, *words)
    assert [each.name for each in tmp_path.iterdir()] == ["photo.npz"]


def test_uncertainty(camera: Camera, tmp_path: Path) -> None:
    """The spread is that of pictures of other noise; a sheet shows it beside the picture."""
    out = tmp_path / "o.png"
    solved(camera, out, "--prior", "denoiser", "--uncertainty", 2)
    spread = torch.from_numpy(tifffile.imread(tmp_path / "o-uncertainty.tif")).movedim(-1, 0)
    assert spread.shape == (3, 24, 32) and float(spread.min()) >= 0
    photograph = nl.reconstruct(
        camera.raw, camera.psf, support=(24, 32), tau=8e-3, iterations=40, prior="denoiser",
        uncertainty=2,
    )  # fmt: skip
    assert photograph.spread is not None and photograph.disagreement is not None
    difference = tifffile.imread(tmp_path / "o-uncertainty-difference.tif")
    torch.testing.assert_close(
        photograph.disagreement, torch.from_numpy(difference).movedim(-1, 0), rtol=1e-3, atol=1e-5
    )
    usual = nl.reconstruct(
        camera.raw, camera.psf, support=(24, 32), tau=8e-3, iterations=40, prior="tv"
    )
    apart = (photograph.values - usual.values).abs()
    torch.testing.assert_close(photograph.disagreement, apart, rtol=1e-2, atol=1e-4)
    torch.testing.assert_close(photograph.spread, spread, rtol=1e-3, atol=1e-5)
    # Noise of about 1 % moves pixels by less than a fifth of the white, and by more than nothing.
    mean = float(spread.mean() / photograph.values.max())
    assert 1e-4 < mean < 0.2
    with Image.open(tmp_path / "o-uncertainty.png") as sheet:
        assert sheet.width > 3 * sheet.height * 0.5


def test_spread_grows_with_the_noise(camera: Camera) -> None:
    raw = nl.load(camera.raw)
    dim = nl.load(camera.raw)
    noise = torch.randn(dim.counts.shape, generator=torch.Generator().manual_seed(0))
    dim = type(dim)(**{**vars(dim), "counts": dim.counts + 60 * noise})
    spreads = [
        nl.reconstruct(
            frame, camera.psf, support=(24, 32), tau=8e-3, iterations=40, uncertainty=4
        ).spread
        for frame in (raw, dim)
    ]
    assert spreads[0] is not None and spreads[1] is not None
    assert float(spreads[1].mean()) > 2 * float(spreads[0].mean())


def test_detail_that_the_psf_does_not_carry() -> None:
    """It is said of a network that adds texture, and not of a photograph, sharp or smooth."""
    plain = training_picture(64, 64, 5)[:1]
    stripes = 0.2 * torch.cos(torch.pi * torch.arange(64.0)).expand(1, 64, 64)
    first = Result(plain, 0.0, 1, "converged", (0, 0, 64, 64))
    smooth = torch.nn.functional.avg_pool2d(plain, 3, 1, 1)
    for scene, warned in ((plain + stripes, True), (smooth, False), (plain, False)):
        result = Result(scene, 0.0, 2, "converged", (0, 0, 64, 64), first=first)
        assert (detail_warning(result, 0.3) is not None) is warned
    assert detail_warning(first, 0.3) is None
