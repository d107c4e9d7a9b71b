"""A simulated camera that is ready to photograph targets, and what that will take."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from nolens.camera import OpenCamera
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import camera_files, read_camera
from nolens.jobs.cost import announce, check_memory, colours_of, cost_of, pattern_size
from nolens.jobs.measuring.resolution_options import ResolutionOptions
from nolens.jobs.reporter import Reporter
from nolens.optics import PointSource
from nolens.twin import FieldMap, Light, Twin
from nolens.twin.point import shortest_nm
from nolens.twin.preview import distance_um, preview_model, relief_points

# Of ADMM, for one channel: bytes for a cell, and transformed samples for a cell and iteration.
_BYTES_PER_CELL = 80
_SAMPLES_PER_CELL = 1.5
_REMEDY = "a camera with fewer pixels, or a target of a smaller angle, needs less"


@dataclass(frozen=True)
class Work:
    """What has to be done.

    Parameters
    ----------
    patterns
        Patterns of all channels.
    solves
        Reconstructions.
    region
        (rows, columns) of cells that each one solves for.
    iterations
        Of each.
    """

    patterns: int
    solves: int
    region: tuple[int, int]
    iterations: int


@dataclass(frozen=True)
class ReadyBench:
    """A camera, before its relief is computed and after.

    Parameters
    ----------
    opened
        The camera.
    files
        Files it is read from, by role.
    light
        Spectrum of the light.
    wavelengths
        How many stand for a channel.
    distance_um
        Of the target.
    preview
        The camera with a stand-in for its relief.
    made
        The camera with its relief; None before `foretold`.
    """

    opened: OpenCamera
    files: dict[str, Path]
    light: Light
    wavelengths: int
    distance_um: float
    preview: Twin
    made: VirtualExperiment | None = None

    @classmethod
    def of(cls, options: ResolutionOptions) -> "ReadyBench":
        """Read the camera.

        Raises
        ------
        NolensError
            If it, the light or the distance cannot be used.
        """
        assert options.simulate is not None
        opened = read_camera(options.simulate)
        bare = preview_model(opened)
        distance = distance_um(options.distance, opened)
        bare.check_source(PointSource((0.0, 0.0), distance))
        return cls(
            opened, camera_files(options.simulate, opened.camera), Light(options.light),
            options.wavelengths, distance, bare,
        )  # fmt: skip

    @property
    def bench(self) -> VirtualExperiment:
        """The camera with its relief."""
        assert self.made is not None
        return self.made

    def cells_of(self, angle_deg: float) -> tuple[int, int]:
        """(rows, columns) of cells that a square target fills.

        Raises
        ------
        OptionError
            If it is beyond the model.
        """
        tangent = math.tan(math.radians(angle_deg) / 2)
        self.preview.check_source(PointSource((tangent, tangent), self.distance_um))
        region = FieldMap.covering(self.preview, (tangent, tangent)).region
        return region.height, region.width

    def foretold(self, work: Work, reporter: Reporter) -> "ReadyBench":
        """Say what the work takes, and make the camera ready for it.

        Raises
        ------
        OptionError
            If the machine has too little memory, or the light cannot be used.
        """
        bare, sensor = self.preview, self.opened.camera.sensor
        colours = colours_of(bare, self.light, self.wavelengths)
        source = PointSource((0.0, 0.0), self.distance_um)
        size = pattern_size(
            bare, source, (sensor.rows, sensor.columns), 1, at_least=2,
            shortest=shortest_nm(colours),
        )  # fmt: skip
        cells = math.prod(a + b for a, b in zip(bare.cells, work.region, strict=True))
        cost = cost_of(
            size, work.patterns * sum(map(len, colours)), points=relief_points(self.opened),
            held=_BYTES_PER_CELL * cells,
            transformed=int(_SAMPLES_PER_CELL * cells * work.solves * work.iterations),
        )  # fmt: skip
        device = torch.device("cpu")
        check_memory(cost, device, _REMEDY)
        announce(cost, device, reporter)
        reporter.advance("mask", 0.0)
        made = VirtualExperiment.of(
            self.opened, light=self.light.name, wavelengths=self.wavelengths
        )
        return replace(self, made=made)
