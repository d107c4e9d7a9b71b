"""Real measurements of known pictures, as examples to train on."""

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import lies_beside, register_picture
from nolens.evaluate.registration import resampled
from nolens.operators import PixelRectangle
from nolens.solvers import Prior, Problem, admm
from nolens.solvers.held_out import weight_by_noise
from nolens.training.measurements import Shot

_ITERATIONS = 32
"""Of the photograph by total variation that the picture is laid on."""


def pair_shot(
    measured: Tensor, valid: Tensor, psf: Tensor, picture: Tensor, support: PixelRectangle
) -> Shot:
    """A measurement, and the picture that was there, laid on its reconstruction.

    The picture is laid on a photograph by total variation, where it clearly lies beside it, and
    each of its channels made as bright as the measurement says.

    Parameters
    ----------
    measured, valid
        Linear values, and where they are none that are saturated, (channels, height, width).
    psf
        Of its pixels, of as many channels.
    picture
        Linear light, (channels, height, width) of the support.
    support
        Where it lies.

    Raises
    ------
    DataError
        If the measurement shows nothing of the picture.
    """
    prior = Prior.COLOUR_TV if len(measured) == 3 else Prior.TV
    problem = Problem.build(psf, measured, valid=valid, support=support, prior=prior)
    weight = weight_by_noise(problem.by_channel).tau
    first = admm(problem.weighted(weight), iterations=_ITERATIONS, low_frequency=True)
    found, as_it_is = (
        register_picture(first.scene, picture, each) for each in ("similarity", "none")
    )
    laid = resampled(picture, found)[0] if lies_beside(found, as_it_is) else picture
    light = torch.where(valid, problem.forward(laid), 0).double()
    overlap = (light * problem.data).sum(dim=(-2, -1), keepdim=True)
    brightness = overlap / light.square().sum(dim=(-2, -1), keepdim=True).clamp_min(1e-300)
    if not bool((brightness > 0).all()):
        raise DataError("the measurement shows nothing of the picture")
    truth = problem.unscale(brightness.float() * laid)
    return Shot(psf, measured, support, truth, valid)


def binned_picture(
    picture: Tensor, by: int, sensor: tuple[int, int]
) -> tuple[Tensor, PixelRectangle]:
    """A picture around the middle of a sensor on pixels of the binned sensor, and where they lie.

    Parameters
    ----------
    picture
        (channels, height, width), on the pixels of the sensor.
    by
        Pixels along a side that become one; the sensor's first one begins one.
    sensor
        (height, width) before binning.
    """
    whole = PixelRectangle.centred(picture.shape[-2], picture.shape[-1], sensor)
    down, right = -whole.top % by, -whole.left % by
    coarse = nnf.avg_pool2d(picture[None, :, down:, right:], by)[0]
    top, left = (whole.top + down) // by, (whole.left + right) // by
    return coarse, PixelRectangle(top, left, coarse.shape[-2], coarse.shape[-1])
