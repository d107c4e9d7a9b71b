"""PSFs of the paper's camera without an aperture, captured at angles, on a part of its sensor."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nolens.camera import LoadedCamera, preset
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.optics import PointSource
from nolens.quantities import Length

DISTANCE_UM = 300e3
CELL_UM = 3.1


def grey_camera(rows: int, columns: int) -> LoadedCamera:
    """One channel on cells of 3.1 um, through the paper's mask and layers."""
    camera = LoadedCamera.of(preset("paper"))
    green = camera.quantum_efficiency.model_copy(
        update={"values": {"grey": camera.quantum_efficiency.values["G"]}}
    )
    sensor = camera.camera.sensor.model_copy(
        update={
            "mosaic": "none", "rows": rows, "columns": columns, "pitch": Length("3.1", "um"),
            "quantum_efficiency": green,
        }
    )  # fmt: skip
    return replace(
        camera,
        camera=camera.camera.model_copy(update={"sensor": sensor}),
        quantum_efficiency=green,
    )


@dataclass(frozen=True)
class Light:
    """A point source: what was written down of it, and where it really was."""

    stated_deg: tuple[float, float]
    actual_deg: tuple[float, float]

    @property
    def source(self) -> PointSource:
        right, up = (math.tan(math.radians(each)) for each in self.actual_deg)
        return PointSource((-up, right), DISTANCE_UM, 50.0)


def lights(half_deg: float, error_deg: float, seed: int = 3) -> list[Light]:
    """Nine lights to the edges of a scene; all but the middle one are off by random angles."""
    generator = torch.Generator().manual_seed(seed)
    found = []
    for up in (half_deg, 0.0, -half_deg):
        for right in (-half_deg, 0.0, half_deg):
            off = torch.randn(2, generator=generator) * (error_deg if up or right else 0.0)
            actual = right + float(off[0]), up + float(off[1])
            found.append(Light((right, up), actual))
    return found


def captured(bench: VirtualExperiment, light: Light, frames: int = 4) -> Tensor:
    """Mean of several frames without black, (channels, rows, columns)."""
    image = bench.light_of(light.source)
    counts = [bench.exposed(image, 0.9, seed).counts for seed in range(frames)]
    return torch.stack(counts).mean(dim=0) - bench.sensor.black_counts
