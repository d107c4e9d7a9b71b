"""Weights of trained priors: .npz of arrays, and a card of facts in JSON beside it."""

import hashlib
import io
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from filecmp import cmp
from functools import cache, partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nolens.errors import FileError
from nolens.files.atomic import Writer, write_text, write_together
from nolens.files.input import check_exists
from nolens.files.state import read_about, read_state
from nolens.solvers.denoising_network import BLOCKS, WIDTHS, DenoisingNetwork
from nolens.solvers.plug_and_play import REFINED_PICTURES, PlugAndPlay, Refinement
from nolens.solvers.ridge import RidgePrior, RidgeWeights

_FORMAT = "nolens weights 2"
_SPREADS_AT_MOST, _WIDE = 100, 1000
_SHIPPED = "nolens.files.trained"
_ACCEPTED = "Accepted is an .npz that `nolens train` wrote"
_SIZE = {"widths": WIDTHS, "blocks": BLOCKS}
"""What says how large a network is, and of which size one is that does not say it."""
_WIDEST, _MOST_BLOCKS = 256, 16
_LIMITS = "share", "finest"
"""Of a `Refinement`, 0 to 1; one that does not say them has none."""


def write_weights(path: Path, prior: PlugAndPlay, card: Mapping[str, Any]) -> None:
    """Write a prior's weights in half precision, and its card beside them as .json.

    Of one with a `Refinement` that is its network; its turns are by the denoiser of nolens.

    Parameters
    ----------
    path
        Of the .npz.
    prior
        What is written.
    card
        Data, licences, seed, command and scores; the hash of the weights is added.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    write_together(weights_writers(path, prior, card))


def weights_writers(path: Path, prior: PlugAndPlay, card: Mapping[str, Any]) -> dict[Path, Writer]:
    """What writes a prior's weights and its card, as `write_weights` does."""
    refinement = prior.refinement
    network = refinement.network if isinstance(refinement, Refinement) else prior.network
    about = {
        "format": _FORMAT,
        "prior": prior.facts.get("prior", path.stem),
        "spreads": list(prior.spreads),
        "white": True,
        "widths": list(network.widths),
        "blocks": list(network.blocks),
    }
    if isinstance(refinement, Refinement):
        about["refines"] = prior.facts["refines"]
        about |= {name: getattr(refinement, name) for name in _LIMITS}
    arrays = {name: each.half().cpu().numpy() for name, each in network.state_dict().items()}
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, about=np.array(json.dumps(about)), **arrays)
    data = content.getvalue()
    facts = {"sha256": hashlib.sha256(data).hexdigest(), "prior": about["prior"], **card}
    text = json.dumps(facts, indent=2, ensure_ascii=False) + "\n"
    return {
        path: partial(Path.write_bytes, data=data),
        card_beside(path): partial(write_text, text=text),
    }


def card_beside(path: Path) -> Path:
    """File of the card that belongs to weights."""
    return path.with_suffix(".json")


def sha256_of_weights(path: Path) -> str:
    """Hash of a file of weights."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _facts(prior: str, path: Path) -> dict[str, str]:
    """What a record says of weights: the prior, their hash, and the card beside them."""
    card = card_beside(path)
    named = {"weights_card": card.name} if card.is_file() else {}
    return {"prior": prior, "weights_sha256": sha256_of_weights(path), **named}


def read_weights(path: Path) -> PlugAndPlay:
    """Read a prior from its weights.

    Raises
    ------
    FileError
        If the file is missing, damaged or holds no weights of this version.
    """
    check_exists(path, _ACCEPTED)
    try:
        about = read_about(path)
        _check_about(about)
        widths, blocks = (tuple(about.get(name, full)) for name, full in _SIZE.items())
        refines = about.get("refines")
        pictures = 1 if refines is None else REFINED_PICTURES
        network = DenoisingNetwork(widths, blocks, pictures)
        wanted = {name: each.half() for name, each in network.state_dict().items()}
        arrays = read_state(path, wanted, _check_about)
    except FileError:
        if _is_ridge(path):
            raise FileError(
                f"{path} is the ridge regulariser that comes with nolens, which has no network: "
                f"--prior ridge takes it. {_ACCEPTED}"
            ) from None
        raise FileError(
            f"{path} holds no weights of a prior that this version of nolens knows. {_ACCEPTED}"
        ) from None
    _check_arrays(path, arrays, wanted)
    network.load_state_dict({name: each.float() for name, each in arrays.items()})
    facts = _facts(about["prior"], path)
    if refines is None:
        return PlugAndPlay(network.eval(), tuple(about["spreads"]), facts)
    turns = denoiser()
    if turns.facts["weights_sha256"] != refines:
        raise FileError(
            f"{path} mends what another denoiser leaves than the one that comes with this version "
            "of nolens: train it again (nolens train)"
        )
    facts["refines"] = refines
    limits = {name: about[name] for name in _LIMITS if name in about}
    return replace(turns, facts=facts, refinement=Refinement(network.eval(), **limits))


def _is_ridge(path: Path) -> bool:
    """Whether a file is that of the ridge regulariser that comes with nolens."""
    with suppress(OSError), as_file(files(_SHIPPED).joinpath("ridge.npz")) as shipped:
        return cmp(path, shipped, shallow=False)
    return False


def _check_about(about: Mapping[str, Any]) -> None:
    """Refuse what describes no network that this version could make."""
    spreads = about.get("spreads")
    sizes = [about.get(name, list(full)) for name, full in _SIZE.items()]
    good = (
        about.get("format") == _FORMAT
        and isinstance(about.get("prior"), str)
        and isinstance(spreads, list)
        # Networks of before that were tuned through the turns are false.
        and about.get("white") is True
        and isinstance(about.get("refines", ""), str)
        and all(_is_fraction(about.get(name, 1.0)) for name in _LIMITS)
        and 0 < len(spreads) <= _SPREADS_AT_MOST
        and all(isinstance(each, float) and 0 < each < _WIDE for each in spreads)
        and all(isinstance(each, list) and 0 < len(each) <= len(WIDTHS) for each in sizes)
        and len(sizes[0]) == len(sizes[1])
        and all(isinstance(each, int) and 0 < each <= _WIDEST for each in sizes[0])
        and all(isinstance(each, int) and 0 < each <= _MOST_BLOCKS for each in sizes[1])
    )
    if not good:
        raise FileError("these are no weights")


def _is_fraction(value: object) -> bool:
    return isinstance(value, float) and 0 < value <= 1


def _check_arrays(path: Path, arrays: Mapping[str, Tensor], wanted: Mapping[str, Tensor]) -> None:
    for name, like in wanted.items():
        array = arrays.get(name)
        if array is None or array.shape != like.shape or not bool(torch.isfinite(array).all()):
            what = "is missing" if array is None else "has another shape, or holds NaN or infinity"
            raise FileError(f"{path}: the array {name} {what}. {_ACCEPTED}")


def trained_prior(prior: Any) -> Any:
    """A prior whose weights are in a file, where that is named; any other as it is.

    Raises
    ------
    FileError
        If the file holds no weights.
    """
    if isinstance(prior, (str, Path)) and Path(prior).suffix.lower() == ".npz":
        return read_weights(Path(prior))
    if isinstance(prior, Path):
        raise FileError(f"{prior} is no prior. {_ACCEPTED}")
    return prior


@cache
def _shipped(name: str) -> PlugAndPlay:
    with as_file(files(_SHIPPED).joinpath(f"{name}.npz")) as path:
        return read_weights(path)


def denoiser() -> PlugAndPlay:
    """The network for white noise that comes with nolens."""
    return _shipped("denoiser")


def unrolled() -> PlugAndPlay:
    """The denoiser's turns, and the network that mends what they leave, which come with nolens."""
    return _shipped("unrolled")


@cache
def ridge() -> RidgePrior:
    """The ridge regulariser that comes with nolens."""
    with as_file(files(_SHIPPED).joinpath("ridge.npz")) as path:
        with np.load(path, allow_pickle=False) as stored:
            weights = RidgeWeights.from_arrays({name: stored[name] for name in stored.files})
        facts = _facts("ridge", path)
        return RidgePrior(weights, facts=facts)
