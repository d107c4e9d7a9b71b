"""A stream by a trained prior: gathers light, follows what moves, ends in time, loses no frame."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from nolens.camera import FieldPsf
from nolens.errors import DataError, DivergenceError, OptionError
from nolens.files.weights import denoiser
from nolens.operators import CroppedConvolution, FieldConvolution, PixelRectangle
from nolens.solvers import Prior, Reconstructor
from nolens.solvers.plug_and_play import Turn
from nolens.solvers.trained_stream import TURNS, TrainedStream
from nolens.training.pictures import training_picture

SENSOR, SIDE = (96, 112), 48
SUPPORT = PixelRectangle.centred(SIDE, SIDE, SENSOR)
TAU = 5e-3
"""About what is chosen for the noise below."""


def camera() -> tuple[Tensor, CroppedConvolution]:
    generator = torch.Generator().manual_seed(1)
    psf = (torch.rand(3, 144, 160, generator=generator) > 0.98).float()
    return psf, CroppedConvolution(psf, SENSOR, SUPPORT)


@pytest.fixture(scope="module")
def noisy() -> Callable[[Tensor, int], Tensor]:
    """Measures a scene, with noise of its own for each number."""
    _, blur = camera()

    def measure(scene: Tensor, number: int) -> Tensor:
        light = blur(scene)
        generator = torch.Generator().manual_seed(number)
        return light + 0.1 * light.max() * torch.randn(light.shape, generator=generator)

    return measure


def scene(step: int) -> Tensor:
    """A part of a picture; the next step's lies two pixels further."""
    return training_picture(SIDE, 2 * SIDE, 3)[..., 2 * step : 2 * step + SIDE].contiguous()


def solver(**options: object) -> Reconstructor:
    return Reconstructor(camera()[0], SUPPORT, TAU, prior=denoiser(), **options)


def error(found: Tensor, truth: Tensor) -> float:
    return float((found - truth).norm() / truth.norm())


def test_a_scene_that_stands_gathers_light(noisy) -> None:
    """The first frame is the photo; by the light of ten more a fifth of its squared error goes, and
    half of that by total variation remains.
    """
    stream = solver().stream(noisy(scene(0), 0))
    frames = [stream.solve(noisy(scene(0), number)) for number in range(11)]
    assert torch.equal(frames[0].scene, solver().solve(noisy(scene(0), 0)).scene)
    assert all(each.iterations == TURNS for each in frames[1:])
    by_variation = replace(solver(), prior=Prior.TV).stream(noisy(scene(0), 0))
    others = [by_variation.solve(noisy(scene(0), number)) for number in range(11)]
    first, *_, a, b, c, d = (error(each.scene, scene(0)) ** 2 for each in frames)
    mean, other = (a + b + c + d) / 4, error(others[-1].scene, scene(0)) ** 2
    assert mean < 0.8 * first and mean < 0.5 * other and stream.cuts == 0


def test_goes_on_from_a_picture(noisy) -> None:
    """As from the stream's own of that measurement; with more detail less of the noise is gone."""
    data, errors = noisy(scene(0), 0), {}
    for detail in (1.0, 2.0, 4.0):
        network = replace(denoiser(), detail=detail)
        own, other = (replace(solver(), prior=network).stream(data) for _ in range(2))
        photo = own.solve(data)
        other.start(data, None, photo.scene)
        frames = [each.solve(noisy(scene(0), 1)).scene for each in (own, other)]
        assert torch.equal(*frames)
        errors[detail] = error(frames[0], scene(0))
    assert errors[1.0] < errors[2.0] < 1.5 * errors[1.0]
    assert errors[2.0] < errors[4.0] < 1.5 * errors[2.0]


def test_psfs_over_the_field() -> None:
    """All of them are used: with that of the axis alone a picture has five times the error."""
    generator = torch.Generator().manual_seed(6)
    values = (torch.rand(5, 1, 144, 160, generator=generator) > 0.98).float()
    psfs = FieldPsf(values, torch.tensor([(0.0, 0), (-24, -24), (-24, 24), (24, -24), (24, 24)]))
    places = psfs.places + torch.tensor([side // 2 for side in SENSOR])
    blur = FieldConvolution(values, places, SENSOR, SUPPORT)
    one = Reconstructor(values[0], SUPPORT, TAU, prior=denoiser())
    streams = [replace(one, field_psf=each).stream(blur(scene(0)[:1])) for each in (psfs, None)]
    for step in range(4):
        truth = scene(step)[:1]
        errors = [error(each.solve(blur(truth)).scene, truth) for each in streams]
    assert errors[0] < 0.2 * errors[1]


def test_what_moves_is_followed(noisy) -> None:
    """Better than by total variation, and as what is there now rather than the frame before."""
    by_network = solver().stream(noisy(scene(0), 0))
    by_variation = replace(solver(), prior=Prior.TV).stream(noisy(scene(0), 0))
    for step in range(8):
        data = noisy(scene(step), step)
        found, other = by_network.solve(data).scene, by_variation.solve(data).scene
    assert error(found, scene(7)) < 0.75 * error(other, scene(7))
    assert error(found, scene(7)) < 0.5 * error(found, scene(6))


def test_what_moves_is_followed_in_little_noise(noisy) -> None:
    """Turns smooth by no more than the noise: the error is a fifth of that by total variation."""
    blur, generator = camera()[1], torch.Generator().manual_seed(0)
    streams, errors = {}, {}
    for step in range(8):
        light = blur(scene(step))
        data = light + 0.01 * light.mean() * torch.randn(light.shape, generator=generator)
        for prior in (denoiser(), Prior.TV):
            one = replace(solver(), tau=1e-4, prior=prior)
            stream = streams.setdefault(prior == Prior.TV, one.stream(data))
            errors[prior == Prior.TV] = error(stream.solve(data).scene, scene(step))
    assert errors[False] < 0.2 * errors[True]


def test_brightness_and_scene_may_change(noisy) -> None:
    """A third more light is followed; another scene, much brighter, is a cut."""
    stream = solver().stream(noisy(scene(0), 0))
    stream.solve(noisy(scene(0), 0))
    for number, (truth, cuts) in enumerate(
        [(1.3 * scene(0), 0), (20 * training_picture(SIDE, SIDE, 8), 1)], start=1
    ):
        data = noisy(truth, number)
        frame = stream.solve(data)
        assert stream.cuts == cuts
        assert error(frame.scene, truth) < 1.01 * error(solver().solve(data).scene, truth)


def test_limits_of_a_frame(noisy) -> None:
    for options in ({"iterations": 0}, {"latency_s": 0.0}):
        with pytest.raises(OptionError, match=r"above 0|1 or more"):
            solver().stream(noisy(scene(0), 0), **options)
    stream = solver().stream(noisy(scene(0), 0), iterations=3, latency_s=1e-6)
    assert isinstance(stream, TrainedStream)
    stream.solve(noisy(scene(0), 0))
    assert stream.solve(noisy(scene(0), 1)).iterations == 1


def test_a_bad_frame_changes_nothing(noisy) -> None:
    """Neither of another size, nor without light; pixels that are not valid do not count."""
    clean, stream = (solver().stream(noisy(scene(0), 0)) for _ in range(2))
    for each in (clean, stream):
        each.solve(noisy(scene(0), 0))
    for bad in (torch.ones(3, 4, 4), torch.zeros(3, *SENSOR)):
        with pytest.raises(DataError):
            stream.solve(bad)
    data = noisy(scene(1), 1)
    valid = data < 0.9 * data.max()
    wrong = torch.where(valid, data, 1e3 * data.max())
    assert torch.equal(stream.solve(wrong, valid).scene, clean.solve(data, valid).scene)


def test_a_refinement_is_of_what_is_shown(noisy) -> None:
    """It sees the last turn of each frame; the next goes on from that turn."""
    shown, turns = [], list[int]()

    def same(turn: Turn) -> Tensor:
        turns.append(turn.number)
        return turn.picture

    for refinement in (None, same):
        prior = replace(denoiser(), refinement=refinement)
        stream = replace(solver(), prior=prior).stream(noisy(scene(0), 0))
        shown.append(torch.stack([stream.solve(noisy(scene(0), each)).scene for each in range(3)]))
    assert torch.equal(*shown)
    assert len(turns) == 3 and turns[0] > TURNS and turns[1:] == [TURNS - 1, TURNS - 1]


def test_a_picture_that_is_no_number(noisy, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is refused, and the next frame is solved as a photo again."""
    stream = solver().stream(noisy(scene(0), 0))
    stream.solve(noisy(scene(0), 0))
    with monkeypatch.context() as patch:
        patch.setattr(
            "nolens.solvers.plug_and_play.denoise", lambda _, picture, *__, **___: picture / 0
        )
        with pytest.raises(DivergenceError):
            stream.solve(noisy(scene(0), 1))
    photo = solver().solve(noisy(scene(0), 2)).scene
    assert torch.equal(stream.solve(noisy(scene(0), 2)).scene, photo)
