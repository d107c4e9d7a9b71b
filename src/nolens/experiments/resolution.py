"""Targets in front of a simulated camera: a flat screen, two points; angles in their pictures."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import torch
from scipy import ndimage
from torch import Tensor

from nolens.camera import Frame, develop
from nolens.errors import DataError
from nolens.evaluate import RAYLEIGH_DIP, FlatPicture, ObservedPair, TwoPoints, point_pair
from nolens.experiments.virtual_experiment import VirtualExperiment, solved
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.progress import ProgressCallback
from nolens.solvers import admm_bytes
from nolens.twin import (
    FieldMap,
    Plane,
    Twin,
    colours_of,
    polychromatic_psf_bytes,
    shortest_nm,
)

Value = TypeVar("Value", covariant=True)
TARGET_ITERATIONS = 300
TAU = 5e-6
POINT_ITERATIONS = 100
_POINTS_SIDE = 48
"""Pixels along the side of the square that two points are looked for in."""
_TARGET_PIXELS = 4
"""Of a target, to a pixel of its picture."""
_MOST_PIXELS = 1600
_BYTES_PER_PIXEL = 20
"""Of PSF, frame and picture, which ADMM works on."""
_FIRST_PIXELS = 6.0
_GROWTH = 1.5
_MARGIN_PIXELS = 12
_STEP_PIXELS = 0.2
_SEED_STEP = 7919
_EXPECTED_STEPS = 6
"""Separations that the search for the smallest resolved one usually takes."""


@dataclass(frozen=True)
class AngularScale:
    """How far apart the pixels of a picture are in the scene.

    Parameters
    ----------
    tangent
        Of the field angle from pixel to pixel, in the middle of the field.
    field
        The camera's map of the pixels; None where they are evenly apart as they are, around the
        picture's middle.
    """

    tangent: float
    field: FieldMap | None = None

    @classmethod
    def of_camera(cls, twin: Twin, support: PixelRectangle) -> "AngularScale":
        """Scale of the pixels of a support, by Snell's law in the camera's layers."""
        return cls(twin.pixel_um / twin.stack().reduced_um, FieldMap(twin, support))

    def pixels(self, angle_deg: float) -> float:
        """Pixels in the middle of the field that an angle, half to each side, is long."""
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
            return FlatPicture(picture, self.tangent, ((height - 1) / 2, (width - 1) / 2))
        tangents = self.field.tangents()
        first = [math.ceil(float(each.min()) / self.tangent) for each in tangents]
        last = [math.floor(float(each.max()) / self.tangent) for each in tangents]
        rows, columns = (
            torch.arange(start, stop + 1, dtype=torch.float64) * self.tangent
            for start, stop in zip(first, last, strict=True)
        )
        radius = torch.hypot(rows[:, None].expand(-1, len(columns)), columns.expand(len(rows), -1))
        twin = self.field.twin
        shift_um = twin.stack().displacement_um(radius / (1 + radius.square()).sqrt())
        scale_um = torch.where(
            radius > 0, shift_um / radius.clamp_min(1e-12), twin.stack().reduced_um
        )
        support, sensor = self.field.support, twin.shape
        places = [
            rows[:, None] * scale_um / twin.pixel_um + sensor[0] // 2 - support.top,
            columns * scale_um / twin.pixel_um + sensor[1] // 2 - support.left,
        ]
        values = ndimage.map_coordinates(
            picture.double().cpu().numpy(),
            [each.numpy() for each in places],
            order=5,
            mode="nearest",
        )
        return FlatPicture(torch.from_numpy(values), self.tangent, (-first[0], -first[1]))


@dataclass(frozen=True)
class SolverSettings:
    """How pictures are taken and solved.

    Parameters
    ----------
    iterations, tau
        As `nolens reconstruct` takes them; all iterations are done.
    fill
        Fraction of a full pixel that the brightest one is exposed to.
    seed
        Of the noise.
    """

    iterations: int = TARGET_ITERATIONS
    tau: float = TAU
    fill: float = 0.9
    seed: int = 0


@dataclass(frozen=True)
class _SolvingCamera:
    """A simulated camera with the PSF of one distance, which solves what it measures."""

    experiment: VirtualExperiment
    support: PixelRectangle
    psf: Tensor
    settings: SolverSettings

    @classmethod
    def of(
        cls,
        experiment: VirtualExperiment,
        distance_um: float,
        support: PixelRectangle,
        settings: SolverSettings,
        progress: ProgressCallback,
    ) -> "_SolvingCamera":
        """Compute the PSF of a distance, wide enough for the support."""
        rows, columns = experiment.twin.shape
        wide = (rows + support.height, columns + support.width)
        psf = experiment.psf(PointSource((0.0, 0.0), distance_um), wide, progress)
        return cls(experiment, support, psf.mean(dim=0, keepdim=True), settings)

    def picture(self, frame: Frame, progress: ProgressCallback) -> Tensor:
        """Mean of the channels of a frame, solved as one."""
        return solved(
            develop(frame, channels="grey"),
            self.psf,
            self.support,
            iterations=self.settings.iterations,
            tau=self.settings.tau,
            progress=progress,
        )[0]


class SimulatedTarget(ABC, Generic[Value]):
    """What a simulated camera is shown at one distance."""

    distance_um: float

    @abstractmethod
    def support(self, twin: Twin) -> PixelRectangle:
        """Scene pixels that its picture is solved on; a preview of the camera tells them.

        Raises
        ------
        OptionError
            If the optics do not hold for it.
        """

    @abstractmethod
    def measure(
        self,
        experiment: VirtualExperiment,
        settings: SolverSettings,
        progress: ProgressCallback | None = None,
    ) -> Value:
        """Show it to a camera, and measure the picture.

        Parameters
        ----------
        experiment
            The camera.
        settings
            How pictures are taken and solved.
        progress
            Called with the fraction that is done.

        Raises
        ------
        OptionError
            If the optics do not hold for it.
        DataError
            If nothing can be measured.
        """

    def working_bytes(self, preview: VirtualExperiment) -> float:
        """Bytes that a frame and its reconstruction hold at once, beside the relief.

        Raises
        ------
        OptionError
            If the optics do not hold for it, or the light cannot be used.
        """
        twin, sensor = preview.twin, preview.sensor
        source = PointSource((0.0, 0.0), self.distance_um)
        twin.check_source(source)
        psf = polychromatic_psf_bytes(
            twin,
            source,
            (sensor.rows, sensor.columns),
            1,
            at_least=2,
            shortest=shortest_nm(colours_of(twin, preview.light, preview.wavelengths)),
        )
        support, (rows, columns) = self.support(twin), twin.shape
        pixels = (rows + support.height) * (columns + support.width)
        # Channels are solved for one by one.
        return psf + admm_bytes(pixels, 1, rows * columns) + _BYTES_PER_PIXEL * pixels


@dataclass(frozen=True)
class ScreenTarget(SimulatedTarget[FlatPicture]):
    """A square target on a flat screen.

    `measure` gives its picture, the fall-off of light divided out.

    Parameters
    ----------
    drawing
        Gives it, (side, side) from 0 to 1, for a side in pixels.
    angle_deg
        Field angle that its side fills.
    distance_um
        Of the screen.
    """

    drawing: Callable[[int], Tensor]
    angle_deg: float
    distance_um: float

    def support(self, twin: Twin) -> PixelRectangle:
        """Scene pixels that it fills."""
        tangent = math.tan(math.radians(self.angle_deg) / 2)
        twin.check_source(PointSource((tangent, tangent), self.distance_um))
        return FieldMap.covering(twin, (tangent, tangent)).support

    def measure(
        self,
        experiment: VirtualExperiment,
        settings: SolverSettings,
        progress: ProgressCallback | None = None,
    ) -> FlatPicture:
        """The picture as a flat screen has it."""
        support = self.support(experiment.twin)
        scale = AngularScale.of_camera(experiment.twin, support)
        pieces = _Pieces(3, progress)
        camera = _SolvingCamera.of(experiment, self.distance_um, support, settings, pieces.part)
        pieces.next()
        side = min(_MOST_PIXELS, math.ceil(_TARGET_PIXELS * scale.pixels(self.angle_deg)))
        radiance = self.drawing(side).float().expand(len(experiment.sensor.channels), -1, -1)
        shot = experiment.measure(
            (Plane(radiance, self.angle_deg, self.distance_um),),
            fill=settings.fill,
            seed=settings.seed,
            progress=pieces.part,
        )
        pieces.next()
        return scale.flat(camera.picture(shot.frame, pieces.part) / shot.response)


@dataclass(frozen=True)
class TwoPointTarget(SimulatedTarget[TwoPoints]):
    """Two point sources, whose smallest resolved angle is sought.

    Each separation is measured `draws` times, each time with other noise and with the middle of
    the points at another place within a pixel, and the dips are averaged (`point_pair`). The
    points are exact: each has its own PSF. The search halves the way between the largest
    unresolved and the smallest resolved separation until they are a fifth of a pixel apart; it
    fails if even points half the support apart are not resolved.

    Parameters
    ----------
    distance_um
        Of the points.
    direction_deg
        Of the line through them, from the right towards up.
    draws
        Pictures of each separation.
    threshold
        Dip that counts as resolved.
    """

    distance_um: float
    direction_deg: float = 0.0
    draws: int = 3
    threshold: float = RAYLEIGH_DIP

    def support(self, twin: Twin) -> PixelRectangle:
        """Scene pixels that the points are looked for in."""
        return PixelRectangle.centred(_POINTS_SIDE, _POINTS_SIDE, twin.shape)

    def measure(
        self,
        experiment: VirtualExperiment,
        settings: SolverSettings,
        progress: ProgressCallback | None = None,
    ) -> TwoPoints:
        """Dips by separation, and the smallest angle that is resolved."""
        support, draws = self.support(experiment.twin), self.draws
        pieces = _Pieces(1 + _EXPECTED_STEPS * draws, progress)
        camera = _SolvingCamera.of(experiment, self.distance_um, support, settings, pieces.part)
        pieces.next()
        scale = AngularScale.of_camera(experiment.twin, support)
        turn = math.radians(self.direction_deg)
        generator = torch.Generator().manual_seed(settings.seed)
        offsets = torch.rand((draws, 2), generator=generator) - 0.5
        pairs: list[ObservedPair] = []

        def is_resolved(pixels: float) -> bool:
            half = pixels / 2 * scale.tangent
            for number, (row, column) in enumerate(offsets.tolist()):
                light = torch.zeros(())
                for side in (-1, 1):
                    source = PointSource(
                        (
                            row * scale.tangent - side * half * math.sin(turn),
                            column * scale.tangent + side * half * math.cos(turn),
                        ),
                        self.distance_um,
                    )
                    light = light + experiment.light_of(source)
                noise = settings.seed + _SEED_STEP * number
                frame = experiment.exposed(light, settings.fill, noise)
                picture = camera.picture(frame, pieces.part)
                angle = math.degrees(2 * math.atan(half))
                pairs.append(ObservedPair(angle, point_pair(picture, pixels), picture))
                pieces.next()
            return sum(each.pair.dip for each in pairs[-draws:]) / draws >= self.threshold

        low, high = 0.0, _FIRST_PIXELS
        while not is_resolved(high):
            low, high = high, high * _GROWTH
            if high > _POINTS_SIDE - _MARGIN_PIXELS:
                raise DataError(
                    f"even two points {pairs[-1].separation_deg:.2g} deg apart are not resolved "
                    f"at {self.distance_um * 1e-3:g} mm: try more iterations or another tau, or a "
                    "mask that is in focus"
                )
        while high - low > _STEP_PIXELS:
            middle = (low + high) / 2
            low, high = (low, middle) if is_resolved(middle) else (middle, high)
        return TwoPoints.of(pairs, self.threshold)


class _Pieces:
    """Passes on what fraction of some equal pieces of work is done."""

    def __init__(self, pieces: int, progress: ProgressCallback | None) -> None:
        self._pieces, self._done, self._progress = pieces, 0, progress

    def part(self, fraction: float) -> None:
        """A fraction of the present piece is done."""
        if self._progress is not None:
            self._progress(min((self._done + fraction) / self._pieces, 0.99))

    def next(self) -> None:
        """The present piece is done."""
        self._done += 1
        self.part(0.0)
