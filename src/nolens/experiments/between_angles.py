"""How far PSFs between the angles of a plan are off when they are interpolated."""

import math
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from nolens.calibrate.capture_plan import CapturePlan
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.operators.field_convolution import interpolation_weights
from nolens.optics import PointSource
from nolens.progress import ProgressCallback, part_of

MOST_PIXELS = (760, 1014)
"""Rows and columns in the middle of a sensor, whose part of the PSF tells the error."""
_Angles = tuple[float, float]


def errors_between(
    experiment: VirtualExperiment,
    plans: Sequence[CapturePlan],
    progress: ProgressCallback,
) -> Iterator[float]:
    r"""Error of the PSFs between each plan's angles, in their contrast.

    At angles in the middle between neighbours, of a far point source,
    :math:`\lVert Σ_k w_k h_k - h \rVert / \lVert h - \bar h \rVert`, where all PSFs lie about their
    chief rays and are equally bright, and w_k are the weights of `interpolation_weights`. Of these
    angles the one with the largest error counts.

    Parameters
    ----------
    experiment
        The camera; of few pixels, as each angle takes a PSF.
    plans
        For one scene; each is computed when it is asked for.
    progress
        Called with the fraction of a plan that is done.
    """
    psfs: dict[_Angles, Tensor] = {}
    for plan in plans:
        shares = _shares(experiment, plan)
        needed = {angle for between in shares for angle in (between, *shares[between])} - set(psfs)
        for number, angle in enumerate(sorted(needed)):
            psf = experiment.psf(_source(angle), progress=part_of(progress, number, len(needed)))
            psfs[angle] = psf / psf.mean(dim=(-2, -1), keepdim=True)
        yield max(
            float(
                sum((share * psfs[angle] for angle, share in parts.items()), -psfs[between]).norm()
                / (psfs[between] - 1).norm()
            )
            for between, parts in shares.items()
        )


def _shares(
    experiment: VirtualExperiment, plan: CapturePlan
) -> dict[_Angles, dict[_Angles, float]]:
    """By angle between those of the plan, how much each of the plan's counts there."""
    twin = experiment.twin

    def pixel(angle: _Angles) -> list[float]:
        return [each / twin.pixel_um for each in twin.shift_um(_source(angle))]

    places = torch.tensor([pixel(each) for each in plan.angles_deg], dtype=torch.float64)
    shares = {}
    for between in plan.between_deg:
        weights = interpolation_weights(places, torch.tensor([pixel(between)]))
        shares[between] = dict(zip(plan.angles_deg, weights[:, 0].tolist(), strict=True))
    return shares


def _source(angle: _Angles) -> PointSource:
    right, up = (math.tan(math.radians(each)) for each in angle)
    return PointSource((-up, right))
