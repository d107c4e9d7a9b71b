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


def draw(count: int, size: tuple[int, int]) -> tuple[list[differences.Differences], torch.Tensor]:
    """Arrays of channels, and the same as one tensor in float64."""
    splits = [(torch.randn(size), torch.randn(size)) for _ in range(count)]
    return splits, torch.stack([torch.stack(split) for split in splits]).double()


def close(left: torch.Tensor, right: torch.Tensor) -> None:
    torch.testing.assert_close(left.double(), right, rtol=1e-5, atol=2e-6)


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize(("count", "functional", "shrinkage"), CASES.values(), ids=CASES)
def test_map_and_pull(count, functional, shrinkage, size):
    splits, a = draw(count, size)
    targets = [torch.randn(size) for _ in range(count)]
    u = functional.prox(a, shrinkage.step)
    pulled = 0.7 * FiniteDifference(size).H(2 * u - a) + torch.stack(targets).double()
    differences.shrink_differences_(
        splits, shrinkage, kept=1.0, added=-1.5, targets=targets, penalty=0.7
    )
    close(torch.stack(targets), pulled)
    close(torch.stack([torch.stack(split) for split in splits]), a - 1.5 * u)


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize(("count", "functional", "shrinkage"), CASES.values(), ids=CASES)
def test_map_alone_and_sums(count, functional, shrinkage, size):
    (splits, a), (before, a_then) = draw(count, size), draw(count, size)
    scenes = [torch.randn(size) for _ in range(count)]
    varied = FiniteDifference(size)(torch.stack(scenes).double())
    u, u_then = (functional.prox(each, shrinkage.step) for each in (a, a_then))
    parts = varied - u, u, u - u_then, (a - u) - (a_then - u_then)
    expected = [each.square().sum(dim=(1, 2, 3)).tolist() for each in parts]
    sums, variation = differences.difference_sums(splits, before, scenes, shrinkage)
    for got, wanted in zip(sums, zip(*expected, strict=True), strict=True):
        assert got == pytest.approx(wanted, rel=1e-4)
    assert variation == pytest.approx(float(functional(varied)), rel=1e-5)
    differences.shrink_differences_(splits, shrinkage, kept=0.3, added=0.7)
    close(torch.stack([torch.stack(split) for split in splits]), torch.lerp(u, a, 0.3))


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_add(size):
    ((split,), a), scene = draw(1, size), torch.randn(size)
    differences.add_differences_(split, scene, 1.5)
    close(torch.stack(split), a[0] + 1.5 * FiniteDifference(size)(scene.double()))
