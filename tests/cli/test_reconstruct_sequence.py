"""`nolens reconstruct` on sequences: folders, stacks, frames that cannot be used."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch
from little_camera import (
    SCENE,
    SENSOR,
    SUPPORT,
    measured,
    quality,
    save,
    spots,
    truth,
)
from PIL import Image
from running import check_refused, listing, run

from nolens.camera import linear_from_srgb

QUICK = ("--support", SUPPORT, "--tau", 8e-3)
"""With the weight that is chosen for the first frame."""


def scenes(count: int) -> list[torch.Tensor]:
    """The scene as it moves to the right, a cell a frame."""
    return [torch.roll(truth(), step, -1) for step in range(count)]


def light(count: int) -> torch.Tensor:
    """What is measured of them, with one factor for all."""
    psf = spots()
    return torch.stack([measured(psf, scene) for scene in scenes(count)])


@pytest.fixture(scope="module")
def psf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(tmp_path_factory.mktemp("psf") / "psf.npy", spots())


def pictures(folder: Path) -> dict[str, torch.Tensor]:
    """Linear radiance of the PNGs, by name."""
    return {
        path.stem: linear_from_srgb(
            torch.from_numpy(np.asarray(Image.open(path)).copy()).movedim(-1, 0).float() / 255
        )
        for path in sorted(folder.glob("*.png"))
    }


def check_follows(found: list[torch.Tensor]) -> None:
    """Every picture shows its own scene better than the one before it."""
    expected = scenes(len(found))
    for step, picture in enumerate(found):
        assert picture.shape == (3, *SCENE)
        good = quality(picture, expected[step].clamp(0, 0.9))
        assert good > 20, step
        assert step == 0 or good > quality(picture, expected[step - 1].clamp(0, 0.9)) + 3


def test_folder(psf: Path, tmp_path: Path) -> None:
    """In the order of the numbers in their names, with a record; what is no frame is left alone."""
    frames = tmp_path / "frames"
    frames.mkdir()
    for step, each in enumerate(light(11)):
        save(frames / f"take {step}.npy", each)
    (frames / "notes.txt").write_text("none")
    out = tmp_path / "pictures"
    done = run("reconstruct", frames, "--psf", psf, "-o", out, *QUICK, "--json")
    assert done.code == 0, done.err
    found = pictures(out)
    check_follows([found[f"take {step}"] for step in range(11)])
    summary = json.loads(done.out)
    assert (summary["frames"], summary["dropped"]) == (11, [])
    record = json.loads((tmp_path / "pictures.json").read_text())
    assert record["result"] == summary
    assert [row["frame"] for row in record["history"]] == list(range(1, 12))
    assert all(row["iterations"] == 8 for row in record["history"][1:])
    assert record["parameters"]["names"][:3] == ["take 0", "take 1", "take 2"]
    assert set(record["inputs"]) == {"psf", *(f"frame take {step}.npy" for step in range(11))}


@pytest.mark.parametrize("kind", ["npy", "npy, channels last", "tif"])
def test_stack(kind: str, psf: Path, tmp_path: Path) -> None:
    stack = light(4)
    path = tmp_path / ("raw.tif" if kind == "tif" else "raw.npy")
    if kind == "tif":
        counts = (60_000 * stack / stack.max()).round().movedim(1, -1).numpy()
        tifffile.imwrite(path, counts.astype(np.uint16), photometric="rgb")
    else:
        np.save(path, (stack if kind == "npy" else stack.movedim(1, -1)).numpy())
    asked = ("--psf", psf, "-o", tmp_path / "out", *QUICK)
    done = run("reconstruct", path, *asked)
    assert done.code == 0, done.err
    found = pictures(tmp_path / "out")
    assert list(found) == [f"frame-{number}" for number in range(1, 5)]
    check_follows(list(found.values()))


def test_by_a_trained_prior(psf: Path, tmp_path: Path) -> None:
    """Turns of the network for each frame after the first, which is a photo, whatever limits these
    have; ridge has none, and is refused.
    """
    np.save(tmp_path / "raw.npy", light(4).numpy())
    asked = ("reconstruct", tmp_path / "raw.npy", "--psf", psf, "-o", tmp_path / "out", *QUICK)
    done = run(*asked, "--prior", "denoiser", "--iterations", 3, "--json")
    assert done.code == 0, done.err
    check_follows(list(pictures(tmp_path / "out").values()))
    summary = json.loads(done.out)
    assert summary["prior"] == "denoiser" and len(summary["weights_sha256"]) == 64
    record = json.loads((tmp_path / "out.json").read_text())
    first, *others = (row["iterations"] for row in record["history"])
    assert first > 20 and others == [3, 3, 3]
    before = listing(tmp_path)
    check_refused(run(*asked[:-1], 1e-3, "--prior", "ridge"), "no ridge", "denoiser")
    assert listing(tmp_path) == before


def test_grey_stack_of_many(tmp_path: Path) -> None:
    stack = light(5)[:, 1]
    np.save(tmp_path / "raw.npy", stack.numpy())
    psf = save(tmp_path / "psf.npy", spots()[1:2])
    asked = ("--psf", psf, "-o", tmp_path / "out", *QUICK, "--iterations", 4)
    assert run("reconstruct", tmp_path / "raw.npy", *asked).code == 0
    assert len(list((tmp_path / "out").glob("*.png"))) == 5


def test_bad_frames_are_dropped(psf: Path, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for step, each in enumerate(light(5)):
        save(frames / f"{step}.npy", each)
    save(frames / "1.npy", torch.zeros(3, *SENSOR))
    save(frames / "2.npy", torch.ones(3, 5, 5))
    (frames / "0.npy").write_bytes(b"none")
    for number in range(5, 10):
        (frames / f"{number}.npy").write_bytes(b"none")
    asked = ("--psf", psf, "-o", tmp_path / "out", *QUICK)
    done = run("reconstruct", frames, *asked)
    assert done.code == 0, done.err
    assert "2 frames, 8 dropped" in done.out
    assert done.err.count("is dropped") == 5
    assert f"3 more frames are dropped: {tmp_path / 'out.json'} says why" in done.err
    assert sorted(pictures(tmp_path / "out")) == ["3", "4"]
    record = json.loads((tmp_path / "out.json").read_text())
    assert record["result"]["dropped"] == list("01256789") and len(record["warnings"]) == 8


def test_latency_bounds_a_frame(psf: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "raw.npy", light(3).numpy())
    asked = (
        "--psf",
        psf,
        "-o",
        tmp_path / "out",
        "--tau",
        1,
        "--iterations",
        100_000,
        "--latency",
        "300ms",
    )
    assert run("reconstruct", tmp_path / "raw.npy", *asked).code == 0
    rows = json.loads((tmp_path / "out.json").read_text())["history"]
    assert all(row["iterations"] < 100_000 for row in rows)


REFUSED = {
    "picture": (["-o", "x.png"], ["x.png", "name of a folder"]),
    "two": (["-o", "x", "-o", "y"], ["x y", "name of a folder"]),
    "method": (["-o", "x", "--method", "fista"], ["leave out --method"]),
    "draft": (["-o", "x", "--quality", "draft"], ["--quality draft"]),
    "latency": (["-o", "x", "--latency", "0s"], ["latency", "1 µs to 1000000 s"]),
    "no unit": (["-o", "x", "--latency", "3"], ["latency"]),
    "region": (["-o", "x", "--support", "9000x9000"], ["--support 9000x9000"]),
}


@pytest.mark.parametrize(("asked", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_refused(
    asked: list[str], words: list[str], psf: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    np.save(tmp_path / "raw.npy", light(2).numpy())
    before = listing(tmp_path)
    done = run("reconstruct", "raw.npy", "--psf", psf, *asked)
    check_refused(done, *words)
    assert listing(tmp_path) == before


def test_no_usable_frame(psf: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "raw.npy", np.zeros((40, *SENSOR, 3), np.float32))
    done = run("reconstruct", tmp_path / "raw.npy", "--psf", psf, "-o", tmp_path / "out")
    assert done.code == 2 and not (tmp_path / "out").exists()
    assert done.err.count("is dropped") == 5
    assert "none of the 40 frames" in done.err.splitlines()[-1]
    (tmp_path / "empty").mkdir()
    done = run("reconstruct", tmp_path / "empty", "--psf", psf, "-o", tmp_path / "out")
    check_refused(done, "holds no frame")


def test_latency_is_for_sequences(psf: Path, tmp_path: Path) -> None:
    raw = save(tmp_path / "raw.npy", light(1)[0])
    asked = ("--psf", psf, "-o", tmp_path / "o.png", "--latency", "1s")
    check_refused(run("reconstruct", raw, *asked), "--latency", "one frame")


def test_weight_is_checked_and_follows_what_changes(psf: Path, tmp_path: Path) -> None:
    """Of 26 frames the last has much more noise; the choice is checked then."""
    generator = torch.Generator().manual_seed(5)
    still = measured(spots())
    noise = torch.full((26,), 0.003)
    noise[-1] = 0.1
    frames = torch.stack(
        [
            still + float(each) * still.max() * torch.randn(still.shape, generator=generator)
            for each in noise
        ]
    )
    stack = tmp_path / "frames.npy"
    np.save(stack, frames.movedim(1, -1).numpy())
    asked = ("--psf", psf, "--support", SUPPORT, "--iterations", 4, "-o", tmp_path / "pictures")
    done = run("reconstruct", stack, *asked)
    assert done.code == 0, done.err
    record = json.loads((tmp_path / "pictures.json").read_text())
    (check,) = record["parameters"]["tau_checks"]
    assert check["frame"] == 26
    taus = [row["tau"] for row in record["history"]]
    assert taus[:25] == [pytest.approx(record["parameters"]["tau"])] * 25
    assert taus[25] == check["tau"] > 2 * taus[24]
