"""Files of weights: what is written is read, the card has the hash, what is damaged is refused."""

import hashlib
import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import torch

from nolens.errors import FileError
from nolens.files.weights import denoiser, read_weights, ridge, unrolled, write_weights
from nolens.solvers.denoising_network import DenoisingNetwork
from nolens.solvers.plug_and_play import PlugAndPlay, Refinement
from nolens.training.unrolled import refinement_for_others, refinement_network


@pytest.fixture
def written(tmp_path: Path) -> tuple[Path, PlugAndPlay]:
    torch.manual_seed(0)
    network = DenoisingNetwork((8, 12), (1, 2))
    prior = PlugAndPlay(network, (0.2, 0.1), {"prior": "denoiser"})
    write_weights(tmp_path / "mine.npz", prior, {"steps": 3})
    return tmp_path / "mine.npz", prior


def test_weights_come_back_in_half_precision(written: tuple[Path, PlugAndPlay]) -> None:
    path, prior = written
    read = read_weights(path)
    assert (read.spreads, read.refinement) == (prior.spreads, None)
    assert read.facts["prior"] == "denoiser"
    assert (read.network.widths, read.network.blocks) == ((8, 12), (1, 2))
    for name, each in prior.network.state_dict().items():
        assert torch.equal(read.network.state_dict()[name], each.half().float())
    card = json.loads(path.with_suffix(".json").read_text())
    assert card["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert card["sha256"] == read.facts["weights_sha256"] and card["steps"] == 3


def test_a_refinement_goes_with_the_denoiser(tmp_path: Path) -> None:
    turns = denoiser()
    network = refinement_network(DenoisingNetwork((8,), (1,)))
    facts = {"prior": "unrolled", "refines": turns.facts["weights_sha256"]}
    prior = replace(turns, facts=facts, refinement=Refinement(network, share=0.5))
    path = tmp_path / "mine.npz"
    write_weights(path, prior, {})
    read = read_weights(path)
    assert read.network is turns.network and read.spreads == turns.spreads
    assert isinstance(read.refinement, Refinement)
    assert torch.equal(read.refinement.network.head.weight, network.head.weight.half().float())
    assert (read.refinement.share, read.refinement.finest) == (0.5, 1.0)
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    assert read.facts == {**facts, "weights_sha256": sha256, "weights_card": "mine.json"}
    changed(path, refines="0" * 64)
    with pytest.raises(FileError, match="another denoiser"):
        read_weights(path)


def test_same_weights_are_the_same_file(written: tuple[Path, PlugAndPlay]) -> None:
    path, prior = written
    before = path.read_bytes()
    write_weights(path, prior, {})
    assert path.read_bytes() == before


SHIPPED = ("denoiser", "ridge", "unrolled")


@pytest.mark.parametrize("name", SHIPPED)
def test_hash_of_what_comes_with_nolens_is_its_cards(name: str) -> None:
    prior = {"denoiser": denoiser, "ridge": ridge, "unrolled": unrolled}[name]()
    card = json.loads(files("nolens.files.trained").joinpath(f"{name}.json").read_text("utf-8"))
    refines = {"refines": denoiser().facts["weights_sha256"]} if name == "unrolled" else {}
    of_file = {"weights_sha256": card["sha256"], "weights_card": f"{name}.json"}
    assert prior.facts == {"prior": name, **of_file, **refines}
    if isinstance(prior, PlugAndPlay) and isinstance(prior.refinement, Refinement):
        assert prior.refinement == refinement_for_others(prior.refinement.network)


def test_what_comes_with_nolens_is_small() -> None:
    """At most 2.5 MB a file and 5 MB together, in half precision."""
    paths = [Path(str(files("nolens.files.trained").joinpath(f"{name}.npz"))) for name in SHIPPED]
    sizes = [path.stat().st_size for path in paths]
    assert max(sizes) <= 2.5e6 and sum(sizes) <= 5e6
    for path in paths:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files if name != "about"}
        assert arrays and {each.dtype for each in arrays.values()} == {np.dtype(np.float16)}


def test_the_ridge_by_its_path_is_named(tmp_path: Path) -> None:
    path = tmp_path / "copy.npz"
    path.write_bytes(files("nolens.files.trained").joinpath("ridge.npz").read_bytes())
    with pytest.raises(FileError, match=r"is the ridge .* --prior ridge takes it"):
        read_weights(path)


def changed(path: Path, **about: object) -> None:
    """The same file with other facts."""
    with np.load(path) as stored:
        arrays = dict(stored)
    arrays["about"] = np.array(json.dumps({**json.loads(str(arrays["about"])), **about}))
    np.savez(path, allow_pickle=False, **arrays)


@pytest.mark.parametrize(
    "about",
    [
        {"format": "nolens weights 3"},
        {"white": 1},
        {"white": False},  # Of before: told the noise of the fit in each turn.
        {"refines": 3},
        {"share": 0.0},
        {"finest": 1.5},
        {"widths": [8, 13]},
        {"widths": [8]},
        {"widths": [8, 12, 16, 20], "blocks": [1, 1, 1, 1]},
        {"widths": [10**9, 12]},
        {"widths": "8,12"},
        {"blocks": [1, 1]},
        {"blocks": [1, 10**9]},
        {"spreads": []},
        {"spreads": [-1.0]},
    ],
    ids=str,
)
def test_facts_that_fit_no_network_are_refused(
    about: dict[str, object], written: tuple[Path, PlugAndPlay]
) -> None:
    changed(written[0], **about)
    with pytest.raises(FileError, match="nolens train"):
        read_weights(written[0])


def test_damaged_weights_are_refused(written: tuple[Path, PlugAndPlay]) -> None:
    path, _ = written
    whole = path.read_bytes()
    for end in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:end])
        with pytest.raises(FileError, match="holds no weights"):
            read_weights(path)
    path.write_bytes(whole)
    with np.load(path) as stored:
        arrays = dict(stored)
    arrays["head.weight"][:] = np.nan
    np.savez(path, allow_pickle=False, **arrays)
    with pytest.raises(FileError, match=r"head\.weight .* NaN"):
        read_weights(path)
