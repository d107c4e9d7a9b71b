"""The PSF behind a relief that repeats itself, with its gradient."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.optics import PointSource, pass_layers_
from nolens.twin import Twin


@dataclass(frozen=True)
class View:
    """A plane wave that a PSF is computed for.

    Parameters
    ----------
    wavelength_nm
        In vacuum.
    weight
        What it counts among all views; their sum is 1.
    tangent
        Of its field angle, (row, column), as in `PointSource`.
    """

    wavelength_nm: float
    weight: float
    tangent: tuple[float, float] = (0.0, 0.0)


class Tile:
    r"""A square piece of a mask that repeats itself, in front of a camera's layers.

    The relief h turns the phase of a plane wave by :math:`k_0(n'\cos θ' - n\cos θ)\,h`, and the
    layers multiply the spectrum by their transfer function, as in
    `nolens.optics.monochromatic_psf`. As the tile repeats itself there is no edge, and everything
    is a function of h that torch can differentiate. What the surfaces between the layers reflect
    is left out: it is the same for all masks.

    Parameters
    ----------
    twin
        The camera; its own relief does not matter.
    side
        Samples along the tile, a multiple of `samples_per_cell`.
    grid_um
        Their distance.
    views
        The light.
    samples_per_cell
        Along one of the squares that the PSF is averaged over.
    device
        Where to compute.
    """

    def __init__(
        self,
        twin: Twin,
        side: int,
        grid_um: float,
        views: tuple[View, ...],
        samples_per_cell: int = 1,
        device: torch.device | str = "cpu",
    ) -> None:
        self.side = side
        self.grid_um = grid_um
        self.views = views
        self.samples_per_cell = samples_per_cell
        self._transfers = [_transfer(twin, side, grid_um, view, device) for view in views]
        self._turns = [_turns_per_um(twin, view) for view in views]

    @property
    def cell_um(self) -> float:
        """Pitch of the PSF's pixels."""
        return self.grid_um * self.samples_per_cell

    @property
    def bulge(self) -> float:
        """1 where a surface that bulges towards the scene gathers light, −1 where it spreads it."""
        return math.copysign(1.0, self._turns[0])

    def pattern(self, heights_um: Tensor, view: int) -> Tensor:
        """Irradiance of one view, 1 on average.

        Parameters
        ----------
        heights_um
            (side, side), towards the scene.
        view
            Its number.

        Returns
        -------
        Tensor
            (cells, cells), float32.
        """
        turned = heights_um * self._turns[view]
        field = torch.complex(turned.cos(), turned.sin())
        field = torch.fft.ifft2(torch.fft.fft2(field) * self._transfers[view])
        irradiance: Tensor = field.real.square() + field.imag.square()
        if self.samples_per_cell == 1:
            return irradiance
        return nnf.avg_pool2d(irradiance[None, None], self.samples_per_cell)[0, 0]

    def mean_pattern(self, heights_um: Tensor) -> Tensor:
        """Weighted mean of all views, without a gradient."""
        with torch.no_grad():
            parts = [
                view.weight * self.pattern(heights_um, number)
                for number, view in enumerate(self.views)
            ]
        return torch.stack(parts).sum(0)


def _transfer(
    twin: Twin, side: int, grid_um: float, view: View, device: torch.device | str
) -> Tensor:
    """Transfer function from the mask to the sensor, (side, side)."""
    p = PointSource(view.tangent).p
    size = math.hypot(*view.tangent)
    carrier = tuple(part / size * p if size > 0 else 0.0 for part in view.tangent)
    light = twin.illumination(PointSource(view.tangent), view.wavelength_nm)
    ones = torch.ones((side, side), dtype=torch.complex64, device=device)
    return pass_layers_(
        ones, grid_um, light.after, view.wavelength_nm * 1e-3, carrier=(carrier[0], carrier[1])
    )


def _turns_per_um(twin: Twin, view: View) -> float:
    """Radians that a µm of relief turns the light by."""
    squared = torch.tensor(PointSource(view.tangent).p ** 2, dtype=torch.float64)
    coupling = float(twin.media(view.wavelength_nm).coupling(squared))
    return 2 * math.pi / (view.wavelength_nm * 1e-3) * coupling
