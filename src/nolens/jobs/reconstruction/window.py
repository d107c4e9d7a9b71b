"""Parts of the scene: what is solved for, and what is written."""

import math

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.files import read_camera
from nolens.jobs.reconstruction.options import ReconstructOptions, parse_window
from nolens.operators import Region
from nolens.solvers import Problem


def asked_region(
    options: ReconstructOptions, sensor: tuple[int, int], psf: Tensor
) -> Region | None:
    """Cells that light can come from: --support, or --field through the --camera; None for all.

    Parameters
    ----------
    options
        What was asked for.
    sensor
        (rows, columns) of the measurement.
    psf
        That it is reconstructed with.

    Raises
    ------
    OptionError
        If they contradict each other, or do not fit the measurement.
    """
    if options.support is not None and options.field is not None:
        raise OptionError(
            f"--support {options.support} and --field {options.field} both say where light can "
            "come from: leave one out"
        )
    if (options.field is None) != (options.camera is None):
        raise OptionError(
            "--field needs --camera, and --camera is for --field: an angle becomes cells by the "
            "camera's layers. Give both, such as --field 56deg --camera paper"
        )
    if options.field is None or options.camera is None:
        return None if options.support is None else region_within(options.support, sensor, psf)
    # Most reconstructions need no camera.
    from nolens.twin import FieldMap, preview_model

    camera = preview_model(read_camera(options.camera))
    cells = tuple(count // options.bin_by for count in camera.shape)
    if cells != sensor:
        raise OptionError(
            f"the camera {options.camera} has {cells[0]}×{cells[1]} cells (height × width), and "
            f"the measurement {sensor[0]}×{sensor[1]}: give the measurement's camera, or --support"
        )
    tangent = math.tan(math.radians(options.field.deg) / 2)
    whole = FieldMap.covering(camera, (tangent, tangent)).region
    by = options.bin_by
    side = -(-whole.height // by), -(-whole.width // by)
    return region_within(f"{side[0]}x{side[1]}", sensor, psf)


def region_within(text: str, sensor: tuple[int, int], psf: Tensor) -> Region:
    """Cells that light can come from; by far more than can be seen would only fill the memory.

    Parameters
    ----------
    text
        As --support has it.
    sensor
        (rows, columns) of the measurement.
    psf
        That it is reconstructed with.

    Raises
    ------
    OptionError
        If the text is no region, or one larger than can be seen.
    """
    region = parse_window(text, sensor, "--support")
    height, width = sensor[0] + psf.shape[-2], sensor[1] + psf.shape[-1]
    if region.height > height or region.width > width:
        raise OptionError(
            f"--support {text} is larger than what the sensor can see through this PSF; give at "
            f"most {height}x{width}, or leave it out for no limit"
        )
    return region


def crop_window(options: ReconstructOptions, problem: Problem) -> tuple[int, int, int, int]:
    """Rows and columns of the scene that are written: (top, left, height, width).

    Raises
    ------
    OptionError
        If --crop reaches beyond the scene.
    """
    geometry = problem.forward.geometry
    height, width = geometry.scene[2:]
    if options.crop is None:
        return problem.frame
    if options.crop == "all":
        return 0, 0, height, width
    wanted = parse_window(options.crop, problem.forward.sensor, "--crop")
    top, left = wanted.top - geometry.origin[0], wanted.left - geometry.origin[1]
    if min(top, left) < 0 or top + wanted.height > height or left + wanted.width > width:
        raise OptionError(
            f"--crop {options.crop} reaches beyond the scene, which is {height}×{width} cells "
            f"from {geometry.origin[0]:+d}{geometry.origin[1]:+d}; give a part of that, or all"
        )
    return top, left, wanted.height, wanted.width


def oriented(picture: Tensor, flip: str) -> Tensor:
    """Picture (…, rows, columns) turned over as --flip asks for."""
    axes = {"none": (), "vertical": (-2,), "horizontal": (-1,), "both": (-2, -1)}[flip]
    return torch.flip(picture, axes) if axes else picture
