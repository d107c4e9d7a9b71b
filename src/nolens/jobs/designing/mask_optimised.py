"""Masks that are optimised for figures of their PSF."""

from typing import Annotated

from torch import Tensor

from nolens.camera.part import PositiveLength
from nolens.design.masks import PsfGoals, TileDescent, lenslet_start, optimised_relief
from nolens.jobs.designing.mask import DESCENT, Steps, TileOptions
from nolens.jobs.fields import parts
from nolens.jobs.options import Option
from nolens.quantities import Length, Percentage
from nolens.ranges import Between

_MAGNITUDE = r"(.*%)\s*@\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*/\s*mm"


_Magnitude = Annotated[Percentage, Between("0.01 %", "100 %")]
_PerMm = Annotated[float, Between(1e-3, 1e5)]
_MagnitudeAt = Annotated[
    tuple[_Magnitude, _PerMm],
    parts(_MAGNITUDE, "give a fraction and a spatial frequency, such as 6%@80/mm"),
]
_Sparsity = Annotated[Percentage, Between("0 %", "99.99 %")]


class OptimisedMask(TileOptions):
    """A PSF of wanted width, sparsity and spectrum, by a descent through the camera's own layers.

    nolens design mask optimised --camera paper -o designed
    """

    kind = "optimised"

    pitch: Annotated[
        PositiveLength | None,
        Option(
            "Mean distance of the lenslets that it begins with.",
            DESCENT,
            default="as large as the slope allows",
        ),
    ] = None
    width: Annotated[PositiveLength, Option("Width of the PSF's autocorrelation, at most.")] = (
        Length("8", "um")
    )
    sparsity: Annotated[_Sparsity, Option("Fraction of the sensor without light, at least.")] = (
        Percentage("98", "%")
    )
    magnitude: Annotated[
        _MagnitudeAt,
        Option(
            "Spectral magnitude of 1 mm2 of the PSF, at least, up to a spatial frequency on the "
            "sensor.",
            default="6%@80/mm",
        ),
    ] = (Percentage("6", "%"), 80.0)
    iterations: Steps = 100

    @property
    def goals(self) -> PsfGoals:
        """Figures that the PSF is to have."""
        magnitude, per_mm = self.magnitude
        return PsfGoals(self.width.um, self.sparsity.value, magnitude.value, per_mm)

    def heights(self, descent: TileDescent) -> tuple[Tensor, None]:
        """Heights that lead from random lenslets to the target figures."""
        radius_um = descent.radius_um
        pitch_um = 2 * self.limits.slope * radius_um if self.pitch is None else self.pitch.um
        start = lenslet_start(descent.tile, radius_um, pitch_um, self.seed)
        heights = optimised_relief(
            descent.tile,
            self.goals,
            self.limits,
            start.to(descent.blank.device),
            iterations=self.iterations,
            stop=descent.stop,
        )
        return heights, None
