"""The objective both sides are judged by, in float64 numpy, written once.

For each channel, with b and the PSF scaled to unit l2 norm, M the periodic convolution on the whole
domain and C the crop to the sensor in its middle,

    f(v) = 1/2 ||b - C M v+||^2 + tau ||Psi v+||_1,    v+ = max(v, 0),

where Psi takes the periodic finite differences along both axes. The domain is what the iterate
spans. The middle of the PSF (row h // 2, column w // 2 of its frame) is the zero shift.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import fft

Array = npt.NDArray[np.float64]


class Objective:
    """f(v) for one measurement; arrays are (channels, height, width)."""

    def __init__(self, psf: npt.ArrayLike, data: npt.ArrayLike, tau: float) -> None:
        self.psf = unit_norm(np.asarray(psf, dtype=np.float64))
        self.data = unit_norm(np.asarray(data, dtype=np.float64))
        self.tau = tau
        self._transfer: dict[tuple[int, int], npt.NDArray[np.complex128]] = {}

    def __call__(self, iterate: npt.ArrayLike) -> float:
        """The objective of the non-negative part, mean over channels; NaN stays NaN."""
        scene = np.maximum(np.asarray(iterate, dtype=np.float64), 0.0)
        shape = scene.shape[-2:]
        spectrum = fft.rfft2(scene) * self._transfer_on(shape)
        predicted = fft.irfft2(spectrum, s=shape)[(..., *window(shape, self.data.shape[-2:]))]
        misfit = 0.5 * float(np.sum((self.data - predicted) ** 2))
        return (misfit + self.tau * total_variation(scene)) / len(scene)

    def _transfer_on(self, shape: tuple[int, int]) -> npt.NDArray[np.complex128]:
        if shape not in self._transfer:
            kernel = np.zeros((self.psf.shape[0], *shape))
            height, width = self.psf.shape[-2:]
            kernel[:, :height, :width] = self.psf
            kernel = np.roll(kernel, (-(height // 2), -(width // 2)), axis=(-2, -1))
            self._transfer = {shape: fft.rfft2(kernel)}
        return self._transfer[shape]


def unit_norm(stack: Array) -> Array:
    """Every channel divided by its l2 norm."""
    return stack / np.sqrt(np.sum(stack**2, axis=(-2, -1), keepdims=True))


def total_variation(scene: Array) -> float:
    """Sum of the absolute periodic finite differences along both axes."""
    rows = np.abs(scene - np.roll(scene, 1, axis=-2)).sum()
    columns = np.abs(scene - np.roll(scene, 1, axis=-1)).sum()
    return float(rows + columns)


def window(domain: tuple[int, int], sensor: tuple[int, int]) -> tuple[slice, slice]:
    """The sensor's cells, in the middle of the domain."""
    top, left = (domain[0] - sensor[0]) // 2, (domain[1] - sensor[1]) // 2
    return slice(top, top + sensor[0]), slice(left, left + sensor[1])
