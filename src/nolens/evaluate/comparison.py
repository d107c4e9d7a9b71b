"""A picture against the truth: registration, fit, and figures in linear light and as shown."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from nolens.camera import srgb_from_linear
from nolens.errors import DataError
from nolens.evaluate.picture import affine_fit, psnr, scale_fit, ssim_and_ms_ssim
from nolens.evaluate.registration import (
    Motion,
    Registration,
    largest_window,
    register_picture,
    resampled,
)

Fit = Literal["affine", "scale", "none"]
"""Gain and offset of each channel, one factor for all channels, or the picture as it is."""
Perceptual = Callable[[Tensor, Tensor], float]
"""A distance of two pictures as shown, (3, rows, columns) from 0 to 1."""

_FITS = {"affine": affine_fit, "scale": scale_fit}
_SMALLEST = 16
_CLEAR_TURN = 0.2
_CLEAR_PX, _CLEAR_ERRORS, _CLEAR_GAIN = 0.5, 3.0, 0.95
"""A picture lies beside the truth where it does by so much, and by so many standard errors, and so
much of what keeps the correlation below 1 is left once it is moved."""


@dataclass(frozen=True)
class Comparison:
    """A picture beside the truth.

    Parameters
    ----------
    picture, truth
        (channels, rows, columns), where they overlap: the picture fitted and clipped to 0 to
        white, and the truth on its pixels.
    registration
        Where they lay on each other.
    figures
        PSNR in dB, SSIM and MS-SSIM in linear light; with ``shown_`` before their names of the
        sRGB values that a screen shows; PSNR of each channel in linear light; LPIPS, where it was
        asked for. NaN where the pictures are too small for one.
    """

    picture: Tensor = field(repr=False)
    truth: Tensor = field(repr=False)
    registration: Registration
    figures: dict[str, float]


def compare_pictures(
    picture: Tensor,
    truth: Tensor,
    *,
    register: Motion = "none",
    fit: Fit = "affine",
    white: float = 1.0,
    perceptual: Perceptual | None = None,
) -> Comparison:
    """Lay the truth on the picture's pixels, fit the picture's brightness to it, and measure.

    Parameters
    ----------
    picture, truth
        Linear radiance, (1 or 3, rows, columns); a grey truth is that of every channel.
    register
        What may differ between their places.
    fit
        What of the picture's brightness is free.
    white
        Radiance of the truth that is white: the peak of PSNR and SSIM.
    perceptual
        LPIPS, where its weights are there.

    Raises
    ------
    DataError
        If they do not have the same channels, are not laid on each other, or hardly overlap.
    """
    if 1 not in (len(picture), len(truth)) and len(picture) != len(truth):
        raise DataError(f"it has {len(picture)} channels, and its truth {len(truth)}")
    sizes = tuple(picture.shape[-2:]), tuple(truth.shape[-2:])
    if register == "none" and abs(sizes[0][0] * sizes[1][1] / sizes[0][1] - sizes[1][0]) > 1:
        raise DataError(
            f"it has {sizes[0][0]}×{sizes[0][1]} pixels and its truth {sizes[1][0]}×{sizes[1][1]}: "
            "say which part of the truth it shows (--crop), or let it be found (--register "
            "similarity)"
        )
    found = register_picture(picture, truth, register)
    if register != "none" and not found.found:
        raise DataError(
            f"it cannot be laid on its truth (correlation {found.correlation:.2f}): check that "
            "they show the same, or compare them as they lie (--register none)"
        )
    on_picture, inside = resampled(truth, found)
    rows, columns = largest_window(inside)
    picture, on_picture = picture[:, rows, columns], on_picture[:, rows, columns]
    if min(picture.shape[-2:]) < _SMALLEST:
        raise DataError(f"it and its truth share fewer than {_SMALLEST} rows or columns")
    channels = max(len(picture), len(on_picture))
    picture, on_picture = (each.expand(channels, -1, -1) for each in (picture, on_picture))
    fitted = picture if fit == "none" else _FITS[fit](picture, on_picture)
    fitted = fitted.clamp(0, white)
    figures = _figures(fitted, on_picture, white)
    if channels == 3:
        figures |= {
            f"psnr_{name}_db": psnr(one, other, white)
            for name, one, other in zip("rgb", fitted, on_picture, strict=True)
        }
    shown, expected = (srgb_from_linear(each / white) for each in (fitted, on_picture))
    figures |= {f"shown_{name}": value for name, value in _figures(shown, expected, 1.0).items()}
    if perceptual is not None:
        figures["lpips"] = perceptual(shown.expand(3, -1, -1), expected.expand(3, -1, -1))
    return Comparison(fitted, on_picture, found, figures)


def _figures(picture: Tensor, truth: Tensor, peak: float) -> dict[str, float]:
    """Those of all channels."""
    similar, over_scales = ssim_and_ms_ssim(picture, truth, peak)
    return {"psnr_db": psnr(picture, truth, peak), "ssim": similar, "ms_ssim": over_scales}


def lies_beside(registration: Registration, as_it_is: Registration) -> bool:
    """Whether a picture clearly does not lie where its truth does.

    Parameters
    ----------
    registration
        What was found.
    as_it_is
        With nothing free.
    """
    moved = registration.moved_px(as_it_is)
    error = registration.error_px if math.isfinite(registration.error_px) else math.inf
    better = 1 - registration.correlation < _CLEAR_GAIN * (1 - as_it_is.correlation)
    return better and registration.found and moved > max(_CLEAR_PX, _CLEAR_ERRORS * error)


def turned_over(picture: Tensor, truth: Tensor) -> str | None:
    """Say how the truth is to be turned over, if it correlates clearly better then.

    Returns
    -------
    str or None
        ``vertical``, ``horizontal`` or ``both``.
    """
    turns: dict[str, list[int]] = {
        "none": [], "vertical": [-2], "horizontal": [-1], "both": [-2, -1]
    }  # fmt: skip
    small = [torch.nn.functional.interpolate(each[None], (48, 64), mode="area")[0]
             for each in (picture, truth)]  # fmt: skip
    alike = {
        name: register_picture(small[0], small[1].flip(axes), "shift").correlation
        for name, axes in turns.items()
    }
    best = max(alike, key=alike.__getitem__)
    return best if best != "none" and alike[best] > alike["none"] + _CLEAR_TURN else None
