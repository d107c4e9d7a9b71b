"""Shifts of one pattern against another one, and of many together."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from nolens.calibrate.registration import fine_structure, match_overlap
from nolens.calibrate.stitch import Capture, locate
from nolens.errors import DataError

Plane = NDArray[np.float64]
LARGE = 400


def canvas(seed: int = 0) -> Plane:
    """Lines about 4 cells wide without end: white noise under a Gaussian, on a period."""
    white = np.random.default_rng(seed).standard_normal((LARGE, LARGE))
    return 10 + 40 * ndimage.gaussian_filter(white, 2.0, mode="wrap")


def view(pattern: Plane, moved: tuple[float, float], rows: int = 120, columns: int = 150) -> Plane:
    """What a sensor sees of a pattern that is moved: exact, by the shift theorem."""
    rowed, columned = (np.fft.fftfreq(n) for n in pattern.shape)
    turn = np.exp(-2j * np.pi * (rowed[:, None] * moved[0] + columned * moved[1]))
    whole = np.fft.ifft2(np.fft.fft2(pattern) * turn).real
    top, left = (LARGE - rows) // 2, (LARGE - columns) // 2
    return np.asarray(whole[top : top + rows, left : left + columns])


@settings(max_examples=8, deadline=None)
@given(
    moved=st.tuples(st.floats(-50, 50), st.floats(-60, 60)),
    off=st.tuples(st.floats(-9, 9), st.floats(-9, 9)),
)
def test_parts_of_a_cell(moved: tuple[float, float], off: tuple[float, float]) -> None:
    one, other = (fine_structure(view(canvas(), each)) for each in ((0.0, 0.0), moved))
    found = match_overlap(one, other, (moved[0] + off[0], moved[1] + off[1]), 10)
    assert found is not None
    assert math.dist(found.shift, moved) < 0.03
    assert found.correlation > 0.98


def test_smooth_light_is_no_landmark() -> None:
    glow = 100 * np.exp(-(((np.arange(150) - 40) / 120) ** 2)) * np.ones((120, 1))
    one, other = view(canvas(), (0, 0)) + glow, view(canvas(), (7.3, -11.6)) + glow
    found = match_overlap(fine_structure(one), fine_structure(other), (6.0, -10.0), 8)
    assert found is not None and math.dist(found.shift, (7.3, -11.6)) < 0.1


def test_other_patterns_are_not_alike() -> None:
    one, other = fine_structure(view(canvas(), (0, 0))), fine_structure(view(canvas(1), (0, 0)))
    found = match_overlap(one, other, (0.0, 0.0), 20)
    assert found is not None and abs(found.correlation) < 0.15
    assert match_overlap(one, other, (110.0, 0.0), 2) is None


def captures(patterns: list[Plane], expected: list[tuple[float, float]]) -> list[Capture]:
    """PSFs of which all but the first may be up to 6 pixels off."""
    return [
        Capture(torch.from_numpy(pattern)[None], shift, 6.0 if number else 0.0)
        for number, (pattern, shift) in enumerate(zip(patterns, expected, strict=True))
    ]


@pytest.mark.parametrize("bin_by", [1, 2])
def test_all_shifts_together(bin_by: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One overlap that leads astray is outvoted; a pattern that fits none is refused."""
    monkeypatch.setattr("nolens.calibrate.stitch._LONGEST", 150 / bin_by)
    truth = [(0.0, 0.0), (31.4, 2.2), (-28.7, 5.9), (3.3, 40.1), (-4.4, -38.8)]
    patterns = [view(canvas(), each) for each in truth]
    expected = [(a + 4.0, b - 3.0) if (a, b) != (0.0, 0.0) else (a, b) for a, b in truth]
    shares: list[float] = []
    found = locate(captures(patterns, expected), 0, shares.append)
    assert shares[-1] == 1 and shares == sorted(shares)
    for shift, wanted in zip(found.shifts, truth, strict=True):
        assert math.dist(shift, wanted) < 0.05 * bin_by
    assert found.residual < 0.1 * bin_by and len(found.overlaps) == 10
    between = (truth[3][0] - truth[1][0], truth[3][1] - truth[1][1])
    assert found.overlaps[1, 3].shift == pytest.approx(between, abs=0.1 * bin_by)

    patterns[3] = view(canvas(1), truth[3])
    with pytest.raises(DataError, match="does not fit the others"):
        locate(captures(patterns, expected), 0)
