"""Random lenslets: as dense, as curved and as smooth as they were ordered; and interpolation."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from optical_bench import places_um
from scipy.spatial import cKDTree
from torch import Tensor

from nolens.optics import Grid, Relief, random_lenslets

RADIUS_UM, PITCH_UM = 670.0, 70.0


def _lenslets(
    smoothing_um: float = 5.0,
    size_um: tuple[float, float] = (1400.0, 1900.0),
    grid_um: float = 1.55,
    seed: int = 1,
) -> Relief:
    return random_lenslets(
        radius_um=RADIUS_UM,
        pitch_um=PITCH_UM,
        smoothing_um=smoothing_um,
        size_um=size_um,
        grid_um=grid_um,
        seed=seed,
    )


@pytest.fixture(scope="module")
def smooth() -> Relief:
    return _lenslets()


def _tops(relief: Relief) -> tuple[Tensor, Tensor]:
    """Rows and columns of the local maxima, on the torus."""
    height = relief.height_um
    highest = torch.ones_like(height, dtype=torch.bool)
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            if row or column:
                highest &= height > height.roll((row, column), (0, 1))
    rows, columns = highest.nonzero(as_tuple=True)
    return rows, columns


def _torus_um(relief: Relief) -> list[float]:
    return [count * relief.grid_um for count in relief.height_um.shape]


def test_same_seed_same_surface():
    first, again, other = (_lenslets(size_um=(300, 400), seed=seed) for seed in (5, 5, 6))
    assert torch.equal(first.height_um, again.height_um)
    assert not torch.equal(first.height_um, other.height_um)


def test_surface_covers_what_was_ordered(smooth):
    assert smooth.extent_um[0] >= 1400
    assert smooth.extent_um[1] >= 1900
    assert smooth.extent_um == pytest.approx((1400, 1900), rel=0.05)
    assert smooth.height_um.dtype == torch.float32


def test_density_is_that_of_a_hexagonal_arrangement(smooth):
    size = _torus_um(smooth)
    expected = 2 / (math.sqrt(3) * PITCH_UM**2) * size[0] * size[1]
    assert len(_tops(smooth)[0]) == pytest.approx(expected, rel=0.02)


def test_lenslets_are_spread_evenly(smooth):
    """Random points would have a mean nearest distance of 0.47 pitch; relaxed ones near 0.9."""
    places = torch.stack(_tops(smooth), dim=1).double().numpy() * smooth.grid_um
    distance = cKDTree(places, boxsize=_torus_um(smooth)).query(places, k=2)[0][:, 1]
    assert distance.mean() / PITCH_UM == pytest.approx(0.87, abs=0.02)
    assert distance.min() > 0.45 * PITCH_UM


def test_tops_are_curved_as_ordered(smooth):
    """A Gaussian leaves a parabola's curvature, −1/R along both axes, and lowers it by σ²/R."""
    rows, columns = _tops(smooth)
    height = smooth.height_um.double()
    for axis in (0, 1):
        bend = height.roll(-2, axis) + height.roll(2, axis) - 2 * height
        curvature = bend[rows, columns] / (2 * smooth.grid_um) ** 2 * -RADIUS_UM
        assert float(curvature.min()) > 0.99
        assert float(curvature.max()) < 1.001
    top = height[rows, columns].median()
    # A sample lies up to half a step beside the top, which lowers it by 0.001 at most.
    assert float(top) == pytest.approx(-(5.0**2) / RADIUS_UM, abs=1e-3)


def test_unsmoothed_cells_are_caps():
    """h = −d²/2R: 0 at the tops, to half a sample, and nowhere above; −1/R everywhere inside."""
    relief = _lenslets(smoothing_um=0.0, size_um=(500, 500))
    height = relief.height_um.double()
    assert float(height.max()) < 1e-6
    rows, columns = _tops(relief)
    within = 2 * (relief.grid_um / 2) ** 2 / (2 * RADIUS_UM)
    assert float(height[rows, columns].min()) > -within - 1e-6
    # The deepest place of a hexagon of this pitch lies pitch / √3 away from three points.
    assert float(height.min()) > -((1.4 * PITCH_UM / math.sqrt(3)) ** 2) / (2 * RADIUS_UM)
    bend = height.roll(-1, 1) + height.roll(1, 1) - 2 * height
    curvature = bend / relief.grid_um**2 * -RADIUS_UM
    assert float(curvature.median()) == pytest.approx(1, abs=0.01)


def test_smoothing_is_a_gaussian_of_the_ordered_width():
    """The spectra of a rough and a smoothed surface differ by the Gaussian's."""
    rough, smoothed = (_lenslets(each, (500, 500)).height_um.double() for each in (0.0, 8.0))
    ratio = (torch.fft.fft2(smoothed) / torch.fft.fft2(rough)).real
    rows, columns = (torch.fft.fftfreq(n, 1.55, dtype=torch.float64) for n in rough.shape)
    squared = rows[:, None].square() + columns.square()
    expected = torch.exp(-2 * math.pi**2 * 8.0**2 * squared)
    low = squared < 0.02**2
    torch.testing.assert_close(ratio[low], expected[low], rtol=0, atol=1e-3)


def test_same_lenslets_on_a_finer_grid():
    """Where the torus is the same, the places do not depend on the grid."""
    coarse = random_lenslets(
        radius_um=670, pitch_um=70, smoothing_um=11, size_um=(500, 596), grid_um=4.0, seed=2
    )
    fine = random_lenslets(
        radius_um=670, pitch_um=70, smoothing_um=11, size_um=(502, 598), grid_um=2.0, seed=2
    )
    assert [2 * n for n in coarse.height_um.shape] == list(fine.height_um.shape)
    difference = (fine.height_um[::2, ::2] - coarse.height_um).abs().max()
    assert float(difference) < 5e-3  # Of heights of some 0.9 µm.


def test_surface_has_no_seam(smooth):
    """It is periodic: the step from the last row to the first is no larger than the others."""
    for axis in (0, 1):
        height = smooth.height_um
        inside = height.diff(dim=axis).abs().max()
        seam = (height.select(axis, 0) - height.select(axis, -1)).abs().max()
        assert float(seam) <= float(inside)


@given(st.integers(0, 10**6), st.floats(0.3, 2.1), st.floats(-3, 3), st.floats(-3, 3))
def test_cubic_polynomials_are_sampled_exactly(seed, pitch_um, row_um, column_um):
    rng = np.random.default_rng(seed)
    factors = torch.from_numpy(rng.uniform(-1, 1, (4, 4)))

    def surface(rows: Tensor, columns: Tensor) -> Tensor:
        powers = [torch.stack([(each / 20) ** k for k in range(4)]) for each in (rows, columns)]
        return powers[0].T @ factors @ powers[1]

    # Samples of even and of odd number, about the middle.
    grid_um = 1.7
    places = [Grid(24, 27, grid_um).positions_um(axis) for axis in (0, 1)]
    relief = Relief(surface(*places).float(), grid_um)
    wanted = Grid(9, 8, pitch_um, (row_um, column_um))
    got = relief.sample(wanted)
    expected = surface(wanted.positions_um(0), wanted.positions_um(1))
    assert got.dtype == torch.float32
    assert float((got - expected).abs().max()) < 1e-5


@pytest.mark.parametrize("size", [(20, 31), (21, 30)])
def test_samples_themselves_come_back(size):
    height = torch.randn(*size, generator=torch.Generator().manual_seed(1))
    relief = Relief(height, 1.55)
    torch.testing.assert_close(relief.sample(Grid(*size, 1.55)), height, rtol=0, atol=1e-6)
    part = Grid(5, 4, 1.55, (1.55 * (3 + 2 - (size[0] - 1) / 2), 1.55 * (7.5 - (size[1] - 1) / 2)))
    torch.testing.assert_close(relief.sample(part), height[3:8, 6:10], rtol=0, atol=1e-5)


def test_surface_goes_on_level_beyond_its_edges():
    height = torch.randn(12, 15, generator=torch.Generator().manual_seed(1))
    got = Relief(height, 2.0).sample(Grid(32, 37, 2.0))
    expected = torch.nn.functional.pad(height[None, None], (11, 11, 10, 10), mode="replicate")
    torch.testing.assert_close(got, expected[0, 0], rtol=0, atol=1e-6)


def test_extent_and_steepest_slope():
    place = places_um(41, 2.0)
    relief = Relief((0.03 * place[:, None] - 0.07 * place[:31]).float(), 2.0)
    assert relief.extent_um == (80.0, 60.0)
    assert relief.steepest == pytest.approx(0.07, rel=1e-4)
    assert Relief(torch.ones(1, 1), 1.0).steepest == 0
