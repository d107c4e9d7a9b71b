"""Oracles in plain float64 numpy, written from the equations and not from the program.

`direct_sum` is eq. 6. `Reference` is one channel of eq. 7 with dense matrices over the period,
and its ADMM with every split and every multiplier in an array of its own. Only the layout
(which cell of the period is which) is taken from the program's `Geometry`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from nolens.operators import Geometry

Array = np.ndarray[Any, np.dtype[Any]]
Triple = tuple[float, float, float]


def direct_sum(v: Array, origin: tuple[int, int], psf: Array, sensor: tuple[int, int]) -> Array:
    """b[i] = Σ_s v[s] h[i − s + c], c = (height // 2, width // 2), with v[0, 0] at `origin`."""
    centre = (psf.shape[0] // 2, psf.shape[1] // 2)
    b = np.zeros(sensor)
    for row, column in np.argwhere(v):
        # PSF cell that falls on sensor cell (0, 0).
        top = centre[0] - (origin[0] + row)
        left = centre[1] - (origin[1] + column)
        i, j = max(0, -top), max(0, -left)
        lit = psf[i + top : max(sensor[0] + top, 0), j + left : max(sensor[1] + left, 0)]
        b[i : i + lit.shape[0], j : j + lit.shape[1]] += v[row, column] * lit
    return b


def used_part(psf: Array, geometry: Geometry) -> Array:
    """The PSF, zero where it carries no light from any scene cell to any sensor cell."""
    out = np.zeros_like(psf)
    (top, left), (height, width) = geometry.origin, geometry.scene[2:]
    rows, columns = geometry.sensor[2:]
    for i, j in product(range(psf.shape[0]), range(psf.shape[1])):
        y, x = i - psf.shape[0] // 2, j - psf.shape[1] // 2
        if top + y < rows and top + height + y > 0 and left + x < columns and left + width + x > 0:
            out[i, j] = psf[i, j]
    return out


def _window(full: tuple[int, int], window: tuple[int, int, int, int]) -> Array:
    mask = np.zeros(full, dtype=bool)
    top, left, height, width = window
    mask[top : top + height, left : left + width] = True
    return mask.ravel()


def _shifts(period: tuple[int, int], down: int, right: int) -> Array:
    """Matrix S with (S v)[i, j] = v[i − down, j − right], periodic."""
    cells = period[0] * period[1]
    numbers = np.arange(cells).reshape(period)
    matrix = np.zeros((cells, cells))
    matrix[np.arange(cells), np.roll(numbers, (down, right), (0, 1)).ravel()] = 1
    return matrix


@dataclass(frozen=True)
class Iterate:
    """One iteration: v, and for the splits x, u, w what the sums are made of."""

    v: Array
    fields: list[Array]
    splits: list[Array]
    splits_before: list[Array]
    multipliers: list[Array]
    multipliers_before: list[Array]
    """Unscaled: λ = μd."""


class Reference:
    """½‖b − CMv‖² + τ R(v), v ≥ 0 and zero outside the support; PSF and data in unit norms."""

    def __init__(
        self,
        psf: Array,
        data: Array,
        valid: Array,
        geometry: Geometry,
        tau: float,
        prior: str,
    ) -> None:
        self.tau, self.prior, self.period = tau, prior, geometry.padded
        kernel = used_part(psf.astype(np.float64), geometry)
        b = np.where(valid, data, 0).astype(np.float64)
        self.scale = float(np.linalg.norm(b) / np.linalg.norm(kernel))
        kernel, b = kernel / np.linalg.norm(kernel), b / np.linalg.norm(b)
        cells = self.period[0] * self.period[1]
        self.blur = np.zeros((cells, cells))
        for i, j in zip(*np.nonzero(kernel), strict=True):
            down, right = int(i) - psf.shape[0] // 2, int(j) - psf.shape[1] // 2
            self.blur += kernel[i, j] * _shifts(self.period, down, right)
        one = np.eye(cells)
        self.difference = np.concatenate(
            [_shifts(self.period, -1, 0) - one, _shifts(self.period, 0, -1) - one]
        )
        self.sensor = _window(self.period, geometry.sensor)
        self.support = _window(self.period, geometry.scene)
        self.b, self.weight = np.zeros(cells), np.zeros(cells)
        self.b[self.sensor] = b.ravel()
        self.weight[self.sensor] = valid.ravel()
        self._support_shape = geometry.scene[2:]

    @property
    def has_tv(self) -> bool:
        return self.prior in ("tv", "isotropic-tv")

    def scene(self, v: Array) -> Array:
        """The scene's cells of a vector over the period."""
        return v[self.support].reshape(self._support_shape)

    def embed(self, scene: Array) -> Array:
        v = np.zeros(self.support.size)
        v[self.support] = scene.ravel()
        return v

    def regulariser(self, v: Array) -> float:
        if self.prior == "l1":
            return float(np.abs(v).sum())
        if self.prior == "none":
            return 0.0
        rows, columns = np.split(self.difference @ v, 2)
        if self.prior == "tv":
            return float(np.abs(rows).sum() + np.abs(columns).sum())
        return float(np.sqrt(rows**2 + columns**2).sum())

    def objective(self, v: Array) -> float:
        misfit = self.weight * (self.b - self.blur @ v)
        return 0.5 * float(misfit @ misfit) + self.tau * self.regulariser(v)

    def uniform(self) -> tuple[Array, float]:
        """Uniform scene that fits best, and the share of ‖b‖² that it explains."""
        ones = self.support.astype(np.float64)
        glow = self.weight * (self.blur @ ones)
        level = float(glow @ self.b / (glow @ glow))
        return level * ones, level * float(glow @ self.b)

    def admm(
        self, penalties: Sequence[Triple], start: Array, relaxation: float = 1.0
    ) -> Iterator[Iterate]:
        """One iterate for each entry of `penalties`: v first, then splits, then multipliers."""
        matrices = [self.blur, self.difference, np.eye(self.support.size)]
        if not self.has_tv:
            matrices[1] = np.zeros((0, self.support.size))
        fields = [k @ start for k in matrices]
        splits = self._proximal(fields, penalties[0])
        multipliers = [
            mu * (kv - x) for mu, kv, x in zip(penalties[0], fields, splits, strict=True)
        ]
        inverses: dict[Triple, Array] = {}
        for mu in penalties:
            if mu not in inverses:
                normal = sum(m * k.T @ k for m, k in zip(mu, matrices, strict=True))
                inverses[mu] = np.linalg.inv(normal)
            right = sum(
                k.T @ (m * x - y)
                for k, m, x, y in zip(matrices, mu, splits, multipliers, strict=True)
            )
            v = inverses[mu] @ right
            fields = [k @ v for k in matrices]
            relaxed = [
                relaxation * kv + (1 - relaxation) * x for kv, x in zip(fields, splits, strict=True)
            ]
            arguments = [h + y / m for h, y, m in zip(relaxed, multipliers, mu, strict=True)]
            new = self._proximal(arguments, mu)
            turned = [
                y + m * (h - x) for y, m, h, x in zip(multipliers, mu, relaxed, new, strict=True)
            ]
            yield Iterate(v, fields, new, splits, turned, multipliers)
            splits, multipliers = new, turned

    def minimum(self, penalties: Triple = (0.5, 0.5, 0.5), iterations: int = 3000) -> Array:
        """Scene over the period, from zero until it stands still: 1e-6 from where it would end."""
        scene = np.zeros(self.support.size)
        for each in self.admm([penalties] * iterations, scene, 1.6):
            before, scene = scene, each.splits[2]
            if np.linalg.norm(scene - before) < 1e-9 * np.linalg.norm(scene):
                break
        return scene

    def _proximal(self, arguments: list[Array], mu: Triple) -> list[Array]:
        a, g, s = arguments
        x = (self.weight * self.b + mu[0] * a) / (self.weight + mu[0])
        threshold = self.tau / mu[1]
        if self.prior == "isotropic-tv":
            rows, columns = np.split(g, 2)
            length = np.maximum(np.tile(np.sqrt(rows**2 + columns**2), 2), 1e-300)
            u = g * np.maximum(1 - threshold / length, 0)
        else:
            u = np.sign(g) * np.maximum(np.abs(g) - threshold, 0)
        w = np.maximum(s - (self.tau / mu[2] if self.prior == "l1" else 0), 0) * self.support
        return [x, u, w]
