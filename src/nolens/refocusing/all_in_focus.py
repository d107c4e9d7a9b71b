"""One picture that is sharp at every depth, and how far away each place of it is."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.refocusing.depth_of_focus import per_m
from nolens.refocusing.solving import sharpness, smoothed
from nolens.refocusing.stack import Stack

_SCALES = (1.0, 2.0, 4.0)
"""Windows, one beside the other: where the smallest sees nothing, a wider one does."""
_SURE = 0.5


@dataclass(frozen=True)
class AllInFocus:
    """What a focal stack shows of a scene with depth.

    Parameters
    ----------
    picture
        Radiance, (channels, rows, columns).
    per_m
        1/z of every pixel, in 1/m, (rows, columns).
    confidence
        How far the sharpest depth stands out there, from 0 (not at all) to 1.
    """

    picture: Tensor
    per_m: Tensor
    confidence: Tensor


def all_in_focus(stack: Stack, width: float) -> AllInFocus:
    r"""Find the sharpest depth of every pixel, and take each pixel from there.

    The sharpness is the energy of the gradient (`pertuz2013`) over the page's objective, in
    Gaussian windows of σ, 2σ and 4σ, each divided by its mean over the picture and added up: a wide
    window decides only where a narrow one sees nothing. The peak over the depths is refined by a
    parabola. The map is the mean of its surroundings, weighted by the confidence; the picture
    blends the two depths next to it.

    Parameters
    ----------
    stack
        Of two depths or more, in equal steps of 1/z.
    width
        σ of the smallest window, in pixels.
    """
    sharp = torch.stack(
        [
            _sharpness(page, width) / max(objective, 1e-30)
            for page, objective in zip(stack.pages, stack.objectives, strict=True)
        ]
    )
    typical = sharp.mean(dim=(0, 2, 3), keepdim=True).clamp_min(1e-30)
    focus = (sharp / typical).mean(dim=1)
    best = focus.argmax(dim=0)
    peak = _between(focus, best)
    top, floor = focus.amax(dim=0), focus.median(dim=0).values
    stands_out = (top - floor) / top.clamp_min(1e-30)
    lit = top / (top + _SURE * top.median()).clamp_min(1e-30)
    confidence = (stands_out * lit).clamp(0, 1)
    weight = confidence.square() + 1e-6
    place = smoothed(peak * weight, width) / smoothed(weight, width)
    return AllInFocus(_blended(stack.pages, place), _vergence(stack, place), confidence)


def _sharpness(page: Tensor, width: float) -> Tensor:
    """Energy of the gradient in windows of all sizes, (sizes, rows, columns)."""
    narrow = sharpness(page, width * _SCALES[0])
    wider = [smoothed(narrow, width * (scale**2 - _SCALES[0] ** 2) ** 0.5) for scale in _SCALES[1:]]
    return torch.stack([narrow, *wider])


def _between(focus: Tensor, best: Tensor) -> Tensor:
    """Number of the sharpest depth, with the part between two by a parabola."""
    last = len(focus) - 1
    inner = best.clamp(1, max(1, last - 1))
    if last < 2:
        return best.to(focus.dtype)
    before, top, after = (focus.gather(0, (inner + step)[None])[0] for step in (-1, 0, 1))
    curve = before - 2 * top + after
    offset = torch.where(curve < 0, (before - after) / (2 * curve).clamp_max(-1e-30), 0.0)
    return torch.where(best == inner, inner + offset.clamp(-0.5, 0.5), best.to(focus.dtype))


def _vergence(stack: Stack, place: Tensor) -> Tensor:
    """1/z between the depths."""
    known = torch.tensor([per_m(depth) for depth in stack.depths_um], dtype=place.dtype)
    lower = place.floor().long().clamp(0, len(known) - 1)
    upper = (lower + 1).clamp_max(len(known) - 1)
    share = place - lower
    return (1 - share) * known[lower] + share * known[upper]


def _blended(pages: Tensor, place: Tensor) -> Tensor:
    """Every cell from the two depths next to its own."""
    picture = torch.zeros_like(pages[0])
    for number, page in enumerate(pages):
        picture += page * (1 - (place - number).abs()).clamp_min(0)
    return picture
