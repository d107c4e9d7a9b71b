"""`magnified` against Gaussians that are known at every size, and against the twin."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from nolens.errors import OptionError
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import read_camera
from nolens.optics import PointSource
from nolens.optics.magnification import covered, magnified

CELLS = (61, 80)
SPOTS = ((-14.3, -20.2), (0.0, 0.0), (6.4, 22.7), (15.1, -3.6))


def gaussians(factor: float, moved: tuple[float, float] = (0, 0), sigma: float = 1.6) -> Tensor:
    """Spots at places and of widths that grow with the factor, each of the same energy."""
    rows, columns = np.mgrid[: CELLS[0], : CELLS[1]].astype(float)
    plane = np.zeros(CELLS)
    for row, column in SPOTS:
        at = CELLS[0] // 2 + factor * row + moved[0], CELLS[1] // 2 + factor * column + moved[1]
        squared = (rows - at[0]) ** 2 + (columns - at[1]) ** 2
        plane += np.exp(-squared / (2 * (sigma * factor) ** 2)) / factor**2
    return torch.from_numpy(plane)[None]


@given(
    factor=st.floats(0.75, 1.25), down=st.floats(-3, 3), right=st.floats(-3, 3),
    sigma=st.floats(1.5, 2.5),
)  # fmt: skip
def test_gaussians_are_gaussians(factor: float, down: float, right: float, sigma: float) -> None:
    got = magnified(gaussians(1.0, sigma=sigma), factor, moved=(down, right))
    wanted = gaussians(factor, (down, right), sigma)
    assert float((got - wanted).abs().max()) < 8e-3 * float(wanted.max())
    assert float(got.sum()) == pytest.approx(float(wanted.sum()), rel=5e-3)


def test_there_and_back() -> None:
    start = gaussians(1.0)
    back = magnified(magnified(start, 1.07), 1 / 1.07)
    assert torch.allclose(back, start, atol=1e-2)
    same = magnified(start, 1.0)
    assert torch.equal(same, start) and same is not start


def test_what_lies_beyond() -> None:
    even = torch.ones(1, *CELLS)
    for factor, moved in ((0.8, (0.0, 0.0)), (0.9, (2.0, -3.0)), (1.2, (0.0, 0.0))):
        inside = covered(CELLS, factor, moved=moved)
        shown = magnified(even, factor, moved=moved)[0] * factor**2
        assert bool(inside.all()) == (factor > 1)
        assert float(shown[~inside].sum()) <= 0.6 * int((~inside).sum())
        deep = covered(CELLS, factor * 0.85, moved=moved) & inside
        assert torch.allclose(shown[deep], torch.ones(int(deep.sum())), atol=1e-5)


@pytest.mark.parametrize("factor", [0.0, -1.0, math.inf, math.nan])
def test_no_magnification(factor: float) -> None:
    with pytest.raises(OptionError, match="magnification"):
        magnified(torch.ones(1, 8, 8), factor)


def test_the_twin_at_another_distance() -> None:
    """Wave optics at 25 mm and at 200 mm: the same pattern, larger by 1 + D/z."""
    bench = VirtualExperiment.of(read_camera("small"), light="550nm")
    cells = (128, 160)
    far, near = (bench.psf(PointSource(distance_um=z), cells)[1:2] for z in (200e3, 25e3))
    reduced = bench.twin.stack().reduced_um
    factor = (1 + reduced / 25e3) / (1 + reduced / 200e3)

    def error(picture: Tensor) -> float:
        scale = float((picture * near).sum() / picture.square().sum())
        return float((scale * picture - near).norm() / near.norm())

    assert error(far) > 0.25
    assert error(magnified(far, factor)) < 0.07
    assert error(magnified(far, 2 - factor)) > 0.4
