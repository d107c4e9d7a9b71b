"""Goals of a PSF: each one begins to count where the figure that is reported misses it."""

import math

import pytest
import torch

from nolens.design.masks import PsfGoals, Shortfall
from nolens.errors import OptionError
from nolens.evaluate import pattern_figures, sparsity, spectral_magnitude

CELLS, CELL_UM = 128, 3.1
EASY = {"width_um": 500.0, "sparsity": 0.0, "magnitude": 1e-9, "magnitude_per_mm": 60.0}


def spots(deviation_um: float, count: int = 30, seed: int = 0) -> torch.Tensor:
    """Gaussian spots in random places, on a torus."""
    generator = torch.Generator().manual_seed(seed)
    side = CELLS * CELL_UM
    pattern = torch.zeros(CELLS, CELLS)
    place = torch.arange(CELLS) * CELL_UM
    for centre in torch.rand((count, 2), generator=generator) * side:
        away = [(place - c + side / 2) % side - side / 2 for c in centre]
        distance = away[0].square()[:, None] + away[1].square()
        pattern += torch.exp(-distance / (2 * deviation_um**2))
    return pattern


def shortfall(pattern: torch.Tensor, **goals: float) -> float:
    return float(Shortfall(PsfGoals(**{**EASY, **goals}), CELLS, CELL_UM)(pattern))


def test_nothing_is_short_of_easy_goals():
    assert shortfall(spots(8.0)) == 0


def test_width_counts_from_the_width_that_is_measured():
    """To 10 %: the reported width averages rings of cells."""
    pattern = spots(8.0)
    measured = pattern_figures(pattern, CELL_UM).width_um
    assert shortfall(pattern, width_um=1.1 * measured) == 0
    assert shortfall(pattern, width_um=0.9 * measured) > 0.05
    assert shortfall(pattern, width_um=0.6 * measured) > shortfall(pattern, width_um=0.9 * measured)


def test_sparsity_is_the_one_that_is_measured():
    pattern = spots(8.0)
    measured = sparsity(pattern)
    assert shortfall(pattern, sparsity=measured - 1e-3) == 0
    wanted = 1 - (1 - measured) / 2
    assert shortfall(pattern, sparsity=wanted) == pytest.approx(math.log(2), rel=1e-3)


def test_gaps_in_the_spectrum_cost():
    """A single wave m of one mm² at one frequency: all other frequencies are missing."""
    pattern = spots(8.0)
    lowest = min(spectral_magnitude(pattern, CELL_UM, f) for f in (5.0, 15.0, 30.0))
    assert shortfall(pattern, magnitude=lowest / 30, magnitude_per_mm=30.0) < 0.05
    place = torch.arange(CELLS)
    wave = (1 + torch.cos(2 * math.pi * 4 * place / CELLS)).expand(CELLS, -1)
    assert shortfall(wave.contiguous(), magnitude=0.01) > 6.5


def test_transfer_is_that_of_a_square_millimetre():
    """A single point has the modulation 1, that is its side in mm for one mm²."""
    point = torch.zeros(CELLS, CELLS)
    point[5, 7] = 1.0
    side_mm = CELLS * CELL_UM * 1e-3
    assert spectral_magnitude(point, CELL_UM, 30.0) == pytest.approx(side_mm, rel=1e-3)
    assert shortfall(point, magnitude=0.9 * side_mm) == 0
    assert shortfall(point, magnitude=2 * side_mm) == pytest.approx(math.log(4), rel=0.01)


def test_the_gradient_leads_to_sharper_patterns():
    pattern = spots(8.0).requires_grad_(True)
    short = Shortfall(PsfGoals(10.0, 0.95, 0.05, 60.0), CELLS, CELL_UM)
    gradient = torch.autograd.grad(short(pattern), pattern)[0]
    sharper = (pattern - gradient * (0.01 * pattern.max() / gradient.abs().max())).detach()
    assert float(short(sharper)) < float(short(pattern.detach()))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"width_um": 0.0}, "width"),
        ({"sparsity": 1.0}, "less than 100 %"),
        ({"sparsity": -0.1}, "0 % or more"),
        ({"magnitude": 0.0}, "more than 0 %"),
        ({"magnitude": 1.1}, "up to 100 %"),
        ({"magnitude_per_mm": 0.0}, "more than zero"),
    ],
)
def test_impossible_goals(change, words):
    with pytest.raises(OptionError, match=words):
        PsfGoals(**{**EASY, **change})


def test_a_frequency_below_the_tiles_own():
    with pytest.raises(OptionError, match="larger period"):
        Shortfall(PsfGoals(8.0, 0.9, 0.1, 1.0), CELLS, CELL_UM)
