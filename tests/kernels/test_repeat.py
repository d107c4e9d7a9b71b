"""Iterations in a row: as the plain loop has them, for every prior, and on CUDA as a graph."""

import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
import torch
from update_cases import BASE, Case, Triple, arrays, draw

from nolens.kernels import (
    PassSums,
    Repeater,
    SplitState,
    admm_numba,
    admm_torch,
    fft2_,
    ifft2_,
    solve_normal_equation_,
    update_splits_,
)
from nolens.kernels.admm import Step, iterate_, step_constants
from nolens.kernels.threads import take_turns

RELAXATION = 1.7
PENALTIES: list[Triple] = [(0.3, 2.0, 0.7), (0.5, 1.5, 0.9)]
CASES = {
    "tv": BASE,
    "isotropic": replace(BASE, isotropic=True, support=(4, 3, 5, 6)),
    "l1": replace(BASE, tv=0.0, l1=0.3),
    "no prior, odd": replace(BASE, tv=0.0, size=(9, 7), sensor=(2, 1, 5, 5), support=(0, 0, 9, 7)),
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


def in_a_loop(of: Channels, steps: list[Step]) -> tuple[list[torch.Tensor], list[PassSums]]:
    pairs, states, transfers = of
    pairs = [pair.clone() for pair in pairs]
    sums: list[PassSums] = []
    for penalties, following, counted in steps:
        sums = []
        for channel, (state, transfer) in enumerate(zip(states, transfers, strict=True)):
            pair = ifft2_(solve_normal_equation_(fft2_(pairs[channel]), transfer, penalties))
            pairs[channel], seen = update_splits_(
                pair, state, penalties, following, RELAXATION, counted=counted
            )
            sums += [seen] if seen is not None else []
    return pairs, sums


def alike(penalties: Triple, times: int) -> list[Step]:
    return [(penalties, penalties, False)] * times


FIRST, SECOND = PENALTIES
RUNS: list[list[Step]] = [
    [*alike(FIRST, 3), (FIRST, SECOND, True)],
    [],
    [(SECOND, FIRST, False)],
    [(FIRST, SECOND, False), *alike(SECOND, 3), (SECOND, SECOND, True)],
]


def equal(one: torch.Tensor, two: torch.Tensor) -> None:
    assert torch.equal(one, two)


def close(one: torch.Tensor, two: torch.Tensor) -> None:
    torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-4)


def check_runs(case: Case, device: str, check: Check) -> None:
    """Runs of several lengths, of none, with other penalties, and with another measurement."""
    here, there = channels(case, device), channels(case, device)
    repeater = Repeater(here[1], here[2], RELAXATION)
    pairs, expected = here[0], there[0]
    for run, steps in enumerate(RUNS):
        if run == 3:
            for state in (*here[1], *there[1]):
                state.data = state.data.flip(0).contiguous()
        pairs, sums = repeater.run(pairs, steps)
        expected, wanted_sums = in_a_loop((expected, *there[1:]), steps)
        assert len(sums) == (len(pairs) if steps and steps[-1][2] else 0)
        for got_sums, one_sums in zip(sums, wanted_sums, strict=True):
            assert vars(got_sums).keys() == vars(one_sums).keys()
            assert got_sums.residual == pytest.approx(one_sums.residual, rel=1e-4)
            assert got_sums.split == pytest.approx(one_sums.split, rel=1e-4)
        for one, two in zip(pairs, expected, strict=True):
            check(one, two)
        for one, two in zip(here[1], there[1], strict=True):
            for got, wanted in zip(arrays(one), arrays(two), strict=True):
                check(got, wanted)


@each_case
def test_repeater_is_the_plain_loop(case):
    check_runs(case, "cpu", equal)


@each_case
def test_channels_that_take_turns_are_the_plain_loop(case):
    torch.set_num_threads(2)
    check_runs(case, "cpu", equal)


def test_turns_are_in_order_and_none_is_left_out():
    torch.set_num_threads(2)
    seen: list[tuple[int, int]] = []
    take_turns(lambda chain, number: seen.append((chain, number)), 5, 7)
    assert [[n for c, n in seen if c == chain] for chain in range(5)] == [list(range(7))] * 5


@pytest.mark.parametrize("threads", [1, 2])
def test_what_fails_in_a_turn_is_raised(threads):
    def work(chain: int, number: int) -> None:
        if (chain, number) == (1, 2):
            raise ValueError("broken")

    torch.set_num_threads(threads)
    with pytest.raises(ValueError, match="broken"):
        take_turns(work, 3, 4)


def test_an_interrupt_ends_the_turns():
    """Ctrl-C is raised in the first thread; the others do not go on for the rest of a stretch."""
    done: list[int] = []

    def work(chain: int, number: int) -> None:
        if (chain, number) == (1, 1):
            os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        done.append(number)

    torch.set_num_threads(2)
    with pytest.raises(KeyboardInterrupt):
        take_turns(work, 2, 300)
    ended = len(done)
    assert ended < 300
    time.sleep(0.05)
    assert len(done) == ended


def test_torch_has_one_thread_in_turns_alone():
    torch.set_num_threads(2)
    seen: list[int] = []
    take_turns(lambda chain, number: seen.append(torch.get_num_threads()), 3, 2)
    assert seen == [1] * 6
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(torch.get_num_threads).result() == 2
    assert torch.get_num_threads() == 2


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_turns_after_a_fork():
    """The child has none of the pool's threads."""
    torch.set_num_threads(2)
    take_turns(lambda chain, number: None, 3, 2)
    child = os.fork()
    if child == 0:
        seen: list[int] = []
        take_turns(lambda chain, number: seen.append(number), 3, 2)
        os._exit(0 if len(seen) == 6 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@on_cuda
@each_case
def test_graph_is_the_plain_loop(case):
    check_runs(case, "cuda", close)


@on_cuda
def test_graph_on_cuda_is_the_loop_on_the_cpu():
    case = CASES["tv"]
    pairs, states, transfers = channels(case, "cuda")
    steps = alike(PENALTIES[0], 5)
    pairs, _ = Repeater(states, transfers, RELAXATION).run(pairs, steps)
    expected, _ = in_a_loop(channels(case), steps)
    for one, two in zip(pairs, expected, strict=True):
        close(one.cpu(), two)


@each_case
@pytest.mark.parametrize("module", [admm_numba, admm_torch], ids=["numba", "torch"])
def test_iteration_with_constants_in_a_tensor(case, module, monkeypatch):
    """What a graph captures, on the CPU."""
    monkeypatch.setattr("nolens.kernels.admm.passes_for", lambda field: module)
    pairs, states, transfers = channels(case)
    expected, _ = in_a_loop(channels(case), alike(PENALTIES[1], 3))
    constants = torch.tensor(
        [step_constants(each, PENALTIES[1], PENALTIES[1], RELAXATION) for each in states]
    )
    for _ in range(3):
        iterate_(pairs, states, transfers, constants)
    for one, two in zip(pairs, expected, strict=True):
        close(one, two)
