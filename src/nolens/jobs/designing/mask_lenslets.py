"""Masks of lenslets: in random places, and in regular ones."""

import math
from functools import partial
from typing import Annotated

from torch import Tensor

from nolens.camera import RandomLenslets
from nolens.camera.part import PositiveLength
from nolens.design.masks import (
    Arrangement,
    Blank,
    MadeMask,
    focusing_radius_um,
    lenslet_array,
    smoothing_margin,
)
from nolens.errors import OptionError
from nolens.jobs.designing.mask import MaskOptions
from nolens.jobs.options import Option, Written
from nolens.quantities import Length
from nolens.twin import REFERENCE_NM

_LENSLETS = "Lenslets"
_REMEDY = "a larger --radius or a smaller --pitch"

_Smoothing = Annotated[
    PositiveLength,
    Option("Width of the Gaussian that rounds the edges between lenslets.", _LENSLETS),
]


class _LensletsMask(MaskOptions):
    """Options that all masks of lenslets have."""

    radius: Annotated[
        PositiveLength | None,
        Option("Radius of curvature of a lenslet.", default="what focuses on the sensor"),
    ] = None
    pitch: Annotated[PositiveLength, Option("Mean distance of neighbouring lenslets.")] = Length(
        "70", "um"
    )
    smoothing: _Smoothing

    def check_together(self) -> None:
        """Refuse lenslets that are rounded away."""
        if self.smoothing.exact >= self.pitch.exact:
            raise OptionError(
                f"--smoothing {self.smoothing} rounds lenslets away that are {self.pitch} apart: "
                "give less than their --pitch, such as a tenth of it"
            )


class RandomLensletsMask(_LensletsMask):
    """Lenslets in random places, the paper's model of its diffuser.

    nolens design mask random-lenslets --camera paper --pitch 90um -o designed
    """

    kind = "random-lenslets"

    smoothing: _Smoothing = Length("11", "um")

    @property
    def written(self) -> tuple[Written, ...]:
        """Description, picture and record: the description says all of the relief."""
        return tuple(each for each in super().written if each.what != "relief")

    def mask(self, blank: Blank) -> MadeMask:
        """Describe the lenslets."""
        radius = self.radius or Length.of(round(focusing_radius_um(blank.model), 2), "um")

        def relief(grid: Length) -> RandomLenslets:
            return RandomLenslets(
                kind="random-lenslets",
                radius=radius,
                pitch=self.pitch,
                smoothing=self.smoothing,
                seed=self.seed,
                grid=grid,
                overhang=blank.overhang,
            )

        return blank.described(relief, _REMEDY)


class LensletArrayMask(_LensletsMask):
    """Lenslets in regular places.

    nolens design mask lenslet-array --camera paper --arrangement square -o designed
    """

    kind = "lenslet-array"

    smoothing: _Smoothing = Length("2", "um")
    arrangement: Annotated[Arrangement, Option("How the lenslets' middles lie.")] = "hexagonal"

    def mask(self, blank: Blank) -> MadeMask:
        """Compute the lenslets."""
        media = blank.model.media(REFERENCE_NM)
        radius_um = focusing_radius_um(blank.model) if self.radius is None else self.radius.um

        def heights(size: tuple[int, int], grid_um: float) -> Tensor:
            surface = lenslet_array(
                radius_um=math.copysign(radius_um, media.below - media.above),
                pitch_um=self.pitch.um,
                arrangement=self.arrangement,
                smoothing_um=self.smoothing.um,
                size=size,
                grid_um=grid_um,
            )
            return surface.height_um

        margin = partial(smoothing_margin, self.smoothing.um)
        return blank.sampled(heights, _REMEDY, margin=margin, smaller="--smoothing or --overhang")
