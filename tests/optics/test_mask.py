"""Openings as the share of every sample that they leave open, and sampling of reliefs."""

import math

import pytest
import torch

from nolens.optics import Grid, MaskSurface, Opening, Relief


@pytest.mark.parametrize("pitch_um", [1.0, 1.55, 3.1])
@pytest.mark.parametrize("size_um", [(200.0, 200.0), (151.3, 240.7)])
@pytest.mark.parametrize(("shape", "share"), [("rectangle", 1.0), ("ellipse", math.pi / 4)])
def test_open_area(shape, share, size_um, pitch_um):
    """To 5e-4, though its edges cut samples."""
    grid = Grid(260, 261, pitch_um)
    opening = Opening(shape, *size_um)
    open_ = opening.coverage(grid.positions_um(0), grid.positions_um(1), pitch_um)
    assert open_.shape == (260, 261)
    assert float(open_.min()) == 0
    assert float(open_.max()) == 1
    area = float(open_.double().sum()) * pitch_um**2
    assert area == pytest.approx(share * size_um[0] * size_um[1], rel=5e-4)


def test_samples_are_open_inside_and_closed_outside():
    grid = Grid(201, 201, 1.0)
    rows, columns = grid.positions_um(0), grid.positions_um(1)
    open_ = Opening("ellipse", 100.0, 160.0).coverage(rows, columns, 1.0)
    radius = torch.hypot(rows[:, None] / 50, columns / 80)
    assert bool((open_[radius < 0.98] == 1).all())
    assert bool((open_[radius > 1.02] == 0).all())
    assert float(open_[100, 180]) == pytest.approx(0.5, abs=1e-3)
    assert float(open_[150, 100]) == pytest.approx(0.5, abs=1e-3)
    open_ = Opening("rectangle", 100.0, 160.0).coverage(rows, columns, 1.0)
    assert float(open_[150, 100]) == pytest.approx(0.5)
    assert float(open_[149, 179]) == 1
    assert float(open_[151, 100]) == float(open_[100, 181]) == 0


def test_coarsest_pitch_puts_four_samples_to_the_fastest_turn():
    """A slope of 0.05 between 1.47 and air turns 0.047 waves in a µm at 0.5 µm."""
    columns = Grid(9, 9, 2.0).positions_um(1)
    mask = MaskSurface(Relief((0.05 * columns).float().expand(9, 9).contiguous(), 2.0))
    assert mask.coarsest_pitch_um(0.5, 0.47) == pytest.approx(1 / (4 * 0.047), rel=1e-4)
    assert mask.coarsest_pitch_um(0.5, -0.47) == mask.coarsest_pitch_um(0.5, 0.47)
    assert mask.coarsest_pitch_um(0.5, 0.0) == math.inf
    # A wave that diverges by 0.05 turns 0.1 times in a µm more: two samples for each turn.
    assert mask.coarsest_pitch_um(0.5, 0.47, 0.05) == pytest.approx(
        1 / (4 * 0.047 + 2 * 0.1), rel=1e-4
    )
