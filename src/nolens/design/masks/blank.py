"""A camera that a mask is made for: samples of its relief, and designs that repeat a tile."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch

from nolens.camera import LoadedCamera, RandomLenslets, ReliefFile
from nolens.design.masks.limits import Limits
from nolens.design.masks.tile import (
    Layout,
    Tile,
    default_period_um,
    focusing_radius_um,
    spread_over,
)
from nolens.errors import OptionError
from nolens.machine import BYTES_OF_PROGRAM, check_memory
from nolens.optics import surface_bytes
from nolens.quantities import Length
from nolens.twin import Light, Twin, preview_model

RELIEF_FILE = "relief.tif"
"""Heights in the folder of a camera whose relief is no description."""
_PER_PIXEL = (1, 2, 4)
_SURELY = 0.6
"""Of the coarsest grid that a patch of random lenslets allows, what all of them do: 0.68 and more
were measured."""
_CPU = torch.device("cpu")
# Measured: bytes of the descent itself, and for a sample of the tile.
_BYTES_OF_DESCENT = 3e8
_BYTES_PER_SAMPLE = 150


@dataclass(frozen=True)
class MadeMask:
    """A camera with a new mask.

    Parameters
    ----------
    loaded
        The camera.
    layout
        Samples of the tile that a designed mask repeats.
    target
        On a mask that was designed for one, the PSF that was the target, on the pixels of the tile.
    stopped
        Whether a person ended the descent early.
    """

    loaded: LoadedCamera
    layout: Layout | None = None
    target: torch.Tensor | None = None
    stopped: bool = False


@dataclass(frozen=True)
class Blank:
    """A camera that a mask is made for.

    Attributes
    ----------
    loaded
        The camera, by its new name, with the mask that it had.
    model
        Its layers and sensor, ready for rays and for estimates.
    light
        That a designed mask is to be good in.
    overhang
        How far the mask extends beyond the sensor.
    device
        Where to compute.
    announce_memory
        Called with the bytes that will be held while a descent runs.
    step
        Called with the number of steps that are done, and of all; True ends the work.
    """

    loaded: LoadedCamera
    model: Twin
    light: Light
    overhang: Length
    device: torch.device
    announce_memory: Callable[[float], None]
    step: Callable[[int, int], bool]

    def size(self, grid_um: float) -> tuple[int, int]:
        """Samples of a relief over sensor and overhang, (rows, columns).

        They are even, so that pixels lie as on the sensor.
        """
        sensor, beyond = self.loaded.camera.sensor, 2 * self.overhang.um
        rows, columns = (
            2 * math.ceil((count * sensor.pitch.um + beyond) / grid_um / 2)
            for count in (sensor.rows, sensor.columns)
        )
        return rows, columns

    def described(self, relief: Callable[[Length], RandomLenslets], remedy: str) -> MadeMask:
        """The camera with a relief that stays a description.

        Parameters
        ----------
        relief
            Of the distance of its samples: the largest of the pixels' pitch, half and a quarter of
            it that carries the light behind the relief.
        remedy
            What would make it less steep, such as "a smaller --height".

        Raises
        ------
        OptionError
            If it is too steep for all of them.
        """
        return self._on_a_grid(lambda grid: self.loaded.with_relief(relief(grid)), remedy)

    def sampled(
        self,
        heights: Callable[[tuple[int, int], float], torch.Tensor],
        remedy: str,
        *,
        margin: Callable[[float], int] = lambda grid_um: 0,
        smaller: str = "--overhang",
    ) -> MadeMask:
        """The camera with a relief of computed heights.

        Parameters
        ----------
        heights
            In um, float32, of so many (rows, columns) and their distance in um; the latter is
            chosen as for `described`.
        remedy
            What would make them less steep, such as "a smaller --height".
        margin
            How many samples of such a distance are computed beside them, on every side.
        smaller
            The options that would have to be smaller to need less memory.

        Raises
        ------
        OptionError
            If they are too steep, or more than the machine has memory for.
        """

        def camera(grid: Length) -> LoadedCamera:
            size, beside = self.size(grid.um), 2 * margin(grid.um)
            points = math.prod(count + beside for count in size)
            needed = BYTES_OF_PROGRAM + surface_bytes(points)
            check_memory(needed, _CPU, f"a smaller {smaller} needs less")
            return self.with_heights(heights(size, grid.um), grid)

        return self._on_a_grid(camera, remedy)

    def with_heights(self, heights_um: torch.Tensor, grid: Length) -> LoadedCamera:
        """The camera with a relief of these heights."""
        relief = ReliefFile(kind="file", file=RELIEF_FILE, grid=grid)
        return self.loaded.with_relief(relief, heights_um)

    def tiled(
        self,
        limits: Limits,
        heights: "Callable[[TileDescent], tuple[torch.Tensor, torch.Tensor | None]]",
        *,
        radius_um: float | None,
        period_um: float | None,
        iterations: int,
    ) -> MadeMask:
        """The camera with a relief that repeats a tile, which is designed for its PSF.

        Parameters
        ----------
        limits
            Of the process.
        heights
            Descends to the heights of the tile in um, and the PSF that was the target where one was
            drawn.
        radius_um
            Radius of curvature that the descent begins with; None for what focuses on the sensor.
        period_um
            Least side of the tile; None for `default_period_um`.
        iterations
            Of the descent.

        Raises
        ------
        OptionError
            If the limits contradict themselves, or the machine has too little memory.
        """
        layout = Layout.fit(self.model, limits, period_um or default_period_um(self.model))
        size = self.size(layout.grid_um)
        held = (
            BYTES_OF_PROGRAM
            + _BYTES_OF_DESCENT
            + _BYTES_PER_SAMPLE * layout.side**2
            + 12 * math.prod(size)
        )
        check_memory(held, self.device, "a smaller --period or --overhang needs less")
        self.announce_memory(held)
        tile = layout.tile(self.model, self.light, self.device)
        radius_um = radius_um or focusing_radius_um(self.model)
        descent = TileDescent(self, layout, tile, radius_um, iterations)
        values, target = heights(descent)
        relief = spread_over(values.cpu(), size)
        loaded = self.with_heights(relief, Length.of(layout.grid_um, "um"))
        return MadeMask(loaded, layout, target, descent.stopped)

    def _on_a_grid(self, make: Callable[[Length], LoadedCamera], remedy: str) -> MadeMask:
        pitch = self.loaded.camera.sensor.pitch
        for per_pixel in _PER_PIXEL:
            grid = pitch if per_pixel == 1 else Length.of(pitch.um / per_pixel, "um")
            loaded = make(grid)
            try:
                coarsest = preview_model(loaded).coarsest_pitch_um()
                described = isinstance(loaded.camera.mask.relief, RandomLenslets)
                if described and grid.um > _SURELY * coarsest:
                    Twin.of(loaded)
                break
            except OptionError as error:
                if per_pixel == _PER_PIXEL[-1]:
                    raise OptionError(
                        f"{error}, and {grid} is the finest that is tried: give {remedy}"
                    ) from None
        return MadeMask(loaded)


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
        self.stopped = self.blank.step(done, self.iterations)
        return self.stopped
