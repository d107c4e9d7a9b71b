"""Likeness of PSFs that are known to be moved, cut, noisy or mixed."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nolens.errors import DataError
from nolens.experiments.off_axis import falls_to, peak_correlation


def texture(seed: int, rows: int = 300, columns: int = 360, sigma: float = 2.5) -> Tensor:
    """White noise, smoothed: its autocorrelation is known, and chance is small on many cells."""
    noise = torch.randn(rows, columns, generator=torch.manual_seed(seed)).double()
    down, right = torch.fft.fftfreq(rows).double(), torch.fft.rfftfreq(columns).double()
    blur = torch.exp(-2 * (math.pi * sigma) ** 2 * (down[:, None] ** 2 + right**2))
    found = torch.fft.irfft2(torch.fft.rfft2(noise) * blur, s=(rows, columns))
    return found / found.std()


def moved(pattern: Tensor, down: float, right: float) -> Tensor:
    """Between the cells too, by its spectrum."""
    rows, columns = pattern.shape
    phase = torch.fft.fftfreq(rows).double()[:, None] * down
    phase = phase + torch.fft.rfftfreq(columns).double() * right
    return torch.fft.irfft2(
        torch.fft.rfft2(pattern) * torch.exp(-2j * math.pi * phase), s=(rows, columns)
    )


@settings(max_examples=12)
@given(st.floats(-40, 40), st.floats(-60, 60))
def test_moved_window(down: float, right: float) -> None:
    """The whole frame loses what leaves it, (1 − s/H)(1 − t/W); the overlap loses nothing."""
    wide = texture(1)
    near = slice(60, 240), slice(80, 280)
    found = peak_correlation(wide[near], moved(wide, down, right)[near])
    assert found.shift == pytest.approx((down, right), abs=0.2)
    share = (1 - abs(down) / 180) * (1 - abs(right) / 200)
    assert found.frame == pytest.approx(share, abs=0.05)
    assert found.overlap > 0.985


def test_frames_are_compared_exactly_at_whole_cells() -> None:
    wide = texture(2, sigma=1.5)
    one, other = wide[60:160, 80:200], wide[67:167, 70:190]
    found = peak_correlation(one, other)
    assert found.shift == pytest.approx((-7, 10), abs=0.05)
    a, b = one - one.mean(), other - other.mean()
    by_hand = float((a[7:, :-10] * b[:-7, 10:]).sum() / (a.norm() * b.norm()))
    assert found.frame == pytest.approx(by_hand, rel=0.01)
    assert found.overlap == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_mixture(share: float) -> None:
    """A share of the same and √(1 − share²) of another has that correlation."""
    same, another = texture(3), texture(4)
    found = peak_correlation(same, 5 + 3 * (share * same + math.sqrt(1 - share**2) * another))
    assert found.frame == pytest.approx(share, abs=0.03)
    # Three times as bright, which is what the first frame's own norm sees.
    assert found.projection == pytest.approx(3 * share, abs=0.1)
    assert found.overlap == pytest.approx(share, abs=0.03)
    assert found.shift == pytest.approx((0, 0), abs=0.5)


def test_same_and_unlike() -> None:
    one = texture(5)
    found = peak_correlation(one, one)
    assert found.frame == pytest.approx(1, abs=1e-5) and found.overlap == pytest.approx(1, abs=1e-5)
    assert found.shift == pytest.approx((0, 0), abs=1e-3)
    assert peak_correlation(one, texture(6)).frame < 0.1


def test_what_cannot_be_compared() -> None:
    with pytest.raises(DataError, match="cannot be compared"):
        peak_correlation(torch.rand(10, 10), torch.rand(10, 12))
    with pytest.raises(DataError, match="even"):
        peak_correlation(torch.rand(10, 10), torch.ones(10, 10))


def test_falls_to() -> None:
    angles, values = [0.0, 10.0, 20.0, 40.0], [1.0, 0.8, 0.4, 0.0]
    assert falls_to(0.6, angles, values) == pytest.approx(15)
    assert falls_to(0.3, angles, values) == pytest.approx(25)
    assert falls_to(0.4, angles, values) == pytest.approx(20)
    assert falls_to(-0.1, angles, values) is None
    assert falls_to(1.0, angles, values) == 0
