"""Nearest points on a torus, against scipy's periodic tree."""

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nolens.kernels import nearest_points

Pair = tuple[int, int]
SIZES = st.tuples(st.integers(1, 70), st.integers(1, 70))


def _check(points: NDArray[np.float64], cells: Pair, pitch: float) -> None:
    owner, squared = nearest_points(points, cells, pitch)
    assert owner.dtype == np.int32
    assert squared.dtype == np.float32
    assert owner.shape == squared.shape == cells
    size = np.array(cells) * pitch
    places = np.indices(cells).reshape(2, -1).T * pitch
    expected = cKDTree(points, boxsize=size).query(places)[0].reshape(cells)
    largest = float(size.max())
    np.testing.assert_allclose(np.sqrt(squared), expected, rtol=2e-7, atol=1e-7 * largest)
    # The owner is a point at that distance; which one, where two are as near, is left open.
    offset = places - points[owner.ravel()]
    offset -= size * np.round(offset / size)
    distance = np.hypot(offset[:, 0], offset[:, 1]).reshape(cells)
    np.testing.assert_allclose(distance, expected, rtol=1e-12, atol=1e-12 * largest)


@given(SIZES, st.integers(1, 90), st.floats(0.1, 3), st.integers(0, 10**6))
@example((1, 1), 1, 1.0, 0)
@example((1, 70), 3, 1.0, 0)
@example((70, 1), 40, 1.0, 0)
@example((65, 3), 2, 0.3, 0)
@example((33, 33), 1, 1.55, 0)
@settings(max_examples=150)
def test_uniform_points(cells, count, pitch, seed):
    points = np.random.default_rng(seed).uniform(size=(count, 2)) * cells * pitch
    _check(points, cells, pitch)


@given(
    SIZES,
    st.integers(1, 60),
    st.floats(1e-6, 0.2),
    st.tuples(st.floats(0, 0.999), st.floats(0, 0.999)),
    st.integers(0, 10**6),
)
@example((64, 64), 60, 1e-6, (0.0, 0.0), 0)
@example((70, 8), 60, 0.05, (0.999, 0.5), 0)
@settings(max_examples=150)
def test_clustered_points(cells, count, width, middle, seed):
    """All in one corner, or over an edge: most bins are empty, and one holds nearly all."""
    size = np.array(cells, dtype=np.float64)
    spread = np.random.default_rng(seed).normal(size=(count, 2)) * width
    points = (np.array(middle) + spread) % 1.0 * size
    _check(np.minimum(points, np.nextafter(size, 0)), cells, 1.0)


@pytest.mark.parametrize("copies", [1, 50])
def test_points_on_the_cells_themselves(copies):
    """Distance 0, also where many points are the same one."""
    points = np.repeat(np.array([[0.0, 0.0], [3.0, 9.0], [19.0, 29.0]]), copies, axis=0)
    owner, squared = nearest_points(points, (20, 30), 1.0)
    for number, (row, column) in enumerate([(0, 0), (3, 9), (19, 29)]):
        assert squared[row, column] == 0
        assert owner[row, column] // copies == number
    _check(points, (20, 30), 1.0)


def test_many_points_and_many_cells_in_threads():
    """The same with one thread and with more, over blocks of rows."""
    points = np.random.default_rng(1).uniform(size=(700, 2)) * (400, 300)
    found = []
    for threads in (1, 3):
        torch.set_num_threads(threads)
        found.append(nearest_points(points, (400, 300), 1.0))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])
    _check(points, (400, 300), 1.0)


def test_points_are_left_as_they_are():
    points = np.random.default_rng(1).uniform(size=(9, 2)) * 12
    kept = points.copy()
    nearest_points(points, (12, 12), 1.0)
    np.testing.assert_array_equal(points, kept)
