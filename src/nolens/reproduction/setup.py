"""The camera that the figures are made with, how much of its sensor is read, and the work of it."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from nolens.camera import LoadedCamera
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files.sample_pictures import sample_picture
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.twin import Twin, in_channels, preview_model

NEEDED_BY = "the scenes of the report come"
"""What scikit-image's photographs are for, as `check_sample_pictures` takes it."""
PINHOLE_UM = 50.0
"""The paper's point source: a white LED behind a pinhole, at 300 mm (`uvimprint`, sec. III)."""
SCREEN_UM = 300e3
TAU = 5e-6

_SAMPLES_PER_PIXEL = 4
"""Of the PSF of a single source; those that are blended over a scene have one."""
_BYTES_OF_PROGRAM = 1e9
_BYTES_PER_PIXEL = 260
"""Held for a pixel of the FFT grid of the paper's way of solving."""
_BYTES_OF_REPORT = 3e7
_BYTES_WRITTEN_PER_PIXEL = 30


@dataclass(frozen=True)
class Size:
    """How much is computed.

    Parameters
    ----------
    pixels
        (rows, columns) of the sensor's middle that are read; None for all of it.
    field_points
        PSFs along each side of a scene.
    iterations
        Of every photograph.
    papers_iterations
        Of the photograph that is solved as the paper does.
    films_mm
        Thicknesses of the films of fig. 2c.
    films_pixels
        (rows, columns) that are read of each.
    point_draws, point_iterations
        Pictures of two points at each separation, and iterations of each.
    angle_steps
        From one angle of fig. 6c to the next, in steps of 2.5°.
    dot_field_points
        PSFs along each side of the grid of dots.
    dot_extent_deg
        Half angle up to which there are dots.
    """

    pixels: tuple[int, int] | None
    field_points: int
    iterations: int
    papers_iterations: int
    films_mm: tuple[float, ...]
    films_pixels: tuple[int, int]
    point_draws: int
    point_iterations: int
    angle_steps: int
    dot_field_points: int
    dot_extent_deg: float


FULL = Size(
    pixels=None,
    field_points=5,
    iterations=300,
    papers_iterations=300,
    films_mm=(0.65, 0.85, 1.05, 1.25, 1.45, 1.65, 1.85, 2.05, 2.25, 2.45),
    films_pixels=(1520, 2028),
    point_draws=3,
    point_iterations=100,
    angle_steps=1,
    dot_field_points=9,
    dot_extent_deg=48.0,
)
QUICK = Size(
    pixels=(1014, 1352),
    field_points=3,
    iterations=50,
    papers_iterations=20,
    films_mm=(0.65, 1.05, 1.25, 1.45, 1.65, 2.05),
    films_pixels=(760, 1014),
    point_draws=1,
    point_iterations=60,
    angle_steps=4,
    dot_field_points=3,
    dot_extent_deg=48.0,
)


@dataclass(frozen=True)
class ExperimentSetup:
    """The camera, the size of the work and the seed of all noise.

    Parameters
    ----------
    loaded
        The camera.
    size
        How much is computed.
    seed
        Of the noise.
    """

    loaded: LoadedCamera
    size: Size
    seed: int

    @cached_property
    def experiment(self) -> VirtualExperiment:
        """The simulated camera; its relief takes seconds, so it is made when it is needed."""
        whole = VirtualExperiment.of(self.loaded, field_points=self.size.field_points)
        return replace(whole, twin=whole.twin.reading(*self.pixels))

    @cached_property
    def preview(self) -> Twin:
        """The camera for rays and sizes, in a moment."""
        return preview_model(self.loaded).reading(*self.pixels)

    @property
    def pixels(self) -> tuple[int, int]:
        """(rows, columns) that are read."""
        sensor = self.loaded.camera.sensor
        rows, columns = self.size.pixels or (sensor.rows, sensor.columns)
        return min(rows, sensor.rows), min(columns, sensor.columns)

    @property
    def reduced(self) -> bool:
        """Whether less than the whole sensor is read."""
        sensor = self.loaded.camera.sensor
        return self.pixels != (sensor.rows, sensor.columns)

    @property
    def source(self) -> PointSource:
        """The paper's point source."""
        return PointSource(distance_um=SCREEN_UM, diameter_um=PINHOLE_UM)

    def picture(self, name: str) -> Tensor:
        """One of scikit-image's photographs in the sensor's channels, linear."""
        radiance = sample_picture(name, NEEDED_BY)
        return in_channels(radiance, len(self.loaded.camera.sensor.channels))

    def wide_psf(self, distance_um: float, support: PixelRectangle) -> Tensor:
        """PSF of a point at some distance, as wide as a scene of this support needs."""
        shape = self.preview.psf_shape(support)
        return self.experiment.psf(PointSource(distance_um=distance_um), shape)

    def parameters(self, **more: Any) -> Mapping[str, Any]:
        """All that the results of a step follow from."""
        loaded = self.loaded
        relief = None if loaded.relief_um is None else loaded.relief_um.cpu().numpy().tobytes()
        return {
            "camera": loaded.camera.model_dump(mode="json"),
            "quantum efficiency": loaded.quantum_efficiency.model_dump(mode="json"),
            "acceptance": loaded.acceptance.model_dump(mode="json"),
            "relief": None if relief is None else hashlib.sha256(relief).hexdigest(),
            "size": asdict(self.size),
            "seed": self.seed,
            "threads": torch.get_num_threads(),
            **more,
        }

    @property
    def bytes(self) -> float:
        """Estimate of the most memory that is held at once: solving as the paper does."""
        rows, columns = self.preview.shape
        return _BYTES_OF_PROGRAM + 4 * rows * columns * _BYTES_PER_PIXEL

    @property
    def written_bytes(self) -> float:
        """Estimate of what the report's folder will hold."""
        rows, columns = self.preview.shape
        return _BYTES_OF_REPORT + rows * columns * _BYTES_WRITTEN_PER_PIXEL

    def psf_work(self, pixels: tuple[int, int] | None = None) -> float:
        """Samples of the PSF of all channels."""
        return self._channels * math.prod(pixels or self.pixels) * _SAMPLES_PER_PIXEL

    def scene_work(self, field_points: int | None = None) -> float:
        """Samples of the PSFs that the measurement of a scene is blended from."""
        points = field_points or self.size.field_points
        return self._channels * points**2 * math.prod(self.pixels)

    def solve_work(self, support: PixelRectangle | None, iterations: int) -> float:
        """Pixels of all iterations of a reconstruction; without a support, the PSF is the sensor's.

        An iteration takes about as long for a pixel as a PSF does for a sample.
        """
        rows, columns = self.preview.shape
        more = (support.height, support.width) if support is not None else (rows, columns)
        return self._channels * (rows + more[0]) * (columns + more[1]) * iterations

    @property
    def _channels(self) -> int:
        return len(self.loaded.camera.sensor.channels)
