"""ADMM's iterations from one look to the next, of all channels.

On the CPU channels take turns on the threads, where there are no more threads than channels: an
iteration of one channel then waits for no other thread, which matters while the cores have other
work too.

On CUDA an iteration is some ten short kernels a channel, which the processor takes longer to
launch than a small period takes to compute. So one iteration of all channels, with penalties that
stay and no sums, is captured as a CUDA graph and replayed. A graph works on the memory that it was
captured with: it has pairs of its own, and reads the constants of the update from the device, so
that other penalties need no other graph.
"""

import itertools

import torch
from torch import Tensor

from nolens.kernels import admm_torch
from nolens.kernels.admm import (
    PassSums,
    SplitState,
    Triple,
    device_passes,
    solve_normal_equation_,
    update_on_device_,
    update_splits_,
)
from nolens.kernels.fft import fft2_, ifft2_
from nolens.kernels.threads import take_turns

Step = tuple[Triple, Triple, bool]
"""Penalties of an iteration, those of the next one, and whether its sums are wanted."""


class Repeater:
    """Runs iterations of all channels.

    Parameters
    ----------
    states
        Of every channel; they are updated in place.
    transfers
        Half spectrum of the PSF of every channel.
    relaxation
        α in (0, 2).
    """

    def __init__(
        self, states: list[SplitState], transfers: list[Tensor], relaxation: float
    ) -> None:
        self._states = states
        self._transfers = transfers
        self._relaxation = relaxation
        self._graph: _Graph | None = None

    def run(self, pairs: list[Tensor], steps: list[Step]) -> tuple[list[Tensor], list[PassSums]]:
        """Iterate; returns the pairs, and the sums of every channel, of the last step alone.

        Parameters
        ----------
        pairs
            q_x + i r of every channel for the first step's penalties; not to be used afterwards,
            as those returned may lie elsewhere. On CUDA they may be the repeater's, and the next
            run overwrites them.
        steps
            One for each iteration.
        """
        pairs = list(pairs)
        sums: list[PassSums | None] = [None] * len(pairs)
        if pairs and pairs[0].device.type == "cuda":
            for step, alike in itertools.groupby(steps):
                times = len(list(alike))
                if step[0] == step[1] and not step[2]:
                    pairs = self._replay(pairs, step[0], times)
                    continue
                for channel in list(range(len(pairs))) * times:
                    sums[channel] = self._iterate(pairs, channel, step)
        else:

            def advance(channel: int, number: int) -> None:
                sums[channel] = self._iterate(pairs, channel, steps[number])

            take_turns(advance, len(pairs), len(steps))
        return pairs, [each for each in sums if each is not None]

    def _iterate(self, pairs: list[Tensor], channel: int, step: Step) -> PassSums | None:
        """One iteration of one channel, whose pair is replaced."""
        penalties, following, counted = step
        pair = fft2_(pairs[channel])
        pair = ifft2_(solve_normal_equation_(pair, self._transfers[channel], penalties))
        pairs[channel], sums = update_splits_(
            pair, self._states[channel], penalties, following, self._relaxation, counted=counted
        )
        return sums

    def _replay(self, pairs: list[Tensor], penalties: Triple, times: int) -> list[Tensor]:
        step = (penalties, penalties, self._relaxation)
        rows = [
            admm_torch.step_constants((state.tv, state.isotropic, state.l1), step)
            for state in self._states
        ]
        if self._graph is None or not self._graph.fits(self._states):
            self._graph = _Graph(self._states, self._transfers)
        return self._graph.run(pairs, torch.tensor(rows, dtype=torch.float32), times)


def iterate_(
    pairs: list[Tensor], states: list[SplitState], transfers: list[Tensor], constants: Tensor
) -> None:
    """One iteration of every channel, without sums, in place.

    Parameters
    ----------
    pairs
        q_x + i r of every channel, replaced by those of the next iteration.
    states
        Of every channel, updated.
    transfers
        Half spectrum of the PSF of every channel.
    constants
        `admm_torch.step_constants` of every channel, float32, on the pairs' device.
    """
    for pair, state, transfer, row in zip(pairs, states, transfers, constants, strict=True):
        spectrum = device_passes(pair).solve_normal_equation_(fft2_(pair), transfer, row)
        update_on_device_(ifft2_(spectrum), state, row, counted=False, out=pair)


class _Graph:
    """One iteration of all channels, captured with the memory that it works on."""

    def __init__(self, states: list[SplitState], transfers: list[Tensor]) -> None:
        self._states = states
        self._transfers = transfers
        self._held = _tensors(states)
        self._pairs = [torch.empty_like(state.scene, dtype=torch.complex64) for state in states]
        self._constants = states[0].scene.new_empty(len(states), 12)
        self._captured: torch.cuda.CUDAGraph | None = None

    def fits(self, states: list[SplitState]) -> bool:
        """Whether the states are still in the memory that was captured."""
        return all(a is b for a, b in zip(self._held, _tensors(states), strict=True))

    def run(self, pairs: list[Tensor], constants: Tensor, times: int) -> list[Tensor]:
        for mine, pair in zip(self._pairs, pairs, strict=True):
            mine.copy_(pair)
        self._constants.copy_(constants, non_blocking=True)
        if self._captured is None:
            with torch.cuda.device(self._constants.device):
                self._captured = self._capture()
            times -= 1
        for _ in range(times):
            self._captured.replay()
        return list(self._pairs)

    def _capture(self) -> torch.cuda.CUDAGraph:
        """Iterate once, so that cuFFT has its plans and kernels are compiled, then capture."""
        stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            self._iterate()
        torch.cuda.current_stream().wait_stream(stream)
        graph = torch.cuda.CUDAGraph()
        # Other threads may go on using the device while this one captures.
        with torch.cuda.graph(graph, capture_error_mode="thread_local"):
            self._iterate()
        return graph

    def _iterate(self) -> None:
        iterate_(self._pairs, self._states, self._transfers, self._constants)


def _tensors(states: list[SplitState]) -> list[Tensor]:
    return [
        tensor
        for each in states
        for tensor in (each.data, each.valid, each.measured, each.rows, each.columns, each.scene)
    ]
