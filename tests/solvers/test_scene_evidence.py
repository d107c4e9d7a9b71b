"""Evidence is the probability of a measurement, and tells where its light comes from."""

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


def problem_of(scene: Tensor, noise: float, seed: int = 1) -> tuple[Tensor, Problem]:
    """Of a scene in the domain, for a PSF of fine random lines, with a few invalid pixels."""
    generator = torch.Generator().manual_seed(seed)
    psf = torch.rand(2, 43, 49, generator=generator) ** 3
    light = CroppedConvolution(psf, SENSOR, DOMAIN)(scene)
    data = light + noise * torch.randn(light.shape, generator=generator)
    valid = torch.ones_like(data, dtype=torch.bool)
    valid[:, 3:5, 7:10] = False
    return psf, Problem.build(psf, data, valid=valid)


def lit(rows: slice, columns: slice) -> Tensor:
    scene = torch.zeros(2, DOMAIN.height, DOMAIN.width)
    scene[:, rows, columns] = torch.rand(scene[:, rows, columns].shape) + 0.5
    return scene


def of_density(problem: Problem, evidence: Evidence, sides: Sides) -> float:
    """The same by the density of a measurement, of the forward model's own light of each block."""
    top, bottom, left, right = sides
    height, width = problem.scene_shape[1:]
    places, lights = [], []
    for row in range(top, bottom):
        for column in range(left, right):
            block = evidence.support((row, row + 1, column, column + 1))
            scene = torch.zeros(problem.scene_shape)
            first = problem.forward.geometry.origin
            scene[:, block.top - first[0] : block.bottom - first[0],
                  block.left - first[1] : block.right - first[1]] = 1  # fmt: skip
            lights.append(problem.forward(scene).double())
            places.append((row, column))
    assert scene.shape[-2:] == (height, width)
    distances = torch.cdist(*[torch.tensor(places).double()] * 2)
    alike = 1 + 0.36 * torch.exp(-distances / (0.35 * max(bottom - top, right - left)))
    rows, columns = (torch.arange(count).double() + 0.5 for count in SENSOR)
    ramps = [
        torch.ones(SENSOR).double(),
        torch.cos(math.pi * rows / SENSOR[0])[:, None].expand(SENSOR),
    ]
    ramps += [each * torch.cos(math.pi * columns / SENSOR[1]) for each in ramps]
    total = 0.0
    for channel, noise in enumerate(channel_noise(problem).double()):
        seen = problem.valid[channel]
        slow = torch.stack([ramp[seen] for ramp in ramps], 1)
        rest = torch.linalg.svd(slow, full_matrices=True).U[:, slow.shape[1] :].T
        values = rest @ problem.data[channel][seen].double() / noise
        light = torch.stack([rest @ each[channel][seen] for each in lights], 1) / noise
        all_light = light @ alike @ light.T
        excess = float(evidence.excess[channel])
        white = torch.eye(len(values)).double() * excess
        top_value = float(torch.linalg.eigvalsh(all_light)[-1]) / excess
        nothing = torch.distributions.MultivariateNormal(torch.zeros_like(values), white)
        best = max(
            float(torch.distributions.MultivariateNormal(
                torch.zeros_like(values), white + 10 ** (k / 4 - 12) / top_value * all_light
            ).log_prob(values))
            for k in range(40, 81)
        )  # fmt: skip
        total += best - float(nothing.log_prob(values))
    return total


@pytest.mark.parametrize("sides", [(2, 7, 3, 8), (0, 9, 0, 10)])
def test_is_the_density_of_the_measurement(sides: Sides) -> None:
    torch.manual_seed(2)
    psf, problem = problem_of(lit(slice(4, 14), slice(6, 16)), noise=2.0)
    evidence = Evidence(psf, problem, DOMAIN)
    assert evidence.of(sides) == pytest.approx(of_density(problem, evidence, sides), rel=1e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("noise", [0.5, 4.0, 12.0])
def test_most_is_where_the_light_comes_from(seed: int, noise: float) -> None:
    """Though at most a hundredth of the contrast is not noise."""
    torch.manual_seed(seed)
    psf, problem = problem_of(lit(slice(4, 14), slice(6, 14)), noise, seed)
    evidence = Evidence(psf, problem, DOMAIN)
    assert evidence.likeliest() == (4, 14, 6, 14)
    assert evidence.of((4, 14, 6, 14)) > 10 + evidence.of((0, 18, 0, 20))


def test_noise_alone_has_none() -> None:
    for seed in range(5):
        psf, problem = problem_of(torch.ones(2, 18, 20) * 1e-3, 8.0, seed)
        evidence = Evidence(psf, problem, DOMAIN)
        assert evidence.of(evidence.likeliest()) < 8
