"""Frames of a point source by simulated cameras, and what they would be without noise."""

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from nolens.calibrate.exposures import superpixels
from nolens.calibrate.frames import FrameMean
from nolens.camera import Frame, LoadedCamera, preset
from nolens.evaluate import psnr, scale_fit
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import write_frame
from nolens.optics import PointSource

DARK = 1e-9
"""Fill of a frame without light."""


@cache
def bench(name: str, size: tuple[int, int] | None = None) -> VirtualExperiment:
    """A preset, with a smaller sensor of the same pixels, in light that all its colours see."""
    camera = preset(name)
    if size is not None:
        sensor = camera.sensor.model_copy(update={"rows": size[0], "columns": size[1]})
        camera = camera.model_copy(update={"sensor": sensor})
    return VirtualExperiment.of(LoadedCamera.of(camera), light="white-led")


@cache
def light_of(
    name: str, size: tuple[int, int] | None = None, distance_mm: float = 300.0,
    tangent: tuple[float, float] = (0.0, 0.0),
) -> Tensor:  # fmt: skip
    return bench(name, size).light_of(PointSource(tangent, distance_mm * 1e3))


@dataclass(frozen=True)
class Shot:
    """A simulated camera in front of a point source.

    `warm` are counts that the pixels have without light, as only dark frames tell; `veil` is
    light of other sources, as a share of the pattern's peak.
    """

    camera: VirtualExperiment
    light: Tensor
    warm: Tensor | None = None
    veil: Tensor | None = None

    @property
    def truth(self) -> Tensor:
        """The PSF without noise, on the cells of the reconstruction."""
        return superpixels(self.light[None], self.frame(0.1, 0))

    def frame(self, fill: float, seed: int, exposure_s: float | None = None) -> Frame:
        light = self.light
        if self.veil is not None:
            light = light + self.veil * self.light.max()
            fill = fill * float(light.max() / self.light.max())
        found = self.camera.exposed(light, fill, seed)
        counts = found.counts
        if self.warm is not None:
            counts = (counts + self.warm).clamp(max=found.white)
        return replace(found, counts=counts, exposure_s=exposure_s)

    def frames(self, count: int, fill: float, exposure_s: float | None = None) -> FrameMean:
        first = round(1e5 * fill)
        mean = FrameMean(self.frame(fill, first, exposure_s))
        for number in range(1, count):
            mean.add(self.frame(fill, first + number, exposure_s))
        return mean

    def darks(self, count: int, first: int = 70000) -> FrameMean:
        bare = replace(self, veil=None)
        mean = FrameMean(bare.frame(DARK, first), "dark frame")
        for number in range(1, count):
            mean.add(bare.frame(DARK, first + number))
        return mean

    def write(self, folder: Path, count: int, fill: float, ms: float, what: str) -> list[Path]:
        """DNGs of so many frames."""
        paths = [folder / f"{what}-{ms:g}ms-{number}.dng" for number in range(count)]
        for number, path in enumerate(paths):
            frame = self.frame(fill, round(1e5 * fill) + 100 * number + len(what))
            write_frame(path, replace(frame, exposure_s=ms * 1e-3))
        return paths


def warm_pixels(size: tuple[int, int], seed: int = 5) -> Tensor:
    """Counts of dark current that differ from pixel to pixel."""
    generator = torch.Generator().manual_seed(seed)
    return (40 * torch.rand(size, generator=generator)).round()[None]


def decibels(found: Tensor, truth: Tensor) -> float:
    """PSNR against the truth after one scale factor."""
    return psnr(scale_fit(found, truth), truth, float(truth.max()))


def spots(
    cells: tuple[int, int], scale: float = 1.0, moved: tuple[float, float] = (0.0, 0.0),
    seed: int = 2, count: int = 60, width: float = 2.0,
) -> Tensor:  # fmt: skip
    """Gaussian spots at places that grow with the scale, (1, rows, columns)."""
    generator = torch.Generator().manual_seed(seed)
    reach = torch.tensor([0.9 * n for n in cells], dtype=torch.float64)
    places = (torch.rand(count, 2, generator=generator, dtype=torch.float64) - 0.5) * reach
    places = places * scale + torch.tensor(moved, dtype=torch.float64)
    rows, columns = (torch.arange(n, dtype=torch.float64) - (n - 1) / 2 for n in cells)
    plane = torch.zeros(cells, dtype=torch.float64)
    for row, column in places.tolist():
        squared = (rows - row)[:, None].square() + (columns - column).square()
        plane += torch.exp(-squared / (2 * (width * scale) ** 2)) / scale**2
    return plane[None].float()


def rms(values: Tensor) -> float:
    return math.sqrt(float(values.double().square().mean()))
