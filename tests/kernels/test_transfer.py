"""The transfer function of layers: the compiled pass and torch's, against complex128."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from torch import Tensor

from nolens.kernels import LayerTransfer, apply_transfer_, transfer
from nolens.optics import transmittance

Pair = tuple[int, int]
LAYERS = st.lists(st.tuples(st.floats(0, 20_000), st.floats(1.0, 3.0)), max_size=4)
# Phases of some ten thousand turns are known to 1e-11 in float64; then float32 rounds.
TOLERANCE = 1e-6


@dataclass(frozen=True)
class Case:
    spectrum: Tensor
    transverse: tuple[Tensor, Tensor]
    linear: tuple[Tensor, Tensor]
    lengths: tuple[float, ...]
    squared: tuple[float, ...]
    limit: float
    media: tuple[float, ...] = ()

    @classmethod
    def random(
        cls, shape: Pair, layers: list[tuple[float, float]], seed: int, *, stopped: float = 0.1
    ) -> "Case":
        """Directions beyond the limit among them, and a share that nothing is to pass."""
        rng = np.random.default_rng(seed)
        squared = tuple(n for _, n in layers)
        # Every second case counts losses at the surfaces between its layers.
        media = tuple(float(np.sqrt(n)) for n in squared) if seed % 2 else ()
        limit = min((1.5, *squared)) * rng.uniform(0.5, 1)
        p = [rng.uniform(-1.2, 1.2, n) * np.sqrt(limit) for n in shape]
        for each in p:
            each[rng.uniform(size=len(each)) < stopped] = np.inf
        linear = [rng.uniform(-9000, 9000, n) for n in shape]
        spectrum = rng.normal(size=(*shape, 2)).astype(np.float32)
        return cls(
            torch.view_as_complex(torch.from_numpy(spectrum)),
            (torch.from_numpy(p[0]), torch.from_numpy(p[1])),
            (torch.from_numpy(linear[0]), torch.from_numpy(linear[1])),
            tuple(t for t, _ in layers),
            squared,
            limit,
            media,
        )

    def expected(self) -> NDArray[np.complex128]:
        p = self.transverse[0].numpy()[:, None] ** 2 + self.transverse[1].numpy() ** 2
        passes = p < self.limit
        inside = np.where(passes, p, 0)
        turns = self.linear[0].numpy()[:, None] + self.linear[1].numpy()
        for length, index in zip(self.lengths, self.squared, strict=True):
            turns = turns + length * np.sqrt(index - inside)
        turned: NDArray[np.complex128] = np.where(
            passes,
            self.spectrum.numpy().astype(np.complex128)
            * np.sqrt(transmittance(self.media, torch.from_numpy(inside)).numpy())
            * np.exp(2j * np.pi * turns),
            0,
        )
        return turned

    def arguments(self, device: str = "cpu") -> tuple[Tensor, LayerTransfer]:
        transverse, linear = (
            tuple(each.to(device) for each in pair) for pair in (self.transverse, self.linear)
        )
        spectrum = self.spectrum.clone().to(device)
        return spectrum, LayerTransfer(
            transverse, linear, self.lengths, self.squared, self.limit, self.media
        )


def _same(got: Tensor, expected: NDArray[np.complex128]) -> None:
    assert got.dtype == torch.complex64
    assert bool(torch.isfinite(torch.view_as_real(got)).all())
    error = np.abs(got.cpu().numpy() - expected).max()
    assert error <= TOLERANCE * max(1.0, np.abs(expected).max())
    np.testing.assert_array_equal(got.cpu().numpy()[expected == 0], 0)


@given(st.tuples(st.integers(1, 40), st.integers(1, 40)), LAYERS, st.integers(0, 10**6))
@example((1, 1), [], 0)
@example((32, 5), [(1.0, 1.0)], 1)
@example((33, 7), [(20_000.0, 2.1609), (900.0, 2.3104), (430.0, 1.0)], 2)
@settings(max_examples=100)
def test_against_complex128(shape, layers, seed):
    case = Case.random(shape, layers, seed)
    expected = case.expected()
    spectrum, layers_transfer = case.arguments()
    got = apply_transfer_(spectrum, layers_transfer)
    assert got.data_ptr() == spectrum.data_ptr()
    _same(got, expected)
    _same(transfer._on_device(*case.arguments()), expected)


def test_blocks_of_rows_in_threads():
    """More rows than a block on the CPU has, and than one on a device has."""
    case = Case.random((1111, 130), [(1900.0, 2.16), (890.0, 2.31), (430.0, 1.0)], 3)
    expected = case.expected()
    for threads in (1, 3):
        torch.set_num_threads(threads)
        _same(apply_transfer_(*case.arguments()), expected)
    _same(transfer._on_device(*case.arguments()), expected)


@pytest.mark.parametrize("apply", [apply_transfer_, transfer._on_device])
def test_nothing_passes_from_the_limit_on(apply):
    """The limit itself is shut, what lies just below is open, and so is p = 0."""
    below = np.nextafter(1.0, 0)
    p = torch.tensor([0.0, below, 1.0, 2.0, np.inf, -np.inf], dtype=torch.float64)
    zero = torch.zeros(1, dtype=torch.float64)
    spectrum = torch.ones(1, 6, dtype=torch.complex64)
    got = apply(
        spectrum, LayerTransfer((zero, p), (zero, torch.zeros_like(p)), (3000.0,), (1.0,), 1.0)
    )
    assert got.abs()[0].tolist() == pytest.approx([1, 1, 0, 0, 0, 0], abs=1e-6)
    got = apply(
        torch.ones(6, 1, dtype=torch.complex64),
        LayerTransfer((p, zero), (torch.zeros_like(p), zero), (3000.0,), (1.0,), 1.0),
    )
    assert got.abs()[:, 0].tolist() == pytest.approx([1, 1, 0, 0, 0, 0], abs=1e-6)


def test_every_fraction_of_a_turn():
    """Sines and cosines of the compiled pass over the circle and at its seams."""
    turns = torch.cat([torch.linspace(-2, 2, 4001), torch.tensor([0.25, 0.5, 0.75, -0.25, -0.5])])
    turns = turns.double()
    zero = torch.zeros(1, dtype=torch.float64)
    none = torch.zeros_like(turns)
    spectrum = torch.ones(1, len(turns), dtype=torch.complex64)
    got = apply_transfer_(spectrum, LayerTransfer((zero, none), (zero, turns), (), (), 1.0))[0]
    expected = torch.exp(2j * np.pi * turns)
    assert float((got - expected).abs().max()) < 2.5e-7


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
def test_transfer_on_cuda():
    case = Case.random((1111, 130), [(1900.0, 2.16), (890.0, 2.31), (430.0, 1.0)], 3)
    _same(apply_transfer_(*case.arguments("cuda")), case.expected())
