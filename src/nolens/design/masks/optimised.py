"""Reliefs that are optimised for their PSF: the descent, and the figures that a PSF is to have."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from nolens.design.masks.limits import Limits
from nolens.design.masks.tile import Tile
from nolens.errors import OptionError
from nolens.optics import squared_distance

_STEP_UM = 0.1
_FLOOR = 1e-3
_WIDTH_WEIGHT = 4.0


def descend(
    tile: Tile,
    start_um: Tensor,
    limits: Limits,
    loss: Callable[[Tensor], Tensor],
    *,
    iterations: int,
    stop: Callable[[int], bool] | None = None,
) -> Tensor:
    r"""Relief whose PSFs have a small loss, within limits.

    Adam (`kingma2015`) with a step that falls to zero by a cosine, on a surface that is blurred to
    the smallest feature and rounded to the levels (with the gradient of the unrounded one);
    slope and height enter as penalties on the way, and hold exactly in the end
    (`Limits.enforce`).

    Parameters
    ----------
    tile
        Piece of the mask, with the light that counts.
    start_um
        Surface to begin with, (side, side).
    limits
        Of the process.
    loss
        Of one view's PSF.
    iterations
        How many steps.
    stop
        Called with the number of steps that are done; True ends the descent there.

    Returns
    -------
    Tensor
        Heights in um from 0 on, (side, side).
    """
    raw = start_um.clone().requires_grad_(True)
    adam = torch.optim.Adam([raw], lr=_STEP_UM, betas=(0.9, 0.99))
    for number in range(iterations):
        for group in adam.param_groups:
            group["lr"] = _STEP_UM * (1 + math.cos(math.pi * number / iterations)) / 2
        surface = limits.smooth(raw, tile.grid_um)
        gradient = torch.autograd.grad(limits.excess(surface, tile.grid_um), surface)[0]
        # One view at a time, so that only one is held in memory.
        quantised = limits.quantised(surface.detach()).requires_grad_(True)
        for view, each in enumerate(tile.views):
            part = each.weight * loss(tile.psf(quantised, view))
            gradient = gradient + torch.autograd.grad(part, quantised)[0]
        raw.grad = torch.autograd.grad(surface, raw, gradient)[0]
        adam.step()
        if stop is not None and stop(number + 1):
            break
    with torch.no_grad():
        return limits.enforce(limits.smooth(raw, tile.grid_um), tile.grid_um)


@dataclass(frozen=True)
class PsfGoals:
    """Target figures of a PSF; `nolens.evaluate` says how each is measured.

    Parameters
    ----------
    width_um
        At most this full width at half maximum of the autocorrelation.
    sparsity
        At least this fraction of the sensor without light.
    magnitude
        At least this spectral magnitude of one square millimetre of the PSF,
    magnitude_per_mm
        up to this spatial frequency.

    Raises
    ------
    OptionError
        If one of them cannot be.
    """

    width_um: float
    sparsity: float
    magnitude: float
    magnitude_per_mm: float

    def __post_init__(self) -> None:
        if not self.width_um > 0:
            raise OptionError(f"a width of {self.width_um:g} µm: give more than zero")
        if not 0 <= self.sparsity < 1:
            raise OptionError(
                f"a sparsity of {100 * self.sparsity:g} %: give 0 % or more and less than 100 %"
            )
        if not 0 < self.magnitude <= 1:
            raise OptionError(
                f"a spectral magnitude of {100 * self.magnitude:g} %: give more than 0 %, up to "
                "100 %"
            )
        if not self.magnitude_per_mm > 0:
            raise OptionError(
                f"a spectral magnitude up to {self.magnitude_per_mm:g} lines per mm: give more "
                "than zero"
            )


class Shortfall:
    r"""How far a PSF is from its goals; 0 where all are met.

    With :math:`M_f = |\hat p_f| / \hat p_0` the sum of three terms

    - :math:`4\,[A(w/2) - ½]_+`, with A the autocorrelation less its mean, at the distance of half
      the target width;
    - :math:`[\log(1/Σ_f M_f^2) - \log(1 - s)]_+`, as :math:`1/Σ M_f^2 = (Σp)^2/(NΣp^2)` is the
      fraction of the area that is lit;
    - the mean of :math:`[\log m^2/M_f^2]_+` over all frequencies up to the target one, weighted by
      :math:`1/|f|`: gaps in the spectrum, which a reconstruction cannot fill, cost most, at low
      frequencies, where the large shapes of a scene are, as much as at high ones.

    Parameters
    ----------
    goals
        The target.
    pixels
        Along the side of the PSF, which repeats itself.
    pixel_um
        Their distance.
    device
        Of the PSFs.
    """

    def __init__(
        self, goals: PsfGoals, pixels: int, pixel_um: float, device: torch.device | str = "cpu"
    ) -> None:
        frequency = torch.fft.fftfreq(pixels, pixel_um * 1e-3, device=device)
        radius = torch.hypot(frequency[:, None].expand(-1, pixels), frequency.expand(pixels, -1))
        self._band = (radius > 0) & (radius <= goals.magnitude_per_mm)
        if not self._band.any():
            raise OptionError(
                f"a PSF of {pixels * pixel_um:g} µm has no frequency up to "
                f"{goals.magnitude_per_mm:g} lines per mm: give a larger period"
            )
        self._weight = 1 / radius[self._band]
        self._weight /= self._weight.sum()
        side_mm = pixels * pixel_um * 1e-3
        self._target = (goals.magnitude / side_mm) ** 2
        self._lit = 1 - goals.sparsity
        lag = torch.fft.fftfreq(pixels, 1 / (pixels * pixel_um), device=device)
        away = torch.hypot(lag[:, None].expand(-1, pixels), lag.expand(pixels, -1))
        ring = (1 - (away - goals.width_um / 2).abs() / pixel_um).clamp_min(0)
        self._ring = torch.fft.fft2(ring / ring.sum()).real

    def __call__(self, psf: Tensor) -> Tensor:
        """Sum of the three terms for a PSF, (pixels, pixels)."""
        spectrum = torch.fft.fft2(psf)
        squared = spectrum.real.square() + spectrum.imag.square()
        squared = squared / squared[0, 0]
        total = squared.sum()
        at_half = ((squared * self._ring).sum() - 1) / (total - 1)
        width = (at_half - 0.5).clamp_min(0)
        sparsity = (-torch.log(total) - math.log(self._lit)).clamp_min(0)
        magnitude = squared[self._band] / self._target
        gaps = ((-torch.log(magnitude + _FLOOR)).clamp_min(0) * self._weight).sum()
        shortfall: Tensor = _WIDTH_WEIGHT * width + sparsity + gaps
        return shortfall


def lenslet_start(tile: Tile, radius_um: float, pitch_um: float, seed: int) -> Tensor:
    """Lenslets in random places on a tile, (side, side), that gather the light.

    The places are not spread evenly (`relaxed_points`): the PSF of evenly spread ones has
    hardly any contrast at frequencies below that of the lenslets, and loses large shapes.

    Parameters
    ----------
    tile
        Piece of the mask.
    radius_um
        Radius of curvature.
    pitch_um
        Distance of neighbours in a hexagonal arrangement that is as dense.
    seed
        Of their places.
    """
    side_um = tile.side * tile.grid_um
    count = max(1, round(side_um**2 * 2 / (math.sqrt(3) * pitch_um**2)))
    points = np.random.default_rng(seed).uniform(size=(count, 2)) * side_um
    squared = squared_distance(points, (tile.side, tile.side), tile.grid_um)
    return squared * (-tile.bulge / (2 * radius_um))


def optimised_relief(
    tile: Tile,
    goals: PsfGoals,
    limits: Limits,
    start_um: Tensor,
    *,
    iterations: int,
    stop: Callable[[int], bool] | None = None,
) -> Tensor:
    """Relief whose PSF comes as near to its goals as the limits allow (`Shortfall`, `descend`).

    Parameters
    ----------
    tile, limits, iterations, stop
        See `descend`.
    goals
        Target figures.
    start_um
        Surface to begin with, such as `lenslet_start`.

    Returns
    -------
    Tensor
        Heights in um from 0 on, (side, side).
    """
    pixels = tile.side // tile.samples_per_pixel
    shortfall = Shortfall(goals, pixels, tile.pixel_um, start_um.device)
    return descend(tile, start_um, limits, shortfall, iterations=iterations, stop=stop)
