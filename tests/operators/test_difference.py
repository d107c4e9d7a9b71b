"""Finite differences at known values."""

import torch

from nolens.operators import FiniteDifference, difference


def test_differences_to_the_next_row_and_column():
    v = torch.tensor([[1.0, 4.0, 9.0], [0.0, 0.0, 5.0]])
    down, right = FiniteDifference((2, 3))(v)
    assert down.tolist() == [[-1, -4, -4], [1, 4, 4]]
    assert right.tolist() == [[3, 5, -8], [0, 5, -5]]


def test_uniform_scene_has_none():
    assert not FiniteDifference((4, 5))(torch.full((3, 4, 5), 2.5)).any()


def test_bands_are_its_rows(monkeypatch):
    """One row at a time, two of five, and all at once."""
    v = torch.rand(3, 5, 4)
    for pixels in (1, 8, 100):
        monkeypatch.setattr(difference, "_BAND", pixels)
        rows = torch.cat(list(FiniteDifference((5, 4)).bands(v)), dim=-2)
        assert torch.equal(rows, FiniteDifference((5, 4))(v))
