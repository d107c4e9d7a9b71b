"""A volume by scico (BSD-3-Clause), which posed and solved it on its own: the same objective."""

import numpy as np
import pytest
import torch

from nolens.operators import CroppedConvolution, PixelRectangle, StackConvolution
from nolens.solvers import StackPrior, StackProblem

SENSOR, SUPPORT = (20, 24), PixelRectangle(3, 4, 14, 16)
TAU = 0.02


def test_objective_of_a_volume():
    pytest.importorskip("scico", reason="needs scico (bench/peer-requirements-scico.txt)")
    import scico.numpy as snp
    from scico import functional, linop, loss
    from scico.optimize.admm import ADMM, LinearSubproblemSolver

    generator = torch.Generator().manual_seed(2)
    psfs = torch.rand((3, *SENSOR), generator=generator).double() ** 8
    scene = torch.zeros(1, 3, SUPPORT.height, SUPPORT.width).double()
    scene[0, 0, 2:6, 3:7], scene[0, 1, 8:12, 2:6], scene[0, 2, 4:9, 10:13] = 1.0, 0.7, 0.5
    forward = StackConvolution([CroppedConvolution(each[None], SENSOR, SUPPORT) for each in psfs])
    image = forward(scene)
    data = image + 0.02 * float(image.max()) * torch.randn(image.shape, generator=generator)
    problem = StackProblem.build(forward, data, prior=StackPrior())
    ours = problem.solve(TAU / problem.tau_unit, iterations=400, tolerance=1e-6)

    # The whole convolution of sensor's frame and PSF, by scico's numpy: no geometry of nolens.
    rows, columns = (SENSOR[axis] + 2 * max(SENSOR) for axis in (0, 1))
    spectra = snp.array(np.fft.rfft2((psfs / _norm(psfs)).numpy(), s=(rows, columns)))
    shape = (3, SUPPORT.height, SUPPORT.width)
    size, top, left = SENSOR, SUPPORT.top, SUPPORT.left

    def measure(v):
        padded = snp.pad(v, ((0, 0), (0, rows - shape[1]), (0, columns - shape[2])))
        full = snp.fft.irfft2((snp.fft.rfft2(padded) * spectra).sum(0), s=(rows, columns))
        moved = snp.roll(full, (top - size[0] // 2, left - size[1] // 2), (0, 1))
        return moved[: size[0], : size[1]]

    b = snp.array((data / torch.linalg.vector_norm(data))[0].numpy())
    fit = loss.SquaredL2Loss(
        y=b, A=linop.LinearOperator(shape, size, eval_fn=measure, input_dtype=b.dtype), scale=0.5
    )
    steps = linop.FiniteDifference(
        shape, input_dtype=b.dtype, axes=(1, 2), prepend=1, append=1, circular=False
    )
    variation, positive = TAU * functional.L1Norm(), functional.NonNegativeIndicator()
    solver = ADMM(
        f=fit,
        g_list=[variation, positive],
        C_list=[steps, linop.Identity(shape, input_dtype=b.dtype)],
        rho_list=[2.0, 2.0],
        maxiter=200,
        subproblem_solver=LinearSubproblemSolver(cg_kwargs={"tol": 1e-8, "maxiter": 100}),
    )
    theirs = snp.maximum(solver.solve(), 0)

    def objective(v):
        return float(fit(v) + variation(steps(v)))

    scene = snp.array((ours.scene[0] / problem.scale).numpy())
    assert objective(theirs) == pytest.approx(ours.objective, rel=1e-3)
    assert objective(scene) == pytest.approx(ours.objective, rel=1e-5)


def _norm(psfs):
    """Root of the mean energy of the PSFs."""
    return psfs.square().sum((1, 2)).mean().sqrt()
