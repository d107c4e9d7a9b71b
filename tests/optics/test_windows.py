"""How a pattern is cut: every sample once, no window too large, and enough around it."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nolens.optics import Margin, divergence
from nolens.optics.psf import window_length, windows


@given(
    st.integers(1, 300),
    st.integers(1, 300),
    st.floats(0.3, 10),
    st.just(math.inf) | st.floats(1e3, 1e5),
    st.integers(5, 120),
)
def test_every_sample_is_in_one_window(rows, columns, pitch_um, distance_um, largest):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nolens.optics.psf._LARGEST", largest)
        parts = list(windows(rows, columns, pitch_um, distance_um))
    times = torch.zeros(rows, columns, dtype=torch.int64)
    most = largest if math.isinf(distance_um) else max(64, largest)
    for part in parts:
        assert 0 < part.rows[1] - part.rows[0] <= most
        assert 0 < part.columns[1] - part.columns[0] <= most
        times[slice(*part.rows), slice(*part.columns)] += 1
    assert bool((times == 1).all())


def test_near_sources_have_small_windows():
    """A tenth of the source's distance: the light's direction changes by so much."""
    parts = list(windows(2000, 2000, 1.55, 10_000.0))
    assert max(part.rows[1] - part.rows[0] for part in parts) <= 1000 / 1.55
    assert len(parts) == 16
    assert len(list(windows(2000, 2000, 1.55, math.inf))) == 1


@given(st.floats(0.3, 5), st.floats(1e4, 1e6))
def test_divergence_is_that_of_the_largest_window(pitch_um, distance_um):
    parts = windows(5000, 4000, pitch_um, distance_um)
    widest = max(part.columns[1] - part.columns[0] for part in parts) * pitch_um
    assert widest / 2 / distance_um <= divergence(pitch_um, distance_um) * (1 + 1e-9)
    assert divergence(pitch_um, math.inf) == 0


def test_margin_grows_with_slope_and_with_diffraction():
    margin = Margin.needed(0.03, 1300.0, 0.55)
    assert margin.geometric_um == pytest.approx(39)
    assert margin.diffraction_um == pytest.approx(3 * math.sqrt(0.55 * 1300))
    assert margin.total_um == pytest.approx(39 + 6 * math.sqrt(0.55 * 1300))
    length = window_length(100, margin, 1.55, of_rows=True)
    assert length * 1.55 >= 100 * 1.55 + 2 * margin.total_um


def test_fading_leaves_the_part_within_the_margin_untouched():
    margin = Margin.needed(0.03, 1300.0, 0.55)
    fading = margin.fading(500, 1.55)
    width = math.ceil(margin.diffraction_um / 1.55)
    assert bool((fading[width:-width] == 1).all())
    assert float(fading[0]) == float(fading[-1]) == 0
    torch.testing.assert_close(fading, fading.flip(0), rtol=0, atol=1e-7)
    assert bool((fading[: width + 1].diff() > 0).all())
