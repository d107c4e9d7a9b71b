"""A mask of concentric rings, each of which gathers light in a ring on the sensor."""

import math
from typing import Annotated

import torch

from nolens.camera.part import PositiveLength
from nolens.design.masks import Blank, MadeMask
from nolens.jobs.designing.mask import MaskOptions
from nolens.jobs.options import Option
from nolens.quantities import Length


class Rings(MaskOptions):
    """Concentric rings, round like waves.

    nolens design mask rings --camera small --spacing 60um -o designed
    """

    kind = "rings"

    spacing: Annotated[PositiveLength, Option("From a ring to the next.")] = Length("80", "um")
    height: Annotated[PositiveLength, Option("Height of a ring.")] = Length("2", "um")

    def mask(self, blank: Blank) -> MadeMask:
        """Heights h (1 + cos 2πr/s)/2 at the distance r from the middle."""

        def heights(size: tuple[int, int], grid_um: float) -> torch.Tensor:
            rows, columns = (grid_um * (torch.arange(count) - (count - 1) / 2) for count in size)
            radius_um = torch.hypot(rows[:, None], columns[None, :])
            waves = torch.cos(radius_um * (2 * math.pi / self.spacing.um))
            return self.height.um / 2 * (1 + waves)

        return blank.sampled(heights, "a larger --spacing or a smaller --height")
