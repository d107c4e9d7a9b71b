"""One measurement reconstructed at one depth, and how sharp it is there."""

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import Measurement
from nolens.camera.measurement import bin_mean
from nolens.operators import Region
from nolens.solvers import Prior, Problem, Reconstructor, Result, Stop
from nolens.solvers.result import Callback


@dataclass(frozen=True)
class Solving:
    """How every depth is reconstructed: eq. 7 by ADMM (`nolens.solvers.admm`).

    Parameters
    ----------
    measurement
        What the sensor measured.
    region
        Pixels that light can come from; None for no limit.
    tau, prior, iterations, tolerance
        As `nolens reconstruct` takes them.
    device
        Where to compute.
    """

    measurement: Measurement
    region: Region | None = None
    tau: float = 1e-4
    prior: Prior = Prior.TV
    iterations: int = 100
    tolerance: float = 3e-4
    device: torch.device | str = "cpu"

    @property
    def sensor(self) -> tuple[int, int]:
        """(rows, columns) of the measurement."""
        return self.measurement.values.shape[-2], self.measurement.values.shape[-1]

    def problem(self, psf: Tensor) -> Problem:
        """The problem for the PSF of a depth."""
        return self._reconstructor(psf).problem(self.measurement)

    def solve(self, psf: Tensor, callback: Callback | None = None) -> Result:
        """The scene as it is if all of it lies at the depth of a PSF."""
        return self._reconstructor(psf).solve(self.measurement, callback=callback)

    def _reconstructor(self, psf: Tensor) -> Reconstructor:
        stop = Stop(self.iterations, self.tolerance, scene_tolerance=0.0, smooth_part=False)
        return Reconstructor(psf, self.region, self.tau, self.prior, stop=stop, device=self.device)

    def coarser(self, bin_by: int, iterations: int) -> "Solving":
        """The same with `bin_by`² pixels made one, with fewer iterations."""
        seen, region = self.measurement, self.region
        unusable = nnf.max_pool2d((~seen.valid).float()[None], bin_by)[0] > 0
        if region is not None:
            bottom, right = region.top + region.height, region.left + region.width
            top, left = region.top // bin_by, region.left // bin_by
            region = Region(top, left, -(-bottom // bin_by) - top, -(-right // bin_by) - left)
        return replace(
            self,
            measurement=replace(seen, values=bin_mean(seen.values, bin_by), valid=~unusable),
            region=region,
            iterations=min(iterations, self.iterations),
            tolerance=0.0,
        )


def sharpness(picture: Tensor, width: float) -> Tensor:
    r"""Energy of the gradient around every pixel (`pertuz2013`, Tenengrad).

    :math:`G_σ * (v_x^2 + v_y^2)`, the mean over channels, with a Gaussian window.

    Parameters
    ----------
    picture
        (channels, rows, columns).
    width
        σ of the window in pixels.

    Returns
    -------
    Tensor
        (rows, columns).
    """
    return smoothed(gradient_energy(picture), width)


def gradient_energy(picture: Tensor) -> Tensor:
    """Squared length of the gradient, mean over the channels, (rows, columns)."""
    rows = nnf.pad(picture.diff(dim=-2), (0, 0, 0, 1))
    columns = nnf.pad(picture.diff(dim=-1), (0, 1))
    return (rows.square() + columns.square()).mean(dim=0)


def smoothed(values: Tensor, width: float) -> Tensor:
    """Weighted means under a Gaussian window of σ = `width` pixels; (rows, columns)."""
    for axis in (0, 1):
        count = values.shape[axis]
        place = torch.arange(count, dtype=values.dtype, device=values.device)
        weight = torch.exp(-((place[:, None] - place) ** 2) / (2 * width * width))
        weight = weight / weight.sum(dim=1, keepdim=True)
        values = weight @ values if axis == 0 else values @ weight.T
    return values
