"""Iterations in a row: as the plain loop has them, for every prior, and on CUDA as a graph."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from update_cases import BASE, Case, Triple, arrays, draw

from nolens.kernels import (
    Repeater,
    SplitState,
    admm_torch,
    fft2_,
    ifft2_,
    solve_normal_equation_,
    update_splits_,
)
from nolens.kernels.repeat import iterate_

RELAXATION = 1.7
PENALTIES: list[Triple] = [(0.3, 2.0, 0.7), (0.5, 1.5, 0.9)]
CASES = {
    "tv": BASE,
    "isotropic": replace(BASE, isotropic=True, region=(4, 3, 5, 6)),
    "l1": replace(BASE, tv=0.0, l1=0.3),
    "no prior, odd": replace(BASE, tv=0.0, size=(9, 7), sensor=(2, 1, 5, 5), region=(0, 0, 9, 7)),
}
each_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
on_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")

Channels = tuple[list[torch.Tensor], list[SplitState], list[torch.Tensor]]
Check = Callable[[torch.Tensor, torch.Tensor], None]


def channels(case: Case, device: str = "cpu") -> Channels:
    """Pairs, states and transfer functions of two channels."""
    generator = torch.Generator().manual_seed(5)
    drawn = [draw(case, device) for _ in range(2)]
    drawn[1][1].scene *= -0.5
    transfers = [
        torch.fft.rfft2(torch.rand(case.size, generator=generator) / 9).to(device) for _ in drawn
    ]
    return [pair for pair, _ in drawn], [state for _, state in drawn], transfers


def in_a_loop(of: Channels, penalties: Triple, times: int) -> list[torch.Tensor]:
    pairs, states, transfers = of
    pairs = [pair.clone() for pair in pairs]
    for _ in range(times):
        for channel, (state, transfer) in enumerate(zip(states, transfers, strict=True)):
            pair = ifft2_(solve_normal_equation_(fft2_(pairs[channel]), transfer, penalties))
            pairs[channel], _ = update_splits_(
                pair, state, penalties, penalties, RELAXATION, counted=False
            )
    return pairs


def equal(one: torch.Tensor, two: torch.Tensor) -> None:
    assert torch.equal(one, two)


def close(one: torch.Tensor, two: torch.Tensor) -> None:
    torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-4)


def check_runs(case: Case, device: str, check: Check) -> None:
    """Runs of several lengths, of none, with other penalties, and with another measurement."""
    here, there = channels(case, device), channels(case, device)
    repeater = Repeater(here[1], here[2], RELAXATION)
    pairs, expected = here[0], there[0]
    for run, times in enumerate((3, 0, 1, 4)):
        if run == 3:
            for state in (*here[1], *there[1]):
                state.data = state.data.flip(0).contiguous()
        penalties = PENALTIES[run % 2]
        pairs = repeater.run(pairs, penalties, times)
        expected = in_a_loop((expected, *there[1:]), penalties, times)
        for one, two in zip(pairs, expected, strict=True):
            check(one, two)
        for one, two in zip(here[1], there[1], strict=True):
            for got, wanted in zip(arrays(one), arrays(two), strict=True):
                check(got, wanted)


@each_case
def test_repeater_is_the_plain_loop(case):
    check_runs(case, "cpu", equal)


@on_cuda
@each_case
def test_graph_is_the_plain_loop(case):
    check_runs(case, "cuda", close)


@on_cuda
def test_graph_on_cuda_is_the_loop_on_the_cpu():
    case = CASES["tv"]
    pairs, states, transfers = channels(case, "cuda")
    pairs = Repeater(states, transfers, RELAXATION).run(pairs, PENALTIES[0], 5)
    expected = in_a_loop(channels(case), PENALTIES[0], 5)
    for one, two in zip(pairs, expected, strict=True):
        close(one.cpu(), two)


@each_case
def test_iteration_with_constants_in_a_tensor(case):
    """What a graph captures, with torch's passes on the CPU."""
    pairs, states, transfers = channels(case)
    expected = in_a_loop(channels(case), PENALTIES[1], 3)
    step = (PENALTIES[1], PENALTIES[1], RELAXATION)
    constants = torch.tensor(
        [admm_torch.step_constants((each.tv, each.isotropic, each.l1), step) for each in states]
    )
    for _ in range(3):
        iterate_(pairs, states, transfers, constants)
    for one, two in zip(pairs, expected, strict=True):
        close(one, two)
