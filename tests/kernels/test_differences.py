"""The split of differences, compiled and by torch, against functionals and operators in float64."""

import pytest
import torch

from nolens.kernels import Coupling, Shrinkage, differences
from nolens.operators import FiniteDifference
from nolens.solvers.functionals import L1, Functional, GroupSparsity, OpponentL1

SIZES = [(7, 5), (300, 211)]  # One block of rows, and many.
COLOURS = OpponentL1(-4, mean=0.8, colour=1.3)
CASES: dict[str, tuple[int, Functional, Shrinkage]] = {
    "each": (2, L1(), Shrinkage(Coupling.NONE, 0.4)),
    "directions": (2, GroupSparsity(-3), Shrinkage(Coupling.DIRECTIONS, 0.4)),
    "colours": (3, COLOURS, Shrinkage(Coupling.COLOURS, 0.4, (0.8, 1.3, 1.3))),
}


@pytest.fixture(params=["compiled", "torch"], autouse=True)
def _way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    torch.set_num_threads(2)
    if request.param == "torch":
        monkeypatch.setattr(differences, "_compiled", lambda _: False)
        monkeypatch.setattr(differences, "_BAND", 1000)


def draw(count: int, size: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
    """A of channels, and the same in float64."""
    a = torch.randn(count, 2, *size)
    return a, a.double()


def close(left: torch.Tensor, right: torch.Tensor) -> None:
    torch.testing.assert_close(left.double(), right, rtol=1e-5, atol=2e-6)


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize(("count", "functional", "shrinkage"), CASES.values(), ids=CASES)
def test_pull_and_scaled_multipliers(count, functional, shrinkage, size):
    (changed, a), targets = draw(count, size), torch.randn(count, *size)
    u = functional.prox(a, shrinkage.step)
    pulled = 0.7 * FiniteDifference(size).H(2 * u - a) + targets.double()
    differences.add_pulls_(targets, changed, shrinkage, 0.7)
    close(targets, pulled)
    assert torch.equal(changed.double(), a)
    differences.scale_multipliers_(changed, shrinkage, 0.3)
    close(changed, u + 0.3 * (a - u))


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize(("count", "functional", "shrinkage"), CASES.values(), ids=CASES)
def test_move_and_sums(count, functional, shrinkage, size):
    (changed, a_then), scenes = draw(count, size), torch.randn(count, *size)
    uncounted = changed.clone()
    varied = FiniteDifference(size)(scenes.double())
    u_then = functional.prox(a_then, shrinkage.step)
    a = a_then + 1.5 * (varied - u_then)
    u = functional.prox(a, shrinkage.step)
    parts = varied - u, u, u - u_then, (a - u) - (a_then - u_then)
    expected = torch.stack([each.square().sum(dim=(1, 2, 3)) for each in parts], -1)
    sums, variation = differences.move_differences_(changed, scenes, shrinkage, 1.5, counted=True)
    close(changed, a)
    torch.testing.assert_close(torch.tensor(sums).double(), expected, rtol=1e-4, atol=0)
    assert variation == pytest.approx(float(functional(varied)), rel=1e-5)
    differences.move_differences_(uncounted, scenes, shrinkage, 1.5, counted=False)
    close(uncounted, a)
