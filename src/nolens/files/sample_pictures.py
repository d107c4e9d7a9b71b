"""The photographs that demonstrations use as scenes: they come with scikit-image."""

import importlib
from types import ModuleType

import torch
from torch import Tensor

from nolens.camera import linear_from_srgb
from nolens.errors import OptionError


def check_sample_pictures(what: str) -> None:
    """Refuse to begin where scikit-image is not installed.

    Parameters
    ----------
    what
        That needs them, as the beginning of a sentence in the singular or plural.

    Raises
    ------
    OptionError
        If it is not.
    """
    _data(what)


def sample_picture(name: str, what: str) -> Tensor:
    """One of scikit-image's photographs in linear light.

    Parameters
    ----------
    name
        Of the function of `skimage.data`.
    what
        See `check_sample_pictures`.

    Returns
    -------
    Tensor
        float32, (3, height, width); 1 is white.

    Raises
    ------
    OptionError
        If scikit-image is not installed.
    """
    pixels = torch.from_numpy(getattr(_data(what), name)())
    if pixels.ndim == 2:
        pixels = pixels[..., None].expand(-1, -1, 3)
    return linear_from_srgb(pixels.permute(2, 0, 1).float() / 255)


def _data(what: str) -> ModuleType:
    try:
        return importlib.import_module("skimage.data")
    except ImportError:
        raise OptionError(
            f"{what} with scikit-image, which is not installed; pip install 'nolens[demo]'"
        ) from None
