"""Where the light of a point is centred."""

import torch
from torch import Tensor


def centroid(psf: Tensor, dark: Tensor) -> tuple[float, float]:
    """Centre of the light outside the dark area, (row, column) in cells from the middle.

    Parameters
    ----------
    psf
        (channels, rows, columns), without stray light.
    dark
        Bool, (rows, columns): cells that have no light of the point.
    """
    light = psf.double().clamp_min(0).sum(dim=0) * ~dark
    light = light / light.sum()
    places = [torch.arange(n, dtype=torch.float64) - (n - 1) / 2 for n in light.shape]
    return float(light.sum(dim=1) @ places[0]), float(light.sum(dim=0) @ places[1])
