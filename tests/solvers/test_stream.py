"""A stream: follows what moves, ends in time, drops nothing on the floor, holds its memory."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import psutil
import pytest
import torch

from nolens.camera import FieldPsf
from nolens.errors import DataError, OptionError
from nolens.operators import CroppedConvolution, FieldConvolution, PixelRectangle
from nolens.solvers import Prior, Problem, Reconstructor, Stream, admm
from nolens.solvers.stream import weight_to_follow

SENSOR = (64, 72)
SUPPORT = PixelRectangle.centred(32, 32, SENSOR)


def camera() -> tuple[torch.Tensor, CroppedConvolution]:
    generator = torch.Generator().manual_seed(1)
    psf = (torch.rand(1, 96, 104, generator=generator) > 0.97).float()
    return psf, CroppedConvolution(psf, SENSOR, SUPPORT)


def scene(step: int) -> torch.Tensor:
    """A bright square that moves by a cell a step, over a grey one."""
    picture = torch.zeros(1, 32, 32)
    picture[:, 4:28, 4:28] = 0.2
    place = 5 + step % 12
    picture[:, place : place + 8, 8:16] = 1.0
    return picture


def error(found: torch.Tensor, truth: torch.Tensor) -> float:
    return float(torch.linalg.vector_norm(found - truth) / torch.linalg.vector_norm(truth))


def test_follows_what_moves_with_a_few_iterations():
    psf, blur = camera()
    stream = Stream(Problem.build(psf, blur(scene(0)), support=SUPPORT, tau=1e-5))
    stream.solve(blur(scene(0)))
    for step in range(1, 8):
        frame = stream.solve(blur(scene(step)))
        assert frame.iterations <= 8
    problem = Problem.build(psf, blur(scene(7)), support=SUPPORT, tau=1e-5)
    cold = admm(problem, iterations=frame.iterations, tolerance=0).scene
    assert error(frame.scene, scene(7)) < 0.2
    assert error(frame.scene, scene(7)) < 0.5 * error(cold, scene(7))


def test_psfs_over_the_field():
    """The first frame is the photo; others follow what moves, saturates, is cut and weighed."""
    generator = torch.Generator().manual_seed(6)
    values = (torch.rand(5, 1, 96, 104, generator=generator) > 0.97).float()
    psfs = FieldPsf(values, torch.tensor([(0.0, 0), (-16, -16), (-16, 16), (16, -16), (16, 16)]))
    solver = Reconstructor(values[0], SUPPORT, 1e-4, field_psf=psfs)
    places = psfs.places + torch.tensor([side // 2 for side in SENSOR])
    blur = FieldConvolution(values, places, SENSOR, SUPPORT)
    stream = solver.stream(blur(scene(0)), iterations=4)
    assert torch.equal(stream.solve(blur(scene(0))).scene, solver.solve(blur(scene(0))).scene)
    for step in range(1, 5):
        light = (1 + step) * blur(scene(step))
        valid = light < 0.95 * light.max()
        frame = stream.solve(torch.where(valid, light, light.max()), valid)
        assert frame.iterations == 4 and error(frame.scene, (1 + step) * scene(step)) < 0.01
    stream.weigh(10 * stream.weight)
    weighed = [stream.solve(light, valid).scene for _ in range(4)][-1]
    assert error(weighed, replace(solver, tau=1e-3).solve(light, valid).scene) < 0.02
    assert stream.cuts == 0
    square = torch.zeros(4, 1, 32, 32)
    for step, each in enumerate(square):
        each[:, 8:16, 5 + step : 13 + step] = 1.0
        found = stream.solve(blur(each)).scene
        assert error(found, each) < 0.1 and stream.cuts == 1


def test_brightness_may_change():
    psf, blur = camera()
    stream = Stream(Problem.build(psf, blur(scene(0)), support=SUPPORT, tau=1e-5))
    stream.solve(blur(scene(0)))
    assert error(stream.solve(30 * blur(scene(0))).scene, 30 * scene(0)) < 0.1


@pytest.mark.parametrize("iterations", [2, 4])
def test_few_iterations_follow_noisy_frames(iterations):
    """The square moves on by a cell a frame; three frames later its old place is given up."""
    psf, blur = camera()
    generator = torch.Generator().manual_seed(2)
    problem = Problem.build(psf, blur(scene(0)), support=SUPPORT, tau=1e-5)
    stream = Stream(problem, iterations=iterations)
    stream.solve(blur(scene(0)))
    for step in range(1, 10):
        light = blur(scene(step))
        light += 0.01 * light.mean() * torch.randn(light.shape, generator=generator)
        found = stream.solve(light).scene
    assert error(found, scene(9)) < 0.8 * error(found, scene(6))
    cold = admm(problem.measuring(light), iterations=iterations, tolerance=0).scene
    assert error(found, scene(9)) < 0.5 * error(cold, scene(9))


@pytest.mark.parametrize("before", ["point", "dark", "stripes"])
def test_another_scene_is_there_within_three_frames(before):
    """Nothing of the scene before a cut stays, however bright or dark it was."""
    psf, blur = camera()
    generator = torch.Generator().manual_seed(4)
    noise = 0.01 * torch.randn(13, 1, *SENSOR, generator=generator)
    others = {name: torch.zeros(1, 32, 32) for name in ("point", "dark", "stripes")}
    others["point"][0, 20, 9] = 300.0
    others["stripes"][:, ::4] = 1.0
    stream = Stream(Problem.build(psf, blur(scene(0)), support=SUPPORT, tau=1e-5), iterations=2)
    for each in noise[:10]:
        stream.solve(blur(others[before]) + each)
    found = [stream.solve(blur(scene(0)) + each).scene for each in noise[10:]]
    first, _, third = (error(each, scene(0)) for each in found)
    assert first < 0.45 and third < 0.2


@pytest.mark.parametrize("prior", [Prior.TV, Prior.ISOTROPIC_TV, Prior.L1, Prior.NONE])
def test_standing_scene_converges(prior):
    psf, blur = camera()
    data = blur(scene(0)) + 0.02 * torch.rand(
        1, *SENSOR, generator=torch.Generator().manual_seed(3)
    )
    problem = Problem.build(psf, data, support=SUPPORT, tau=1e-4, prior=prior)
    best = admm(problem, iterations=3000, tolerance=1e-6)
    stream = Stream(problem)
    frames = [stream.solve(data) for _ in range(40)]
    assert problem.objective(frames[-1].scene / problem.scale) < 1.01 * best.objective


def test_another_weight_is_followed():
    """A stream goes on to the scene of its new weight, also from and to none at all."""
    psf, blur = camera()
    data = blur(scene(0))
    problem = Problem.build(psf, data, support=SUPPORT, tau=1e-4)
    stream = Stream(problem, iterations=40)
    for factor in (100, 1, 0, 1):
        stream.weigh(factor * problem.weight)
        found = [stream.solve(data).scene for _ in range(4)][-1]
        alone = admm(problem.weighted(factor * problem.weight), iterations=300, tolerance=0).scene
        assert error(found, alone) < 0.02, factor
    assert stream.cuts == 0
    assert [weight_to_follow(1.0, chosen) for chosen in (0.4, 0.6, 1.9, 2.1)] == [0.4, 1, 1, 2.1]


def test_standing_scene_is_left_as_it_is():
    """A frame that shows what the one before showed is done long before its limit."""
    psf, blur = camera()
    stream = Stream(Problem.build(psf, blur(scene(0)), support=SUPPORT, tau=1e-4), iterations=500)
    for _ in range(3):
        found = stream.solve(blur(scene(0)))
    assert found.iterations < 100
    assert error(found.scene, scene(0)) < 0.05


def test_frames_end_in_time(monkeypatch):
    """By a clock that moves on by a tenth of the bound whenever it is looked at."""
    looks = itertools.count()
    clock = SimpleNamespace(perf_counter=lambda: 0.03 * next(looks))
    monkeypatch.setattr("nolens.solvers.stream.time", clock)
    psf, blur = camera()
    problem = Problem.build(psf, blur(scene(0)), support=SUPPORT, tau=1e-5)
    slow = Stream(problem, iterations=100_000, latency_s=0.3)
    for step in range(4):
        frame = slow.solve(blur(scene(step)))
        assert 4 < frame.iterations < 100
        assert 0.2 < frame.seconds < 0.301


def test_bad_frame_leaves_the_stream_as_it_was():
    psf, blur = camera()
    problem = Problem.build(psf, blur(scene(0)), support=SUPPORT, tau=1e-5)
    streams = [Stream(problem) for _ in range(2)]
    for stream in streams:
        stream.solve(blur(scene(0)))
    for bad in (torch.zeros(1, *SENSOR), torch.ones(1, 5, 5), blur(scene(0)) * torch.nan):
        with pytest.raises(DataError):
            streams[0].solve(bad)
    first, second = (stream.solve(blur(scene(1))).scene for stream in streams)
    assert torch.equal(first, second)


def test_memory_is_flat_over_500_frames():
    psf, blur = camera()
    data = [blur(scene(step)) for step in range(12)]
    stream = Stream(Problem.build(psf, data[0], support=SUPPORT), iterations=4)
    process = psutil.Process()
    held = []
    for step in range(500):
        stream.solve(data[step % 12])
        if step % 50 == 49:
            held.append(process.memory_info().rss)
    # Forty frames of this size would be a megabyte; the first fifty settle the allocators.
    assert held[-1] - held[1] < 4e6


@pytest.mark.parametrize(
    ("options", "message"),
    [({"iterations": 0}, "iterations is 0"), ({"latency_s": 0.0}, "latency_s is 0")],
)
def test_bad_options(options, message):
    psf, blur = camera()
    with pytest.raises(OptionError, match=message):
        Stream(Problem.build(psf, blur(scene(0)), support=SUPPORT), **options)
