"""A video from one measurement of a rolling shutter."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nolens.camera import Measurement, Sensor, Shutter, developed_rows
from nolens.operators import StackConvolution
from nolens.solvers.problem import Problem
from nolens.solvers.reconstructor import Reconstructor
from nolens.solvers.stack import StackPrior, StackProblem

ACROSS = 1.0
"""Weight of differences between frames over those between pixels (docs/video.md)."""


@dataclass(frozen=True)
class VideoProblem:
    r"""Frames :math:`v_k` of one measurement, :math:`b = C \sum_k m_k ⊙ (h * v_k)` (`antipa2019`).

    Each line of the sensor sees the whole scene, through the mask, while it is exposed; :math:`m_k`
    is the fraction of that in the time of frame k (`Shutter.fractions`).

    Parameters
    ----------
    shutter
        Of the sensor.
    times_s
        At which frames begin and end, (frames + 1,).
    single
        The problem of one picture in place of the video, but with its PSF in the stack's unit.
    stack
        That of the video.
    """

    shutter: Shutter
    times_s: Tensor
    single: Problem
    stack: StackProblem

    @classmethod
    def build(
        cls,
        reconstructor: Reconstructor,
        measurement: Measurement,
        sensor: Sensor,
        exposure_s: float,
        frames: int,
    ) -> "VideoProblem":
        """Build the problem of frames that share the time of the whole exposure equally.

        Parameters
        ----------
        reconstructor
            PSF and support; `VideoProblem` has a weight and a prior of its own.
        measurement
            Developed from all of the sensor, in counts.
        sensor
            With its line time, and the figures of its noise.
        exposure_s
            Of a line.
        frames
            How many.

        Raises
        ------
        NolensError
            As `Problem.build`.
        """
        shutter = Shutter.of(sensor, exposure_s)
        times = shutter.frames(frames)
        single = replace(reconstructor, tau=0.0).problem(measurement)
        masks = developed_rows(
            shutter.fractions(times), sensor.mosaic, measurement.channels, measurement.size
        )
        norm = single.scale * single.psf_norm
        stack = StackProblem.build(
            StackConvolution([single.forward], masks[:, : single.forward.channels].to(norm.device)),
            single.data,
            valid=single.valid,
            variance=_variance(measurement, sensor).to(norm.device) / norm.square(),
            prior=StackPrior(across=ACROSS, colours=single.channels == 3),
        )
        return cls(shutter, times, single, stack)

    @property
    def frame_s(self) -> float:
        """Time of a frame."""
        return float(self.times_s[1])

    def video(self, stack: Tensor) -> Tensor:
        """Frames in units of measurement over PSF, (frames, channels, height, width)."""
        return (stack * self.single.scale[:, None].to(stack)).movedim(1, 0)


def _variance(measurement: Measurement, sensor: Sensor) -> Tensor:
    """Of each pixel's noise, shot and read, in counts²; like the measurement."""
    one = sensor.noise_variance(measurement.values.clamp_min(0))
    pixels = [max(1, sensor.mosaic.count(name)) for name in measurement.channels]
    return one / torch.tensor(pixels)[:, None, None]
