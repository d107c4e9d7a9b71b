"""Surfaces of masks: heights in µm on a grid, and their values between the samples."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nolens.kernels import fast_length, irfft2, nearest_points, rfft2
from nolens.optics.grid import Grid

_RELAXATION_STEPS = 12
_SAMPLES_PER_PITCH = 10


@dataclass(frozen=True)
class Relief:
    """Heights towards the scene, on a grid around the sensor's middle.

    Parameters
    ----------
    height_um
        float32, (rows, columns).
    grid_um
        Distance of the samples.
    """

    height_um: Tensor
    grid_um: float

    @property
    def extent_um(self) -> tuple[float, float]:
        """Height and width of the surface."""
        rows, columns = self.height_um.shape
        return (rows - 1) * self.grid_um, (columns - 1) * self.grid_um

    @cached_property
    def steepest(self) -> float:
        """Largest slope between neighbouring samples, along the rows or the columns."""
        steps = [self.height_um.diff(dim=axis).abs() for axis in (0, 1)]
        return (
            max((float(step.max()) for step in steps if step.numel()), default=0.0) / self.grid_um
        )

    def sample(self, grid: Grid) -> Tensor:
        """Heights on another grid, by cubic polynomials through four neighbours.

        The surface goes on level beyond its edges.

        Returns
        -------
        Tensor
            float32, (rows, columns), on the surface's device.
        """
        values = self.height_um
        for axis in (0, 1):
            count = self.height_um.shape[axis]
            place = grid.positions_um(axis) / self.grid_um + (count - 1) / 2
            first = place.floor()
            weights = _lagrange(place - first).to(values)
            rows = first.to(torch.int64).to(values.device)
            shape = [1, 1]
            shape[axis] = len(rows)
            total: Tensor | None = None
            for step, weight in enumerate(weights):
                at = (rows + (step - 1)).clamp(0, count - 1)
                part = values.index_select(axis, at).mul_(weight.view(shape))
                total = part if total is None else total.add_(part)
            assert total is not None
            values = total
        return values


def random_lenslets(
    *,
    radius_um: float,
    pitch_um: float,
    smoothing_um: float,
    size_um: tuple[float, float],
    grid_um: float,
    seed: int,
) -> Relief:
    r"""Random smooth microlenses, the paper's model of its mask (`uvimprint`).

    Places are uniform random points after Lloyd's relaxation (`lloyd1982`), as dense as a
    hexagonal arrangement of spacing `pitch_um`: :math:`2/(\sqrt3\,\text{pitch}^2)` to the area.
    A lenslet is the cap :math:`h = -d^2/2R` over the cell of its point; a Gaussian of standard
    deviation `smoothing_um` rounds the edges between them.

    Parameters
    ----------
    radius_um
        Radius of curvature.
    pitch_um
        Mean distance of neighbouring lenslets.
    smoothing_um
        Standard deviation of the Gaussian.
    size_um
        (height, width) that the surface covers at least.
    grid_um
        Distance of the samples.
    seed
        Of the places.
    """
    cells = (
        fast_length(math.ceil(size_um[0] / grid_um) + 1, of_rows=False),
        fast_length(math.ceil(size_um[1] / grid_um) + 1, of_rows=True),
    )
    size = np.array(cells) * grid_um
    points = _relaxed_points(size, pitch_um, seed)
    _, squared = nearest_points(points, cells, grid_um)
    spectrum = rfft2(torch.from_numpy(squared).mul_(-1 / (2 * radius_um)))
    for axis, count in enumerate(cells):
        frequency = torch.fft.fftfreq(count, grid_um, dtype=torch.float64)
        blur = torch.exp(-2 * (math.pi * smoothing_um * frequency) ** 2).float()
        spectrum *= blur[:, None] if axis == 0 else blur[: spectrum.shape[1]]
    return Relief(irfft2(spectrum, cells), grid_um)


def _relaxed_points(size: NDArray[np.float64], pitch_um: float, seed: int) -> NDArray[np.float64]:
    """Points that Lloyd's relaxation has spread on a torus, (count, 2)."""
    generator = np.random.default_rng(seed)
    count = max(1, round(float(size.prod()) * 2 / (math.sqrt(3) * pitch_um**2)))
    points = generator.uniform(size=(count, 2)) * size
    step = pitch_um / _SAMPLES_PER_PITCH
    cells = (max(1, round(size[0] / step)), max(1, round(size[1] / step)))
    scale = size / cells  # Cells are square to within rounding; distances are taken in cells.
    points /= scale
    rows, columns = np.indices(cells, dtype=np.float64).reshape(2, -1)
    for _ in range(_RELAXATION_STEPS):
        owner = nearest_points(points, cells, 1.0)[0].ravel()
        share = np.maximum(np.bincount(owner, minlength=count), 1)
        for axis, place in enumerate((rows, columns)):
            offset = place - points[owner, axis]
            offset -= cells[axis] * np.round(offset / cells[axis])
            moved = np.bincount(owner, offset, minlength=count) / share
            points[:, axis] = (points[:, axis] + moved) % cells[axis]
    spread: NDArray[np.float64] = points * scale
    return spread


def _lagrange(t: Tensor) -> Tensor:
    """Weights of the samples at −1, 0, 1, 2 for the place t in 0…1, (4, …)."""
    return torch.stack(
        [
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        ]
    )
