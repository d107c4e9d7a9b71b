"""Measurements of known scenes, as a linear map of the PSF they have in common."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.errors import DataError
from nolens.operators import Region


@dataclass(frozen=True)
class KnownScenes:
    """Measurements of scenes that are known; each channel of each pair is one of them.

    Attributes
    ----------
    scenes
        Radiance on the scene's cells, (measurements, rows, columns), not negative.
    measured
        Linear values with 0 for no light, (measurements, rows, columns) of the sensor.
    valid
        bool, like `measured`: False where a pixel is saturated.
    region
        Where the scenes' cells lie in the sensor's frame.
    """

    scenes: Tensor
    measured: Tensor
    valid: Tensor
    region: Region

    @classmethod
    def of(
        cls, scenes: Sequence[Tensor], measured: Sequence[Tensor],
        valid: Sequence[Tensor] | None = None, region: Region | None = None,
    ) -> Self:  # fmt: skip
        """Put pairs together, each of one or more channels.

        Parameters
        ----------
        scenes, measured, valid
            (channels, rows, columns) of each pair; without `valid` every pixel is.
        region
            None for scenes in the middle of the sensor's frame.

        Raises
        ------
        DataError
            If there is none, sizes do not fit together, or one shows nothing.
        """
        if not scenes or len(scenes) != len(measured):
            raise DataError(
                f"{len(scenes)} scenes and {len(measured)} measurements: give one of each, or more"
            )
        if valid is None:
            valid = [torch.ones_like(each, dtype=torch.bool) for each in measured]
        for name, given in (("scene", scenes), ("measurement", measured)):
            sizes = {tuple(each.shape[-2:]) for each in given}
            if len(sizes) > 1:
                raise DataError(f"the sizes of the {name}s differ: {sorted(sizes)}")
        for one, other in zip(scenes, measured, strict=True):
            if one.shape[0] != other.shape[0]:
                raise DataError(
                    f"a scene has {one.shape[0]} channels and its measurement {other.shape[0]}"
                )
        rows, columns = scenes[0].shape[-2:]
        sensor = (measured[0].shape[-2], measured[0].shape[-1])
        if region is None:
            region = Region.centred(rows, columns, sensor)
        if (region.height, region.width) != (rows, columns):
            raise DataError(
                f"the region has {region.height}×{region.width} cells and the scenes "
                f"{rows}×{columns}"
            )
        found = cls(
            torch.cat([each.float() for each in scenes]),
            torch.cat([each.float() for each in measured]),
            torch.cat(list(valid)),
            region,
        )
        found._check_light()
        return found

    @property
    def sensor(self) -> tuple[int, int]:
        """(rows, columns) of the measurements."""
        return self.measured.shape[-2], self.measured.shape[-1]

    @property
    def reach(self) -> tuple[int, int]:
        """(rows, columns) of the PSF that light from every scene cell to every pixel needs."""
        rows, columns = self.sensor
        return rows + self.region.height, columns + self.region.width

    def binned(self, by: int) -> Self:
        """The same on cells of by × by; what does not fill one is dropped at the far edges."""
        if by == 1:
            return self
        # Scene cells are binned from the sensor's first cell, so that both grids stay together.
        top, left = self.region.top, self.region.left
        skipped = -top % by, -left % by
        scenes = self.scenes[:, skipped[0] :, skipped[1] :]
        dark = nnf.max_pool2d((~self.valid).float()[None], by)[0] > 0
        scenes = nnf.avg_pool2d(scenes[None], by)[0]
        region = Region(
            (top + skipped[0]) // by, (left + skipped[1]) // by, scenes.shape[-2], scenes.shape[-1]
        )
        return replace(
            self, scenes=scenes, measured=nnf.avg_pool2d(self.measured[None], by)[0], valid=~dark,
            region=region,
        )  # fmt: skip

    def _check_light(self) -> None:
        for name, given in (("scene", self.scenes), ("measurement", self.measured)):
            if not bool(torch.isfinite(given).all()):
                raise DataError(f"a {name} holds NaN or infinity; give finite values")
            if not bool((given.double().mean(dim=(-2, -1)) > 0).all()):
                raise DataError(f"a {name} is dark: nothing can be learnt from it")
            if not bool((given.double().std(dim=(-2, -1)) > 0).all()):
                raise DataError(f"a {name} is the same everywhere: nothing can be learnt from it")


def over_the_field(known: KnownScenes) -> Tensor:
    """1, and how a PSF changes over a scene: φ of `ManyScenesAslant`, (4, rows, columns).

    With u and v the place along rows and columns, from −1 to 1 along the longer side: 1, u, v and
    u² + v², the field dependence of a camera's aberrations to second order (`welford1986`). All
    but the first are 0 in the mean over the scenes' light, so that its PSF is the mean one.
    """
    rows, columns = known.scenes.shape[-2:]
    half = max(rows, columns) / 2
    u = ((torch.arange(rows) + 0.5 - rows / 2) / half)[:, None].expand(rows, columns)
    v = ((torch.arange(columns) + 0.5 - columns / 2) / half)[None].expand(rows, columns)
    light = (known.scenes / known.scenes.mean(dim=(-2, -1), keepdim=True)).mean(dim=0)
    changing = torch.stack([u, v, u.square() + v.square()])
    changing -= (changing * light).mean(dim=(-2, -1), keepdim=True) / light.mean()
    return torch.cat([torch.ones(1, rows, columns), changing])
