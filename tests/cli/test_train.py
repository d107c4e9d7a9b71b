"""`nolens train`: weights, card and record; checkpoints; what is refused."""

import hashlib
import importlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from little_camera import BLACK, as_counts, little_twin, save, spots
from PIL import Image
from running import Done, check_refused, listing, run

from nolens.camera import PsfEntry
from nolens.cli.terminal import TerminalReporter
from nolens.files import read_record, write_psfs
from nolens.files.weights import denoiser, read_weights, write_weights
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.quantities import Length
from nolens.solvers.denoising_network import DenoisingNetwork
from nolens.solvers.plug_and_play import PlugAndPlay, Refinement
from nolens.training.pictures import training_picture
from nolens.training.unrolled import refinement_for_others, refinement_network

JOB = importlib.import_module("nolens.jobs.training.job")
QUICK = ("--pictures", 1)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of a network that a step takes milliseconds with."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("tiny") / "tiny.npz"
    network = DenoisingNetwork((8,), (1,))
    write_weights(path, PlugAndPlay(network, (0.1,), facts={"prior": "denoiser"}), {})
    return path


@pytest.fixture(scope="module")
def tiny_refinement(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of one that mends what the denoiser of nolens leaves."""
    path, turns = tmp_path_factory.mktemp("tiny") / "refinement.npz", denoiser()
    refinement = Refinement(refinement_network(DenoisingNetwork((8,), (1,))))
    facts = {"prior": "unrolled", "refines": turns.facts["weights_sha256"]}
    write_weights(path, replace(turns, facts=facts, refinement=refinement), {})
    return path


@pytest.fixture(autouse=True)
def few_and_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measurements, and pictures that are held out."""
    monkeypatch.setattr("nolens.training.measurements._SCENE", (64, 72))
    monkeypatch.setattr("nolens.training.measurements._SENSOR", (72, 90))
    monkeypatch.setattr("nolens.training.validation._NOISY", 2)
    monkeypatch.setattr("nolens.training.validation._MEASURED", 1)
    monkeypatch.setattr("nolens.training.unrolled._LEAST", 1)
    monkeypatch.setattr("nolens.jobs.training.camera.SIMULATED", 1)
    monkeypatch.setattr(JOB, "BATCHES", {"denoiser": (4, 64), "unrolled": (2, 64)})


def stop_at(step: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C after so many steps."""

    def stopped(self: TerminalReporter, what: str, done: int, *_: object) -> bool:
        self.interrupted = done == step
        return self.interrupted

    monkeypatch.setattr(TerminalReporter, "step", stopped)


def train(output: Path, tiny: Path, *arguments: object) -> Done:
    return run("train", "--start", tiny, *QUICK, *arguments, "-o", output)


def folder_with_psfs(folder: Path, size: tuple[int, int], channels: int = 3) -> Path:
    names = ("R", "G", "B") if channels == 3 else ("grey",)
    entry = PsfEntry(
        file="psf.tif", pixel=Length("3", "um"), channels=names, distance=Length("300", "mm")
    )
    folder.mkdir()
    write_psfs(folder, {entry: spots(size)[:channels]})
    return folder


def test_denoiser_and_its_card(tiny: Path, tmp_path: Path) -> None:
    photographs, unseen = tmp_path / "photographs", tmp_path / "unseen"
    for folder in (photographs, unseen):
        folder.mkdir()
        save(folder / "linear.npy", 5 * torch.rand(3, 70, 80))
    Image.fromarray(np.full((70, 90, 3), 99, np.uint8)).save(photographs / "srgb.png")
    mine = tmp_path / "out" / "mine.npz"
    mine.parent.mkdir()
    kinds = ("--photographs", photographs, "--validation", unseen, "--licence", "cc0-1.0")
    asked = ("--prior", "denoiser", "--steps", 3, "--seed", 5, *kinds)
    done = train(mine, tiny, *asked)
    assert done.code == 0, done.err
    assert "denoiser: 3 of 3 steps" in done.out and "; it began with " in done.out
    assert sorted(listing(mine.parent)) == ["mine.json", "mine.npz", "mine.record.json"]
    card = json.loads((mine.parent / "mine.json").read_text())
    assert card["sha256"] == hashlib.sha256(mine.read_bytes()).hexdigest()
    assert (card["prior"], card["seed"], card["steps"]) == ("denoiser", 5, 3)
    assert card["start"]["sha256"] == hashlib.sha256(tiny.read_bytes()).hexdigest()
    assert card["data"][1] == {"photographs": "photographs", "licence": "cc0-1.0"}
    assert card["command"].startswith("nolens train -o ") and "--seed 5" in card["command"]
    assert "evidence" in card["not_for"]
    assert card["camera"] == "none"
    assert set(card["scores_db"]) == {"all", "generated", "photographs"}
    record = read_record(mine.parent / "mine.record.json")
    assert [row["step"] for row in record.history] == [1, 2, 3]
    assert max(row["validation_db"] for row in record.history) == pytest.approx(
        card["scores_db"]["all"], abs=1e-3
    )
    assert set(record.inputs) == {
        "photograph linear.npy",
        "photograph srgb.png",
        "held-out photograph linear.npy",
        "weights to start from",
    }
    prior = read_weights(mine)
    of_file = {"weights_sha256": card["sha256"], "weights_card": "mine.json"}
    assert prior.facts == {"prior": "denoiser", **of_file}
    assert (prior.network.widths, prior.network.blocks) == ((8,), (1,))
    (unseen / "below").mkdir()
    shutil.copy(photographs / "srgb.png", unseen / "below" / "other.png")
    before = listing(tmp_path)
    words = ("below/other.png of --validation is the same picture", "srgb.png of --photographs")
    check_refused(train(mine, tiny, *asked), *words)
    assert listing(tmp_path) == before


def test_weights_at_the_start_are_kept_where_none_are_better(tmp_path: Path) -> None:
    mine = tmp_path / "mine.npz"
    asked = ("train", *QUICK, "--prior", "denoiser", "-o", mine, "--steps", 1, "--rate")
    check_refused(run(*asked, 1), "NaN or infinity by step 1", "smaller --rate than 1")
    assert not listing(tmp_path)
    done = run(*asked, 0.03, "--json")
    assert done.code == 0, done.err
    summary, card = json.loads(done.out), json.loads((tmp_path / "mine.json").read_text())
    assert summary["validation_start_db"] == summary["validation_db"]
    assert summary["validation_before_db"] < summary["validation_db"] - 5
    assert card["scores_start_db"] == card["scores_db"] and card["best_step"] == 0
    (warning,) = summary["warnings"]
    begun = f"{summary['validation_start_db']:.2f} dB of the weights that it began with"
    assert begun in warning and "smaller --rate" in warning
    shipped = denoiser().network.state_dict()
    for name, each in read_weights(mine).network.state_dict().items():
        assert torch.equal(each, shipped[name])


def test_interrupted_and_resumed_is_uninterrupted(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Byte by byte; the checks of the networks too, though the interruption does one more."""
    whole, half = tmp_path / "whole.npz", tmp_path / "half.npz"
    asked = ("--prior", "denoiser", "--steps")
    assert train(whole, tiny, *asked, 20).code == 0
    with monkeypatch.context() as patch:
        stop_at(7, patch)
        done = train(half, tiny, *asked, 20, "--json")
    assert done.code == 130
    assert json.loads(done.out)["stop_reason"] == "interrupted"
    assert json.loads((tmp_path / "half.json").read_text())["steps"] == 7
    read_weights(half)
    state = tmp_path / "half.state.npz"
    kept = shutil.copy(state, tmp_path / "kept.state.npz")
    before = listing(tmp_path)
    done = train(half, tiny, *asked, 20, "--seed", 1, "--resume", state)
    check_refused(done, "another seed", "--resume")
    done = train(half, tiny, *asked, 30, "--resume", state)
    check_refused(done, "another steps")
    assert listing(tmp_path) == before
    assert train(half, tiny, *asked, 20, "--resume", state).code == 0
    assert half.read_bytes() == whole.read_bytes()
    card = json.loads((tmp_path / "half.json").read_text())
    assert card["best_step"] > 0 and card["scores_db"]["all"] > card["scores_start_db"]["all"]
    assert not state.exists()
    histories = [read_record(each.with_suffix(".record.json")).history for each in (whole, half)]
    assert histories[0] == histories[1]
    damaged = tmp_path / "damaged.state.npz"
    damaged.write_bytes(Path(kept).read_bytes()[:-900])
    check_refused(train(half, tiny, *asked, 20, "--resume", damaged), "damaged", "state file")


def test_killed_training_goes_on_from_its_checkpoint(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(self: TerminalReporter, what: str, done: int, *_: object) -> bool:
        if done == 5:
            raise MemoryError
        return False

    whole, half = tmp_path / "whole.npz", tmp_path / "half.npz"
    asked = ("--prior", "denoiser", "--steps", 8)
    assert train(whole, tiny, *asked).code == 0
    with monkeypatch.context() as patch:
        patch.setattr(JOB, "_CHECKPOINT_S", 0.0)
        patch.setattr(TerminalReporter, "step", killed)
        with pytest.raises(MemoryError):
            train(half, tiny, *asked)
    assert not half.exists()
    assert train(half, tiny, *asked, "--resume", tmp_path / "half.state.npz").code == 0
    assert half.read_bytes() == whole.read_bytes()
    assert json.loads((tmp_path / "half.json").read_text())["best_step"] > 0


def test_unrolled_for_a_folder(
    tiny_refinement: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It goes on from a checkpoint with the same measurements by the same camera, without colours;
    reconstruct takes what comes out.
    """
    folder = folder_with_psfs(tmp_path / "camera", (48, 64), 1)
    mine, whole = tmp_path / "mine.npz", tmp_path / "whole.npz"
    asked = ("train", folder, "--start", tiny_refinement, *QUICK, "--steps", 2, "-o")
    assert run(*asked, whole).code == 0
    asked = (*asked, mine)
    with monkeypatch.context() as patch:
        stop_at(1, patch)
        assert run(*asked).code == 130
    done = run(*asked, "--resume", tmp_path / "mine.state.npz")
    assert done.code == 0, done.err
    assert "unrolled: 2 of 2 steps" in done.out
    assert mine.read_bytes() == whole.read_bytes()
    record = read_record(tmp_path / "mine.record.json")
    assert [row["step"] for row in record.history] == [1, 2]
    # The weights at the start may be the best ones here: the history tells of the others.
    assert record.history == read_record(tmp_path / "whole.record.json").history
    assert {"psfs.toml", "PSF psf.tif"} < set(record.inputs)
    assert record.result["spreads"] == list(denoiser().spreads)
    card = json.loads((tmp_path / "mine.json").read_text())
    assert card["camera"] == "camera" and card["widths"] == [8]
    # It begins with one that changes nothing.
    assert card["scores_start_db"] == card["scores_before_db"]
    save(tmp_path / "measured.npy", torch.rand(1, 48, 64))
    files = (tmp_path / "measured.npy", "--psf", folder / "psf.tif", "--support", "24x32")
    done = run("reconstruct", *files, "--prior", mine, "-o", tmp_path / "photo.tif")
    assert done.code == 0, done.err
    record = read_record(tmp_path / "photo.json")
    assert record.result["prior"] == "unrolled"


def test_unrolled_for_a_simulated_camera(tiny_refinement: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.npz"
    asked = ("--start", tiny_refinement, *QUICK, "--steps", 1, "--angle", "10deg")
    done = run("train", little_twin(tmp_path), *asked, "-o", mine)
    assert done.code == 0, done.err
    prior = read_weights(mine)
    assert prior.facts["prior"] == "unrolled"
    # Without the limits of weights for other cameras.
    assert prior.refinement == Refinement(prior.refinement.network)


def test_unrolled_for_random_cameras(
    tiny_refinement: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scenes are measured by a simulated one, here all; what comes first is said beforehand."""
    monkeypatch.setattr("nolens.jobs.training.camera._LARGEST_PSF", 160)
    monkeypatch.setattr("nolens.training.cameras._OF_KNOWN", 1.0)
    mine = tmp_path / "mine.npz"
    asked = ("--start", tiny_refinement, *QUICK, "--steps", 1)
    done = run("train", *asked, "-o", mine)
    assert done.code == 0, done.err
    assert "12 cameras are simulated and 1 scenes are measured" in done.err.replace("\n", " ")
    refinement = read_weights(mine).refinement
    assert refinement == refinement_for_others(refinement.network)
    assert json.loads((tmp_path / "mine.json").read_text())["camera"] == "random cameras"


def test_pairs_of_the_camera(tiny_refinement: Path, tmp_path: Path) -> None:
    """Two real ones to learn from, and one that is held out."""
    size = (96, 120)
    folder, pairs = folder_with_psfs(tmp_path / "camera", size), tmp_path / "pairs"
    for part in ("measured", "pictures"):
        (pairs / part).mkdir(parents=True)
    psf = spots(size)
    for number in range(3):
        picture = training_picture(70, 80, number)
        light = CroppedConvolution(psf, size, PixelRectangle.centred(70, 80, size))(picture)
        counts = as_counts(light.clamp_min(0), number, 1.0) - BLACK
        save(pairs / "measured" / f"{number}.npy", counts)
        save(pairs / "pictures" / f"{number}.npy", picture)
    mine = tmp_path / "mine.npz"
    asked = ("--start", tiny_refinement, *QUICK, "--steps", 2)
    done = run("train", folder, "--pairs", pairs, *asked, "-o", mine)
    assert done.code == 0, done.err
    record = read_record(tmp_path / "mine.record.json")
    assert set(record.result["scores_db"]) == {"all", "generated", "pairs"}
    assert sum(role.startswith("measurement ") for role in record.inputs) == 3
    card = json.loads((tmp_path / "mine.json").read_text())
    assert card["data"][1]["pairs"] == "pairs"
    before = listing(tmp_path)
    done = run("train", "small", "--pairs", pairs, *asked, "-o", tmp_path / "other.npz")
    check_refused(done, "--pairs needs the PSF", "psfs.toml")
    save(pairs / "pictures" / "0.npy", torch.rand(3, 30, 40))
    done = run("train", folder, "--pairs", pairs, *asked, "-o", tmp_path / "other.npz")
    check_refused(done, "the pair 0:", "30×40", "64×64")
    assert listing(tmp_path).keys() == before.keys()


def test_what_cannot_be_trained_is_refused(
    tiny: Path, tiny_refinement: Path, tmp_path: Path
) -> None:
    empty, small = tmp_path / "empty", tmp_path / "small"
    empty.mkdir()
    small.mkdir()
    Image.new("RGB", (90, 20)).save(small / "thin.png")
    damaged, odd = tmp_path / "damaged.npz", tmp_path / "odd.npz"
    damaged.write_bytes(tiny.read_bytes()[:-500])
    np.savez(odd, about=np.array(json.dumps({"format": "another"})))
    psfs = folder_with_psfs(tmp_path / "camera", (20, 30))
    out = tmp_path / "mine.npz"
    before = listing(tmp_path)

    def refused(*arguments: object, words: tuple[str, ...], output: Path = out) -> None:
        started = (*QUICK, "--start", tiny_refinement, *arguments)
        check_refused(run("train", *started, "-o", output), *words)

    refused(psfs, words=("20×30", "at least 32×32"))
    refused(empty, words=("no PSF to train with", "psfs.toml", "camera.toml"))
    refused("papr", words=("there is no camera", "Did you mean"))
    refused("paper", "--prior", "denoiser", words=("white noise", "leave CAMERA out"))
    refused("--angle", "20deg", words=("--angle", "give the camera"))
    refused("--steps", 0, words=("--steps", "1 to 1000000"))
    refused("--photographs", empty, words=("holds no picture",))
    refused("--photographs", small, words=("thin.png", "64×64", "leave it out"))
    refused("--validation", tiny, words=("is no folder",))
    refused("--resume", tiny, words=("is no checkpoint of a training", ".state.npz"))
    refused(words=("suffix .pt", ".npz"), output=tmp_path / "mine.pt")
    refused(words=("would overwrite",), output=tiny_refinement)
    refused("--prior", "denoiser", words=("holds weights of --prior unrolled", "leave --start out"))
    done = run("train", *QUICK, "--start", tiny, "-o", out)
    check_refused(done, "holds weights of --prior denoiser", "no other")
    for start, word in ((damaged, "holds no weights"), (odd, "holds no weights")):
        check_refused(run("train", *QUICK, "--start", start, "-o", out), word, "nolens train")
    check_refused(run("train", "--start", "small.pt", "-o", out), "--start", "an .npz of weights")
    check_refused(run("train"), "-o mine.npz")
    assert listing(tmp_path) == before
