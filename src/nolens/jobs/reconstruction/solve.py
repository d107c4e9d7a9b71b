"""Which solver does what was asked for, and when it stops."""

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.operators import Region
from nolens.solvers import Method, Quality, Reconstructor, stop_of
from nolens.solvers.admm_state import Balance


def method_of(options: ReconstructOptions) -> Method:
    """The solver: what --quality or --method say.

    Raises
    ------
    OptionError
        If they contradict each other.
    """
    if options.quality is None:
        return options.method
    if options.method is not Method.ADMM:
        raise OptionError(
            f"--quality {options.quality} chooses how to solve, and so does --method "
            f"{options.method}: leave one out"
        )
    return Method.WIENER if options.quality is Quality.DRAFT else Method.ADMM


def reconstructor_of(
    options: ReconstructOptions, psf: Tensor, region: Region | None, device: torch.device
) -> Reconstructor:
    """What solves: the preset's limits, with what was given in their place.

    Parameters
    ----------
    options
        What was asked for.
    psf, region
        That fit the measurement.
    device
        Where to compute.
    """
    method = method_of(options)
    return Reconstructor(
        psf,
        region,
        tau=options.tau,
        prior=options.prior,
        method=method,
        stop=stop_of(
            method,
            options.quality,
            iterations=options.iterations,
            tolerance=options.tolerance,
            low_frequency=options.low_frequency,
        ),
        penalties=options.penalties,
        balance=Balance() if options.balance else None,
        relaxation=options.relaxation,
        device=device,
    )
