r"""ADMM's iterations of all channels, on any device: transforms, and two passes between them.

The iteration, in the Douglas-Rachford form of ADMM with over-relaxation (`eckstein1992`,
`boyd2011`), keeps one array `a` per split. With the splits x = Mv, u = Ψv, w = v, their
penalties μ and the proximal maps prox of the three terms of the objective,

    x = prox(a),  q = 2x - a,
    v = argmin Σ μ/2 ‖K v - q‖²          (`solve_normal_equation_`, in the Fourier domain)
    a ← a + α (K v - x)                  (`update_splits_`)

for every split K in {M, Ψ, 1}. The scaled multiplier is d = a - x, so nothing else is stored.
The two real fields that go into the transforms ride as real and imaginary part of one complex
field: (q_x, μ₂Ψᵀq_u + μ₃q_w) on the way there and (v, Mv) on the way back.

On the CPU channels take turns on the threads, where there are no more threads than channels: an
iteration of one channel then waits for no other thread, which matters while the cores have other
work too.

On CUDA an iteration is some ten short kernels a channel, which the processor takes longer to
launch than a small padded shape takes to compute. So one iteration of all channels, with penalties
that stay and no sums, is captured as a CUDA graph and replayed. A graph works on the memory that it
was captured with: it has pairs of its own, and reads the constants of the update from the device,
so that other penalties need no other graph.

Every module of passes (`passes_for`) has the same two functions, which take a pass's constants as
a tensor on the device; those of `admm_torch` say what they do.
"""

import functools
import importlib
import importlib.util
import itertools
import warnings
from dataclasses import dataclass
from types import ModuleType

import torch
from torch import Tensor

from nolens.kernels.fft import Window, fft2_, ifft2_
from nolens.kernels.threads import take_turns

Triple = tuple[float, float, float]

Step = tuple[Triple, Triple, bool]
"""Penalties of an iteration, those of the next one, and whether its sums are needed."""


@dataclass
class SplitState:
    """One channel's arrays and the constants of its objective.

    Parameters
    ----------
    data
        Measurement, (height, width) of the sensor.
    valid
        1 where the measurement takes part in the fit, 0 where a pixel is saturated; uint8.
    sensor, support
        Where the sensor, and the pixels that light can come from, lie in the padded shape.
    tv, isotropic, l1
        Weight of the total variation, its kind, and weight of the ℓ1 norm.
    measured, rows, columns, scene
        The arrays `a` of the splits x = Mv, u = Ψv (its two directions) and w = v, of the
        padded shape's size. `rows` and `columns` are empty where `tv` is zero; `measured` has the
        sensor's size where the measurement is in the linear step, and is no split there.
    """

    data: Tensor
    valid: Tensor
    sensor: Window
    support: Window
    tv: float
    isotropic: bool
    l1: float
    measured: Tensor
    rows: Tensor
    columns: Tensor
    scene: Tensor

    @property
    def light(self) -> Tensor:
        """X on the sensor: a part of `measured`."""
        top, left, height, width = self.sensor
        whole = self.measured.shape == self.data.shape
        return self.measured if whole else self.measured[top : top + height, left : left + width]

    def estimate(self, penalty: float) -> Tensor:
        """Scene w = prox(a) of the last split on the support's pixels: non-negative."""
        top, left, height, width = self.support
        inside = self.scene[top : top + height, left : left + width]
        return (inside - self.l1 / penalty).clamp_min_(0)

    def rescale_(self, penalties: Triple, following: Triple) -> None:
        """Write the state for other penalties: the splits and the multipliers μd are kept."""
        still = torch.zeros_like(self.scene, dtype=torch.complex64)
        update_splits_(still, self, penalties, following, 0.0, counted=False)


@dataclass(frozen=True)
class PassSums:
    """Sums over all pixels that `update_splits_` gathers, each a tuple (x, u, w) by split.

    `primal` is Σ(Kv - x)², `split` Σx², `change` Σ(x - x_before)² and `multiplier_change`
    Σ(d - d_before)²; `residual` is Σ(b - CMv)² over the
    valid pixels, `variation` ‖Ψv‖₁ and `magnitude` ‖v‖₁.
    """

    primal: Triple
    split: Triple
    change: Triple
    multiplier_change: Triple
    residual: float
    variation: float
    magnitude: float

    @classmethod
    def of(cls, sums: list[float]) -> "PassSums":
        """Sums in the order of the passes: four of (x, u, w), then the last three."""
        primal, split, change, multiplier_change = (
            (sums[k], sums[k + 1], sums[k + 2]) for k in range(0, 12, 3)
        )
        return cls(primal, split, change, multiplier_change, *sums[12:])


def step_constants(
    state: SplitState, penalties: Triple, next_penalties: Triple, relaxation: float
) -> list[float]:
    """Constants of an update: μ of (x, u, w), their following values, their ratios, α, τ and λ.

    Parameters
    ----------
    state
        Of the channel, for the weights of its prior.
    penalties, next_penalties
        Those with which v was computed, and those of the next iteration.
    relaxation
        α in (0, 2).
    """
    # With no penalty on a split its multiplier is absent, and 0/0 would be the rescaling.
    rescale = [
        now / later if later > 0 else 1.0
        for now, later in zip(penalties, next_penalties, strict=True)
    ]
    return [*penalties, *next_penalties, *rescale, relaxation, state.tv, state.l1]


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, penalties: Triple) -> Tensor:
    r"""Solve (μ₁MᵀM + μ₂ΨᵀΨ + μ₃) v = μ₁Mᵀq_x + r at every frequency, in place.

    Parameters
    ----------
    spectrum
        Full spectrum of q_x + i r, (height, width) of the padded shape, complex64; replaced by the
        spectrum of v + i Mv.
    transfer
        Half spectrum of the PSF, (height, width // 2 + 1).
    penalties
        μ₁, μ₂, μ₃.
    """
    constants = _on_device([*penalties], spectrum.device)
    result: Tensor = passes_for(spectrum).solve_normal_equation_(spectrum, transfer, constants)
    return result


def update_splits_(
    pair: Tensor,
    state: SplitState,
    penalties: Triple,
    next_penalties: Triple,
    relaxation: float,
    *,
    counted: bool = True,
) -> tuple[Tensor, PassSums | None]:
    """Update every split from (v, Mv), and prepare (q_x, r) of the next iteration, in place.

    Parameters
    ----------
    pair
        v + i Mv over the padded shape; replaced by q_x + i r.
    state
        Arrays of this channel, updated.
    penalties
        Those with which v was computed.
    next_penalties
        Those of the next iteration; the multipliers are rescaled so that μd is unchanged.
    relaxation
        α in (0, 2); 1 is plain ADMM.
    counted
        Whether the sums are needed: they are a third of the work, and on CUDA the wait for them.
    """
    constants = step_constants(state, penalties, next_penalties, relaxation)
    sums: list[float] | None = passes_for(pair).update_splits_(
        pair, state, _on_device(constants, pair.device), counted=counted, out=pair
    )
    return pair, None if sums is None else PassSums.of(sums)


def passes_for(field: Tensor) -> ModuleType:
    """The passes for a field: numba's on the CPU; Triton's on CUDA where it runs, else torch's."""
    if field.device.type == "cpu":
        return importlib.import_module("nolens.kernels.admm_numba")
    # Triton's offsets are 32 bits wide, and a complex pixel is two numbers.
    if field.device.type == "cuda" and field.numel() < 2**30 and _triton_runs(field.device):
        return importlib.import_module("nolens.kernels.admm_triton")
    return importlib.import_module("nolens.kernels.admm_torch")


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
        rows = [
            step_constants(state, penalties, penalties, self._relaxation) for state in self._states
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
        `step_constants` of every channel, float32, on the pairs' device.
    """
    for pair, state, transfer, row in zip(pairs, states, transfers, constants, strict=True):
        passes = passes_for(pair)
        spectrum = passes.solve_normal_equation_(fft2_(pair), transfer, row)
        passes.update_splits_(ifft2_(spectrum), state, row, counted=False, out=pair)


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


def _on_device(constants: list[float], device: torch.device) -> Tensor:
    """Constants on their way to the device, without waiting for what it still computes."""
    return torch.tensor(constants, dtype=torch.float32).to(device, non_blocking=True)


@functools.cache
def _triton_runs(device: torch.device) -> bool:
    """Whether Triton is installed and can compile for the device; it needs a C compiler too."""
    if importlib.util.find_spec("triton") is None:
        return False
    field = torch.zeros(1, 1, dtype=torch.complex64, device=device)
    try:
        passes = importlib.import_module("nolens.kernels.admm_triton")
        passes.solve_normal_equation_(field, field.clone(), torch.ones(3, device=device))
    except Exception as error:
        warnings.warn(f"Triton does not run here, torch's passes do: {error}", stacklevel=2)
        return False
    return True
