"""A problem on pixels that are means over some: quick to solve, and to start from."""

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.operators import Geometry
from nolens.solvers.held_out import box_mean, channel_noise
from nolens.solvers.problem import Problem
from nolens.solvers.result import Result, Stop

_ROUGH, _REFINED = 1.5, 2.0
"""What a photo's tolerance is multiplied by on larger pixels, and on its own after those."""
_LARGEST, _TOLERATED = 0.25, 2_400_000
"""The same on the largest pixels where light may come from everywhere, and padded pixels of those
that follow from which on it is 1: below it is the root of their number over these, as iterations
there take little time. On the measurement's own one check is all (decision 26)."""

_TAKEN_UP = 5.0
"""The model's error over what a photograph leaves of it, squared."""
_FITTED = 1.05
"""The noise over what a photograph leaves of it, at most."""


@dataclass(frozen=True)
class Coarse:
    """A problem on larger pixels.

    Parameters
    ----------
    problem
        Whose pixels, of measurement and PSF, are means over by×by.
    by
        Pixels along each side that become one.
    """

    problem: Problem
    by: int

    def finer(self, scene: Tensor, problem: Problem) -> Tensor:
        r"""A scene of this problem on the pixels of the original one, bilinear.

        A pixel r of the sensor's frame lies at (r + ½)/b − ½ − ε of the larger pixels; ε is by how
        much the PSF's middle, pixel c, lies beside the middle of its larger pixel C:
        ε = (c + ½)/b − ½ − C.

        Parameters
        ----------
        scene
            (channels, height, width), in units of measurement over PSF.
        problem
            The original one.
        """
        here, there = self.problem.forward.geometry, problem.forward.geometry
        rows, columns = (self._places(here, there, axis).to(scene) for axis in (0, 1))
        grid = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1)
        # The sum of a PSF of means is b² times less.
        radiance = scene[None] / self.by**2
        finer: Tensor = nnf.grid_sample(
            radiance, grid[None], mode="bilinear", padding_mode="border", align_corners=False
        )
        return finer[0]

    def finer_result(self, result: Result, problem: Problem) -> Result:
        """A result of this problem on the pixels of the original one.

        Parameters
        ----------
        result, problem
            As `finer` takes scene and problem.
        """
        return replace(result, scene=self.finer(result.scene, problem), frame=problem.frame)

    def _places(self, here: Geometry, there: Geometry, axis: int) -> Tensor:
        """Where pixels of the finer scene lie, from −1 to 1 across this one's."""
        middle, coarse_middle = (each.psf[axis] - each.psf_shift[axis] for each in (there, here))
        beside = (middle + 0.5) / self.by - 0.5 - coarse_middle
        pixel = there.origin[axis] + torch.arange(there.scene[2 + axis], dtype=torch.float64)
        place = (pixel + 0.5) / self.by - 0.5 - beside - here.origin[axis]
        return (2 * place + 1) / here.scene[2 + axis] - 1

    def errors(self, scene: Tensor, problem: Problem) -> "Errors":
        """`Errors.of` a scene of this problem, for the original one and in its normalised units.

        Parameters
        ----------
        scene, problem
            As `finer` takes them.
        """
        here, there = (each.scale * each.psf_norm for each in (self.problem, problem))
        unit = (here / there).flatten()
        errors = Errors.of(self.problem, scene)
        # White noise is less by the number of pixels along each side in means over them.
        noise = torch.minimum(self.by * unit * errors.noise, channel_noise(problem))
        return Errors(noise, unit * errors.model)


@dataclass(frozen=True)
class Errors:
    """What a measurement is off by from the light that its forward model says.

    Parameters
    ----------
    noise
        Standard deviation in each channel, (channels,), normalised.
    model
        Root mean square of the model's error, the same.
    """

    noise: Tensor
    model: Tensor

    @classmethod
    def of(cls, problem: Problem, scene: Tensor) -> "Errors":
        r"""From the residual r of a photograph, on valid pixels.

        .. math:: σ^2 = \min\left(s^2, 1.05^2\,\overline{r^2}\right), \qquad
            e^2 = 5 \left(\overline{r^2} − s^2\right)_+

        with s of `channel_noise`, which takes detail of a sharp PSF for noise. The photograph has
        taken up a little of the noise, and the larger part of the model's error, as detail that is
        not there (decision 24).

        Parameters
        ----------
        problem
            That was solved.
        scene
            (channels, height, width), in units of measurement over PSF.
        """
        left = problem.residual(scene / problem.scale).square().sum(dim=(-2, -1))
        left /= problem.valid.sum(dim=(-2, -1)).clamp_min(1)
        noise = channel_noise(problem)
        model = (_TAKEN_UP * (left - noise.square()).clamp_min(0)).sqrt()
        return cls(torch.minimum(noise, _FITTED * left.sqrt()), model)

    @property
    def whole(self) -> Tensor:
        """Of both together."""
        return torch.hypot(self.noise, self.model)


def lost_detail(psf: Tensor) -> float:
    r"""Fraction of a PSF's detail that its means over 2×2 pixels lose.

    .. math:: 1 − 4 \sum \bar d^2 / \sum d^2

    with d the PSF without its local means over 9×9 pixels, and its means over 2×2: 0 where detail
    is wider than some pixels, ¾ where each pixel is another. Means of a measurement are not the
    light of means of the scene where it is large.

    Parameters
    ----------
    psf
        (channels, height, width); the channel that loses most counts.
    """
    detail = psf - box_mean(psf, 9)
    means = nnf.avg_pool2d(detail, 2)
    power, kept = (each.square().sum(dim=(-2, -1)) for each in (detail, means))
    return float((1 - 4 * kept / power.clamp_min(1e-30)).max())


def stop_on_larger(photo: Stop, problem: Problem, *, largest: bool) -> Stop:
    """When a photo ends on larger pixels; some iterations stay for those that follow.

    Parameters
    ----------
    photo
        When it ends that starts from there.
    problem
        On larger pixels.
    largest
        Whether it starts from no larger ones itself.
    """
    if problem.forward.support is not None:
        return replace(photo, scene_tolerance=_ROUGH * photo.scene_tolerance)
    return replace(photo, scene_tolerance=_LARGEST * photo.scene_tolerance) if largest else photo


def stop_after_larger(photo: Stop, problem: Problem, *, own: bool) -> Stop:
    """When a photo ends that starts from one on larger pixels.

    Parameters
    ----------
    photo
        When it would end else.
    problem
        To be solved.
    own
        Whether its pixels are the measurement's.
    """
    if problem.forward.support is not None:
        return replace(photo, scene_tolerance=_REFINED * photo.scene_tolerance)
    factor = math.inf if own else min(1.0, math.sqrt(problem.padded_pixels / _TOLERATED))
    iterations = 2 * photo.iterations  # Those on larger pixels count.
    return replace(photo, iterations=iterations, scene_tolerance=factor * photo.scene_tolerance)
