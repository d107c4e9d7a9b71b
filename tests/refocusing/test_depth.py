"""Depth of focus, width of lines, depths in even steps."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from depth_spots import SIGMA, spots
from nolens.errors import DataError
from nolens.refocusing import (
    depth_of_focus_per_m,
    depth_um,
    even_depths,
    line_pixels,
    lit_pixels,
    per_m,
)


def test_the_papers_camera() -> None:
    """Lines of 14.25 um, 1.277 mm behind the mask, half of 6.287 mm: 3.55 dioptres."""
    found = depth_of_focus_per_m(14.25, 1277, 6287 / 2)
    assert found == pytest.approx(3.55, rel=2e-3)
    # Its objects at 8 and 20 cm are more than two depths of focus apart.
    assert (per_m(80e3) - per_m(200e3)) / found == pytest.approx(2.11, rel=5e-3)


@given(depth=st.floats(1e4, 1e6), line=st.floats(5, 50), lit=st.floats(200, 4000))
def test_edge_moves_by_a_line(depth: float, line: float, lit: float) -> None:
    reduced = 1277.0
    apart = depth_of_focus_per_m(line, reduced, lit)
    nearer = depth_um(per_m(depth) + apart)
    moved = lit * ((1 + reduced / nearer) - (1 + reduced / depth))
    assert moved == pytest.approx(line, rel=1e-6)


@given(near=st.floats(1e4, 9e4), steps=st.integers(2, 40), far=st.floats(1e5, math.inf))
def test_even_steps(near: float, steps: int, far: float) -> None:
    depths = even_depths(near, far, steps)
    assert len(depths) == steps and (depths[0], depths[-1]) == (near, far)
    places = torch.tensor([per_m(each) for each in depths], dtype=torch.float64)
    apart = places.diff()
    assert bool((apart < 0).all())
    assert torch.allclose(apart, apart.mean().expand_as(apart), rtol=1e-6)


def test_there_and_back() -> None:
    assert per_m(math.inf) == 0 and depth_um(0.0) == math.inf
    assert depth_um(per_m(123e3)) == pytest.approx(123e3)


def test_width_of_lines() -> None:
    """A Gaussian spot has a half-width of 2.355 σ, whatever its place."""
    rows, columns = torch.arange(60.0)[:, None], torch.arange(80.0)
    for sigma in (1.0, 1.7, 3.0):
        spot = torch.exp(-((rows - 21.3) ** 2 + (columns - 50.6) ** 2) / (2 * sigma**2))
        # Its mean, which is taken off, makes it a little narrower.
        assert line_pixels(spot[None]) == pytest.approx(2.355 * sigma, rel=0.06)
    assert line_pixels(spots(1e6)) == pytest.approx(2.355 * SIGMA, rel=0.1)


def test_no_lines() -> None:
    with pytest.raises(DataError, match="even"):
        line_pixels(torch.ones(1, 20, 20))
    ramp = torch.linspace(0, 1, 64)[:, None].expand(64, 64)[None]
    with pytest.raises(DataError, match="blurred"):
        line_pixels(ramp)


def test_lit_part() -> None:
    psf = torch.zeros(1, 41, 61)
    psf[0, 12:29, 25:36] = 1.0
    assert lit_pixels(psf, (41, 61)) == pytest.approx(8.5)
    assert lit_pixels(psf, (10, 10)) == 5
    assert lit_pixels(torch.ones(1, 41, 61), (20, 30)) == 15
