"""The smooth part: never a worse objective, and what thousands of iterations would give."""

from dataclasses import replace

import pytest
import torch
from posed import Case, pose

from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Problem, admm
from nolens.solvers.corrections import LowFrequencyCorrection


def full_view(channels: int = 1) -> tuple[Problem, torch.Tensor]:
    """A shaded scene through a broad PSF: the glow of an open mask, without noise."""
    generator = torch.Generator().manual_seed(2)
    sensor, side = (96, 112), 48
    away = torch.hypot(torch.arange(160)[:, None] - 80.0, torch.arange(176) - 88.0)
    texture = torch.rand(channels, 160, 176, generator=generator) ** 6
    psf = torch.exp(-((away / 80) ** 2)) * (1 + 0.2 * texture)
    rows, columns = torch.meshgrid(*[torch.linspace(0, 1, side)] * 2, indexing="ij")
    scene = (0.3 + 0.7 * rows * columns + 0.2 * torch.cos(6 * rows)).expand(channels, -1, -1)
    support = PixelRectangle.centred(side, side, sensor)
    data = CroppedConvolution(psf, sensor, support)(scene)
    return Problem.build(psf, data, support=support, tau=1e-7), scene


@pytest.mark.parametrize("channels", [1, 3])
def test_finds_a_shading_at_once(channels):
    """From a grey scene with some structure, which the weights of the variation go by."""
    problem, truth = full_view(channels)
    noise = 0.02 * torch.randn(truth.shape, generator=torch.Generator().manual_seed(4))
    grey = (truth.mean() + noise) / problem.scale
    better, fell = LowFrequencyCorrection(problem).improved(grey)
    assert fell
    assert problem.objective(better) < 0.1 * problem.objective(grey)
    error = torch.linalg.vector_norm(problem.unscale(better) - truth)
    assert error < 0.5 * torch.linalg.vector_norm(truth - truth.mean())


def test_saves_iterations():
    problem, truth = full_view()

    def error(iterations: int, low_frequency: bool) -> float:
        scene = admm(problem, iterations=iterations, tolerance=0, low_frequency=low_frequency).scene
        return float(torch.linalg.vector_norm(scene - truth))

    assert error(24, low_frequency=True) < 0.5 * error(200, low_frequency=False)


@pytest.mark.parametrize("prior", ["tv", "isotropic-tv", "l1", "none"])
@pytest.mark.parametrize("seed", range(3))
def test_objective_never_rises(prior, seed):
    case = Case(
        sensor=(24, 26), psf=(40, 42), channels=2, view=True, prior=prior, seed=seed,
        support=PixelRectangle(-2, 3, 24, 19), saturated=0.05,
    )  # fmt: skip
    problem = pose(case).problem
    scene = torch.rand(problem.scene_shape, generator=torch.Generator().manual_seed(seed)) * 0.01
    better, fell = LowFrequencyCorrection(problem).improved(scene)
    assert (better >= 0).all()
    assert fell == (problem.objective(better) < problem.objective(scene))
    assert fell or torch.equal(better, scene)


def test_is_left_alone_where_the_scene_does_not_fill_the_view():
    problem = pose(replace(Case(), support=PixelRectangle(1, 2, 4, 5))).problem
    plain = admm(problem, iterations=30, tolerance=0)
    assert torch.equal(
        admm(problem, iterations=30, tolerance=0, low_frequency=True).scene, plain.scene
    )
