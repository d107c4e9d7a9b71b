"""Cameras to train on: what a camera's folder decides, and what is drawn."""

import numpy as np
import pytest
import torch
from lessons import tiny_network
from torch import Tensor

from nolens.camera import FieldPsf, preset
from nolens.solvers import Problem
from nolens.solvers.plug_and_play import PlugAndPlay, Refinement
from nolens.training.cameras import KnownCamera, RandomCameras
from nolens.training.denoising import Schedule, Trainer
from nolens.training.measurements import simulate
from nolens.training.patches import PicturePool
from nolens.training.pictures import training_picture
from nolens.training.unrolled import RefinementLessons, refinement_network

SIDE, SENSOR = 20, (40, 52)
SIZE = 60, 72


def psfs(channels: int = 3, size: tuple[int, int] = (200, 240)) -> FieldPsf:
    """Of two field points: sparse points, the second ones beside the first."""
    generator = torch.Generator().manual_seed(0)
    plane = (torch.rand(channels, *size, generator=generator) < 0.02).float()
    other = torch.roll(plane, 3, -1)
    return FieldPsf(torch.stack([plane, other]), torch.tensor([[0.0, 0.0], [0.0, 99.0]]))


@pytest.mark.parametrize("size", [(40, 50), (200, 240), (700, 700)])
@pytest.mark.parametrize("channels", [1, 3])
def test_views_are_as_large_as_asked_for(channels: int, size: tuple[int, int]) -> None:
    camera = KnownCamera.of(psfs(channels, size), preset("small").sensor)
    random = np.random.default_rng(0)
    for _ in range(5):
        view = camera.view(random, SIDE, SENSOR)
        assert len(view.light.places) == len(view.light.values)
        for psf in (view.psf, *view.light.values):
            assert psf.shape == (channels, *SIZE)
            assert torch.allclose(psf.sum((-2, -1)), torch.ones(channels), atol=1e-5)
        assert view.gains.shape == view.pixels.shape == (channels, 1, 1)


def test_noise_is_the_sensors() -> None:
    sensor = preset("small").sensor
    camera, random = KnownCamera.of(psfs(), sensor), np.random.default_rng(0)
    views = [camera.view(random, SIDE, SENSOR) for _ in range(30)]
    assert {view.read_electrons for view in views} == {sensor.read_noise_electrons}
    electrons = [view.electrons / sensor.clip_electrons for view in views]
    assert 0.02 <= min(electrons) < 0.1 < 0.5 < max(electrons) <= 0.9
    # 1, 2 and 1 pixels of the mosaic in each, times those that are binned.
    assert {float(view.pixels[1] / view.pixels[0]) for view in views} == {2.0}
    assert {float(view.pixels[0]) for view in views} == {1.0, 4.0, 9.0}


def test_light_comes_by_the_psfs_of_all_field_points() -> None:
    """On pixels that are binned they lie nearer; the model is mostly that of the axis."""
    camera, random = KnownCamera(psfs()), np.random.default_rng(0)
    views = [camera.view(random, SIDE, SENSOR) for _ in range(60)]
    field = [view for view in views if view.light.places[-1, 1] not in (0, SIDE / 2)]
    assert 36 <= len(field) < 60
    for view in field:
        assert float(view.light.places[1, 1]) == pytest.approx(99 / float(view.pixels[0]) ** 0.5)
        assert float((view.light.values[0] - view.light.values[1]).abs().sum() / 6) > 0.3
    exact = [torch.equal(view.psf, view.light.values[0]) for view in field]
    assert 0.4 < sum(exact) / len(exact) < 0.9


def test_light_of_one_psf_differs_on_both_sides() -> None:
    one = FieldPsf(psfs().values[:1], torch.zeros(1, 2))
    random = np.random.default_rng(0)
    lights = [KnownCamera(one).view(random, SIDE, SENSOR).light for _ in range(20)]
    others = [light for light in lights if light.points == 2]
    assert 6 <= len(others) < 20 and {light.points for light in lights} == {1, 2}
    for light in others:
        assert sorted(light.places.abs().amax(dim=0).tolist()) == [0, SIDE / 2]
        assert not torch.equal(*light.values)


@pytest.mark.parametrize("camera", [None, KnownCamera(psfs(3)), KnownCamera(psfs(1))])
def test_measurements_fit_their_truth(camera: KnownCamera | None) -> None:
    """By the problem's own model, but for noise and what is altered."""
    random = np.random.default_rng(3)
    picture = training_picture(40, 40, 7)
    errors = []
    for _ in range(3):
        shot = simulate(random, picture, (48, 56), camera)
        problem = Problem.build(shot.psf, shot.values, support=shot.support, tau=0.0)
        errors.append(float(problem.residual(shot.truth / problem.scale).norm()))
    assert min(errors) < 0.2 and max(errors) < 1.0


@pytest.mark.parametrize("channels", [1, 3])
def test_a_network_learns_what_turns_leave(channels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """It changes nothing at first; after some steps whole pictures are nearer to their scenes."""
    monkeypatch.setattr("nolens.training.measurements._SCENE", (40, 48))
    monkeypatch.setattr("nolens.training.measurements._SENSOR", (48, 64))
    monkeypatch.setattr("nolens.training.unrolled._STEPS_OF_EACH", 8)
    turns = PlugAndPlay(tiny_network(), (0.3, 0.1))
    lessons = RefinementLessons(PicturePool.generate(1, 0), turns, KnownCamera(psfs(channels)))
    network = refinement_network(tiny_network(1))
    made = Trainer(network, Schedule(40, 1e-2, patches=4, side=44), seed=0)
    lessons.begin(made, lambda _: None)
    assert len(lessons.examples) == 5

    def errors() -> Tensor:
        refine = Refinement(made.network)
        with torch.no_grad():
            left = [(refine(each.turn) - each.truth).norm() for each in lessons.examples]
        return torch.stack(left)

    before = torch.stack([(each.turn.picture - each.truth).norm() for each in lessons.examples])
    torch.testing.assert_close(errors(), before)
    losses = [float(made.learn(lessons.losses(made))) for _ in range(made.schedule.steps)]
    assert losses[0] == pytest.approx(0, abs=1e-4) and losses[-1] < -0.05
    assert float((errors() / before).log().mean()) < -0.02
    again = RefinementLessons(PicturePool.generate(1, 0), turns, KnownCamera(psfs(channels)))
    again.begin(made, lambda _: None)
    for one, other in zip(lessons.examples, again.examples, strict=True):
        assert torch.equal(one.turn.pictures, other.turn.pictures)


def test_random_cameras_differ() -> None:
    random = np.random.default_rng(0)
    one, other = (RandomCameras().view(random, 15, (25, 25)) for _ in range(2))
    assert not torch.equal(one.psf, other.psf) and one.electrons != other.electrons
