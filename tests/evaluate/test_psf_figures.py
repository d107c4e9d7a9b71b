"""Figures of PSFs with known ones: Gaussian spots and ideal discs, alone and on lattices."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import psf_figures, sparsity
from nolens.evaluate.psf import trimmed

SIDE = 384
CELL_UM = 3.1
GAUSSIAN = 2 * math.sqrt(2 * math.log(2)) * math.sqrt(2)
"""Full width at half maximum of a Gaussian's autocorrelation, in its deviations."""
DISC = 2 * 0.40397275
"""The same of a disc's, in its diameters: acos x − x √(1 − x²) = π/4."""


def lattice(columns: int, *, staggered: bool, jitter: float, seed: int = 0) -> Tensor:
    """Places that fill the frame; staggered, in hexagons to within 1 %."""
    rows = {12: 14, 14: 16, 20: 23}[columns] if staggered else columns
    row, column = torch.meshgrid(
        torch.arange(rows, dtype=torch.float64),
        torch.arange(columns, dtype=torch.float64),
        indexing="ij",
    )
    shift = 0.5 * (row % 2) if staggered else 0.0
    places = torch.stack([row * SIDE / rows, (column + shift) * SIDE / columns], dim=-1)
    moved = torch.randn(places.shape, dtype=torch.float64, generator=torch.manual_seed(seed))
    return (places + jitter * SIDE / columns * moved).reshape(-1, 2)


def spots(places: Tensor, sigma: float) -> Tensor:
    """Gaussians of weight 1, by their spectrum: exact, and they go on at the frame's edges."""
    frequency = torch.fft.fftfreq(SIDE, dtype=torch.float64)
    down, right = (torch.exp(-2j * math.pi * frequency * places[:, axis, None]) for axis in (0, 1))
    blur = torch.exp(-2 * (math.pi * sigma * frequency) ** 2)
    spectrum = torch.einsum("ki,kj->ij", down, right)
    return torch.fft.ifft2(spectrum * blur[:, None] * blur).real


def discs(places: Tensor, diameter: float) -> Tensor:
    """1 at every cell whose middle lies in one, not smoothed by the cells; they wrap around."""
    at = torch.arange(SIDE, dtype=torch.float64)
    lit = torch.zeros(SIDE, SIDE, dtype=torch.float64)
    for place in places:
        row, column = ((at - x + SIDE / 2) % SIDE - SIDE / 2 for x in place)
        lit += row[:, None] ** 2 + column**2 <= (diameter / 2) ** 2
    return lit


@pytest.mark.parametrize("staggered", [False, True], ids=["square", "hexagonal"])
@pytest.mark.parametrize(
    ("columns", "thin", "jitter"), [(12, 24, 0.02), (14, 12, 0.05), (20, 10, 0)]
)
def test_gaussian_spots_on_a_lattice(columns, thin, jitter, staggered):
    places = lattice(columns, staggered=staggered, jitter=jitter)
    pitch = SIDE / columns
    sigma = pitch / thin
    # Spots that lie over each other by chance share their light.
    found = psf_figures(spots(places, sigma).float(), CELL_UM)
    assert found.fwhm_um == pytest.approx(GAUSSIAN * sigma * CELL_UM, rel=0.01)
    assert found.line_width_um == pytest.approx(GAUSSIAN / math.sqrt(2) * sigma * CELL_UM, rel=0.01)
    assert found.row_fwhm_um == pytest.approx(GAUSSIAN * sigma * CELL_UM, rel=0.01)
    assert found.pitch_um == pytest.approx(pitch * CELL_UM, rel=0.01)
    assert found.row_pitch_um == pytest.approx(pitch * CELL_UM, rel=0.01)
    density = len(places) / SIDE**2
    assert found.sparsity == pytest.approx(1 - 4 * math.pi * sigma**2 * density, rel=0.01)
    contrast = math.sqrt(1 / (4 * math.pi * sigma**2 * density) - 1)
    assert found.contrast == pytest.approx(contrast, rel=0.01)
    # Half way to the mean it is narrower, by more where spots fill more.
    assert found.fwhm_over_mean_um < found.fwhm_um


@pytest.mark.parametrize("diameter", [8.0, 12.0])
@pytest.mark.parametrize("staggered", [False, True], ids=["square", "hexagonal"])
def test_ideal_discs_on_a_lattice(diameter, staggered):
    places = lattice(12, staggered=staggered, jitter=0.03)
    found = psf_figures(discs(places, diameter), CELL_UM, noise=0.0)
    assert found.fwhm_um == pytest.approx(DISC * diameter * CELL_UM, rel=0.01)
    assert found.pitch_um == pytest.approx(SIDE / 12 * CELL_UM, rel=0.01)
    dark = 1 - len(places) * math.pi * diameter**2 / 4 / SIDE**2
    assert found.sparsity == pytest.approx(dark, rel=0.01)
    assert found.contrast == pytest.approx(math.sqrt(dark / (1 - dark)), rel=0.01)


def test_a_lattice_that_does_not_fill_the_frame():
    """Nor go on at its edges: spots 24 cells apart, of 160 columns and 128 rows, one margin."""
    rows, columns = torch.arange(128).double(), torch.arange(160).double()
    lines = [
        torch.exp(-((each[:, None] - torch.arange(11.3, 150, 24)) ** 2) / 8).sum(dim=1)
        for each in (rows, columns)
    ]
    found = psf_figures(lines[0][:, None] * lines[1], CELL_UM)
    assert found.fwhm_um == pytest.approx(GAUSSIAN * 2 * CELL_UM, rel=0.01)
    assert found.row_fwhm_um == pytest.approx(GAUSSIAN * 2 * CELL_UM, rel=0.01)
    assert found.pitch_um == pytest.approx(24 * CELL_UM, rel=0.01)
    assert found.row_pitch_um == pytest.approx(24 * CELL_UM, rel=0.01)


def test_magnitude_of_one_gaussian_spot():
    """exp(−2π²σ²f²) in all directions, to zero light of noise."""
    sigma = 3.0
    found = psf_figures(spots(torch.tensor([[190.3, 201.6]]).double(), sigma), CELL_UM)
    told = {None: (found.per_mm, found.magnitude), **found.direction_magnitude}
    assert set(found.direction_magnitude) == {0, 90, 180, 270}
    for at, transfer in told.values():
        f = torch.tensor(at, dtype=torch.float64) * CELL_UM * 1e-3
        expected = torch.exp(-2 * (math.pi * sigma * f) ** 2)
        high = expected > 0.05
        assert int(high.sum()) > 10
        assert torch.allclose(torch.tensor(transfer).double()[high], expected[high], rtol=0.01)
    # Half a period is as wide as a line.
    line_per_mm = 1e3 / (2 * math.sqrt(2 * math.log(2)) * sigma * CELL_UM * 2)
    assert found.line_per_mm == pytest.approx(line_per_mm, rel=0.01)
    lowest = math.exp(-2 * (math.pi * sigma * line_per_mm * CELL_UM * 1e-3) ** 2)
    assert found.lowest_magnitude == pytest.approx(lowest, rel=0.04)


def test_magnitude_of_one_disc():
    """2 J₁(πDf) / (πDf)."""
    found = psf_figures(discs(torch.tensor([[190.3, 201.6]]), 20.0), 1.0, noise=0.0)
    for at, transfer in [(found.per_mm, found.magnitude), *found.direction_magnitude.values()]:
        f = torch.tensor(at, dtype=torch.float64) * 1e-3
        argument = math.pi * 20.0 * f[f < 0.25]
        expected = (2 * torch.special.bessel_j1(argument) / argument).abs()
        off = torch.tensor(transfer, dtype=torch.float64)[f < 0.25] - expected
        assert float(off.abs().max()) < 0.01


def test_directions_are_the_pictures():
    """Spots drawn out to the right carry less at 0 and 180°, as much at 90 and 270°."""
    narrow, wide = spots(torch.tensor([[192.0, 192.0]]).double(), 2.0), torch.zeros(SIDE, SIDE)
    for step in range(-6, 7):
        wide = wide + narrow.roll(step, dims=1)
    found = psf_figures(wide, 1.0)
    at = found.direction_magnitude
    half = {a: next(f for f, v in zip(*at[a], strict=True) if v < 0.5) for a in at}
    assert half[0] == half[180] < 0.7 * half[90]
    assert half[90] == half[270]
    assert found.row_fwhm_um > 1.2 * found.fwhm_um


@pytest.mark.parametrize("noise", [0.005, 0.06])
def test_white_noise_is_told_and_taken_off(noise):
    places = lattice(14, staggered=True, jitter=0.03)
    clean = spots(places, 2.5)
    clean = clean / clean.max()
    noisy = clean + noise * torch.randn(clean.shape, generator=torch.manual_seed(5))
    found, truth = psf_figures(noisy, CELL_UM), psf_figures(clean, CELL_UM)
    assert not found.noise_known
    assert found.noise == pytest.approx(noise, rel=0.05)
    assert truth.noise < 1e-6
    assert found.fwhm_um == pytest.approx(truth.fwhm_um, rel=0.01)
    assert abs(found.background_fraction) < 0.05
    assert found.contrast == pytest.approx(truth.contrast, rel=0.01)
    assert found.sparsity == pytest.approx(truth.sparsity, rel=0.01)
    # Of the magnitude too, where noise is a good part of it.
    high = next(n for n, f in enumerate(found.per_mm) if f > 0.85 * found.usable_per_mm)
    near = slice(high - 3, high + 4)
    assert sum(found.magnitude[near]) == pytest.approx(sum(truth.magnitude[near]), rel=0.15)
    given_too = psf_figures(noisy, CELL_UM, noise=noise)
    assert given_too.noise_known and given_too.noise == pytest.approx(noise)
    # Where the spots' power, which is known, has come down to the noise's.
    power = len(places) * (2 * math.pi * 2.5**2 * float(spots(places, 2.5).max())) ** -2
    power *= (2 * math.pi * 2.5**2) ** 2
    crossing = math.sqrt(math.log(power / (noise**2 * SIDE**2)) / 4) / (math.pi * 2.5)
    assert found.usable_per_mm == pytest.approx(crossing * 1e3 / CELL_UM, rel=0.08)
    assert truth.usable_per_mm > found.usable_per_mm
    assert found.clear_bands_per_mm == ((0.0, found.usable_per_mm),)


def test_bands_above_the_noise_and_the_gap_between_them():
    """A texture with power up to 0.15 and from 0.25 to 0.35 cycles, and white noise of a third."""
    grains = torch.randn(2, SIDE, SIDE, dtype=torch.float64, generator=torch.manual_seed(6))
    frequency = torch.fft.fftfreq(SIDE, dtype=torch.float64)
    radius = torch.hypot(frequency[:, None], frequency[: SIDE // 2 + 1].abs())
    held = (radius < 0.15) | ((radius > 0.25) & (radius < 0.35))
    texture = torch.fft.irfft2(torch.fft.rfft2(grains[0]) * held, s=(SIDE, SIDE))
    found = psf_figures(10 + texture + grains[1] / 3, 1.0, noise=1 / 3)
    bands = [[each / 1e3 for each in band] for band in found.clear_bands_per_mm]
    assert torch.tensor(bands).flatten().tolist() == pytest.approx([0, 0.15, 0.25, 0.35], abs=0.006)


def test_noise_as_magnitude_and_without_any():
    pattern = spots(lattice(14, staggered=False, jitter=0.03), 2.0)
    found = psf_figures(pattern, CELL_UM, noise=1e-5)
    assert found.noise_magnitude == pytest.approx(1e-5 * SIDE / float(pattern.sum()), rel=0.01)
    assert psf_figures(pattern, CELL_UM, noise=0.0).usable_per_mm == pytest.approx(500 / CELL_UM)


@settings(max_examples=5)
@given(st.floats(0.05, 20.0), st.floats(0.0, 3.0), st.floats(0.5, 10.0))
def test_unit_level_and_cell(factor, level, cell_um):
    """A scale changes nothing, an even background only what is told of it."""
    pattern = spots(lattice(14, staggered=True, jitter=0.03), 2.5)
    one = psf_figures(pattern, 1.0, reduced_um=1000.0)
    top = float(pattern.max())
    other = psf_figures(factor * (pattern + level * top), cell_um, reduced_um=1000.0)
    assert other.fwhm_um == pytest.approx(cell_um * one.fwhm_um, rel=1e-6)
    assert other.pitch_um == pytest.approx(cell_um * one.pitch_um, rel=1e-6)
    assert other.line_per_mm == pytest.approx(one.line_per_mm / cell_um, rel=1e-6)
    assert other.lowest_magnitude == pytest.approx(one.lowest_magnitude, rel=1e-3)
    mean = float(pattern.mean())
    share = level * top / (level * top + mean)
    assert other.background_fraction == pytest.approx(share, abs=2e-3)
    assert other.contrast == pytest.approx(one.contrast * (1 - share), rel=1e-3, abs=1e-6)
    assert math.tan(math.radians(other.line_deg)) == pytest.approx(other.line_width_um / 1000.0)
    assert math.tan(math.radians(other.usable_deg)) == pytest.approx(0.5 / other.usable_per_mm)


def test_curves_say_what_the_figures_say():
    found = psf_figures(spots(lattice(14, staggered=True, jitter=0.03), 2.5), CELL_UM)
    lag, values = torch.tensor(found.lag_um), torch.tensor(found.autocorrelation)
    assert values[0] == 1 and float(lag[1]) == pytest.approx(CELL_UM / 4)
    assert found.level == pytest.approx(float(values[: int(found.pitch_um / CELL_UM * 4)].min()))
    half = int((values < (1 + found.level) / 2).nonzero()[0])
    assert lag[half - 1] <= found.fwhm_um / 2 <= lag[half]
    # By another way: the row's line of the frame that stands in zeros.
    pattern = spots(lattice(14, staggered=True, jitter=0.03), 2.5)
    pattern = trimmed(pattern - found.background_fraction * float(pattern.mean()))
    (rows, columns), cells = pattern.shape, pattern.numel()
    mean = float(pattern.mean())
    line = [
        float((pattern[:, step:] * pattern[:, : columns - step]).sum()) / cells
        - mean**2 * (1 - step / columns)
        for step in range(80)
    ]
    row = torch.tensor(found.row_autocorrelation).double()[::4]
    expected = torch.tensor(line).double() / line[0]
    assert torch.allclose(row[: len(line)], expected, atol=1e-5)
    # And on a circle of lag 20, between the cells.
    angles = torch.arange(0, 360, 3) * math.pi / 180
    padded = torch.zeros(2 * SIDE, 2 * SIDE).double()
    padded[:rows, :columns] = pattern
    full = torch.fft.irfft2(torch.fft.rfft2(padded).abs() ** 2).roll((SIDE, SIDE), (0, 1)) / cells
    place = torch.stack([20 * angles.cos(), 20 * angles.sin()], dim=-1)
    at = (place + SIDE + 0.5) / SIDE - 1
    ring = torch.nn.functional.grid_sample(
        full[None, None], at[None, None].double(), mode="bicubic", align_corners=False
    )
    over = 1 - 2 * 20 / math.pi * (1 / rows + 1 / columns) + 400 / (math.pi * cells)
    value = (float(ring.mean()) - mean**2 * over) / line[0]
    assert found.autocorrelation[80] == pytest.approx(value, abs=2e-3)


def test_a_single_spot_has_no_pitch():
    found = psf_figures(spots(torch.tensor([[190.0, 200.0]]).double(), 4.0), CELL_UM)
    assert found.pitch_um is None and found.row_pitch_um is None
    assert found.fwhm_um == pytest.approx(GAUSSIAN * 4.0 * CELL_UM, rel=0.01)
    assert found.line_deg is None and found.usable_deg is None


def test_noise_counts_in_sparsity():
    pattern = torch.zeros(64, 64)
    pattern[:, :16] = 3.0
    noisy = pattern + 0.5 * torch.randn(64, 64, generator=torch.manual_seed(1))
    assert sparsity(noisy, 0.5) == pytest.approx(0.75, abs=0.01)


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        (torch.zeros(64, 64), "dark"),
        (torch.full((64, 64), 1 / 3), "even"),
        (torch.ones(8, 64), "8×64 pixels is too small"),
        (1 + torch.cos(2 * math.pi * torch.arange(512) / 512).expand(64, 512), "wider than half"),
    ],
)
def test_what_cannot_be_measured(pattern, words):
    with pytest.raises(DataError, match=words):
        psf_figures(pattern, CELL_UM)


def test_nothing_but_noise():
    noisy = 1 + 0.1 * torch.randn(64, 64, generator=torch.manual_seed(1))
    with pytest.raises(DataError, match="no more than its noise"):
        psf_figures(noisy, CELL_UM, noise=0.2)
