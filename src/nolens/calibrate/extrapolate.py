"""The PSF beyond the sensor's edge: its mean light, or estimated with ordinary pictures."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from nolens.calibrate.known_scenes import ManyScenes
from nolens.camera.measurement import Measurement
from nolens.errors import DataError, OptionError
from nolens.operators import PixelRectangle
from nolens.solvers import Reconstructor

_SCENE_STEPS = 60
"""Of ADMM, for each scene and round."""
_PSF_STEPS = 40
"""Of FISTA, for each round."""
_LEAST_EXPLAINED = 0.1
"""Fraction of the residual that the first round must explain: less is noise, and harms."""


@dataclass(frozen=True)
class ExtrapolatedPsf:
    """A PSF extrapolated beyond the sensor.

    Parameters
    ----------
    psf
        (channels, rows, columns), zero shift in the pixel (rows // 2, columns // 2); the
        captured one in its middle.
    from_pictures
        Whether the pictures show what lies outside; if not, it is the mean light.
    residual
        Root mean square of what the pictures' reconstructions leave over, as a fraction of the
        measurements', before the first round and after each.
    interrupted
        Whether it was stopped before its end.
    """

    psf: Tensor
    from_pictures: bool
    residual: tuple[float, ...]
    interrupted: bool = False

    def figures(self) -> dict[str, Any]:
        """Figures in values that JSON has."""
        return {
            "pixels": list(self.psf.shape[-2:]),
            "extrapolated_by": "pictures" if self.from_pictures else "mean light",
            "rounds": max(0, len(self.residual) - 1),
            "residual": [round(each, 7) for each in self.residual],
            "interrupted": self.interrupted,
        }

    def warnings(self) -> list[str]:
        """Whether there were pictures, and they show too little."""
        if not self.residual or self.from_pictures:
            return []
        explained = 1 - self.residual[1] / self.residual[0]
        return [
            "the pictures show too little of what lies beyond the sensor "
            f"({100 * explained:.1f} % of what their reconstruction leaves over): it has the PSF's "
            "mean light. Captures at angles give more (nolens calibrate plan)"
        ]


def check_support(support: PixelRectangle, captured: Tensor) -> None:
    """Refuse a support that a captured PSF cannot be extrapolated for.

    Raises
    ------
    OptionError
        If the support is larger than the sensor, or wholly beside it.
    """
    rows, columns = captured.shape[-2:]
    for start, side, count in (
        (support.top, support.height, rows),
        (support.left, support.width, columns),
    ):
        if side > count or start + side <= 0 or start >= count:
            raise OptionError(
                f"--support {side} pixels from pixel {start} on: light must fall on the sensor's "
                f"{count} pixels through the middle of the PSF, and cover no more of them than "
                "there are; nolens calibrate plan CAMERA --angle 56deg gives the support"
            )


def filled(captured: Tensor, support: PixelRectangle) -> Tensor:
    """The captured PSF with its mean light around it, as far as a scene's light comes from.

    The PSF, (channels, rows, columns), is as large as the sensor; the support has the pixels that
    light comes from.
    """
    rows, columns = captured.shape[-2:]
    size = (
        2 * max(support.top + support.height, rows - support.top),
        2 * max(support.left + support.width, columns - support.left),
    )
    wide = captured.mean(dim=(-2, -1), keepdim=True).expand(-1, *size).clone()
    wide[_inside(size, (rows, columns))] = captured
    return wide


def check_picture(picture: Measurement, psf: Tensor, channels: tuple[str, ...], name: str) -> None:
    """Refuse a picture from which a PSF of some channels, of a file of this name, cannot be told.

    Raises
    ------
    DataError
        If its channels or pixels are not the PSF's, or one of them shows no light.
    """
    if picture.channels != channels:
        raise DataError(
            f"{picture.source} has the channels {', '.join(picture.channels)}, but the PSF "
            f"{name} {', '.join(channels)}: give raw frames of the same camera"
        )
    if picture.values.shape != psf.shape:
        raise DataError(
            f"{picture.source} has {picture.size_text} pixels, but the PSF {name} "
            f"{psf.shape[-2]}×{psf.shape[-1]}: give raw frames of the same camera, whole"
        )
    light = torch.where(picture.valid, picture.values, 0).sum(dim=(-2, -1))
    if not bool((light > 0).all()):
        raise DataError(f"{picture.source} shows no light in at least one channel: leave it out")


def extrapolate(
    captured: Tensor,
    pictures: list[Measurement],
    support: PixelRectangle,
    *,
    rounds: int,
    tau: float,
    step: Callable[[int, int], bool] | None = None,
) -> ExtrapolatedPsf:
    r"""Estimate the PSF beyond the sensor's edge from pictures of unknown scenes.

    Minimises :math:`\sum_k ½‖b_k - C(h * v_k)‖^2 + τ R(v_k)` over scenes :math:`v_k \ge 0` in the
    support and the PSF :math:`h \ge 0` outside what was captured, in turns, as blind deconvolution
    does (`ayers1988`; convex in each of the two): the scenes by ADMM (`nolens.solvers.admm`), the
    PSF by FISTA (`beck2009`), from the PSF's mean light all around. What makes it
    possible is that the largest part of h is known and the sensor has many times more pixels than
    the scenes.

    Where the scenes are so wide that their light averages the extrapolated PSF out, the
    measurements show nothing of it above noise, and the estimate of the first round is worse than
    the mean light. Then the mean light is the result (docs/decisions/0005-beyond-the-sensor.md).

    Parameters
    ----------
    captured
        PSF straight ahead, (channels, rows, columns), as large as the sensor.
    pictures
        What the sensor measured, with the PSF's channels; without any the result is the captured
        PSF with its mean light around it.
    support
        Pixels that their light comes from.
    rounds
        Turns of both.
    tau
        Weight of the prior, as `nolens reconstruct` takes it.
    step
        Called with the number of steps that are done, and of all; stops by returning True.
    """
    psf, from_pictures = filled(captured, support), False
    residual: list[float] = []
    limit = rounds * (len(pictures) + 1)
    stops = (step is not None and step(done, limit) for done in range(limit + 1))
    interrupted = bool(pictures) and next(stops)
    for _ in range(rounds if pictures and not interrupted else 0):
        scenes = []
        for picture in pictures:
            reconstructor = Reconstructor(psf, support, tau).for_iterations(_SCENE_STEPS)
            scenes.append(reconstructor.solve(picture).scene)
            if next(stops):
                return ExtrapolatedPsf(psf, from_pictures, tuple(residual), True)
        following, before, after = _outside_captured(psf, captured, pictures, scenes, support)
        residual += [after] if residual else [before, after]
        if residual[1] > (1 - _LEAST_EXPLAINED) * residual[0]:
            break
        psf, from_pictures = following, True
        if next(stops):
            interrupted = True
            break
    return ExtrapolatedPsf(psf, from_pictures, tuple(residual), interrupted)


def _inside(size: tuple[int, int], sensor: tuple[int, int]) -> tuple[slice, slice, slice]:
    """Where the captured PSF lies in the wide one: zero shift on zero shift."""
    top, left = (whole // 2 - part // 2 for whole, part in zip(size, sensor, strict=True))
    return slice(None), slice(top, top + sensor[0]), slice(left, left + sensor[1])


def _outside_captured(
    psf: Tensor,
    captured: Tensor,
    pictures: list[Measurement],
    scenes: list[Tensor],
    support: PixelRectangle,
) -> tuple[Tensor, float, float]:
    """Non-negative least squares for the PSF outside what was captured, given the scenes.

    Also the residuals that it begins and ends with.
    """
    size, sensor = (psf.shape[-2], psf.shape[-1]), (captured.shape[-2], captured.shape[-1])
    inside = _inside(size, sensor)
    planes, first, last = [], 0.0, 0.0
    for channel, radiances in enumerate(zip(*scenes, strict=True)):
        forward = ManyScenes(torch.stack(radiances), support, sensor, size)
        values = torch.stack([each.values[channel] for each in pictures])
        valid = torch.stack([each.valid[channel] for each in pictures])
        lipschitz = float(forward.transfer.abs().square().sum(dim=0).max())
        plane = ahead = psf[channel : channel + 1]
        momentum = 1.0
        for number in range(_PSF_STEPS):
            residual = torch.where(valid, forward(ahead) - values, 0)
            if number == 0:
                first += float(residual.double().square().sum())
            slope = forward.adjoint(residual)
            slope[inside] = 0
            before, plane = plane, (ahead - slope / lipschitz).clamp_min(0)
            following = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            ahead = plane + (momentum - 1) / following * (plane - before)
            momentum = following
        left = torch.where(valid, forward(plane) - values, 0)
        last += float(left.double().square().sum())
        planes.append(plane)
    light = sum(
        float(torch.where(each.valid, each.values, 0).double().square().sum()) for each in pictures
    )
    return torch.cat(planes), math.sqrt(first / light), math.sqrt(last / light)
