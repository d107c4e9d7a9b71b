"""Masks whose PSF is brought to wanted figures by following its gradient."""

import math
from collections.abc import Callable

import numpy as np
from torch import Tensor

from nolens.design.masks.descent import descend
from nolens.design.masks.goals import PsfGoals, Shortfall
from nolens.design.masks.limits import Limits
from nolens.design.masks.tile import Tile
from nolens.optics import squared_distance


def lenslet_start(tile: Tile, radius_um: float, pitch_um: float, seed: int) -> Tensor:
    """Lenslets in random places on a tile, (side, side), that gather the light.

    The places are not spread evenly (`relaxed_points`): the PSF of evenly spread ones has
    hardly any contrast at frequencies below that of the lenslets, and loses large shapes.

    Parameters
    ----------
    tile
        Piece of the mask.
    radius_um
        Radius of curvature.
    pitch_um
        Distance of neighbours in a hexagonal arrangement that is as dense.
    seed
        Of their places.
    """
    side_um = tile.side * tile.grid_um
    count = max(1, round(side_um**2 * 2 / (math.sqrt(3) * pitch_um**2)))
    points = np.random.default_rng(seed).uniform(size=(count, 2)) * side_um
    squared = squared_distance(points, (tile.side, tile.side), tile.grid_um)
    return squared * (-tile.bulge / (2 * radius_um))


def optimised_relief(
    tile: Tile,
    goals: PsfGoals,
    limits: Limits,
    start_um: Tensor,
    *,
    iterations: int,
    stop: Callable[[int], bool] | None = None,
) -> Tensor:
    """Relief whose PSF comes as near to its goals as the limits allow (`Shortfall`, `descend`).

    Parameters
    ----------
    tile
        Piece of the mask, with the light that counts.
    goals
        Wanted figures.
    limits
        Of the process.
    start_um
        Surface to begin with, such as `lenslet_start`.
    iterations
        Of the descent.
    stop
        See `descend`.

    Returns
    -------
    Tensor
        Heights in um from 0 on, (side, side).
    """
    cells = tile.side // tile.samples_per_cell
    shortfall = Shortfall(goals, cells, tile.cell_um, start_um.device)
    return descend(tile, start_um, limits, shortfall, iterations=iterations, stop=stop)
