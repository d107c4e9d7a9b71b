"""Intervals of the mean difference of two methods cover the known one as often as they say."""

import numpy as np
import pytest

from nolens.evaluate import bootstrap_mean


@pytest.mark.parametrize("count", [8, 40])
def test_covers_the_known_difference(count: int) -> None:
    """Two methods on the same pictures, whose figures vary much more than they differ."""
    generator = np.random.default_rng(5)
    covered = 0
    for draw in range(100):
        pictures = generator.normal(20, 4, count)
        one = pictures + 0.5 + generator.exponential(0.6, count) - 0.6
        other = pictures + generator.normal(0, 0.4, count)
        found = bootstrap_mean(one - other, seed=draw)
        covered += found.low <= 0.5 <= found.high
    assert 90 <= covered <= 99


def test_seed_and_edges() -> None:
    values = np.array([1.0, 2.0, 4.0, 4.5])
    assert bootstrap_mean(values, seed=3) == bootstrap_mean(values, seed=3)
    assert np.isnan(bootstrap_mean(values[:3]).low) and bootstrap_mean(values[:1]).mean == 1
    same = bootstrap_mean(np.full(6, 0.25))
    assert (same.low, same.high) == (0.25, 0.25)
