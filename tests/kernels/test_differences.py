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
def test_map_and_pull(count, functional, shrinkage, size):
    (changed, a), targets = draw(count, size), torch.randn(count, *size)
    u = functional.prox(a, shrinkage.step)
    pulled = 0.7 * FiniteDifference(size).H(2 * u - a) + targets.double()
    differences.shrink_differences_(
        changed, shrinkage, kept=1.0, added=-1.5, targets=targets, penalty=0.7
    )
    close(targets, pulled)
    close(changed, a - 1.5 * u)


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize(("count", "functional", "shrinkage"), CASES.values(), ids=CASES)
def test_map_alone_and_sums(count, functional, shrinkage, size):
    (changed, a), (before, a_then) = draw(count, size), draw(count, size)
    scenes = torch.randn(count, *size)
    varied = FiniteDifference(size)(scenes.double())
    u, u_then = (functional.prox(each, shrinkage.step) for each in (a, a_then))
    parts = varied - u, u, u - u_then, (a - u) - (a_then - u_then)
    expected = torch.stack([each.square().sum(dim=(1, 2, 3)) for each in parts], -1)
    sums, variation = differences.difference_sums(changed, before, scenes, shrinkage)
    torch.testing.assert_close(torch.tensor(sums).double(), expected, rtol=1e-4, atol=0)
    assert variation == pytest.approx(float(functional(varied)), rel=1e-5)
    differences.shrink_differences_(changed, shrinkage, kept=0.3, added=0.7)
    close(changed, torch.lerp(u, a, 0.3))


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_add(size):
    (changed, a), scene = draw(1, size), torch.randn(size)
    differences.add_differences_(changed[0], scene, 1.5)
    close(changed[0], a[0] + 1.5 * FiniteDifference(size)(scene.double()))
