"""Evidence is the probability of a measurement, and tells where its light comes from."""

import itertools
import math

import pytest
import torch
from torch import Tensor

from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers.held_out import channel_noise
from nolens.solvers.problem import Problem
from nolens.solvers.scene_evidence import Evidence, Sides

SENSOR = (26, 30)
DOMAIN = PixelRectangle(4, 5, 18, 20)
"""What a PSF of 43×49 pixels puts on all of the sensor."""


def problem_of(
    scene: Tensor, noise: float, seed: int = 1, sensor: tuple[int, int] = SENSOR
) -> tuple[Tensor, Problem]:
    """Of a scene in the domain, for a PSF of fine random lines, with a few invalid pixels."""
    generator = torch.Generator().manual_seed(seed)
    psf = torch.rand(2, 43, 49, generator=generator) ** 3
    domain = PixelRectangle.centred(DOMAIN.height, DOMAIN.width, sensor)
    light = CroppedConvolution(psf, sensor, domain)(scene)
    data = light + noise * torch.randn(light.shape, generator=generator)
    valid = torch.ones_like(data, dtype=torch.bool)
    valid[:, 3:5, 7:10] = False
    return psf, Problem.build(psf, data, valid=valid)


def lit(rows: slice, columns: slice) -> Tensor:
    scene = torch.zeros(2, DOMAIN.height, DOMAIN.width)
    scene[:, rows, columns] = torch.rand(scene[:, rows, columns].shape) + 0.5
    return scene


def light_of(problem: Problem, block: PixelRectangle) -> Tensor:
    """What the forward model has of a block of even light, (channels, rows, columns)."""
    scene = torch.zeros(problem.scene_shape)
    top, left = problem.forward.geometry.origin
    rows = slice(block.top - top, block.bottom - top)
    scene[:, rows, block.left - left : block.right - left] = 1
    return problem.forward(scene).double()


def fast_light(valid: Tensor) -> Tensor:
    """A basis of all valid pixels' light but four slow cosines, (basis, valid pixels)."""
    rows, columns = (torch.arange(count).double() + 0.5 for count in valid.shape)
    down = torch.cos(math.pi * rows / len(rows))[:, None]
    across = torch.cos(math.pi * columns / len(columns))
    ones = torch.ones(valid.shape).double()
    slow = torch.stack([each[valid] for each in (ones, down * ones, across * ones, down * across)])
    return torch.linalg.svd(slow).Vh[len(slow) :]


def log_density(values: Tensor, covariance: Tensor) -> float:
    normal = torch.distributions.MultivariateNormal(torch.zeros_like(values), covariance)
    return float(normal.log_prob(values))


def of_density(
    problem: Problem, evidence: Evidence, sides: Sides, inner: Sides | None = None
) -> float:
    """The evidence by the density of all pixels together, with the most likely strength."""
    places = list(itertools.product(range(*sides[:2]), range(*sides[2:])))
    top, bottom, left, right = sides if inner is None else inner
    light = [1 if top <= row < bottom and left <= column < right else 0.3 for row, column in places]
    blocks = [evidence.support((row, row + 1, column, column + 1)) for row, column in places]
    lights = torch.stack(
        [share * light_of(problem, block) for share, block in zip(light, blocks, strict=True)]
    )
    distances = torch.cdist(*[torch.tensor(places).double()] * 2)
    alike = 1 + 0.36 * torch.exp(-distances / (0.35 * max(bottom - top, right - left)))
    total = 0.0
    for channel, noise in enumerate(channel_noise(problem).double()):
        valid = problem.valid[channel]
        basis = fast_light(valid) / noise
        values = basis @ problem.data[channel][valid].double()
        light = basis @ lights[:, channel][:, valid].T
        expected = light @ alike @ light.T
        white = evidence.excess[channel] * torch.eye(len(values)).double()
        unit = evidence.excess[channel] / float(torch.linalg.eigvalsh(expected)[-1])
        strengths = unit * 10 ** torch.linspace(-4, 8, 49)
        most = max(log_density(values, white + each * expected) for each in strengths.double())
        total += most - log_density(values, white)
    return total


@pytest.mark.parametrize(
    ("sides", "sensor"),
    [((2, 7, 3, 8), (16, 18)), ((0, 9, 0, 10), (17, 18)), ((2, 7, 3, 8), (15, 17))],
)
def test_is_the_density_of_the_measurement(sides: Sides, sensor: tuple[int, int]) -> None:
    torch.manual_seed(2)
    psf, problem = problem_of(lit(slice(4, 14), slice(6, 16)), 2.0, sensor=sensor)
    domain = PixelRectangle.centred(DOMAIN.height, DOMAIN.width, sensor)
    evidence = Evidence(psf, problem, domain)
    expected = of_density(problem, evidence, sides)
    assert evidence.of(sides) == pytest.approx(expected, rel=1e-4)
    inner = 3, 6, 4, 6
    expected = of_density(problem, evidence, sides, inner)
    assert evidence.of(sides, inner) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("noise", [0.5, 4.0, 12.0])
def test_most_is_where_the_light_comes_from(seed: int, noise: float) -> None:
    """Though at most a hundredth of the contrast is not noise."""
    torch.manual_seed(seed)
    psf, problem = problem_of(lit(slice(4, 14), slice(6, 14)), noise, seed)
    evidence = Evidence(psf, problem, DOMAIN)
    assert evidence.likeliest() == (4, 14, 6, 14)
    assert evidence.of((4, 14, 6, 14)) > 10 + evidence.of((0, 18, 0, 20))


@pytest.mark.parametrize(("dim", "sides"), [(0.3, (2, 16, 2, 18)), (0.0, (6, 12, 6, 14))])
def test_dim_light_around_is_a_part_of_it(dim: float, sides: Sides) -> None:
    torch.manual_seed(4)
    scene = dim * lit(slice(2, 16), slice(2, 18))
    scene += (1 - dim) * lit(slice(6, 12), slice(6, 14))
    psf, problem = problem_of(scene, 2.0)
    assert Evidence(psf, problem, DOMAIN).likeliest() == sides


def test_noise_alone_has_none() -> None:
    for seed in range(5):
        psf, problem = problem_of(torch.ones(2, 18, 20) * 1e-3, 8.0, seed)
        assert Evidence(psf, problem, DOMAIN).likeliest() is None
