"""What masks have in common that repeat a tile which is designed for its PSF."""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated

from torch import Tensor

from nolens.camera.part import PositiveLength
from nolens.design.masks import (
    Layout,
    Limits,
    Tile,
    default_period_um,
    focusing_radius_um,
    spread_over,
)
from nolens.jobs.designing.mask import Blank, MadeMask, MaskOptions, SmallAngle
from nolens.jobs.fields import Iterations
from nolens.jobs.options import Option
from nolens.jobs.run import announce_memory, check_memory
from nolens.quantities import Angle, Length
from nolens.ranges import Between

WANTED, DESCENT = "Wanted PSF", "Descent"
"""Headings of options."""
Steps = Annotated[Iterations, Option("Steps, at most.", DESCENT)]

_PROCESS = "Process"
_Levels = Annotated[int, Between(2, 65536)]
# Measured: bytes for a sample of the tile.
_BYTES_OF_PROGRAM = 8e8
_BYTES_PER_SAMPLE = 150


@dataclass
class TileDescent:
    """The descent to a tile, which a person may end.

    Parameters
    ----------
    blank
        The camera.
    layout
        Samples of the tile.
    tile
        Computes its light.
    radius_um
        Radius of curvature of what it begins with.
    iterations
        How many steps it has.
    stopped
        Whether it was ended early.
    """

    blank: Blank
    layout: Layout
    tile: Tile
    radius_um: float
    iterations: int
    stopped: bool = False

    def stop(self, done: int) -> bool:
        """See how many steps are done; True ends it."""
        reporter = self.blank.reporter
        self.stopped = reporter.step("step", done, self.iterations, "the mask")
        return self.stopped


class TileOptions(MaskOptions):
    """Options of masks that repeat a tile; a kind derives from it."""

    radius: Annotated[
        PositiveLength | None,
        Option(
            "Radius of curvature of the lenslets or lines that it begins with.",
            DESCENT,
            default="what focuses on the sensor",
        ),
    ] = None
    iterations: Steps
    feature: Annotated[PositiveLength, Option("Smallest feature.", _PROCESS)] = Length("8", "um")
    height: Annotated[PositiveLength, Option("Largest height of the relief.", _PROCESS)] = Length(
        "12", "um"
    )
    slope: Annotated[SmallAngle, Option("Steepest slope.", _PROCESS)] = Angle("5.4", "deg")
    levels: Annotated[
        _Levels | None,
        Option(
            "Number of heights that the process makes, from the lowest to --height above it.",
            _PROCESS,
            default="any height",
        ),
    ] = None
    period: Annotated[
        PositiveLength | None,
        Option(
            "Side of the square that the mask repeats.",
            _PROCESS,
            default="the width of a 75deg scene on the sensor, or of the aperture",
        ),
    ] = None

    @property
    def limits(self) -> Limits:
        """Limits of the process."""
        return Limits(self.height.um, math.tan(self.slope.rad), self.feature.um, self.levels)

    @abstractmethod
    def heights(self, descent: TileDescent) -> tuple[Tensor, Tensor | None]:
        """Heights of the tile in um, and the PSF that was wanted where one was drawn."""

    def mask(self, blank: Blank) -> MadeMask:
        """Design the tile, and spread it over the sensor.

        Raises
        ------
        OptionError
            If the limits of the process contradict themselves, or the machine has too little
            memory.
        """
        model, device = blank.model, blank.device
        radius_um = focusing_radius_um(model) if self.radius is None else self.radius.um
        period_um = default_period_um(model) if self.period is None else self.period.um
        layout = Layout.fit(model, self.limits, period_um)
        size = blank.size(layout.grid_um)
        held = _BYTES_PER_SAMPLE * layout.side**2 + 12 * math.prod(size)
        needed = _BYTES_OF_PROGRAM + held
        check_memory(needed, device, "a smaller --period or --overhang needs less")
        announce_memory(needed, blank.reporter)
        tile = layout.tile(model, blank.light, device)
        descent = TileDescent(blank, layout, tile, radius_um, self.iterations)
        heights, target = self.heights(descent)
        relief = spread_over(heights.cpu(), size)
        opened = blank.with_heights(relief, Length.of(layout.grid_um, "um"))
        return MadeMask(opened, layout, target, descent.stopped)
