"""Maps of measured heights, against planes, spheres, waves and other solutions."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nolens.optics import Relief, random_lenslets
from nolens.optics.measured import (
    extend_by_reflection,
    fill_gaps,
    relief_figures,
    remove_tilt,
    resample,
)

factors = st.floats(-5, 5)


def places(shape, pitch):
    return np.meshgrid(
        *((np.arange(n) - (n - 1) / 2) * p for n, p in zip(shape, pitch, strict=True)),
        indexing="ij",
    )


@settings(max_examples=40)
@given(factors, factors, factors, factors, st.tuples(st.floats(0.1, 5), st.floats(0.1, 5)))
def test_tilt_and_bow_are_those_put_in(offset, down, right, bow, pitch):
    """In mrad and in um from the middle to the corners, with a tenth of the points missing."""
    y, x = places((31, 24), pitch)
    squared = y**2 + x**2
    heights = offset + 1e-3 * (down * y + right * x) - bow * squared / squared.max()
    heights[np.random.default_rng(0).uniform(size=heights.shape) < 0.1] = np.nan
    flat, tilt = remove_tilt(heights, pitch)
    assert tilt.bow_um == pytest.approx(bow, abs=1e-6)
    if bow == 0:
        assert tilt.rise_mrad == pytest.approx((down, right), abs=1e-6)
        np.testing.assert_allclose(flat[~np.isnan(flat)], 0, atol=1e-9)
    again, rest = remove_tilt(flat, pitch)
    assert rest.rise_mrad == pytest.approx((0, 0), abs=1e-6)
    np.testing.assert_allclose(again, flat, atol=1e-9)
    assert np.isnan(flat).sum() == np.isnan(heights).sum()


def test_plane_of_a_whole_bowl_is_level():
    y, x = places((31, 24), (2.0, 1.0))
    _, tilt = remove_tilt(1e-3 * (3 * y - 2 * x) + 1e-3 * (y**2 + x**2), (2.0, 1.0))
    assert tilt.rise_mrad == pytest.approx((3, -2), abs=1e-9)
    assert tilt.bow_um == pytest.approx(-1e-3 * (30**2 + 11.5**2))


def test_gaps_are_filled_as_a_membrane_hangs():
    """Against Gauss and Seidel's iteration; a harmonic surface comes back exactly."""
    y, x = places((30, 25), (1.0, 1.0))
    harmonic = x * y + x**2 - y**2 + 3 * x
    generator = np.random.default_rng(1)
    gaps = generator.uniform(size=harmonic.shape) < 0.2
    gaps[10:17, 8:16] = True
    gaps[[0, -1]] = gaps[:, [0, -1]] = False
    broken = np.where(gaps, np.nan, harmonic)
    np.testing.assert_allclose(fill_gaps(broken), harmonic, atol=1e-9)

    rough = generator.normal(size=(12, 9))
    gaps = generator.uniform(size=rough.shape) < 0.3
    gaps[0, :4] = gaps[-1, -1] = gaps[5:9, 0] = True
    expected = np.where(gaps, 0.0, rough)
    for _ in range(400):
        for row, column in np.argwhere(gaps):
            around = [(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)]
            known = [expected[at] for at in around if 0 <= at[0] < 12 and 0 <= at[1] < 9]
            expected[row, column] = sum(known) / len(known)
    np.testing.assert_allclose(fill_gaps(np.where(gaps, np.nan, rough)), expected, atol=1e-8)


def test_nothing_missing_stays():
    heights = np.random.default_rng(0).normal(size=(5, 6))
    assert fill_gaps(heights) is heights


@settings(max_examples=40)
@given(
    st.tuples(st.floats(0.3, 2), st.floats(0.3, 2)), st.floats(0.3, 2),
    st.tuples(st.integers(20, 60), st.integers(20, 60)),
)  # fmt: skip
def test_a_smooth_surface_on_another_grid(pitch, grid, shape):
    """Waves of 40 um and more, around the same middle and within the same area."""

    def surface(y, x):
        return np.sin(y / 8 + 1) + np.cos(x / 9 + y / 20)

    found = resample(surface(*places(shape, pitch)), pitch, grid)
    for axis in (0, 1):
        extent, was = (found.shape[axis] - 1) * grid, (shape[axis] - 1) * pitch[axis]
        assert was - grid - 1e-6 <= extent <= was + 1e-6
    expected = surface(*places(found.shape, (grid, grid)))
    inner = (slice(4, -4), slice(4, -4))
    # The Gaussian before a coarser grid takes 1 % of such a wave at most; edges are as they are.
    np.testing.assert_allclose(found[inner], expected[inner], atol=0.03)


def test_the_same_grid_changes_nothing():
    heights = np.random.default_rng(0).normal(size=(9, 8))
    np.testing.assert_array_equal(resample(heights, (0.7, 0.7), 0.7), heights)


def test_noise_does_not_fold_into_a_coarse_grid():
    """Of white noise on 0.2 um about the 64 points remain that lie in a cell of 1.6 um."""
    noise = np.random.default_rng(0).normal(size=(800, 800))
    assert resample(noise, (0.2, 0.2), 1.6).std() < 0.15


def test_continued_by_reflection():
    heights = np.arange(12.0).reshape(3, 4)
    found = extend_by_reflection(heights, (8, 4))
    assert found[:, 0].tolist() == [8, 4, 0, 4, 8, 4, 0, 4]
    assert extend_by_reflection(heights, (2, 9)).shape == (3, 9)
    assert np.abs(np.diff(extend_by_reflection(heights, (50, 60)), axis=1)).max() == 1


@pytest.mark.parametrize("radius", [300.0, 1000.0])
def test_radius_of_the_tops_is_the_lenslets(radius):
    relief = random_lenslets(
        radius_um=radius, pitch_um=60, smoothing_um=3, size_um=(900, 700), grid_um=1.5, seed=2
    )
    figures = relief_figures(relief)
    assert figures.radius_um == pytest.approx(radius, rel=0.01)
    lenslets = np.prod(relief.extent_um) * 2 / (np.sqrt(3) * 60**2)
    assert figures.tops == pytest.approx(lenslets, rel=0.2)
    below = relief_figures(Relief(-relief.height_um, relief.grid_um))
    assert below.rms_um == pytest.approx(figures.rms_um) and below.radius_um < radius / 2


def test_figures_of_a_wave():
    """h = cos(qx)cos(qy): rms ½, peak to valley 2, slope q, curvature q² at its tops, and the
    autocorrelation cos(qx) falls to a half at a sixth of the period."""
    period, step = 40.0, 0.5
    y, x = places((801, 801), (step, step))
    q = 2 * np.pi / period
    wave = np.cos(q * x) * np.cos(q * y)
    figures = relief_figures(Relief(torch.from_numpy(wave).float(), step))
    assert figures.size_um == (400, 400)
    assert figures.rms_um == pytest.approx(0.5, rel=0.01)
    assert figures.peak_to_valley_um == pytest.approx(2, rel=1e-6)
    assert figures.steepest == pytest.approx(q, rel=0.002)
    assert figures.correlation_um == pytest.approx(period / 6, rel=0.02)
    # Within the 1.5 um that are fitted the cosines bend a little less than at their very top.
    assert figures.radius_um == pytest.approx(1 / q**2, rel=0.02)
    assert 160 <= figures.tops <= 221


def test_figures_of_a_plane():
    figures = relief_figures(Relief(torch.zeros(40, 50), 1.0))
    assert (figures.rms_um, figures.tops, figures.radius_um) == (0, 0, None)
