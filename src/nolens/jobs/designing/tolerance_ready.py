"""What is checked before the tolerances of a camera are studied."""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from nolens.camera import Camera, OpenCamera
from nolens.design.tolerances import (
    Criterion,
    Parameter,
    Patch,
    RayModel,
    Sharpness,
    WaveModel,
    check_possible,
    criterion_of,
    default_parameters,
    draw,
    find,
    variables,
)
from nolens.errors import OptionError
from nolens.files import read_tolerances
from nolens.jobs.cost import Cost, check_memory, colours_of, cost_of, pattern_size
from nolens.jobs.designing.tolerance_options import ToleranceOptions
from nolens.optics import PointSource
from nolens.twin import Light
from nolens.twin.preview import preview_model

_WAVELENGTHS = 3
_AT_ONCE = 1000
_CPU = torch.device("cpu")


@dataclass(frozen=True)
class Ready:
    """A study that has been checked and can be computed.

    Parameters
    ----------
    camera
        The description.
    parameters
        What varies.
    sharpness
        The criterion's kind.
    patch
        Of the mask.
    criterion
        From cameras to their figures.
    at_once
        Cameras that are computed in one portion.
    cameras
        Drawn, (trials, parameters).
    cost
        Of one portion.
    """

    camera: Camera
    parameters: tuple[Parameter, ...]
    sharpness: Sharpness
    patch: Patch
    criterion: Criterion
    at_once: int
    cameras: Tensor
    cost: Cost


def parameters_of(opened: OpenCamera, tolerances: Path | None) -> tuple[Parameter, ...]:
    """Tolerances from a file, or what is assumed.

    Raises
    ------
    NolensError
        If the file cannot be used, or the camera's mask is flat.
    """
    if tolerances is None:
        return default_parameters(opened.camera)
    return read_tolerances(tolerances, opened.camera)


def prepare(options: ToleranceOptions, opened: OpenCamera) -> Ready:
    """Check all that can be checked before anything takes long.

    Raises
    ------
    NolensError
        If an option, the tolerances or the camera cannot be used.
    """
    sharpness, light = Sharpness.parse(options.criterion), Light(options.light)
    parameters = parameters_of(opened, options.tolerances)
    options.limit_for(sharpness, 1.0)
    if options.solve is not None:
        place_of(options.solve, parameters, opened.camera)
    cameras = draw(parameters, options.trials, options.seed)
    check_possible(opened.camera, parameters, cameras)
    preview_model(opened)  # Refuses a relief that is coarser than it must be.
    patch = Patch.of(opened)
    sharpness.check(patch.twin.sensor_pitch_um, patch.lenslets.pitch_um)
    channels = colours_of(patch.twin, light, _WAVELENGTHS)
    colours = channels[len(channels) // 2]
    threads = torch.get_num_threads()
    model: WaveModel | RayModel = WaveModel(patch, sharpness, colours, threads)
    if options.model == "rays":
        model = RayModel(patch, sharpness, sum(nm * weight for nm, weight in colours))
    criterion = criterion_of(model, opened.camera, tuple(each.name for each in parameters))
    at_once = _AT_ONCE if options.model == "rays" else threads
    cost = Cost(0, 0) if options.model == "rays" else _cost_of_portion(patch, colours, at_once)
    check_memory(cost, _CPU, "thinner layers, or --model rays, need less")
    return Ready(opened.camera, parameters, sharpness, patch, criterion, at_once, cameras, cost)


def _cost_of_portion(patch: Patch, colours: tuple[tuple[float, float], ...], cameras: int) -> Cost:
    """Patterns of some cameras, side by side."""
    twin = patch.twin
    source = PointSource(distance_um=twin.camera.reference_distance.um)
    cells = round(patch.side_um[0] / twin.cell_um), round(patch.side_um[1] / twin.cell_um)
    size = pattern_size(
        twin, source, cells, twin.cell_pixels, at_least=2, shortest=min(nm for nm, _ in colours)
    )
    points = twin.mask.relief.height_um.numel()
    one = cost_of(size, len(colours), points=points, held=0)
    return Cost(bytes=cameras * one.bytes, seconds=one.seconds)


def place_of(name: str, parameters: tuple[Parameter, ...], camera: Camera) -> int:
    """Place of a parameter among those that vary.

    Raises
    ------
    OptionError
        If the camera has none of this name, or it does not vary.
    """
    full = find(variables(camera), camera, name).name
    names = [each.name for each in parameters]
    if full not in names:
        raise OptionError(
            f"--solve {name}: it is not among the parameters of the tolerances, which are "
            f"{', '.join(names)}: add it, with any tolerance and its distribution"
        )
    return names.index(full)
