"""The pattern that designs are differentiated through, against the twin's."""

import pytest
import torch
from mask_bench import GREEN_NM, by_the_twin, small, tile_of, waves

from nolens.design.masks import Tile, View
from nolens.twin import Twin

SIDE = 128


@pytest.fixture(scope="module")
def twin() -> Twin:
    return small()


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.1, -0.3), (-0.5, 0.2)])
def test_pattern_is_the_twins(tangent, twin):
    """To 0.2 %: the twin's windows fade beyond their margin, the tile goes on for ever."""
    heights = waves(SIDE, 1.0, seed=0)
    tile = Tile(twin, SIDE, 1.55, (View(GREEN_NM, 1.0, tangent),))
    own = tile.psf(heights, 0)
    wanted = by_the_twin(twin, heights, 1.55, tangent)
    assert float((own - wanted).norm() / wanted.norm()) < 2e-3


def test_light_is_kept(twin):
    tile = tile_of(twin, SIDE)[1]
    assert float(tile.psf(waves(SIDE, 1.5, seed=1), 0).mean()) == pytest.approx(1.0, abs=1e-5)


def test_cells_are_means_of_samples(twin):
    heights = waves(SIDE, 1.0, seed=2)
    fine = Tile(twin, SIDE, 1.55, (View(GREEN_NM, 1.0),)).psf(heights, 0)
    cells = tile_of(twin, SIDE)[1].psf(heights, 0)
    wanted = (fine[::2, ::2] + fine[1::2, ::2] + fine[::2, 1::2] + fine[1::2, 1::2]) / 4
    torch.testing.assert_close(cells, wanted)


def test_gradient_is_that_of_the_twin(twin):
    """Along a random direction, against a central difference of the twin's own patterns."""
    heights, direction = waves(SIDE, 1.0, seed=3), waves(SIDE, 1.0, seed=4)
    weight = waves(SIDE, 1.0, seed=5, deviation=3.0)
    tile = Tile(twin, SIDE, 1.55, (View(GREEN_NM, 1.0),))
    leaf = heights.clone().requires_grad_(True)
    (tile.psf(leaf, 0) * weight).sum().backward()
    assert leaf.grad is not None
    slope = float((leaf.grad * direction).double().sum())
    step = 0.01
    ends = [
        float((by_the_twin(twin, heights + sign * step * direction, 1.55, (0, 0)) * weight).sum())
        for sign in (1, -1)
    ]
    assert slope == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=0.01)


def test_a_bulge_gathers(twin):
    """A cap of the radius that focuses is brighter in its middle than the surface around."""
    tile = tile_of(twin, SIDE)[1]
    place = (torch.arange(SIDE) - SIDE / 2) * 1.55
    squared = place.square()[:, None] + place.square()
    cap = tile.bulge * (-squared / (2 * 600.0)).clamp_min(-3.0)
    assert float(tile.psf(cap, 0).max()) > 20
    assert float(tile.psf(-cap, 0)[SIDE // 4, SIDE // 4]) < 0.5


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
def test_cuda_gives_the_same_pattern_and_gradient(twin):
    heights = waves(SIDE, 1.0, seed=7)
    weight = waves(SIDE, 1.0, seed=8)
    found = []
    for device in ("cpu", "cuda"):
        tile = Tile(twin, SIDE, 1.55, (View(GREEN_NM, 1.0),), device=device)
        leaf = heights.to(device).requires_grad_(True)
        pattern = tile.psf(leaf, 0)
        gradient = torch.autograd.grad((pattern * weight.to(device)).sum(), leaf)[0]
        found.append((pattern.detach().cpu(), gradient.cpu()))
    for one, other in zip(*found, strict=True):
        assert float((one - other).norm() / one.norm()) < 1e-4
