"""Several scenes from one measurement: the same minimum as the generic solvers, and the weight."""

import pytest
import torch

from nolens.operators import CroppedConvolution, FieldConvolution, PixelRectangle, StackConvolution
from nolens.solvers import StackPrior, StackProblem, primal_dual

SENSOR = (12, 15)
SUPPORT = PixelRectangle(1, 2, 9, 11)


def psfs(count: int, channels: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.rand((count, channels, 12, 15), generator=generator).double() ** 8


def depths(channels: int = 2) -> StackConvolution:
    return StackConvolution([CroppedConvolution(psf, SENSOR, SUPPORT) for psf in psfs(3, channels)])


def bands() -> StackConvolution:
    filters = torch.arange(12)[:, None] % 2 + 2 * (torch.arange(15) % 2)
    masks = torch.stack([0.1 + 0.9 * (filters == number) for number in range(4)]).double()
    return StackConvolution([CroppedConvolution(psfs(1, 1)[0], SENSOR, SUPPORT)], masks)


def field() -> StackConvolution:
    places = torch.tensor([(4, 4), (8, 10)])
    each = psfs(4, 1)
    return StackConvolution(
        [FieldConvolution(each[k : k + 2], places, SENSOR, SUPPORT) for k in (0, 2)]
    )


def measured(forward: StackConvolution, noise: float, channels: int) -> torch.Tensor:
    """Of squares, one in each slice."""
    scene = torch.zeros(channels, *forward.domain_shape[-3:]).double()
    for number in range(forward.slices):
        scene[:, number, 1 + number : 5 + number, 2 * number : 4 + 2 * number] = 1.0
    image = forward(scene)
    generator = torch.Generator().manual_seed(5)
    return image + noise * float(image.max()) * torch.randn(image.shape, generator=generator)


@pytest.mark.parametrize(
    ("forward", "prior"),
    [
        (depths(3), StackPrior(colours=True)),
        (bands(), StackPrior(across=0.5)),
        (field(), StackPrior(across=1.0, isotropic=True)),
    ],
    ids=["depths", "bands", "field"],
)
def test_the_minimum_is_that_of_another_solver(forward, prior):
    """With pixels that are not valid, and noise that differs from pixel to pixel."""
    data = measured(forward, 0.02, forward.channels)
    valid = torch.rand(data.shape, generator=torch.Generator().manual_seed(6)) > 0.1
    variance = 1 + torch.arange(15.0).double() / 12
    problem = StackProblem.build(
        forward,
        torch.where(valid, data, torch.nan),
        valid=valid,
        variance=variance,
        prior=prior,
    )
    tau = 0.02 / problem.tau_unit
    result = problem.solve(tau, iterations=100, tolerance=1e-6)
    other = primal_dual(*problem.functionals(tau), iterations=1000, tolerance=1e-6)
    assert result.objective == pytest.approx(other.objective, rel=1e-4)
    scene = result.scene / problem.scale
    assert float((scene - other.scene).norm() / other.scene.norm()) < 0.02
    assert result.scene.shape == problem.scene_shape


def test_few_photons_by_their_law():
    """Poisson's likelihood with read noise: the minimum of another solver, below the squares'."""
    generator = torch.Generator().manual_seed(1)
    forward = depths(1)
    light = measured(forward, 0, 1).clamp_min(0)
    light *= 5 / float(light.mean())
    electrons = torch.poisson(light, generator=generator)
    electrons += torch.randn(light.shape, generator=generator)
    valid = torch.rand(light.shape, generator=generator) > 0.1
    squares = StackProblem.build(
        forward, 3 * electrons, valid=valid, variance=9 * (light + 1), prior=StackPrior()
    )
    problem = squares.counting(3.0, 1.0)
    tau = 0.5 * problem.noise / problem.tau_unit
    result = problem.solve(tau, iterations=100, tolerance=1e-4)
    other = primal_dual(*problem.functionals(tau), iterations=200, tolerance=1e-6)
    assert result.objective == pytest.approx(other.objective, rel=1e-3)
    electron = (1 + forward(result.scene / problem.scale) * problem.norm / 3).clamp_min(1e-9)
    there = (electrons + 1).clamp_min(0)
    law = (electron - torch.special.xlogy(there, electron))[valid].sum()
    best = (there - torch.special.xlogy(there, there))[valid].sum()
    fit = result.objective - tau * problem.tau_unit * float(
        problem.prior.functional(problem.scene_shape)(result.scene / problem.scale)
    )
    assert problem.noise**2 * float(law - best) == pytest.approx(fit, rel=1e-3)
    by_squares = squares.solve(tau, iterations=100, tolerance=1e-4).scene / problem.scale
    values = [each(by_squares) for each in problem.functionals(tau)]
    assert float(sum(values)) > 1.0005 * result.objective


def test_the_weight_of_few_bright_points():
    """Held-out pixels choose one with which the stack errs little more than with the best."""
    forward = StackConvolution(
        [CroppedConvolution(psf, (40, 48), PixelRectangle(2, 2, 36, 44)) for psf in psfs(2, 1)]
    )
    truth = torch.zeros(1, 2, 36, 44).double()
    truth[0, 0, 8:30:7, 5:40:9], truth[0, 1, 4:34:9, 9:36:8] = 1.0, 0.7
    generator = torch.Generator().manual_seed(5)
    image = forward(truth)
    noise = 0.05 * float(image.std())
    data = image + noise * torch.randn(image.shape, generator=generator)
    variance = torch.tensor(noise**2)
    problem = StackProblem.build(forward, data, variance=variance, prior=StackPrior(sparse=True))
    assert problem.noise == pytest.approx(noise / float(data.norm()), rel=1e-6)

    def error(tau: float) -> float:
        return float((problem.solve(tau, iterations=60).scene - truth).norm() / truth.norm())

    chosen = problem.choose_weight().tau
    errors = [error(factor * chosen) for factor in (1, 1 / 8, 1 / 3, 3, 8)]
    assert errors[0] < 0.05
    assert errors[0] < 1.6 * min(errors) < 0.5 * max(errors)
