"""The mask's surface as light meets it: relief and opening."""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from nolens.optics.relief import Relief


@dataclass(frozen=True)
class Opening:
    """A hole in an opaque film, around the sensor's middle.

    Parameters
    ----------
    shape
        "rectangle" or "ellipse".
    height_um, width_um
        Its size.
    """

    shape: Literal["rectangle", "ellipse"]
    height_um: float
    width_um: float

    def coverage(self, rows_um: Tensor, columns_um: Tensor, pitch_um: float) -> Tensor:
        """Fraction of each square sample that is open, (rows, columns), float32."""
        if self.shape == "rectangle":
            sides = [
                (0.5 + (size / 2 - place.abs()) / pitch_um).clamp(0, 1).float()
                for size, place in ((self.height_um, rows_um), (self.width_um, columns_um))
            ]
            return sides[0][:, None] * sides[1]
        y, x = rows_um[:, None] / self.height_um, columns_um / self.width_um
        radius = 2 * torch.hypot(y.expand(-1, len(x)), x.expand(len(y), -1))
        # Distance to the edge: that of the level line, by its value over its gradient.
        steepness = 4 * torch.hypot(y / self.height_um, x / self.width_um) / radius.clamp_min(1e-9)
        return (0.5 + (1 - radius) / (steepness * pitch_um).clamp_min(1e-9)).clamp(0, 1).float()


@dataclass(frozen=True)
class MaskSurface:
    """Relief between two media, and the opening in front of it.

    Parameters
    ----------
    relief
        Heights towards the scene.
    opening
        None where the whole surface is open.
    """

    relief: Relief
    opening: Opening | None = None

    def coarsest_pitch_um(
        self, wavelength_um: float, coupling: float, divergence: float = 0.0
    ) -> float:
        """Largest distance of samples that carries light of a wavelength behind the relief.

        The relief turns the phase by `coupling` · slope / λ turns in a µm; four samples to the
        fastest turn leave room for what diffraction adds. Two samples more are for each turn of
        a wave that diverges by `divergence` (in p) within a window.
        """
        turn = (2 * abs(coupling) * self.relief.steepest + divergence) / wavelength_um
        return 1 / (2 * turn) if turn > 0 else float("inf")
