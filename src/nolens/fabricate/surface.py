"""Which surface of the imprint is made: the replica, the master, or the mould between them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.optics import Grid, Relief

SurfaceName = Literal["master", "mould", "replica"]

_STRIP = 256
_WORDS: dict[SurfaceName, str] = {
    "master": "MASTER: as on the camera, towards the viewer",
    "mould": "MOULD: mirrored left-right and inverted, towards the viewer",
    "replica": "REPLICA: as on the camera, towards the scene",
}


@dataclass(frozen=True)
class MadeSurface:
    """Heights of a surface that is to be made, as seen by who looks onto it.

    Parameters
    ----------
    name
        Which one it is.
    camera
        Name of the camera.
    height_um
        float32, (rows, columns), towards the viewer. Columns go to the right and rows *upwards*:
        so the sensor's go for who looks at the camera from the scene, because the sensor's
        picture is upright (`nolens.optics.PointSource.origin_um`).
    pitch_um
        Distance of the points, in both directions.
    rms_error_um, largest_error_um
        By how much the surface between the points that were kept misses the relief's own points.
    """

    name: SurfaceName
    camera: str
    height_um: Tensor
    pitch_um: float
    rms_error_um: float = 0.0
    largest_error_um: float = 0.0

    @property
    def words(self) -> str:
        """Which surface it is, in ASCII, as all files of it say."""
        return _WORDS[self.name]

    @property
    def size_mm(self) -> tuple[float, float]:
        """(width, height) from the first point to the last one."""
        rows, columns = self.height_um.shape
        return (columns - 1) * self.pitch_um * 1e-3, (rows - 1) * self.pitch_um * 1e-3

    @property
    def range_um(self) -> tuple[float, float]:
        """Lowest and highest point."""
        return float(self.height_um.min()), float(self.height_um.max())

    def coarser(self, pitch_um: float) -> "MadeSurface":
        """The surface at points farther apart, by cubic interpolation (`Relief.sample`).

        Raises
        ------
        OptionError
            If they are nearer than they were, or fewer than 2×2 are left.
        """
        if pitch_um < self.pitch_um * (1 - 1e-9):
            raise OptionError(
                f"a pitch of {pitch_um:g} µm is finer than the relief's {self.pitch_um:g} µm, and "
                f"would add nothing: give {self.pitch_um:g} µm or more (--pitch), or a camera "
                "whose relief has a finer grid"
            )
        count = [math.floor(length * 1e3 / pitch_um + 1e-6) + 1 for length in self.size_mm[::-1]]
        if min(count) < 2:
            raise OptionError(
                f"a pitch of {pitch_um:g} µm leaves fewer than 2×2 points of a relief of "
                f"{self.size_mm[0]:.4g} × {self.size_mm[1]:.4g} mm: give a smaller one (--pitch)"
            )
        if count == list(self.height_um.shape):
            return self
        relief = Relief(self.height_um, self.pitch_um)
        kept = relief.sample(Grid(count[0], count[1], pitch_um))
        squares, largest, points = 0.0, 0.0, 0
        for made, meant in _beside(kept, pitch_um, self):
            miss = (made - meant).double()
            squares, points = squares + float(miss.square().sum()), points + miss.numel()
            largest = max(largest, float(miss.abs().max()))
        return replace(
            self,
            height_um=kept,
            pitch_um=pitch_um,
            rms_error_um=math.sqrt(squares / points),
            largest_error_um=largest,
        )


def made_surface(
    relief: Relief,
    name: SurfaceName,
    camera: str,
    *,
    crop_mm: tuple[float, float] | None = None,
    mould_shrinkage: float = 0.0,
) -> MadeSurface:
    r"""Turn the relief on a camera into the surface that is made.

    The replica is the relief h(x, y) itself. The mould meets it from above; turned over, it shows
    :math:`-h(-x, y)`. The mould took its shape from the master while it was larger, by
    :math:`1/(1 - s)` with the linear shrinkage s, so the master is the replica enlarged by that in
    all directions (`lee2008` gives s for PDMS).

    Parameters
    ----------
    relief
        On the camera.
    name
        Which surface.
    camera
        Name of the camera.
    crop_mm
        (width, height) of the middle part that is made; None for all of it.
    mould_shrinkage
        Fraction of its lengths that the mould loses until it is used.

    Raises
    ------
    OptionError
        If the part is larger than the relief, or smaller than 2×2 points, or the shrinkage is
        not within 0 to 0.5.
    """
    if not 0 <= mould_shrinkage < 0.5:
        raise OptionError(
            f"a shrinkage of the mould of {100 * mould_shrinkage:g} % (--mould-shrinkage): give a "
            "fraction of the length from 0 % to less than 50 %"
        )
    heights = relief.height_um
    if crop_mm is not None:
        heights = _cropped(relief, crop_mm)
    pitch_um = relief.grid_um
    if name == "mould":
        heights = -heights.flip(1)
    elif name == "master":
        heights, pitch_um = heights / (1 - mould_shrinkage), pitch_um / (1 - mould_shrinkage)
    return MadeSurface(name, camera, heights.contiguous(), pitch_um)


def _cropped(relief: Relief, crop_mm: tuple[float, float]) -> Tensor:
    there = relief.extent_um[::-1]
    if any(not 0 < want * 1e3 <= have + 1e-6 for want, have in zip(crop_mm, there, strict=True)):
        raise OptionError(
            f"a crop of {crop_mm[0]:g} × {crop_mm[1]:g} mm is no part of the relief of "
            f"{there[0] * 1e-3:.4g} × {there[1] * 1e-3:.4g} mm: give at most that (--crop)"
        )
    kept = []
    for want, count in zip(crop_mm[::-1], relief.height_um.shape, strict=True):
        points = math.floor(want * 1e3 / relief.grid_um + 1e-6) + 1
        # The middle must stay where it is.
        points -= (count - points) % 2
        if points < 2:
            raise OptionError(
                f"a crop of {crop_mm[0]:g} × {crop_mm[1]:g} mm has fewer than 2×2 points of the "
                f"relief, which has one every {relief.grid_um:g} µm: give a larger one (--crop)"
            )
        first = (count - points) // 2
        kept.append(slice(first, first + points))
    return relief.height_um[kept[0], kept[1]]


def _beside(kept: Tensor, pitch_um: float, fine: MadeSurface) -> Iterator[tuple[Tensor, Tensor]]:
    """Heights between the points that were kept (bilinear), and the surface's own, in strips."""
    (top, rows, down), (left, columns, right) = (
        _cells(fine.height_um.shape[axis], fine.pitch_um, kept.shape[axis], pitch_um)
        for axis in (0, 1)
    )
    inside = slice(left, left + len(columns))
    for start in range(0, len(rows), _STRIP):
        part = slice(start, start + _STRIP)
        at, share = rows[part], down[part, None]
        lines = kept[at] * (1 - share) + kept[at + 1] * share
        made = lines[:, columns] * (1 - right) + lines[:, columns + 1] * right
        yield made, fine.height_um[top + start : top + start + len(at), inside]


def _cells(
    count: int, pitch_um: float, kept: int, kept_pitch_um: float
) -> tuple[int, Tensor, Tensor]:
    """First point within the kept ones, and for each from there its cell and place in it."""
    steps = torch.arange(count, dtype=torch.float64) - (count - 1) / 2
    place = steps * (pitch_um / kept_pitch_um) + (kept - 1) / 2
    within = torch.nonzero((place >= -1e-9) & (place <= kept - 1 + 1e-9))[:, 0]
    place = place[within]
    cell = place.floor().clamp(0, kept - 2)
    return int(within[0]), cell.long(), (place - cell).float()
