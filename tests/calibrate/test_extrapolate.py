"""The PSF beyond the sensor, from ordinary pictures: judged by pictures that were left out."""

import pytest
import torch
from captured_at_angles import DISTANCE_UM, grey_camera
from skimage.data import astronaut, camera, coffee
from torch import Tensor

from nolens.calibrate.extrapolate import extrapolate, filled
from nolens.camera import develop
from nolens.evaluate import psnr, scale_fit
from nolens.experiments.virtual_experiment import SimulatedMeasurement, VirtualExperiment, solved
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.twin import Plane

ROWS, COLUMNS, SCENE_DEG = 128, 160, 5.5


@pytest.fixture(scope="module")
def bench() -> VirtualExperiment:
    return VirtualExperiment.of(grey_camera(ROWS, COLUMNS), field_points=3)


@pytest.fixture(scope="module")
def captured(bench: VirtualExperiment) -> Tensor:
    return bench.psf(PointSource(distance_um=DISTANCE_UM, diameter_um=50.0))


def photograph(bench: VirtualExperiment, picture: Tensor, seed: int) -> SimulatedMeasurement:
    return bench.measure((Plane(picture[None], SCENE_DEG, DISTANCE_UM),), seed=seed)


@pytest.fixture(scope="module")
def shots(bench: VirtualExperiment) -> list[SimulatedMeasurement]:
    pictures = [astronaut()[..., 1], camera(), coffee()[:, 100:500, 1]]
    return [
        photograph(bench, (torch.from_numpy(each.copy()).float() / 255).square(), seed)
        for seed, each in enumerate(pictures)
    ]


def quality(shot: SimulatedMeasurement, psf: Tensor) -> float:
    seen = solved(shot.frame, psf, shot.support, iterations=60, tau=5e-6)
    truth = shot.truth * shot.response
    return psnr(scale_fit(seen, truth), truth, 1.0)


def test_pictures_that_were_left_out(
    bench: VirtualExperiment, captured: Tensor, shots: list[SimulatedMeasurement]
) -> None:
    support = shots[0].support
    mean = filled(captured, support)
    told: list[tuple[int, int]] = []

    def step(done: int, limit: int) -> bool:
        told.append((done, limit))
        return False

    found = extrapolate(
        captured,
        [develop(each.frame) for each in shots[:2]],
        support,
        rounds=3,
        tau=1e-5,
        step=step,
    )
    assert found.from_pictures and told == [(done, 9) for done in range(10)]
    assert all(b < a for a, b in zip(found.residual, found.residual[1:], strict=False))
    top, left = (mean.shape[-2] - ROWS) // 2, (mean.shape[-1] - COLUMNS) // 2
    inner = (..., slice(top, top + ROWS), slice(left, left + COLUMNS))
    assert torch.equal(found.psf[inner], captured) and torch.equal(mean[inner], captured)
    assert float(found.psf.min()) >= 0 and found.psf.shape == mean.shape
    # What the first two pictures tell serves the third.
    with_mean = quality(shots[2], mean)
    assert with_mean > quality(shots[2], captured) + 5
    assert quality(shots[2], found.psf) > with_mean + 3
    wide = bench.psf(PointSource(distance_um=DISTANCE_UM, diameter_um=50.0), mean.shape[-2:])
    outside = torch.ones(mean.shape, dtype=torch.bool)
    outside[inner] = False
    pattern, estimate = (each[outside] - each[outside].mean() for each in (wide, found.psf))
    assert float((pattern * estimate).sum() / (pattern.norm() * estimate.norm())) > 0.5


def test_noise_shows_nothing(bench: VirtualExperiment, captured: Tensor) -> None:
    """What a dark picture does not tell is not made up."""
    picture = (torch.from_numpy(astronaut()[..., 1].copy()).float() / 255).square()
    plane = Plane(picture[None], SCENE_DEG, DISTANCE_UM)
    shot = bench.measure((plane,), seed=3, fill=0.01)
    found = extrapolate(captured, [develop(shot.frame)], shot.support, rounds=3, tau=1e-5)
    assert not found.from_pictures and len(found.residual) == 2
    assert torch.equal(found.psf, filled(captured, shot.support))


@pytest.mark.parametrize("last", [0, 1])
def test_stopped_before_the_first_round_ends(
    captured: Tensor, shots: list[SimulatedMeasurement], last: int
) -> None:
    support = shots[0].support
    result = extrapolate(
        captured,
        [develop(shots[0].frame)],
        support,
        rounds=3,
        tau=1e-5,
        step=lambda done, limit: done == last,
    )
    assert result.interrupted and not result.from_pictures and result.residual == ()
    assert torch.equal(result.psf, filled(captured, support))


def test_stopped_later(captured: Tensor, shots: list[SimulatedMeasurement]) -> None:
    result = extrapolate(
        captured,
        [develop(shots[0].frame)],
        shots[0].support,
        rounds=3,
        tau=1e-5,
        step=lambda done, limit: done == 3,
    )
    assert result.interrupted and result.from_pictures and len(result.residual) == 2


@pytest.mark.parametrize("rows", [20, 21])
@pytest.mark.parametrize(
    "support",
    [PixelRectangle(5, 6, 10, 12), PixelRectangle(-3, 4, 9, 11), PixelRectangle(14, 20, 9, 7)],
)
def test_wide_enough(rows: int, support: PixelRectangle) -> None:
    """All cells from any place of the support to any pixel, and zero shift stays."""
    captured = torch.rand(2, rows, 25)
    wide = filled(captured, support)
    for size, count, start, length in (
        (wide.shape[1], rows, support.top, support.height),
        (wide.shape[2], 25, support.left, support.width),
    ):
        assert -(size // 2) <= -(start + length - 1)
        assert size - 1 - size // 2 >= count - 1 - start
    assert torch.equal(wide[:, wide.shape[1] // 2, wide.shape[2] // 2], captured[:, rows // 2, 12])
    assert float(wide.mean()) == pytest.approx(float(captured.mean()), rel=1e-4)
