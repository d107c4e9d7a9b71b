"""Pictures of scenes in the channels of a sensor."""

import torch
from torch import Tensor

_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear sRGB (IEC 61966-2-1)."""


def in_channels(radiance: Tensor, channels: int) -> Tensor:
    """A linear picture in colour, or its luminance for a sensor of one channel.

    Parameters
    ----------
    radiance
        (3, height, width).
    channels
        Of the sensor.
    """
    if channels != 1:
        return radiance
    return (radiance * torch.tensor(_LUMINANCE)[:, None, None]).sum(dim=0, keepdim=True)
