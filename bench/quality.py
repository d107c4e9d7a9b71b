"""PSNR of an iterate inside the cells of a known scene, in float64 numpy, written once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from objective import Array, window


class Quality:
    """PSNR after the one factor for each channel that fits best; the truth's peak is 1.

    Parameters
    ----------
    truth
        (channels, height, width) of the part of the scene that has light, in the middle of the
        sensor's frame.
    sensor
        (height, width) of that frame, which lies in the middle of the domain.
    """

    def __init__(self, truth: npt.ArrayLike, sensor: tuple[int, int]) -> None:
        self._truth: Array = np.asarray(truth, dtype=np.float64)
        self._sensor = sensor

    def __call__(self, iterate: npt.ArrayLike) -> float:
        """In dB, of the non-negative part of an iterate on its domain."""
        whole = np.asarray(iterate)
        frame = whole[(..., *window(whole.shape[-2:], self._sensor))]
        size = (self._truth.shape[-2], self._truth.shape[-1])
        part = np.maximum(frame[(..., *window(self._sensor, size))].astype(np.float64), 0.0)
        overlap = (part * self._truth).sum(axis=(-2, -1), keepdims=True)
        square = (part * part).sum(axis=(-2, -1), keepdims=True)
        fitted = part * (overlap / np.maximum(square, 1e-300))
        return float(-10 * np.log10(np.mean((fitted - self._truth) ** 2)))
