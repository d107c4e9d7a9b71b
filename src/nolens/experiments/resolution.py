"""A flat screen with a target in front of a simulated camera, and angles in pictures of one."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from scipy import ndimage
from torch import Tensor

from nolens.camera import Frame, develop
from nolens.evaluate import angle_of_length
from nolens.experiments.virtual_experiment import Tick, VirtualExperiment, solved
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.twin import FieldMap, Plane, Twin

TARGET_ITERATIONS = 300
TAU = 1e-5
_PIXELS_PER_CELL = 4
_MOST_PIXELS = 1600


@dataclass(frozen=True)
class AngularScale:
    """How far apart the cells of a picture are in the scene.

    Parameters
    ----------
    tangent
        Of the field angle from cell to cell, in the middle of the field.
    axis
        Row and column that the optical axis falls on; None: the picture's middle.
    field
        The camera's map of the cells; None where the cells are evenly apart as they are.
    """

    tangent: float
    axis: tuple[float, float] | None = None
    field: FieldMap | None = None

    @classmethod
    def of_camera(cls, twin: Twin, region: Region) -> "AngularScale":
        """Scale of the cells of a region, by Snell's law in the camera's layers."""
        tangent = twin.pixel_um / twin.stack().reduced_um
        axis = (twin.shape[0] // 2 - region.top, twin.shape[1] // 2 - region.left)
        return cls(tangent, axis, FieldMap(twin, region))

    def cells(self, angle_deg: float) -> float:
        """Cells in the middle of the field that an angle, half to each side, is long."""
        return 2 * math.tan(math.radians(angle_deg) / 2) / self.tangent

    def flat(self, picture: Tensor) -> "FlatPicture":
        """The picture as a flat screen has it: tangents of the field angle evenly apart.

        Parameters
        ----------
        picture
            (height, width).
        """
        height, width = picture.shape
        if self.field is None:
            axis = self.axis or ((height - 1) / 2, (width - 1) / 2)
            return FlatPicture(picture, self.tangent, axis)
        tangents = self.field.tangents()
        first = [math.ceil(float(each.min()) / self.tangent) for each in tangents]
        last = [math.floor(float(each.max()) / self.tangent) for each in tangents]
        rows, columns = (
            torch.arange(start, stop + 1, dtype=torch.float64) * self.tangent
            for start, stop in zip(first, last, strict=True)
        )
        reach = torch.hypot(rows[:, None].expand(-1, len(columns)), columns.expand(len(rows), -1))
        twin = self.field.twin
        away_um = twin.stack().displacement_um(reach / (1 + reach.square()).sqrt())
        share = torch.where(reach > 0, away_um / reach.clamp_min(1e-12), twin.stack().reduced_um)
        region, cells = self.field.region, twin.shape
        places = [
            rows[:, None] * share / twin.pixel_um + cells[0] // 2 - region.top,
            columns * share / twin.pixel_um + cells[1] // 2 - region.left,
        ]
        values = ndimage.map_coordinates(
            picture.double().cpu().numpy(),
            [each.numpy() for each in places],
            order=5,
            mode="nearest",
        )
        return FlatPicture(torch.from_numpy(values), self.tangent, (-first[0], -first[1]))


@dataclass(frozen=True)
class FlatPicture:
    """A picture on evenly spaced tangents of the field angle.

    Parameters
    ----------
    values
        (height, width).
    tangent
        From cell to cell.
    axis
        Row and column that the optical axis falls on.
    """

    values: Tensor
    tangent: float
    axis: tuple[float, float]

    def angle_deg(
        self, place: tuple[float, float], direction: tuple[float, float], cells: float
    ) -> float:
        """Angle that some cells at a row and column, in a direction, are seen under."""
        at = [(each - axis) * self.tangent for each, axis in zip(place, self.axis, strict=True)]
        return angle_of_length((at[0], at[1]), direction, cells * self.tangent)


@dataclass(frozen=True)
class SolverSettings:
    """How pictures are taken and solved.

    Parameters
    ----------
    iterations, tau
        As `nolens reconstruct` takes them; all iterations are done.
    fill
        Share of a full pixel that the brightest one is exposed to.
    seed
        Of the noise.
    """

    iterations: int
    tau: float = TAU
    fill: float = 0.9
    seed: int = 0


@dataclass(frozen=True)
class SolvingCamera:
    """A simulated camera with the PSF of one distance, which solves what it photographs.

    Parameters
    ----------
    bench
        The camera.
    region
        Cells that it solves for.
    psf
        Wide enough for them.
    settings
        How pictures are taken and solved.
    """

    bench: VirtualExperiment
    region: Region
    psf: Tensor
    settings: SolverSettings

    @classmethod
    def ready(
        cls,
        bench: VirtualExperiment,
        distance_um: float,
        region: Region,
        settings: SolverSettings,
        tick: Tick,
    ) -> "SolvingCamera":
        """Make the PSF of a distance."""
        rows, columns = bench.twin.shape
        wide = (rows + region.height, columns + region.width)
        psf = bench.psf(PointSource((0.0, 0.0), distance_um), wide, tick)
        return cls(bench, region, psf.mean(dim=0, keepdim=True), settings)

    def picture(self, frame: Frame, tick: Tick) -> Tensor:
        """The mean of the channels of what was photographed, solved as one."""
        return solved(
            develop(frame, channels="grey"),
            self.psf,
            self.region,
            iterations=self.settings.iterations,
            tau=self.settings.tau,
            tick=tick,
        )[0]


@dataclass(frozen=True)
class Screen:
    """A flat screen in front of a simulated camera, to show targets on.

    Parameters
    ----------
    bench
        The camera.
    distance_um
        Of the screen.
    settings
        How its picture is taken and solved.
    tick
        Called with the share that is done.
    """

    bench: VirtualExperiment
    distance_um: float
    settings: SolverSettings
    tick: Tick | None = None

    def photograph(self, target: Callable[[int], Tensor], angle_deg: float) -> FlatPicture:
        """Take a picture of a square target: reconstructed, its fall-off of light divided out.

        Parameters
        ----------
        target
            Gives it, (side, side) from 0 to 1, for a side in pixels.
        angle_deg
            Field angle that its side fills.

        Raises
        ------
        OptionError
            If the angle is beyond the model.
        """
        bench, settings = self.bench, self.settings
        tangent = math.tan(math.radians(angle_deg) / 2)
        region = FieldMap.covering(bench.twin, (tangent, tangent)).region
        scale = AngularScale.of_camera(bench.twin, region)
        shares = Shares(3, self.tick)
        camera = SolvingCamera.ready(bench, self.distance_um, region, settings, shares.part)
        shares.next()
        side = min(_MOST_PIXELS, math.ceil(_PIXELS_PER_CELL * scale.cells(angle_deg)))
        radiance = target(side).float().expand(len(bench.sensor.channels), -1, -1)
        shot = bench.photograph(
            (Plane(radiance, angle_deg, self.distance_um),),
            fill=settings.fill,
            seed=settings.seed,
            tick=shares.part,
        )
        shares.next()
        return scale.flat(camera.picture(shot.frame, shares.part) / shot.response)


class Shares:
    """What share of some equal pieces of work is done.

    Parameters
    ----------
    pieces
        How many there are.
    tick
        Called with the share.
    """

    def __init__(self, pieces: int, tick: Tick | None) -> None:
        self._pieces, self._done, self._tick = pieces, 0, tick

    def part(self, share: float) -> None:
        """A share of the present piece is done."""
        if self._tick is not None:
            self._tick(min((self._done + share) / self._pieces, 0.99))

    def next(self) -> None:
        """The present piece is done."""
        self._done += 1
        self.part(0.0)
