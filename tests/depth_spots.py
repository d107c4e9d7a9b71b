"""A camera whose PSF is known at every distance: round spots that move away from the middle."""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from nolens.camera import Frame, Measurement, PsfEntry
from nolens.files import write_frame, write_psfs
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.quantities import Length

SENSOR = (60, 80)
SCENE = (30, 48)
WIDE = (SENSOR[0] + SCENE[0], SENSOR[1] + SCENE[1])
SUPPORT = PixelRectangle.centred(*SCENE, SENSOR)
CELL_UM = 10.0
REDUCED_UM = 4000.0
SIGMA = 0.9
NEAR_UM, FAR_UM = 20e3, 80e3
LEFT, RIGHT = (slice(4, 26), slice(3, 20)), (slice(4, 26), slice(28, 45))


def spots(
    depth_um: float,
    cells: tuple[int, int] = WIDE,
    *,
    moved: tuple[float, float] = (0.0, 0.0),
    reduced_um: float = REDUCED_UM,
    seed: int = 4,
) -> Tensor:
    """PSF of a point at a distance, (1, rows, columns): places and widths grow with 1 + D/z."""
    generator = np.random.default_rng(seed)
    m = 1 + reduced_um / depth_um
    rows, columns = np.mgrid[: cells[0], : cells[1]]
    plane = np.zeros(cells)
    for _ in range(60):
        row, column = generator.uniform(-0.62, 0.62, 2) * WIDE
        height = generator.uniform(0.5, 1)
        at = cells[0] // 2 + m * row + moved[0], cells[1] // 2 + m * column + moved[1]
        squared = (rows - at[0]) ** 2 + (columns - at[1]) ** 2
        plane += height / m**2 * np.exp(-squared / (2 * (SIGMA * m) ** 2))
    return torch.from_numpy(plane)[None].float()


def objects() -> tuple[Tensor, Tensor]:
    """Two objects beside each other, each of its own pattern, (1, rows, columns)."""
    left, right = torch.zeros(1, *SCENE), torch.zeros(1, *SCENE)
    left[0][LEFT] = 0.4
    left[0, 7:11, 6:17] = 1.0
    left[0, 14:23, 6:9] = 0.9
    left[0, 14:17, 12:18] = 0.05
    right[0][RIGHT] = 0.5
    right[0, 6:24, 31:33] = 1.0
    right[0, 6:24, 37:40] = 0.1
    right[0, 12:15, 40:44] = 1.0
    return left, right


def light(scenes: dict[float, Tensor]) -> Tensor:
    """What falls on the sensor from scenes at distances, (1, rows, columns)."""
    return sum(
        (CroppedConvolution(spots(z), SENSOR, SUPPORT)(scene) for z, scene in scenes.items()),
        torch.zeros(1, *SENSOR),
    )


def two_objects() -> Tensor:
    left, right = objects()
    return light({NEAR_UM: left, FAR_UM: right})


def noisy(values: Tensor, share: float, seed: int = 1) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return values + share * values.max() * torch.randn(values.shape, generator=generator)


def measurement(values: Tensor) -> Measurement:
    valid = torch.ones_like(values, dtype=torch.bool)
    return Measurement(values, valid, ("grey",), None, "made here", True)


def write_set(
    folder: Path, distances_mm: tuple[float, ...], *, kind: str = "stitched",
    cells: tuple[int, int] = WIDE, **more: float,
) -> Path:  # fmt: skip
    """A folder with PSFs at distances."""
    entries = {}
    for z in distances_mm:
        distance = "infinity" if math.isinf(z) else Length.of(z, "mm")
        entry = PsfEntry.model_validate({
            "file": f"psf-{z:g}mm.tif", "cell": f"{CELL_UM:g} um", "channels": ("grey",),
            "distance": distance, "kind": kind,
        })  # fmt: skip
        entries[entry] = spots(z * 1e3, cells, **more)
    write_psfs(folder, entries)
    return folder


def write_raw(path: Path, values: Tensor) -> Path:
    """Counts of 12 bits, black at 64."""
    counts = (64 + 3600 * values[:1] / values.max()).round()
    write_frame(path, Frame(counts, ("grey",), None, (64.0,), 4095.0, "uint16", str(path)))
    return path
