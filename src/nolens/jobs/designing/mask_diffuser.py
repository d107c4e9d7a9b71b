"""Masks that are Gaussian surfaces."""

from typing import Annotated

from torch import Tensor

from nolens.camera.part import PositiveLength
from nolens.design.masks import Blank, MadeMask, gaussian_diffuser
from nolens.jobs.designing.mask import MaskOptions, SmallAngle
from nolens.jobs.options import Option
from nolens.quantities import Angle, Length
from nolens.twin import REFERENCE_NM


class DiffuserMask(MaskOptions):
    """A diffuser: a surface of Gaussian heights.

    nolens design mask diffuser --camera paper --angle 2deg -o designed
    """

    kind = "diffuser"

    angle: Annotated[
        SmallAngle,
        Option("Full width at half maximum of the light that it scatters, in air."),
    ] = Angle("1", "deg")
    feature: Annotated[PositiveLength, Option("Distance over which heights are alike.")] = Length(
        "30", "um"
    )

    def mask(self, blank: Blank) -> MadeMask:
        """Compute the surface."""
        media = blank.model.media(REFERENCE_NM)

        def heights(size: tuple[int, int], grid_um: float) -> Tensor:
            surface = gaussian_diffuser(
                angle_rad=self.angle.rad,
                feature_um=self.feature.um,
                index_step=media.below - media.above,
                size=size,
                grid_um=grid_um,
                seed=self.seed,
            )
            return surface.height_um

        return blank.sampled(heights, "a smaller --angle")
