"""Masks that are designed for their PSF: what they reach, and what pictures they give."""

import math

import numpy as np
import pytest
import torch
from mask_bench import LIMITS, small, tile_of
from torch import Tensor

from nolens.design.masks import (
    Layout,
    Limits,
    PsfGoals,
    Shortfall,
    Tile,
    contour_relief,
    correlation,
    default_period_um,
    focusing_radius_um,
    lenslet_start,
    line_target,
    optimised_relief,
    random_contours,
)
from nolens.errors import OptionError
from nolens.evaluate import psnr, scale_fit, spectral_magnitude
from nolens.kernels import fast_length
from nolens.operators import PixelRectangle
from nolens.optics import mask_to_sensor, relaxed_points, smoothed, squared_distance
from nolens.solvers import Problem, admm
from nolens.twin import REFERENCE_NM, Light, Twin

SIDE = 256
GOALS = PsfGoals(width_um=8.0, sparsity=0.98, magnitude=0.06, magnitude_per_mm=80.0)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return small()


@pytest.fixture(scope="module")
def tile(twin: Twin) -> Tile:
    return tile_of(twin, SIDE)[1]


def test_focusing_radius_is_that_of_the_matrices(twin):
    radius = focusing_radius_um(twin)
    assert float(mask_to_sensor(1.0, twin.stack(REFERENCE_NM), radius)[0, 0]) == pytest.approx(
        0, abs=1e-12
    )


def test_contours_are_where_the_field_changes_its_sign():
    """Brute force: the points nearest to zero of the same field, in fine steps along lines."""
    lines = random_contours(96, 2.0, 120.0, seed=3)
    assert lines.shape == (96, 96)
    torch.testing.assert_close(lines, random_contours(96, 2.0, 120.0, seed=3), rtol=0, atol=0)
    noise = np.random.default_rng(3).standard_normal((96, 96))
    radius = np.hypot(*np.meshgrid(np.fft.fftfreq(96, 2.0), np.fft.fftfreq(96, 2.0)))
    ring = np.exp(-((radius * 120.0 - 1) ** 2) / (2 * 0.35**2))
    field = np.fft.ifft2(np.fft.fft2(noise) * ring).real
    slope = np.hypot(*np.gradient(field, 2.0))
    near = lines.numpy() < 9.0
    assert 0.05 < near.mean() < 0.3
    # Close to a line the field over its slope is the distance.
    inner = near & (slope > np.median(slope) / 2)
    distance = np.abs(field[inner]) / slope[inner]
    assert np.quantile(np.abs(distance - np.sqrt(lines.numpy()[inner])), 0.9) < 0.5
    assert np.abs(field[lines.numpy() > 400]).mean() > 3 * np.abs(field[near]).mean()


def test_contour_mask_shows_its_target(tile, twin):
    lines = random_contours(SIDE, tile.grid_um, 200.0, seed=0)
    target = line_target(lines, 12.0, 2)
    radius = focusing_radius_um(twin)
    start = LIMITS.enforce(lines * (-tile.bulge / (2 * radius)), tile.grid_um)
    before = float(correlation(tile.psf(start, 0), target))
    heights = contour_relief(tile, lines, target, LIMITS, radius_um=radius, iterations=40)
    after = float(correlation(tile.psf(heights, 0), target))
    assert after >= 0.9 and after > before
    assert float(heights.max() - heights.min()) <= LIMITS.height_um * (1 + 1e-5)
    wrong = random_contours(SIDE, tile.grid_um, 200.0, seed=1)
    other = line_target(wrong, 12.0, 2)
    assert float(correlation(tile.psf(heights, 0), other)) < 0.3


def test_line_target_has_the_width():
    place = (torch.arange(400) - 200) * 0.5
    lines = place.square().expand(4, -1).contiguous()
    target = line_target(lines, 12.0, 1)[0]
    assert float((target > 0.5).sum()) * 0.5 == pytest.approx(12.0, abs=0.6)


def optimised(tile: Tile, twin: Twin, limits: Limits = LIMITS, steps: int = 40) -> Tensor:
    start = lenslet_start(tile, focusing_radius_um(twin), 110.0, seed=0)
    return optimised_relief(tile, GOALS, limits, start, iterations=steps)


@pytest.fixture(scope="module")
def designed(tile: Tile, twin: Twin) -> Tensor:
    return optimised(tile, twin)


def test_descent_comes_nearer_to_its_goals(designed, tile, twin):
    short = Shortfall(GOALS, SIDE // 2, tile.pixel_um)
    start = lenslet_start(tile, focusing_radius_um(twin), 110.0, seed=0)
    start = LIMITS.enforce(LIMITS.smooth(start, tile.grid_um), tile.grid_um)
    before, after = (float(short(tile.psf(each, 0))) for each in (start, designed))
    assert after < 0.8 * before
    torch.testing.assert_close(optimised(tile, twin), designed, rtol=0, atol=0)


def test_levels_are_kept_and_cost_little(designed, tile, twin):
    fine = Limits(12.0, LIMITS.slope, 8.0, levels=121)
    made = optimised(tile, twin, fine)
    torch.testing.assert_close(made * 10, (made * 10).round(), atol=1e-3, rtol=0)
    short = Shortfall(GOALS, SIDE // 2, tile.pixel_um)
    plain, rounded = (float(short(tile.psf(each, 0))) for each in (designed, made))
    assert rounded < plain + 0.1


def _picture(side: int) -> Tensor:
    """A scene of edges and shades that no design has seen."""
    place = torch.linspace(-1, 1, side)
    y, x = place[:, None].expand(-1, side), place.expand(side, -1)
    scene = 0.3 + 0.25 * x + 0.15 * torch.sin(5 * y + 3 * x)
    scene = torch.where((x - 0.2).square() + (y + 0.3).square() < 0.15, 0.9, scene)
    scene = torch.where((x + 0.5).abs() + (y - 0.4).abs() < 0.3, 0.05, scene)
    return torch.where((y - 0.75).abs() < 0.06, torch.sign(torch.sin(40 * x)) * 0.4 + 0.5, scene)


def _psnr(pattern: Tensor, electrons: float, seed: int) -> float:
    """Of a reconstruction from 176² cells, behind an open mask that repeats the pattern."""
    cells, side, sensor = len(pattern), 64, 176
    scene = _picture(side)
    field = torch.zeros(cells, cells)
    field[:side, :side] = scene
    start = (cells - side) // 2
    field = torch.roll(field, (start, start), (0, 1))
    kernel = torch.roll(pattern, (-(cells // 2), -(cells // 2)), (0, 1))
    light = torch.fft.ifft2(torch.fft.fft2(field) * torch.fft.fft2(kernel)).real
    index = (torch.arange(sensor) - sensor // 2 + cells // 2) % cells
    light = light[index][:, index].clamp_min(0)
    generator = torch.Generator().manual_seed(seed)
    light = torch.poisson(light * (electrons / light.mean()), generator=generator)
    light += 3 * torch.randn(light.shape, generator=generator)
    wide = (torch.arange(sensor + side) - (sensor + side) // 2 + cells // 2) % cells
    problem = Problem.build(
        pattern[wide][:, wide][None], light[None],
        support=PixelRectangle.centred(side, side, (sensor, sensor)), tau=1e-5,
    )  # fmt: skip
    found = admm(problem, iterations=150).scene
    return psnr(scale_fit(found, scene[None]), scene[None], 1.0)


def test_designed_mask_gives_better_pictures(designed, tile):
    """≥ 1 dB over the paper's random lenslets, at equal light and noise."""
    side_um = SIDE * tile.grid_um
    points = relaxed_points((side_um, side_um), 70.0, 0)
    papers = squared_distance(points, (SIDE, SIDE), tile.grid_um) / -(2 * 670.0)
    papers = smoothed(papers, 11.0 / tile.grid_um)
    for seed, electrons in ((0, 3000.0), (1, 1000.0)):
        own = _psnr(tile.psf(designed, 0), electrons, seed)
        random = _psnr(tile.psf(papers, 0), electrons, seed)
        assert own >= random + 1.0


def test_even_spacing_loses_large_shapes(tile, twin):
    """The same lenslets in random places: more contrast at low frequencies, better pictures."""
    radius, side_um = focusing_radius_um(twin), SIDE * tile.grid_um
    even = squared_distance(relaxed_points((side_um, side_um), 70.0, 0), (SIDE, SIDE), tile.grid_um)
    surfaces = (even / -(2 * radius), lenslet_start(tile, radius, 70.0, seed=0))
    patterns = [
        tile.psf(LIMITS.enforce(LIMITS.smooth(each, tile.grid_um), tile.grid_um), 0)
        for each in surfaces
    ]
    evenly, randomly = (spectral_magnitude(each, tile.pixel_um, 7.0) for each in patterns)
    assert randomly > 2 * evenly
    evenly, randomly = (_psnr(each, 3000.0, 0) for each in patterns)
    assert randomly > evenly + 2.0


def test_layout(twin):
    layout = Layout.fit(twin, LIMITS, 600.0)
    assert layout.grid_um == pytest.approx(1.55) and layout.samples_per_pixel == 2
    for period in (200.0, 250.0, 310.0, 600.0, 777.0):
        side = Layout.fit(twin, LIMITS, period).side
        assert side % 4 == 0 and period <= side * 1.55 < 1.1 * period + 20
        assert fast_length(side, of_rows=False) == side
    steep = Layout.fit(twin, Limits(12.0, 0.19, 8.0), 600.0)
    assert steep.grid_um == pytest.approx(0.775) and steep.samples_per_pixel == 4
    views = layout.tile(twin, Light("white-led")).views
    assert len(views) == 3 and math.fsum(view.weight for view in views) == pytest.approx(1)
    assert views[0].wavelength_nm > views[1].wavelength_nm > views[2].wavelength_nm
    # The aperture of the small camera ends what light can come through.
    assert default_period_um(twin) == 250.0


@pytest.mark.parametrize(
    ("limits", "period", "words"),
    [
        (Limits(12.0, 0.9, 8.0), 600.0, "smaller --slope"),
        (Limits(12.0, 0.095, 1.0), 600.0, "finer --grid|3.1 µm or more"),
        (Limits(12.0, 0.095, 8.0, 8), 600.0, "more --levels"),
        (LIMITS, 50.0, "larger --period"),
    ],
)
def test_impossible_layouts(limits, period, words, twin):
    with pytest.raises(OptionError, match=words):
        Layout.fit(twin, limits, period)
