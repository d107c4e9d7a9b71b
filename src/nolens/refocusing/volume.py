"""Volumes: planes of a scene that are solved together, what tells them apart, and one picture."""

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import Measurement, Sensor
from nolens.refocusing.depth import depth_mm, per_m
from nolens.refocusing.focal_stack import AllInFocus, FocalStack

_CLOSE = 0.5
"""Depths of focus that are between planes at least, for each to show what lies there."""
_NAMED = 3
"""Pairs of planes that a warning names."""
_AROUND = 9
"""Pixels along the square over which the light's mean is taken."""
_DARK = 0.05
"""Light over the brightest, around which a depth begins to be known."""


def spacing_warnings(depths_um: Sequence[float], focus_per_m: float) -> list[str]:
    """About planes that look alike, and about gaps between planes.

    Parameters
    ----------
    depths_um
        From the nearest on; the last may be infinite.
    focus_per_m
        Depth of focus: see `nolens.refocusing.depth_of_focus_per_m`.
    """
    apart = {
        f"{_text(near)} and {_text(far)}": (per_m(near) - per_m(far)) / focus_per_m
        for near, far in pairwise(depths_um)
    }
    unit = f"the depth of focus is {focus_per_m:.3g}/m in 1/z"

    def listed(names: Sequence[str]) -> str:
        more = len(names) - _NAMED
        return ", ".join(names[:_NAMED]) + (f", and {more} more" if more > 0 else "")

    close = [name for name, steps in apart.items() if steps < _CLOSE]
    wide = [f"{name} ({steps:.1f})" for name, steps in apart.items() if steps > 1.5]
    texts = []
    if close:
        texts.append(
            f"planes at {listed(close)} are nearer to one another than a half of the depth of "
            f"focus ({unit}): light of one may show at the other; leave some out"
        )
    if wide:
        texts.append(
            f"the depths have gaps: between {listed(wide)} lie more depths of focus than one, "
            f"in brackets ({unit}); what is in a gap comes out blurred, at the planes beside it"
        )
    return texts


def _text(depth_um: float) -> str:
    return "infinity" if math.isinf(depth_um) else f"{depth_mm(depth_um):g} mm"


def transparent(stack: FocalStack) -> AllInFocus:
    """The light of all planes in one picture, and its mean 1/z at every pixel.

    Parameters
    ----------
    stack
        Planes that were solved together: what each pixel shows adds up.
    """
    light = stack.pages.mean(dim=1)
    total = light.sum(dim=0)
    places = torch.tensor([per_m(each) for each in stack.depths_um], dtype=light.dtype)
    mean = torch.einsum("k,kij->ij", places, light) / total.clamp_min(1e-30)
    nearest = torch.where(total > 0, mean, places[-1])
    lit = total / (total + _DARK * total.max()).clamp_min(1e-30)
    return AllInFocus(
        stack.pages.sum(dim=0), nearest, lit * light.amax(dim=0) / total.clamp_min(1e-30)
    )


def photon_variance(measurement: Measurement, sensor: Sensor | None) -> Tensor:
    r"""Variance of a pixel's noise up to a factor: :math:`g\,\bar b + g^2 r^2` in counts squared.

    Shot noise (Poisson's) of the local mean of the light, and read noise (`janesick2007`). Weights
    of a Gaussian data term, they make it that of Poisson's noise from about ten electrons on.

    Parameters
    ----------
    measurement
        Linear counts.
    sensor
        Counts per electron g and read noise r; None for shot noise alone.
    """
    values = measurement.values
    light = nnf.avg_pool2d(values[None], _AROUND, 1, _AROUND // 2, count_include_pad=False)[0]
    # What is darker than a hundredth of the mean has other noise, too.
    light = light.clamp_min(1e-2 * float(light.mean()))
    return light if sensor is None else sensor.noise_variance(light)
