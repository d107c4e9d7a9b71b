"""The demonstration: what the paper's camera, simulated, sees of a point source and of a scene."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import Frame, LoadedCamera, exposure_white, preset
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.twin import Light, Plane, Twin

_SCENE_PIXELS = (1520, 2028)
"""Part of the paper's sensor that is read for the scene: half of it in each direction."""
_PSF_PIXELS = (2320, 2828)
"""Part that is read for the point source: wider by what the scene moves the PSF."""
_DISTANCE_UM = 300e3
_SOURCE_UM = 50.0
_ANGLE_DEG = 50.0


@dataclass(frozen=True)
class Demonstration:
    """Frames of the simulated camera, and what their reconstruction is to show.

    Parameters
    ----------
    point, scene
        Frames of a point source and of the scene.
    truth
        Radiance of the scene on the pixels of its support, (3, rows, columns).
    support
        Pixels that light comes from.
    """

    point: Frame
    scene: Frame
    truth: Tensor
    support: PixelRectangle


def demonstrate(
    photograph: Tensor, note: Callable[[str], None], advance: Callable[[str, float], None]
) -> Demonstration:
    """Let the paper's camera see a point source, and then a photograph at the same distance.

    Parameters
    ----------
    photograph
        Radiance, (3, rows, columns).
    note
        Called with a sentence about what comes next.
    advance
        Called with a piece of work and the fraction of it that is done.
    """
    note(f"the paper's camera: a point source at 300 mm, on the middle {_size(_PSF_PIXELS)} pixels")
    wide = Twin.of(LoadedCamera.of(preset("paper"))).reading(*_PSF_PIXELS)
    experiment = VirtualExperiment(wide, Light("white-led"), wavelengths=1, field_points=5)
    source = PointSource(distance_um=_DISTANCE_UM, diameter_um=_SOURCE_UM)
    point = experiment.point(
        source, seed=2, progress=lambda fraction: advance("point source", fraction)
    )
    points = experiment.field_points
    note(
        f"a scene that fills {_ANGLE_DEG:g}°, on the middle {_size(_SCENE_PIXELS)} pixels, with "
        f"{points}×{points} PSFs"
    )
    shot = replace(experiment, twin=wide.reading(*_SCENE_PIXELS)).measure(
        (Plane(photograph, _ANGLE_DEG, _DISTANCE_UM),),
        seed=1,
        progress=lambda fraction: advance("scene", fraction),
    )
    return Demonstration(point, shot.frame, shot.truth * shot.response, shot.support)


def side_by_side(measurement: Tensor, reconstruction: Tensor, truth: Tensor) -> Tensor:
    """Measurement | reconstruction | truth at one height, each exposed by itself."""
    height = truth.shape[-2]
    width = round(measurement.shape[-1] * height / measurement.shape[-2])
    small = nnf.interpolate(measurement.clamp_min(0)[None], size=(height, width), mode="area")[0]
    white = exposure_white(truth)
    panels = [small / exposure_white(small), reconstruction / white, truth / white]
    gap = torch.ones(3, height, 8)
    return torch.cat([panels[0], gap, panels[1], gap, panels[2]], dim=-1).clamp(0, 1)


def _size(pixels: tuple[int, int]) -> str:
    return f"{pixels[1]}×{pixels[0]}"
