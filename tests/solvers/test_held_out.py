"""The weight of the prior, chosen by held-out pixels, is near the best that the truth can say."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as nnf
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from skimage import data as photographs
from torch import Tensor

from nolens.evaluate import psnr, scale_fit
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Method, Prior, Problem, Reconstructor, circulant_wiener
from nolens.solvers.held_out import box_mean, choose_weight, pixel_noise
from nolens.solvers.wiener_weight import choose_circulant_weight, choose_wiener_weight

SENSOR = (192, 224)
SUPPORT = PixelRectangle.centred(64, 64, SENSOR)


def mask_psf() -> Tensor:
    """Fine random lines, like a caustic's, that reach beyond the sensor."""
    noise = torch.randn(1, 1, 256, 288)
    smooth = nnf.avg_pool2d(nnf.avg_pool2d(noise, 7, 1, 3), 5, 1, 2)
    return torch.exp(-((smooth / 0.01).square()))[0] + 0.02


def photograph() -> Tensor:
    encoded = torch.as_tensor(photographs.camera()).float()[None, None] / 255
    return nnf.interpolate(encoded, size=(64, 64), mode="bilinear", antialias=True)[0]


def measured(psf: Tensor, scene: Tensor, noise: float) -> Tensor:
    light = CroppedConvolution(psf, SENSOR, SUPPORT)(scene)
    light /= light.square().mean().sqrt()
    return light + noise * torch.randn(light.shape)


@given(st.integers(0, 9), st.integers(1, 24), st.integers(1, 24))
def test_box_mean_is_the_plain_mean(half: int, height: int, width: int) -> None:
    """Of a side that is larger than the planes, too."""
    side = 2 * half + 1
    planes = torch.rand(2, height, width, dtype=torch.float64)
    plain = ndimage.uniform_filter(planes.numpy(), (0, side, side), mode="constant")
    torch.testing.assert_close(box_mean(planes, side), torch.from_numpy(plain))


def quality(solver: Reconstructor, data: Tensor, truth: Tensor, weight: float) -> float:
    scene = replace(solver, tau=weight).solve(data).scene
    return psnr(scale_fit(scene, truth), truth, 1.0)


@pytest.mark.parametrize(
    ("prior", "noise", "loss_db"),
    [
        (Prior.TV, 0.003, 1.0),
        (Prior.TV, 0.03, 0.6),
        (Prior.ISOTROPIC_TV, 0.03, 0.6),
        (Prior.L1, 0.03, 6.0),
    ],
)
def test_is_near_the_best_of_a_grid(prior: Prior, noise: float, loss_db: float) -> None:
    psf, truth = mask_psf(), photograph()
    if prior == Prior.L1:
        truth = truth * (torch.rand_like(truth) > 0.95)
    data = measured(psf, truth, noise)
    solver = Reconstructor(psf, SUPPORT, prior=prior)
    chosen = solver.choose_weight(data)
    best = max(quality(solver, data, truth, chosen.tau * by) for by in (0.1, 0.5, 2, 10))
    assert quality(solver, data, truth, chosen.tau) > best - loss_db
    # Stronger and weaker ones were tried, and predict worse.
    assert min(step.excess for step in chosen.steps) == 0
    assert all(chosen.steps[end].excess > 0 for end in (0, -1))
    # A scene of this kind is explained but for the noise.
    assert chosen.prediction is not None
    assert chosen.prediction.unexplained < 2 * chosen.prediction.unexplained_by_noise


def test_smooth_scene_through_lenslets() -> None:
    """Far from solved after 28 iterations, by which every weaker weight looked better."""
    size = (96, 128)
    psf = torch.zeros(1, *size)
    psf.view(-1)[torch.randint(0, psf.numel(), (30,))] = 1.0
    psf = nnf.avg_pool2d(psf, 3, 1, 1)
    region = PixelRectangle.centred(64, 96, size)
    y, x = (torch.linspace(-1, 1, count) for count in (64, 96))
    blob = torch.exp(-10 * ((y[:, None] - 0.2).square() + (x + 0.1).square()))
    truth = (0.3 + blob + 0.2 * torch.sin(3 * x))[None].clamp_min(0)
    light = CroppedConvolution(psf, size, region)(truth)
    data = light + 0.003 * light.std() * torch.randn(light.shape)
    solver = Reconstructor(psf, region)
    tau = solver.choose_weight(data).tau
    at, weaker, stronger = (quality(solver, data, truth, tau * by) for by in (1, 0.1, 10))
    assert at > max(weaker, stronger) - 0.5


def test_solves_with_its_choice() -> None:
    psf = mask_psf()
    data = measured(psf, photograph(), 0.01)
    solver = Reconstructor(psf, SUPPORT)
    assert solver.problem(data).weight == pytest.approx(solver.choose_weight(data).tau)


def test_a_weight_is_chosen_on_larger_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """2×2, with a network, too; it is about that of the measurement's own. Through a PSF of single
    pixels it would not be, and is chosen on those, unless a network goes on from there.
    """
    psf = mask_psf()
    data = measured(psf, photograph(), 0.02)
    fine = Reconstructor(psf, SUPPORT).choose_weight(data).tau
    monkeypatch.setattr("nolens.solvers.reconstructor.COARSEN_FROM", 0)
    solver = Reconstructor(psf, SUPPORT, prior="denoiser")
    tau = solver.choose_weight(data).tau
    assert tau == pytest.approx(choose_weight(solver.coarse_problem(data)).tau)
    assert 1 / 4 < tau / fine < 4

    sharp = (torch.rand(psf.shape) > 0.98).float()
    data = measured(sharp, photograph(), 0.02)
    solver = Reconstructor(sharp, SUPPORT)
    fine, coarse = (choose_weight(solver.coarse_problem(data, by=by)).tau for by in (1, 2))
    assert coarse > 2 * fine
    assert solver.choose_weight(data).tau == pytest.approx(fine)
    assert replace(solver, prior="denoiser").choose_weight(data).tau == pytest.approx(coarse)


@pytest.mark.parametrize("noise", [0.0003, 0.01, 0.1])
def test_weight_of_the_wiener_filter_is_chosen(noise: float) -> None:
    """Of the circulant one, too, which is far behind: light falls beside the sensor."""
    psf, truth = mask_psf(), photograph()
    data = measured(psf, truth, noise)
    solver = Reconstructor(psf, SUPPORT, method=Method.WIENER)
    problem = solver.problem(data)
    chosen = choose_wiener_weight(problem)
    taus = [step.tau for step in chosen.steps]
    assert taus == sorted(taus, reverse=True)
    reached = quality(solver, data, truth, chosen.tau)
    assert reached > max(quality(solver, data, truth, chosen.tau * by) for by in (0.01, 100))
    assert reached > max(quality(solver, data, truth, tau) for tau in taus) - 1

    def by_circulant(weight: float) -> float:
        scene = circulant_wiener(problem.weighted(weight)).scene
        return psnr(scale_fit(scene, truth), truth, 1.0)

    circulant = choose_circulant_weight(problem)
    best = max(by_circulant(step.tau) for step in circulant.steps)
    assert best - 1 < by_circulant(circulant.tau) <= best < reached - 1


def test_a_weight_for_a_psf_that_errs_is_strong() -> None:
    """Next to no noise: the noise's own weight would explain the model's error."""
    psf, truth = mask_psf(), photograph()
    data = measured(psf + 0.3 * psf.roll(3, -1), truth, 0.0001)
    solver = Reconstructor(psf, SUPPORT, method=Method.WIENER)
    prediction = choose_wiener_weight(solver.problem(data)).prediction
    assert prediction is not None and prediction.unexplained < 0.3


def test_where_there_is_nothing_to_choose_by() -> None:
    psf, scene = mask_psf(), photograph()
    problem = Problem.build(psf, measured(psf, scene, 0.01), support=SUPPORT)
    assert choose_weight(Problem.build(psf, problem.data, prior="none")).tau == 0
    # Few pixels, or a caller who stops at once: the noise says it.
    stopped = choose_weight(problem, progress=lambda fraction: True)
    assert stopped.interrupted and not stopped.steps
    assert stopped.tau * problem.tau_unit == pytest.approx(0.6 * stopped.noise)
    few = Problem.build(psf, problem.data[..., :24, :24])
    assert choose_weight(few).tau > 0 and not choose_weight(few).steps


def test_noise_is_that_of_valid_pixels() -> None:
    psf = mask_psf()
    data = torch.full((1, *SENSOR), 1.0) + 0.02 * torch.randn(1, *SENSOR)
    valid = torch.rand(data.shape) > 0.1
    spoilt = torch.where(valid, data, 50.0)
    problem = Problem.build(psf, spoilt, valid=valid)
    level = pixel_noise(problem) / float(problem.data[problem.valid].mean())
    assert level == pytest.approx(0.02, rel=0.05)
    # Values without noise have what storing leaves.
    assert pixel_noise(Problem.build(psf, torch.ones(1, *SENSOR))) > 0


@pytest.mark.parametrize("prior", [Prior.TV, Prior.L1])
def test_a_number_means_the_same_at_any_binning_and_support(prior: Prior) -> None:
    psf = mask_psf()
    scene = nnf.interpolate(torch.rand(1, 1, 8, 8), size=(64, 64))[0]
    data = measured(psf, scene, 0.0)

    def prior_term(problem: Problem, scene: Tensor) -> float:
        return problem.tau * float(problem.regulariser(scene / problem.scale))

    fine = Problem.build(psf, data, support=SUPPORT, prior=prior).weighted(1e-3)
    here = prior_term(fine, scene)
    coarse = Problem.build(
        nnf.avg_pool2d(psf, 2), nnf.avg_pool2d(data, 2), support=(32, 32), prior=prior
    ).weighted(1e-3)
    # In units of measurement over PSF, light of 2×2 pixels comes from one.
    assert prior_term(coarse, 4 * nnf.avg_pool2d(scene, 2)) == pytest.approx(here, rel=0.4)
    wide = Problem.build(psf, data, support=(96, 128), prior=prior).weighted(1e-3)
    assert prior_term(wide, nnf.pad(scene, (32, 32, 16, 16))) == pytest.approx(here, rel=0.05)
    colours = Problem.build(psf, data.expand(3, -1, -1), support=SUPPORT, prior=prior)
    per_channel = prior_term(colours.weighted(1e-3), scene.expand(3, -1, -1)) / 3
    assert per_channel == pytest.approx(here, rel=1e-3)
