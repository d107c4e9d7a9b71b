"""Width and pitch of patterns whose autocorrelation is known."""

import math

import pytest
import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import pattern_figures

SIZE = 512
CELL_UM = 1.55


def _place() -> tuple[Tensor, Tensor]:
    at = torch.arange(SIZE, dtype=torch.float64)
    return at[:, None], at


def _spots(places: Tensor, sigma: float) -> Tensor:
    """Gaussian spots at places in cells, on a torus; by their spectrum."""
    frequency = torch.fft.fftfreq(SIZE, dtype=torch.float64)
    waves = [
        torch.exp(-2j * math.pi * frequency * places[:, axis, None]) for axis in (0, 1)
    ]  # fmt: skip
    spectrum = torch.einsum("ki,kj->ij", *waves)
    blur = torch.exp(-2 * (math.pi * sigma * frequency) ** 2)
    return torch.fft.ifft2(spectrum * blur[:, None] * blur).real


def _random_spots(sigma: float, seed: int) -> Tensor:
    """As many as there is room for, so that by chance some are near each other."""
    count = round(SIZE**2 / (40 * sigma**2))
    generator = torch.Generator().manual_seed(seed)
    return _spots(SIZE * torch.rand(count, 2, dtype=torch.float64, generator=generator), sigma)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("sigma", [2.0, 3.5, 4.5])
def test_width_of_gaussian_spots(sigma, seed):
    """The autocorrelation of a Gaussian is √2 wider: full width 2√(2 ln 2)·√2·σ."""
    got = pattern_figures(_random_spots(sigma, seed).float(), CELL_UM)
    expected = 2 * math.sqrt(2 * math.log(2)) * math.sqrt(2) * sigma * CELL_UM
    assert got.width_um == pytest.approx(expected, rel=0.02)


def test_width_of_a_single_spot():
    """Without neighbours, chance has no share: within 1 %, in spite of the rings."""
    places = torch.tensor([[250.0, 260.0], [250.0, 260.0 - SIZE / 6]], dtype=torch.float64)
    got = pattern_figures(_spots(places, 5.0).float(), 2.0)
    expected = 2 * math.sqrt(2 * math.log(2)) * math.sqrt(2) * 5.0 * 2.0
    assert got.width_um == pytest.approx(expected, rel=0.02)
    assert got.pitch_um == pytest.approx(SIZE / 6 * 2.0, rel=0.01)


def _lattice(rows: int, columns: int, *, staggered: bool, jitter: float) -> Tensor:
    """Places that fill the torus: in rows one above the other, or every second one displaced."""
    row, column = torch.meshgrid(
        torch.arange(rows, dtype=torch.float64),
        torch.arange(columns, dtype=torch.float64),
        indexing="ij",
    )
    shift = 0.5 * (row % 2) if staggered else 0.0
    places = torch.stack([row * SIZE / rows, (column + shift) * SIZE / columns], dim=-1)
    generator = torch.Generator().manual_seed(2)
    moved = torch.randn(places.shape, dtype=torch.float64, generator=generator)
    return (places + jitter * SIZE / columns * moved).reshape(-1, 2)


@pytest.mark.parametrize("columns", [14, 26])
@pytest.mark.parametrize("staggered", [False, True], ids=["square", "hexagonal"])
@pytest.mark.parametrize(("thin", "jitter"), [(24, 0.02), (12, 0.05)])
def test_pitch_of_a_lattice(staggered, columns, thin, jitter):
    """That of the next neighbours, though farther ones are more and can make a higher peak; 14
    columns and 16 staggered rows are hexagons to within 1 %."""
    rows = {14: 16, 26: 30}[columns] if staggered else columns
    pitch = SIZE / columns
    places = _lattice(rows, columns, staggered=staggered, jitter=jitter)
    got = pattern_figures(_spots(places, pitch / thin).float(), CELL_UM)
    assert got.pitch_um == pytest.approx(pitch * CELL_UM, rel=0.02)


def test_stripes():
    """A grating has its first peak at once its period; the mean over directions keeps it near."""
    rows, _ = _place()
    pattern = (0.5 + 0.5 * torch.cos(2 * math.pi * rows / 32)).expand(SIZE, SIZE)
    got = pattern_figures(pattern.float().contiguous(), 1.0)
    # J₀(2πr/32) has its second maximum at 7.0156·32/2π, and its half height at 1.5211·32/2π.
    assert got.pitch_um == pytest.approx(7.0156 * 32 / (2 * math.pi), rel=0.01)
    assert got.width_um == pytest.approx(2 * 1.5211 * 32 / (2 * math.pi), rel=0.01)


def test_unit_and_level_do_not_matter():
    pattern = _spots(_lattice(16, 14, staggered=True, jitter=0.05), 3.0).float()
    one = pattern_figures(pattern, 1.0)
    for other in (1000 * pattern, pattern + 0.5, pattern.double(), pattern.T.contiguous()):
        got = pattern_figures(other, 1.0)
        assert got.pitch_um == pytest.approx(one.pitch_um, rel=2e-3)
        assert got.width_um == pytest.approx(one.width_um, rel=2e-3)
    twice = pattern_figures(pattern, 2.0)
    assert twice.width_um == pytest.approx(2 * one.width_um)
    assert twice.pitch_um == pytest.approx(2 * one.pitch_um)


def test_frames_need_not_be_square():
    pattern = _spots(_lattice(26, 26, staggered=False, jitter=0.02), 1.0).float()
    got = pattern_figures(pattern[:300, :431].contiguous(), 1.0)
    assert got.pitch_um == pytest.approx(SIZE / 26, rel=0.02)


@pytest.mark.parametrize("value", [0.0, 7.0, 1 / 3])
def test_even_patterns_are_refused(value):
    with pytest.raises(DataError, match="even"):
        pattern_figures(torch.full((64, 64), value), CELL_UM)


def test_patterns_without_a_second_peak_are_refused():
    one = _spots(torch.tensor([[256.0, 256.0]], dtype=torch.float64), 20.0)
    with pytest.raises(DataError, match="no second peak"):
        pattern_figures(one.float(), CELL_UM)


def test_patterns_wider_than_the_frame_are_refused():
    """A wave as long as the frame, of which a quarter of the height is looked at."""
    _, columns = _place()
    wide = torch.cos(2 * math.pi * columns / SIZE).expand(64, SIZE)
    with pytest.raises(DataError, match="lines are wider than half of it"):
        pattern_figures(wide.float().contiguous(), CELL_UM)
