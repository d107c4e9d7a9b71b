"""What the jobs of `nolens measure resolution` have in common."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from torch import Tensor

from nolens.camera import OpenCamera
from nolens.evaluate import FlatPicture
from nolens.experiments.resolution import screen_picture
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import camera_files, read_camera
from nolens.jobs.measuring.resolution_options import ResolutionOptions
from nolens.jobs.measuring.resolution_pictures import target_pictures
from nolens.jobs.measuring.rounded import rounded
from nolens.jobs.run import BYTES_OF_PROGRAM, Product, Run, check_memory
from nolens.optics import PointSource
from nolens.solvers import admm_bytes
from nolens.twin import (
    FieldMap,
    Light,
    Twin,
    colours_of,
    distance_um,
    polychromatic_psf_bytes,
    preview_model,
    relief_points,
    shortest_nm,
    simulation_bytes,
)

Options = TypeVar("Options", bound=ResolutionOptions)
Value = TypeVar("Value")
# More is neither known nor worth the paper.
_DIGITS = 5
_BYTES_PER_CELL = 20
"""Of PSF, frame and picture, which ADMM works on."""
_REMEDY = "a camera with fewer pixels, or a target of a smaller angle, needs less"


@dataclass(frozen=True)
class ReadyBench:
    """A camera to simulate, before its relief is computed.

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
    """

    opened: OpenCamera
    files: dict[str, Path]
    light: Light
    wavelengths: int
    distance_um: float
    preview: Twin

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
            opened,
            camera_files(options.simulate, opened.camera),
            Light(options.light),
            options.wavelengths,
            distance,
            bare,
        )

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

    def needed(self, region: tuple[int, int]) -> float:
        """Bytes that are held at once where so many (rows, columns) of pixels are solved for.

        Raises
        ------
        OptionError
            If the light cannot be used.
        """
        bare, sensor = self.preview, self.opened.camera.sensor
        colours = colours_of(bare, self.light, self.wavelengths)
        source = PointSource((0.0, 0.0), self.distance_um)
        pattern = polychromatic_psf_bytes(
            bare,
            source,
            (sensor.rows, sensor.columns),
            1,
            at_least=2,
            shortest=shortest_nm(colours),
        )
        cells = math.prod(a + b for a, b in zip(bare.shape, region, strict=True))
        # Channels are solved for one by one.
        held = admm_bytes(cells) + _BYTES_PER_CELL * cells
        return BYTES_OF_PROGRAM + simulation_bytes(relief_points(self.opened), pattern + held)

    def experiment(self, run: Run[Options], region: tuple[int, int]) -> VirtualExperiment:
        """Say what memory it takes to solve for a region, and compute the camera's relief.

        Raises
        ------
        OptionError
            If the machine has too little memory, or a file of the camera would be written over.
        """
        run.reads(self.files)
        needed = self.needed(region)
        check_memory(needed, run.device, _REMEDY)
        run.begin(needed)
        run.reporter.advance("mask", 0.0)
        return VirtualExperiment.of(
            self.opened, light=self.light.name, wavelengths=self.wavelengths
        )


def target_picture(
    run: Run[Options], target: Callable[[int], Tensor], angle_deg: float, what: str
) -> FlatPicture:
    """The only frame as a flat screen has it, or the picture of a simulated camera.

    Parameters
    ----------
    run
        Which frame, or which camera.
    target
        What a simulated camera is shown: gives a square, (side, side) from 0 to 1, for a side in
        pixels.
    angle_deg
        Field angle that the side of the square fills.
    what
        Name of the target, for who watches.

    Raises
    ------
    NolensError
        If a file or an option cannot be used, or the angle is beyond the model.
    """
    settings = run.options.settings
    if run.options.simulate is None:
        (each,) = target_pictures(run, settings.iterations)
        return each.scale.flat(each.picture)
    ready = ReadyBench.of(run.options)
    experiment = ready.experiment(run, ready.cells_of(angle_deg))
    tick = partial(run.reporter.advance, what)
    return screen_picture(experiment, target, angle_deg, ready.distance_um, settings, tick)


def resolution_product(
    run: Run[Options],
    value: Value,
    figures: Mapping[str, Any],
    draw: Callable[[Value, Path], None],
) -> Product[Value]:
    """The figures, how their pictures were solved, and the plot if it is asked for.

    Parameters
    ----------
    run
        What was asked for.
    value
        What was measured.
    figures
        Of it, in values that JSON has, of any number of digits.
    draw
        Draws it, as the PNG of a path.
    """
    options = run.options
    reconstructs = options.simulate is not None or options.psf is not None
    solver = {
        "simulated": options.simulate,
        "iterations": options.settings.iterations if reconstructs else None,
        "tau": options.settings.tau if reconstructs else None,
    }
    writers = {} if options.plot is None else {options.plot: partial(draw, value)}
    return Product(value, {**rounded(figures, _DIGITS), **solver}, writers)


def solver_line(summary: Mapping[str, Any]) -> list[str]:
    """How the pictures were solved, for a terminal; nothing where they were pictures already."""
    if summary["iterations"] is None:
        return []
    return [f"reconstructed with {summary['iterations']} iterations, tau {summary['tau']:g}"]
