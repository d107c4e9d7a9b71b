"""State files: where an interrupted run stands, as npz."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nolens.errors import FileError
from nolens.files.atomic import atomic_write
from nolens.files.check_input import check_exists

_ABOUT = "about"
_ACCEPTED = "Accepted is a state file that an interrupted run wrote (.npz)"


def write_state(path: str | Path, arrays: Mapping[str, Tensor], about: Mapping[str, Any]) -> None:
    """Write tensors, and as JSON what run they belong to.

    Parameters
    ----------
    path
        The file to write, .npz.
    arrays
        By name.
    about
        What a run must have in common with this one to go on from here.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    held = {name: tensor.detach().cpu().numpy() for name, tensor in arrays.items()}
    with atomic_write(path) as temporary:
        np.savez(temporary, allow_pickle=False, **{_ABOUT: np.array(json.dumps(about)), **held})


def read_state(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `write_state` wrote.

    Raises
    ------
    FileError
        If the file is missing, damaged or something else.
    """
    path = Path(path)
    check_exists(path, _ACCEPTED)
    try:
        with np.load(path, allow_pickle=False) as stored:
            about = json.loads(str(stored[_ABOUT]))
            arrays = {name: torch.from_numpy(stored[name]) for name in stored if name != _ABOUT}
    # A damaged archive can raise nearly anything.
    except Exception as error:
        raise FileError(f"{path} is no state file ({error}). {_ACCEPTED}") from error
    return arrays, about
