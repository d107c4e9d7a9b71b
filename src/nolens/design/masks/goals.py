"""What a PSF is wanted to be like, as a function that can be differentiated."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.errors import OptionError

_FLOOR = 1e-3
_WIDTH_WEIGHT = 4.0


@dataclass(frozen=True)
class PsfGoals:
    """Wanted figures of a PSF; `nolens.evaluate` says how each is measured.

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
      the wanted width;
    - :math:`[\log(1/Σ_f M_f^2) - \log(1 - s)]_+`, as :math:`1/Σ M_f^2 = (Σp)^2/(NΣp^2)` is the
      share of the area that is lit;
    - the mean of :math:`[\log m^2/M_f^2]_+` over all frequencies up to the wanted one, weighted by
      :math:`1/|f|`: gaps in the spectrum, which a reconstruction cannot fill, cost most, at low
      frequencies, where the large shapes of a scene are, as much as at high ones.

    Parameters
    ----------
    goals
        What is wanted.
    cells
        Along the side of the PSF, which repeats itself.
    cell_um
        Their distance.
    device
        Of the PSFs.
    """

    def __init__(
        self, goals: PsfGoals, cells: int, cell_um: float, device: torch.device | str = "cpu"
    ) -> None:
        frequency = torch.fft.fftfreq(cells, cell_um * 1e-3, device=device)
        radius = torch.hypot(frequency[:, None].expand(-1, cells), frequency.expand(cells, -1))
        self._band = (radius > 0) & (radius <= goals.magnitude_per_mm)
        if not self._band.any():
            raise OptionError(
                f"a PSF of {cells * cell_um:g} µm has no frequency up to "
                f"{goals.magnitude_per_mm:g} lines per mm: give a larger period"
            )
        self._weight = 1 / radius[self._band]
        self._weight /= self._weight.sum()
        side_mm = cells * cell_um * 1e-3
        self._wanted = (goals.magnitude / side_mm) ** 2
        self._lit = 1 - goals.sparsity
        lag = torch.fft.fftfreq(cells, 1 / (cells * cell_um), device=device)
        away = torch.hypot(lag[:, None].expand(-1, cells), lag.expand(cells, -1))
        ring = (1 - (away - goals.width_um / 2).abs() / cell_um).clamp_min(0)
        self._ring = torch.fft.fft2(ring / ring.sum()).real

    def __call__(self, pattern: Tensor) -> Tensor:
        """Sum of the three terms for a pattern, (cells, cells)."""
        spectrum = torch.fft.fft2(pattern)
        squared = spectrum.real.square() + spectrum.imag.square()
        squared = squared / squared[0, 0]
        total = squared.sum()
        at_half = ((squared * self._ring).sum() - 1) / (total - 1)
        width = (at_half - 0.5).clamp_min(0)
        sparsity = (-torch.log(total) - math.log(self._lit)).clamp_min(0)
        magnitude = squared[self._band] / self._wanted
        gaps = ((-torch.log(magnitude + _FLOOR)).clamp_min(0) * self._weight).sum()
        shortfall: Tensor = _WIDTH_WEIGHT * width + sparsity + gaps
        return shortfall
