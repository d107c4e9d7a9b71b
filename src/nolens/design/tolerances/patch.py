"""A patch of a camera's mask that stands for all of it."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf

from nolens.camera import LoadedCamera, RandomLenslets, ReliefFile
from nolens.errors import OptionError
from nolens.optics import Margin, Relief
from nolens.twin import REFERENCE_NM, Twin, described_lenslets

_SIDE_UM = 600.0
_PITCHES = 8.0
_SLACK = 1.25
"""Margin around a patch that also serves cameras that came out differently."""
_FEWEST = 5
_MOST_POINTS = 1e8


@dataclass(frozen=True)
class Lenslets:
    """What a relief has in common with an arrangement of lenslets.

    Parameters
    ----------
    radius_um
        Radius of curvature at their tops, the median.
    pitch_um
        Distance of neighbours in a hexagonal arrangement as dense.
    gathered
        Fraction of the surface that is curved like them in both directions, and gathers light.
    """

    radius_um: float
    pitch_um: float
    gathered: float

    @classmethod
    def of(cls, relief: Relief, *, bulging: float) -> "Lenslets":
        r"""Find the lenslets of a relief: its tops, with the curvature :math:`-\nabla^2 h / 2`.

        Parameters
        ----------
        relief
            The surface.
        bulging
            1 where hills focus the light, −1 where hollows do.

        Raises
        ------
        OptionError
            If there are fewer than five.
        """
        height = relief.height_um.double() * bulging
        inner = height[1:-1, 1:-1]
        along = height[2:, 1:-1] + height[:-2, 1:-1] - 2 * inner
        across = height[1:-1, 2:] + height[1:-1, :-2] - 2 * inner
        twist = (height[2:, 2:] + height[:-2, :-2] - height[2:, :-2] - height[:-2, 2:]) / 4
        curvature = -(along + across) / (2 * relief.grid_um**2)
        gathers = (curvature > 0) & (along * across > twist.square())
        tops = (nnf.max_pool2d(height[None, None], 3, 1)[0, 0] == inner) & (curvature > 0)
        count = int(tops.sum())
        if count < _FEWEST:
            raise OptionError(
                f"the mask has {count} tops that gather light in a patch of "
                f"{inner.shape[1] * relief.grid_um * 1e-3:.2g} mm, and {_FEWEST} are the fewest "
                "whose PSF says something: give a relief with more or smaller lenslets"
            )
        density = count / (inner.numel() * relief.grid_um**2)
        return cls(
            1 / float(curvature[tops].median()),
            math.sqrt(2 / (math.sqrt(3) * density)),
            float(gathers.double().mean()),
        )

    @property
    def area_um2(self) -> float:
        """Area that one of them has to itself."""
        return math.sqrt(3) / 2 * self.pitch_um**2


@dataclass(frozen=True)
class Patch:
    """A camera with a patch of its mask.

    Parameters
    ----------
    twin
        Its relief is the patch alone, with a margin around.
    side_um
        (height, width) of the part of the sensor that is looked at.
    lenslets
        Of the patch.
    """

    twin: Twin
    side_um: tuple[float, float]
    lenslets: Lenslets

    @classmethod
    def of(cls, loaded: LoadedCamera) -> "Patch":
        """Take a patch of eight lenslets along a side, and 0.6 mm or more; or all of the sensor.

        Of random lenslets as many are drawn as the patch needs: others than those of the whole
        mask, of the same kind.

        Raises
        ------
        OptionError
            If the relief is too coarse for the light or too small, or has too few lenslets.
        """
        camera, relief = loaded.camera, loaded.camera.mask.relief
        assert isinstance(relief, RandomLenslets | ReliefFile)
        whole = camera.sensor.rows, camera.sensor.columns
        length_um = _SIDE_UM
        if isinstance(relief, RandomLenslets):
            length_um = max(length_um, _PITCHES * relief.pitch.um)
        side = [min(length_um, count * camera.sensor.pitch.um) for count in whole]
        beyond = 2 * _margin_um(loaded, side)
        points = math.prod((each + beyond) / relief.grid.um for each in side)
        if points > _MOST_POINTS:
            finest = relief.grid.um * math.sqrt(points / _MOST_POINTS)
            raise OptionError(
                f"the grid of the relief of {camera.name!r}, {relief.grid}, puts {points:.0e} "
                f"points on a patch of {side[1] * 1e-3:.2g} mm: give one of {finest:.2g} µm or "
                "coarser"
            )
        if isinstance(relief, RandomLenslets):
            surface = described_lenslets(camera, (side[0] + beyond, side[1] + beyond))
        else:
            assert loaded.relief_um is not None
            surface = _middle(Relief(loaded.relief_um, relief.grid.um), side, beyond)
        file = ReliefFile(kind="file", file="patch.tif", grid=relief.grid)
        twin = Twin.of(loaded.with_relief(file, surface.height_um))
        if camera.mask.aperture is None:
            lit = [length - beyond for length in surface.extent_um]
            side = [min(one, other) for one, other in zip(side, lit, strict=True)]
        media = twin.media(REFERENCE_NM)
        lenslets = Lenslets.of(surface, bulging=math.copysign(1.0, media.below - media.above))
        if min(side) < 3 * lenslets.pitch_um:
            raise OptionError(
                f"the relief of {camera.name!r} carries a PSF of {max(0.0, min(side)):.0f} µm, "
                f"less than three of its lenslets of {lenslets.pitch_um:.0f} µm: give a relief of "
                f"{(beyond + 3 * lenslets.pitch_um) * 1e-3:.2f} mm or more"
            )
        return cls(twin, (side[0], side[1]), lenslets)


def _margin_um(loaded: LoadedCamera, side: list[float]) -> float:
    """What a patch needs around it: light that the relief turns, and diffraction."""
    camera = loaded.camera
    surface, indices = camera.mask.surface, camera.media(REFERENCE_NM)
    layers = zip(camera.layers[surface:], indices[surface + 1 :], strict=True)
    spread = sum(layer.thickness.um / index for layer, index in layers)
    relief = camera.mask.relief
    if isinstance(relief, RandomLenslets):
        # A lenslet's rim is the steepest there is.
        slope = relief.pitch.um / relief.radius.um
    else:
        assert isinstance(relief, ReliefFile) and loaded.relief_um is not None
        slope = Relief(loaded.relief_um, relief.grid.um).steepest
    turned = abs(indices[surface + 1] - indices[surface]) * slope
    lost = _SLACK * Margin.needed(turned, spread, REFERENCE_NM * 1e-3).total_um
    return float(lost + 0.1 * max(side))


def _middle(relief: Relief, side: list[float], beyond: float) -> Relief:
    """The middle of a relief, as large as a patch needs."""
    values = relief.height_um
    for axis, length in enumerate(side):
        count = values.shape[axis]
        needed = min(count, math.ceil((length + beyond) / relief.grid_um) + 1)
        values = values.narrow(axis, (count - needed) // 2, needed)
    return Relief(values.to(torch.float32), relief.grid_um)
