"""LPIPS, where the package and its weights are on this machine already; nothing is downloaded."""

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from nolens.evaluate.comparison import Perceptual

_WEIGHTS = "alexnet-owt-7be5be79.pth"


def perceptual_distance() -> "Perceptual | str":
    """LPIPS with AlexNet's features (`zhang2018`), or why there is none.

    It needs torchmetrics and torchvision, and AlexNet's weights where torch keeps what it has
    downloaded (``torch.hub``); they are 233 MB and under a licence of their own.
    """
    for name in ("torchmetrics", "torchvision"):
        if importlib.util.find_spec(name) is None:
            return f"{name} is not installed"
    weights = Path(torch.hub.get_dir()) / "checkpoints" / _WEIGHTS
    if not weights.is_file():
        return f"its weights are not here ({weights})"
    try:
        from torchmetrics.image.lpip import LearnedPerceptualImagePatchSimilarity

        network = LearnedPerceptualImagePatchSimilarity(net_type="alex", normalize=True)
    except (ImportError, RuntimeError, OSError) as error:  # Versions that do not fit together.
        return f"torchvision and torch do not fit together ({error})"

    def distance(one: Tensor, other: Tensor) -> float:
        with torch.no_grad():
            value = float(network(one[None].float(), other[None].float()))
        network.reset()
        return value

    return distance
