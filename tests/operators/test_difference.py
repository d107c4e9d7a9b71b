"""Finite differences at known values."""

import torch

from nolens.operators import FiniteDifference


def test_differences_to_the_next_row_and_column():
    v = torch.tensor([[1.0, 4.0, 9.0], [0.0, 0.0, 5.0]])
    down, right = FiniteDifference((2, 3))(v)
    assert down.tolist() == [[-1, -4, -4], [1, 4, 4]]
    assert right.tolist() == [[3, 5, -8], [0, 5, -5]]


def test_uniform_scene_has_none():
    assert not FiniteDifference((4, 5))(torch.full((3, 4, 5), 2.5)).any()
