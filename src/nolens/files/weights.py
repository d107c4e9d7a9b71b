"""Weights of trained priors: .npz of arrays, and a card of facts in JSON beside it."""

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nolens.errors import FileError
from nolens.files.atomic import atomic_write
from nolens.files.state import read_state
from nolens.solvers.denoising_network import DenoisingNetwork
from nolens.solvers.plug_and_play import PlugAndPlay

_FORMAT = "nolens weights 1"
_SPREADS_AT_MOST = 100
_SHIPPED = "nolens.files.trained"


def write_weights(path: Path, prior: PlugAndPlay, card: Mapping[str, Any]) -> None:
    """Write a prior's weights in half precision, and its card beside them as .json.

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
    about = {
        "format": _FORMAT,
        "prior": prior.facts.get("prior", path.stem),
        "spreads": list(prior.spreads),
    }
    arrays = {name: each.half().numpy() for name, each in prior.network.state_dict().items()}
    with atomic_write(path) as temporary:
        np.savez(temporary, allow_pickle=False, about=np.array(json.dumps(about)), **arrays)
    text = json.dumps({"sha256": sha256_of_weights(path), **card}, indent=2, ensure_ascii=False)
    with atomic_write(path.with_suffix(".json")) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def sha256_of_weights(path: Path) -> str:
    """Hash of a file of weights."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_weights(path: Path) -> PlugAndPlay:
    """Read a prior from its weights.

    Raises
    ------
    FileError
        If the file is missing, damaged or holds no weights of this version.
    """
    network = DenoisingNetwork()
    wanted = {name: each.half() for name, each in network.state_dict().items()}
    found: dict[str, Any] = {}

    def check(about: Mapping[str, Any]) -> None:
        spreads = about.get("spreads")
        good = (
            about.get("format") == _FORMAT
            and isinstance(about.get("prior"), str)
            and isinstance(spreads, list)
            and 0 < len(spreads) <= _SPREADS_AT_MOST
            and all(isinstance(each, float) and 0 < each < 1000 for each in spreads)
        )
        if not good:
            raise FileError(
                f"{path} holds no weights of a prior that this version of nolens knows. Accepted "
                "is an .npz that `nolens train` wrote"
            )
        found.update(about)

    arrays = read_state(path, wanted, check)
    _check_arrays(path, arrays, wanted)
    network.load_state_dict({name: each.float() for name, each in arrays.items()})
    return PlugAndPlay(
        network.eval(),
        tuple(found["spreads"]),
        facts={"prior": found["prior"], "weights_sha256": sha256_of_weights(path)},
    )


def _check_arrays(path: Path, arrays: Mapping[str, Tensor], wanted: Mapping[str, Tensor]) -> None:
    for name, like in wanted.items():
        array = arrays.get(name)
        if array is None or array.shape != like.shape or not bool(torch.isfinite(array).all()):
            what = "is missing" if array is None else "has another shape, or holds NaN or infinity"
            raise FileError(
                f"{path}: the array {name} {what}. Accepted is an .npz that `nolens train` wrote"
            )


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
        raise FileError(f"{prior} is no prior. Accepted is an .npz that `nolens train` wrote")
    return prior


@cache
def _shipped(name: str) -> PlugAndPlay:
    with as_file(files(_SHIPPED).joinpath(f"{name}.npz")) as path:
        return read_weights(path)


def denoiser() -> PlugAndPlay:
    """The network for white noise that comes with nolens."""
    return _shipped("denoiser")


def unrolled() -> PlugAndPlay:
    """The network for what the fit of measurements leaves that comes with nolens."""
    return _shipped("unrolled")
