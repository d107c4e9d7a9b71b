"""Frames of a point source as the small camera captures them, in files."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from nolens.calibrate.exposures import superpixels
from nolens.camera import LoadedCamera, preset
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import write_frame
from nolens.optics import PointSource

OFF_AXIS_DEG = (0.2, -0.1)
"""How far to the right and up the light stands that is meant to be straight ahead."""


@cache
def bench() -> VirtualExperiment:
    return VirtualExperiment.of(LoadedCamera.of(preset("small")), light="535nm")


@cache
def light_of(distance_mm: float, angle_deg: tuple[float, float] = (0.0, 0.0)) -> Tensor:
    right, up = (math.tan(math.radians(each)) for each in angle_deg)
    return bench().light_of(PointSource((-up, right), distance_mm * 1e3))


def truth(distance_mm: float) -> Tensor:
    """The PSF without noise, of a light exactly straight ahead."""
    light = light_of(distance_mm)
    return superpixels(light[None], bench().exposed(light, 0.1, 0))


def captured(
    folder: Path, name: str, light: Tensor, *, fills: tuple[float, ...] = (0.5, 2.0),
    count: int = 4, timed: bool = True, suffix: str = ".dng",
) -> list[Path]:  # fmt: skip
    """Frames of 10 ms for each half of a full pixel."""
    folder.mkdir(exist_ok=True)
    paths = []
    for fill in fills:
        ms = 10 * fill / 0.5
        for number in range(count):
            path = folder / f"{name}-{ms:g}ms-{number}{suffix}"
            frame = bench().exposed(light, fill, 1000 * number + round(10 * fill) + len(name))
            seconds = ms * 1e-3 if timed else None
            write_frame(path, replace(frame, exposure_s=seconds))
            paths.append(path)
    return paths


def dark_frames(folder: Path, ms: float = 10.0, count: int = 2) -> list[Path]:
    folder.mkdir(exist_ok=True)
    paths = [folder / f"dark-{ms:g}ms-{number}.dng" for number in range(count)]
    for number, path in enumerate(paths):
        frame = bench().exposed(torch.ones(256, 320), 1e-9, 50 + number)
        write_frame(path, replace(frame, exposure_s=ms * 1e-3))
    return paths


def smaller(folder: Path) -> Path:
    """A frame of a camera with fewer pixels."""
    frame = bench().exposed(light_of(300.0), 0.5, 3)
    path = folder / "smaller.dng"
    write_frame(path, replace(frame, counts=frame.counts[:, :240], exposure_s=0.01))
    return path
