"""Where a job computes."""

from typing import Literal

import torch

from nolens.errors import OptionError

DeviceName = Literal["auto", "cpu", "cuda"]


def pick_device(name: DeviceName) -> torch.device:
    """Find the device of a name; auto takes CUDA where there is one.

    Raises
    ------
    OptionError
        If CUDA is asked for and there is none.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise OptionError(
            "--device cuda was asked for, but torch finds no CUDA device here; use "
            "--device cpu or auto, or install a CUDA build of torch"
        )
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)
