"""A network in turn with the fit of the measurement."""

import math
from dataclasses import replace

import pytest
import torch
from posed import Case, pose
from torch import Tensor

from nolens.errors import OptionError
from nolens.files.weights import denoiser
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Method, Prior, Problem, Progress, Reconstructor
from nolens.solvers.denoising_network import (
    BANDS,
    STEP,
    DenoisingNetwork,
    denoise,
    noise_planes,
    tiles,
)
from nolens.solvers.held_out import channel_noise
from nolens.solvers.plug_and_play import Fit, PlugAndPlay, Refinement, Turn
from nolens.solvers.report import Report
from nolens.training.pictures import training_picture
from nolens.training.unrolled import refinement_network

CASE = Case(sensor=(20, 22), psf=(20, 22), support=PixelRectangle(3, 4, 12, 13), channels=3)


@pytest.fixture(scope="module")
def network() -> DenoisingNetwork:
    torch.manual_seed(0)
    return DenoisingNetwork((4, 8, 8), (1, 1, 1)).requires_grad_(False)


@pytest.fixture(scope="module")
def problem() -> Problem:
    posed = pose(CASE)
    psf, data = (torch.from_numpy(each).float() for each in (posed.psf, posed.data))
    noise = torch.randn(data.shape, generator=torch.Generator().manual_seed(1))
    return Problem.build(psf, data + 0.02 * data.std() * noise, support=CASE.support, tau=1e-3)


@pytest.fixture
def own_spreads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Turns have the prior's own spreads, whatever noise there is, and none before."""
    monkeypatch.setattr(Fit, "own_noise", lambda *_: math.inf)
    monkeypatch.setattr("nolens.solvers.plug_and_play._WIDEST", 0.0)


def identity() -> DenoisingNetwork:
    """What takes nothing off."""
    same = DenoisingNetwork((4, 8, 8), (1, 1, 1)).requires_grad_(False)
    torch.nn.init.zeros_(same.tail.weight)
    return same


def test_the_unit_of_brightness_does_not_matter(network: DenoisingNetwork) -> None:
    scene, sigma = torch.rand(3, 30, 21), torch.tensor([0.1, 0.2, 0.05])
    plain = denoise(network, scene, sigma, 0.3)
    assert float((plain - scene).norm()) > 0.01 * float(scene.norm())
    scaled = denoise(network, 700 * scene, 700 * sigma, 210.0)
    torch.testing.assert_close(scaled, 700 * plain, rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize("size", [(7, 5), (STEP, 3 * STEP), (33, 70)])
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_sizes_and_channels(
    network: DenoisingNetwork, size: tuple[int, int], channels: int
) -> None:
    scene, sigma = torch.rand(channels, *size), torch.full((channels, BANDS), 0.1)
    result = denoise(network, scene, sigma)
    assert result.shape == scene.shape
    if channels != 3:  # Each by itself, as a grey picture.
        last = denoise(network, scene[-1:].expand(3, -1, -1), sigma[-1:].expand(3, -1))
        torch.testing.assert_close(result[-1], last.mean(dim=0))


def test_a_quarter_turn_is_a_turn_of_the_scene(network: DenoisingNetwork) -> None:
    scene, sigma = torch.rand(3, 24, 32), torch.full((3,), 0.1)
    turned = torch.rot90(scene, 1, (1, 2))
    expected = torch.rot90(denoise(network, turned, sigma), -1, (1, 2))
    torch.testing.assert_close(denoise(network, scene, sigma, turn=1), expected)


def test_tiles_join(network: DenoisingNetwork, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, sigma = torch.rand(3, 150, 170), torch.full((3,), 0.1)
    whole = denoise(network, scene, sigma)
    monkeypatch.setattr("nolens.solvers.denoising_network._TILE", 64)
    assert len(list(tiles(150, 170))) == 9
    torch.testing.assert_close(denoise(network, scene, sigma), whole, rtol=0, atol=1e-4)


def test_planes_of_white_noise() -> None:
    sigma = torch.rand(2, 3)
    torch.testing.assert_close(
        noise_planes(sigma, 0.2), noise_planes(sigma[..., None].expand(-1, -1, BANDS), 0.2)
    )


def test_fit_near_a_picture(problem: Problem) -> None:
    """The minimiser of the fit's objective, by dense matrices in float64."""
    photograph, spread = 3 * torch.rand(3, 12, 13), 0.3
    fit = Fit(problem, photograph)
    picture = photograph / fit.white
    x, noise = fit.near(picture, spread)
    assert noise.shape == (3, BANDS) and bool((noise > 0).all())
    exact = _minimiser(problem, fit, picture, spread)
    left = (x.double() - exact).norm() / (picture.double() - exact).norm()
    assert float(left) < 0.3  # The first call goes most of the way.
    for _ in range(20):
        x, _ = fit.near(picture, spread)
    torch.testing.assert_close(x.double(), exact, rtol=0, atol=2e-3 * float(exact.abs().max()))


@pytest.mark.parametrize(
    ("sensor", "corner"), [((60, 64), (14, 16)), ((62, 66), (15, 15)), ((61, 67), (14, 13))]
)
def test_a_coarse_start_lies_where_the_scene_does(
    sensor: tuple[int, int], corner: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a pixel, by which middles and corners of larger pixels differ, would be seen."""
    monkeypatch.setattr("nolens.solvers.reconstructor.COARSEN_FROM", 0)
    rows, columns = torch.meshgrid(torch.arange(32.0), torch.arange(36.0), indexing="ij")
    scene = torch.exp(-((rows - 13) ** 2 + (columns - 21) ** 2) / 60).expand(3, -1, -1)
    support = PixelRectangle(*corner, 32, 36)
    posed = pose(Case(sensor=sensor, psf=sensor, support=support, channels=3))
    psf = torch.nn.functional.avg_pool2d(torch.from_numpy(posed.psf).float()[None], 5, 1, 2)[0]
    data = CroppedConvolution(psf, sensor, support)(scene)
    solver = Reconstructor(psf, support, tau=1e-5, prior=PlugAndPlay(identity(), (0.5,)))
    problem = solver.problem(data)
    assert solver.starts_coarse(problem)
    first = solver.solve(problem).first
    assert first is not None and first.scene.shape == scene.shape
    assert float(first.scene.sum()) == pytest.approx(float(scene.sum()), rel=0.02)
    light = (first.scene - 0.2).clamp_min(0).sum(dim=0)
    for places, middle in ((rows, 13), (columns, 21)):
        assert float((light * places).sum() / light.sum()) == pytest.approx(middle, abs=0.3)


@pytest.mark.usefixtures("own_spreads")
def test_of_many_pixels_every_second_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """On 2×2 pixels and on the measurement's own; the last one is among them."""
    monkeypatch.setattr("nolens.solvers.reconstructor.COARSEN_FROM", 0)
    psf = torch.from_numpy(pose(Case(sensor=(60, 64), psf=(60, 64), channels=3)).psf).float()
    support = PixelRectangle.centred(32, 36, (60, 64))
    generator = torch.Generator().manual_seed(5)
    data = CroppedConvolution(psf, (60, 64), support)(torch.rand(3, 32, 36, generator=generator))
    data += 0.003 * data.mean() * torch.randn(data.shape, generator=generator)
    prior = PlugAndPlay(identity(), (0.5, 0.4, 0.3, 0.2, 0.1))
    solver = Reconstructor(psf, support, tau=1e-5, prior=prior)
    problem = solver.problem(data)
    for most in (0, 10**9):
        monkeypatch.setattr("nolens.solvers.plug_and_play.FEW_TURNS_PIXELS", most)
        result = solver.solve(problem)
        assert result.first is not None
        turns = len(result.history) - len(result.first.history)
        assert turns == (6 if most == 0 else 10)


def _minimiser(problem: Problem, fit: Fit, picture: Tensor, spread: float) -> Tensor:
    """Of ½‖(b − Av)/σ‖² + ‖v − z‖²/2s², in units of the white."""
    noise = fit.noise.double()
    height, width = picture.shape[1:]
    basis = torch.eye(height * width).reshape(-1, 1, height, width)
    scenes = []
    for number in range(3):
        single = problem.single(number)
        image = torch.cat([single.forward(each) for each in basis]).flatten(1).double().T
        image = image * (fit.white / problem.scale[number].double()) / noise[number]
        data = single.data.double().flatten() / noise[number]
        prior = torch.eye(height * width).double() / spread**2
        z = picture[number].double().flatten()
        scenes.append(torch.linalg.solve(image.T @ image + prior, image.T @ data + prior @ z))
    return torch.stack(scenes).reshape(picture.shape)


def test_the_error_of_the_model_counts_as_noise(problem: Problem) -> None:
    """A wrong picture leaves a part of it."""
    own = channel_noise(problem)
    right = Reconstructor(torch.empty(0)).solve(problem).scene
    assert bool((Fit(problem, right).noise <= own).all())
    wrong = Fit(problem, 2 * right)
    left = problem.residual(2 * right / problem.scale).square().mean(dim=(1, 2))
    error = 5 * (left - own.square())
    torch.testing.assert_close(wrong.noise, (own.square() + error).sqrt())
    assert wrong.errs


@pytest.mark.parametrize("coarsen_from", [10**9, 0])
def test_little_noise_through_a_sharp_psf(
    coarsen_from: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Detail of the measurement is no noise: that is measured to a third, and the picture has at
    most half of total variation's squared error, also after turns on larger pixels, where the
    model errs. Spreads fall further than the prior's own, and in more noise not as far.
    """
    monkeypatch.setattr("nolens.solvers.reconstructor.COARSEN_FROM", coarsen_from)
    generator = torch.Generator().manual_seed(0)
    psf = (torch.rand(3, 120, 150, generator=generator) > 0.98).float()
    support = PixelRectangle.centred(48, 56, (96, 112))
    scene = training_picture(48, 56, 2000001)
    light = CroppedConvolution(psf, (96, 112), support)(scene)
    noise = 0.005 * light.mean()
    data = light + noise * torch.randn(light.shape, generator=generator)
    spreads = list[float]()

    def seen(turn: Turn) -> Tensor:
        spreads.append(turn.spread)
        return turn.picture

    prior = replace(denoiser(), refinement=seen)
    solver = Reconstructor(psf, support, tau=1e-4, prior=prior)
    problem = solver.problem(data)
    photograph = replace(solver, prior=Prior.TV).solve(problem).scene
    own, measured = channel_noise(problem), Fit(problem, photograph).noise
    true = noise / (problem.scale * problem.psf_norm).flatten()
    assert bool((own > 3 * true).all())
    torch.testing.assert_close(measured, true, rtol=0.35, atol=0)
    result = solver.solve(problem)
    best, default = (float((each - scene).square().sum()) for each in (photograph, result.scene))
    assert default < 0.5 * best
    solver.solve(solver.problem(light + 30 * (data - light)))
    little, louder = spreads
    assert little < 0.5 * prior.spreads[-1] < prior.spreads[-1] < 0.5 * louder
    report = Report.of(
        problem, result, psf, prediction=None, method="admm", automatic_tau=False,
        automatic_support=False, seconds=1.0,
    )  # fmt: skip
    assert report.noise == pytest.approx(0.005, rel=0.35)


def test_noise_that_the_fit_leaves() -> None:
    """The density by octaves is about that of noise alone, fitted near nothing."""
    posed = replace(CASE, sensor=(96, 96), psf=(96, 96), support=PixelRectangle(24, 24, 48, 48))
    psf = torch.from_numpy(pose(posed).psf).float()
    data = torch.randn(3, 96, 96, generator=torch.Generator().manual_seed(2))
    noisy = Problem.build(psf, data, support=posed.support, tau=1e-3)
    fit = Fit(noisy, 1e-6 * torch.rand(noisy.scene_shape))
    fit.white = 1.0
    zero = torch.zeros(noisy.scene_shape)
    for _ in range(5):
        x, stated = fit.near(zero, 0.3)
    rows, columns = (torch.fft.fftfreq(side)[:, None] for side in x.shape[1:])
    octave = torch.hypot(rows, columns.T).clamp_min(1e-9).log2().add(1 + BANDS).floor()
    density = torch.fft.fft2(x).abs().square() / x[0].numel()
    for band in range(2, BANDS):  # Below are a few waves only.
        within = octave.clamp(0, BANDS - 1) == band
        measured = density[:, within].mean(dim=1).sqrt()
        ratio = measured / stated[:, band]
        assert float(ratio.min()) > 0.5 and float(ratio.max()) < 1.5


@pytest.mark.usefixtures("own_spreads")
def test_turns_of_a_network_that_takes_nothing_off(problem: Problem) -> None:
    """The fits' residual is below the photograph's, and the record goes on from that."""
    seen: list[Progress] = []
    prior = PlugAndPlay(identity(), (0.5, 0.5))
    solver = Reconstructor(torch.empty(0), prior=prior)
    first = replace(solver, prior=Prior.TV).solve(problem)
    result = solver.solve(problem, callback=seen.append)
    rows = len(result.history) - len(first.history)
    assert result.iterations == first.iterations + rows == result.history[-1]["iteration"]
    assert rows == len(seen) - len(first.history) and rows % 2 == 0
    assert float(result.scene.min()) >= 0 and result.first is not None
    assert torch.equal(result.first.scene, first.scene)
    for turn in prior.turns(problem, first.scene):
        before, after = (
            float(problem.residual(scene / problem.scale).norm())
            for scene in (first.scene, turn.white * turn.fit)
        )
        assert after < before


def test_the_strength_follows_from_what_is_carried() -> None:
    """Of the finest detail: 1 where the noise is white, ⅔ at most and less where it is not. Detail
    divides the weight, its square.
    """
    case = replace(CASE, sensor=(60, 64), psf=(60, 64), support=PixelRectangle(14, 16, 32, 32))
    sharp = torch.from_numpy(pose(case).psf).float()
    scene = torch.rand(3, 8, 8, generator=torch.Generator().manual_seed(0))
    scene = scene.repeat_interleave(4, 1).repeat_interleave(4, 2)
    prior = PlugAndPlay(identity(), (0.02,) * 3)

    def strength(psf: Tensor, size: float, detail: float = 1.0) -> tuple[float, float]:
        """Of all turns, and how much of the finest detail is carried."""
        data = CroppedConvolution(psf, case.sensor, case.support)(scene)
        noise = torch.randn(data.shape, generator=torch.Generator().manual_seed(1))
        noisy = data + size * data.std() * noise
        problem = Problem.build(psf, noisy, support=case.support, tau=1e-4)
        first = Reconstructor(torch.empty(0)).solve(problem)
        result = replace(prior, detail=detail).solve(problem, first)
        (one,) = {row["penalty_1"] for row in result.history[len(first.history) :]}
        return one, Fit(problem, first.scene).finest(0.02)

    little = torch.nn.functional.avg_pool2d(sharp, 3, 1, 1)
    smooth = sharp
    for _ in range(4):
        smooth = torch.nn.functional.avg_pool2d(smooth, 5, 1, 2)
    assert strength(sharp, 0.01)[0] == 1
    assert strength(little, 0.01)[0] == pytest.approx(2 / 3)
    assert strength(little, 0.01, detail=4.0)[0] == pytest.approx(1 / 3)
    # With little noise what the photograph leaves of a smooth PSF's light says that the model errs.
    assert strength(smooth, 0.01)[0] == pytest.approx(2 / 3)
    weaker, finest = strength(smooth, 0.2)
    assert weaker == pytest.approx((2 * finest) ** (1 / 6)) and weaker < 0.6


@pytest.mark.parametrize("coarsen_from", [10**9, 0])
def test_wide_spreads_mend_the_slow_parts(
    coarsen_from: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A PSF of open and closed pixels hardly carries them, and noise hides them from total
    variation; without wide spreads the photograph's error stays, to five times at least.
    """
    monkeypatch.setattr("nolens.solvers.reconstructor.COARSEN_FROM", coarsen_from)
    generator = torch.Generator().manual_seed(1)
    psf = (torch.rand(3, 144, 160, generator=generator) > 0.5).float()
    support = PixelRectangle.centred(48, 48, (96, 112))
    scene = training_picture(48, 48, 2000004)
    light = CroppedConvolution(psf, (96, 112), support)(scene)
    data = light + 0.1 * light.mean() * torch.randn(light.shape, generator=generator)
    solver = Reconstructor(psf, support, tau=0.02, prior=denoiser())
    problem = solver.problem(data)
    result = solver.solve(problem)
    monkeypatch.setattr("nolens.solvers.plug_and_play._WIDEST", 0.0)
    monkeypatch.setattr("nolens.solvers.plug_and_play._FROM_NOISE", 0.0)
    narrow = solver.solve(problem)
    assert result.first is not None

    def slow(picture: Tensor) -> float:
        means = torch.nn.functional.avg_pool2d(picture - scene, 8)
        return float(means.square().sum())

    assert slow(result.scene) < 0.2 * slow(narrow.scene) < 0.2 * slow(result.first.scene)


def test_some_of_the_photograph_stays_after_wide_spreads(problem: Problem) -> None:
    """Turns whose spread leaves the picture as it is go on with the mean, after wide ones alone."""
    prior = PlugAndPlay(identity(), (30.0, 1e-6, 1e-6))
    photograph = torch.rand(problem.scene_shape, generator=torch.Generator().manual_seed(2))
    first, second, third = prior.turns_from_wide(2, problem, photograph)
    start = photograph / first.white
    assert float((first.picture - start).norm()) > 0.1 * float(start.norm())
    torch.testing.assert_close(second.picture, first.picture, rtol=0, atol=1e-4)
    mean = 0.85 * second.picture + 0.15 * start
    torch.testing.assert_close(third.picture, mean, rtol=0, atol=1e-4)
    *_, own = prior.turns_from_wide(3, problem, photograph)
    torch.testing.assert_close(own.picture, first.picture, rtol=0, atol=1e-4)


@pytest.mark.usefixtures("own_spreads")
@pytest.mark.parametrize("channels", [1, 3])
def test_a_refinement_makes_the_last_picture(channels: int, network: DenoisingNetwork) -> None:
    """Of the last turn, once; its network starts as one that changes nothing."""
    posed = pose(replace(CASE, channels=channels))
    psf, data = (torch.from_numpy(each).float() for each in (posed.psf, posed.data))
    problem = Problem.build(psf, data, support=CASE.support, tau=1e-3)
    first = Reconstructor(torch.empty(0)).solve(problem)
    seen: list[Turn] = []

    def half(turn: Turn) -> Tensor:
        seen.append(turn)
        return turn.picture / 2

    turns = PlugAndPlay(network, (0.5, 0.2))
    plain = turns.solve(problem, first)
    result = replace(turns, refinement=half).solve(problem, first)
    torch.testing.assert_close(result.scene, plain.scene / 2)
    assert [turn.number for turn in seen] == [1]
    assert result.iterations == plain.iterations + 1 == result.history[-1]["iteration"]
    assert seen[0].pictures.shape == (3, channels, 12, 13)
    same = Refinement(refinement_network(network).requires_grad_(False))
    torch.testing.assert_close(same(seen[0]), seen[0].picture)
    torch.nn.init.normal_(same.network.tail.weight)
    mended = same(seen[0])
    assert mended.shape == seen[0].picture.shape and float(mended.min()) >= 0
    assert not torch.equal(mended, seen[0].picture)
    # A share of what it changes, and only where the finest detail is not carried.
    some = replace(same, share=0.25)(seen[0])
    torch.testing.assert_close(some, 0.75 * seen[0].picture + 0.25 * mended)
    carried = seen[0].finest
    assert torch.equal(replace(same, finest=0.99 * carried)(seen[0]), seen[0].picture)
    assert torch.equal(replace(same, finest=1.01 * carried)(seen[0]), mended)
    # In other units of brightness it is the same.
    brighter = {
        name: 7 * getattr(seen[0], name) for name in ("fit", "picture", "multiplier", "noise")
    }
    scaled = same(replace(seen[0], **brighter, spread=7 * seen[0].spread))
    torch.testing.assert_close(scaled, 7 * mended, rtol=1e-4, atol=1e-4)
    stopped = replace(turns, refinement=half).solve(problem, first, lambda _: True)
    assert stopped.stop_reason == "callback" and len(seen) == 1


def test_a_run_that_is_stopped_keeps_its_picture(problem: Problem) -> None:
    prior = PlugAndPlay(identity(), (0.5, 0.4, 0.3))
    first = Reconstructor(torch.empty(0)).solve(problem)
    result = prior.solve(problem, first, lambda progress: True)
    assert result.stop_reason == "callback"
    assert result.iterations == first.iterations + 1


def test_what_has_another_prior() -> None:
    posed = pose(CASE)
    prior = PlugAndPlay(identity(), (0.5,))
    solver = Reconstructor(torch.from_numpy(posed.psf), prior=prior, method=Method.WIENER)
    with pytest.raises(OptionError, match=r"the Wiener filter .* has a prior of its own"):
        solver.problem(torch.from_numpy(posed.data))
