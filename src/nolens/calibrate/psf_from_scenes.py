"""A camera's PSF from measurements of known scenes, where no point source is to be had."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as nnf
from scipy import ndimage
from torch import Tensor

from nolens.calibrate.pairs_model import KnownScenes, over_the_field
from nolens.calibrate.pairs_solver import TAU, PsfSolver
from nolens.errors import DataError

STEPS = 24
_COARSE = 64
_COARSE_STEPS = 16
_COARSE_SHARE = 0.2
_ROUNDS = 3
_BLUR = 16
_FAINT = 0.2
_SMALL = 0.05
_HALF = 0.5

Tick = Callable[[float], None]


@dataclass(frozen=True)
class SolvedPsf:
    """A PSF, and how well it explains what it was solved from.

    Attributes
    ----------
    psf
        (rows, columns), not negative, in units of measurement over scene; its middle,
        (rows // 2, columns // 2), is zero shift.
    gains
        Of each measurement: it is gain × (psf * scene); their mean is 1.
    misfit
        Of each measurement, ‖b − gain C(psf * scene)‖ over ‖b‖, weighted as `Weights` says.
    misfit_varying
        The same with the changes of the PSF over the scene that were solved with it.
    support
        bool, (rows, columns): where the PSF was found to have light.
    """

    psf: Tensor
    gains: Tensor
    misfit: Tensor
    misfit_varying: Tensor
    support: Tensor


def psf_from_scenes(
    known: KnownScenes, *, support: Tensor | None = None, tau: float = TAU, steps: int = STEPS,
    tick: Tick | None = None,
) -> SolvedPsf:  # fmt: skip
    """Solve one PSF from all measurements together: crop-aware and non-negative.

    First on coarse cells, for its support: solved without one, the PSF's light stands out of the
    haze that explains noise; where its local mean is more than a fifth of the largest, the PSF has
    light, and nowhere else. Without that, a PSF as wide as sensor and scene has more unknowns than
    the measurements have to say. Then within it on all cells, by `PsfSolver`, together with how
    the PSF changes over the scene (`over_the_field`): what light from aslant does else would be
    taken for the PSF's. The result is the mean PSF.

    Parameters
    ----------
    known
        Scenes and measurements.
    support
        bool, (rows, columns) of the PSF: where it may have light. None finds it, with the PSF as
        large as `known.reach`.
    tau
        Weight of the total variation, as `nolens.calibrate.pairs_solver.TAU`.
    steps
        Of ADMM, on all cells.
    tick
        Called with the share that is done.

    Raises
    ------
    DataError
        If no PSF explains the measurements.
    """
    start = None
    if support is None:
        support, start = _found_support(known, tau, tick)
    rows, columns = _around(support)
    inner = slice(*rows), slice(*columns)
    within = support[inner].float()
    solver = PsfSolver(known, over_the_field(known), within, tau)
    found = solver.solve(
        steps, start=None if start is None else start[inner],
        tick=None if tick is None else lambda share: tick(_COARSE_SHARE + 0.8 * share),
    )  # fmt: skip
    varying = solver.misfit(found)
    alone = PsfSolver(known, torch.ones_like(known.scenes[:1]), within)
    found = found[:1] * alone.fit_gains(found[:1])
    misfit = alone.misfit(found)
    found, gains = alone.unscaled(found)
    psf = found.new_zeros(support.shape)
    psf[inner] = found[0]
    return SolvedPsf(psf, gains, misfit, varying, support)


def unexplained(known: KnownScenes, psf: Tensor) -> Tensor:
    """Misfit of each measurement as `SolvedPsf` has it, for a PSF that was not solved from them.

    Parameters
    ----------
    known
        Scenes and measurements.
    psf
        (rows, columns); each measurement has its own gain.
    """
    solver = PsfSolver(known, torch.ones_like(known.scenes[:1]), torch.ones_like(psf))
    return solver.misfit(psf[None] * solver.fit_gains(psf[None]))


def _found_support(known: KnownScenes, tau: float, tick: Tick | None) -> tuple[Tensor, Tensor]:
    """Where the PSF has light, and roughly how much, on the cells of the scenes."""
    by = max(1, min(known.sensor) // _COARSE)
    coarse = known.binned(by)
    support, psf = torch.ones(coarse.reach), None
    for number in range(_ROUNDS):
        solver = PsfSolver(coarse, torch.ones_like(coarse.scenes[:1]), support, tau)
        psf = solver.solve(_COARSE_STEPS, start=psf)[0]
        support = _lit(psf, min(coarse.sensor) / _BLUR)
        psf = psf * support
        if tick is not None:
            tick(_COARSE_SHARE * (number + 1) / _ROUNDS)
    assert psf is not None
    fine = [_refined(each, by, known.reach) for each in (support, psf)]
    if not bool((fine[0] >= _HALF).any()):
        raise DataError("no PSF explains these measurements: check that each has its own picture")
    return fine[0] >= _HALF, fine[1]


def _lit(psf: Tensor, sigma: float) -> Tensor:
    """1 where its local mean is not faint, but for patches that have little light; else 0."""
    local = _blurred(psf, sigma)
    patches, count = ndimage.label((local > _FAINT * local.max()).numpy())
    light = ndimage.sum_labels(psf.numpy(), patches, range(1, count + 1))
    kept = [number + 1 for number in range(count) if light[number] > _SMALL * light.max()]
    return torch.from_numpy(np.isin(patches, kept)).to(psf.dtype)


def _refined(coarse: Tensor, by: int, size: tuple[int, int]) -> Tensor:
    """Between coarse cells on straight lines; a shift of one of them is `by` cells."""
    middles = [each // 2 - whole // 2 / by for whole, each in zip(size, coarse.shape, strict=True)]
    fine = ndimage.affine_transform(
        coarse.numpy(), [1 / by, 1 / by], offset=middles, output_shape=size, order=1
    )
    return torch.from_numpy(fine)


def _around(support: Tensor) -> tuple[tuple[int, int], tuple[int, int]]:
    """Rows and columns, from and to, of the smallest window around it with the same middle."""
    spans = []
    for axis in (1, 0):
        lit = support.any(dim=axis).nonzero().flatten()
        middle = support.shape[1 - axis] // 2
        reach = max(middle - int(lit[0]), int(lit[-1]) - middle)
        spans.append((middle - reach, min(support.shape[1 - axis], middle + reach + 1)))
    return spans[0], spans[1]


def _blurred(plane: Tensor, sigma: float) -> Tensor:
    """Local mean: convolved with a Gaussian, with nothing beyond the edges."""
    reach = max(1, round(3 * sigma))
    offsets = torch.arange(-reach, reach + 1, dtype=torch.float32)
    weights = torch.exp(-0.5 * (offsets / sigma).square())
    weights /= weights.sum()
    rows = nnf.conv2d(plane[None, None], weights[:, None][None, None], padding=(reach, 0))
    return nnf.conv2d(rows, weights[None, None, None], padding=(0, reach))[0, 0]
