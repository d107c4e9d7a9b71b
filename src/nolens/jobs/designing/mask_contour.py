"""Masks whose PSF is made of thin lines."""

from typing import Annotated

from torch import Tensor

from nolens.camera.part import PositiveLength
from nolens.design.masks import TileDescent, contour_relief, line_target, random_contours
from nolens.jobs.designing.mask import Steps, TileOptions
from nolens.jobs.options import Option
from nolens.quantities import Length


class ContourMask(TileOptions):
    """A PSF of thin lines, by near-field phase retrieval.

    nolens design mask contour --camera paper --line 10um -o designed

    The lines are level lines of a random field. Such masks made by edge filtering are the subject
    of the patent application US 2025/0377536 A1.
    """

    kind = "contour"

    line: Annotated[PositiveLength, Option("Width of a line of the PSF.")] = Length("12", "um")
    spacing: Annotated[PositiveLength, Option("Lines lie about half of this apart.")] = Length(
        "250", "um"
    )
    iterations: Steps = 60

    def heights(self, descent: TileDescent) -> tuple[Tensor, Tensor]:
        """Heights whose light comes near to drawn lines, and these lines."""
        layout = descent.layout
        lines = random_contours(layout.side, layout.grid_um, self.spacing.um, self.seed)
        target = line_target(lines, self.line.um, layout.samples_per_pixel)
        heights = contour_relief(
            descent.tile,
            lines.to(descent.blank.device),
            target,
            self.limits,
            radius_um=descent.radius_um,
            iterations=self.iterations,
            stop=descent.stop,
        )
        return heights, target
