"""The demonstration: what the paper's camera, simulated, sees of point sources and of a scene."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import (
    Camera,
    FieldPsf,
    Frame,
    LoadedCamera,
    develop,
    exposure_white,
    preset,
)
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.progress import part_of
from nolens.quantities import Length
from nolens.twin import Light, Plane, Twin, mosaic

_SCENE_PIXELS = (1520, 2028)
"""Part of the paper's sensor that is read for the scene: half of it in each direction."""
_PSF_PIXELS = (2320, 2828)
"""Part that is read for a point source: wider by what the scene moves the PSF."""
DISTANCE = Length("300", "mm")
_SOURCE_UM = 50.0
_ANGLE_DEG = 50.0
_POINTS = ((0.0, 0.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0))
"""Point sources: ahead, and in the scene's corners."""


@dataclass(frozen=True)
class Demonstration:
    """Frames of the simulated camera, and what their reconstruction is to show.

    Parameters
    ----------
    camera
        With the part of its sensor that is read for the scene.
    psfs
        Of the point sources, as they are measured.
    scene
        Frame of the scene.
    truth
        Radiance of the scene on the pixels of its support, (3, rows, columns).
    support
        Pixels that light comes from.
    """

    camera: Camera
    psfs: FieldPsf
    scene: Frame
    truth: Tensor
    support: PixelRectangle


def demonstrate(
    photograph: Tensor, note: Callable[[str], None], advance: Callable[[str, float], None]
) -> Demonstration:
    """Let the paper's camera see a photograph, and then point sources at the same distance.

    Parameters
    ----------
    photograph
        Radiance, (3, rows, columns).
    note
        Called with a sentence about what comes next.
    advance
        Called with a piece of work and the fraction of it that is done.
    """
    wide = Twin.of(LoadedCamera.of(preset("paper"))).reading(*_PSF_PIXELS)
    experiment = VirtualExperiment(wide, Light("white-led"), wavelengths=1, field_points=5)
    points = experiment.field_points
    note(
        f"a scene that fills {_ANGLE_DEG:g}°, on the middle {_size(_SCENE_PIXELS)} pixels of the "
        f"paper's camera, with {points}×{points} PSFs"
    )
    camera = wide.reading(*_SCENE_PIXELS)
    shot = replace(experiment, twin=camera).measure(
        (Plane(photograph, _ANGLE_DEG, DISTANCE.um),),
        seed=1,
        progress=lambda fraction: advance("scene", fraction),
    )
    note(
        f"{len(_POINTS)} point sources at {DISTANCE}, ahead and in the corners of the scene, each "
        f"on {_size(_PSF_PIXELS)} pixels"
    )
    tangent = math.tan(math.radians(_ANGLE_DEG / 2))
    corner = (tangent * photograph.shape[-2] / photograph.shape[-1], tangent)
    frames, places = [], []
    for number, (down, right) in enumerate(_POINTS):
        source = PointSource((down * corner[0], right * corner[1]), DISTANCE.um, _SOURCE_UM)
        part = part_of(lambda done: advance("point sources", done), number, len(_POINTS))
        psf = experiment.psf(source, _PSF_PIXELS, part, pixels=1)
        frames.append(experiment.exposed(mosaic(psf, experiment.sensor.mosaic), 0.9, 2 + number))
        places.append([each / wide.pixel_um for each in wide.shift_um(source)])
    return Demonstration(
        camera.camera,
        FieldPsf.of([develop(each).values for each in frames], torch.tensor(places)),
        shot.frame,
        shot.truth * shot.response,
        shot.support,
    )


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
