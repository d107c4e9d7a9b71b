"""A photograph with a prior of one's own."""

from dataclasses import replace

import pytest
import torch
from posed import Case, pose

from nolens.errors import OptionError
from nolens.operators import FiniteDifference, PixelRectangle
from nolens.solvers import (
    L1,
    Functional,
    Prior,
    Progress,
    Reconstructor,
    Ridge,
)
from nolens.solvers.held_out import Weight, channel_noise
from nolens.solvers.scene_prior import scene_prior

CASE = Case(sensor=(12, 13), psf=(12, 13), support=PixelRectangle(2, 1, 6, 7), channels=2)


def smooth(first: torch.Tensor) -> Functional:
    return 3.0 * (Ridge() @ FiniteDifference(first.shape[-2:]))


def reconstructor(prior: object, factor: float = 1.0) -> tuple[Reconstructor, torch.Tensor]:
    posed = pose(CASE)
    psf, data = (torch.from_numpy(each).float() for each in (posed.psf, posed.data))
    solver = Reconstructor(factor * psf, CASE.support, tau=1e-3, prior=prior)  # type: ignore[arg-type]
    return solver, data


def test_the_most_probable_scene() -> None:
    """½Σ((b − Av)/σ)² + f(v), v ≥ 0: no gradient where there is light, and none towards it."""
    seen: list[Progress] = []
    firsts: list[torch.Tensor] = []

    def prior(first: torch.Tensor) -> Functional:
        firsts.append(first)
        return smooth(first)

    solver, data = reconstructor(prior)
    result = solver.solve(data, callback=seen.append)
    problem = replace(solver, prior="tv").problem(data)
    assert float(torch.quantile(firsts[0], 0.995)) == pytest.approx(1.0)
    white = replace(solver, prior="tv").solve(data).scene / firsts[0]
    white = white[firsts[0] > 0].mean()
    noise = channel_noise(problem)[:, None, None]

    def slope(scene: torch.Tensor) -> tuple[float, torch.Tensor]:
        v = (scene / white).double().requires_grad_()
        fit = (problem.residual(v * white / problem.scale) / noise).square().sum() / 2
        value = fit + smooth(firsts[0])(v)
        return float(value.detach()), torch.autograd.grad(value, v)[0]

    value, here = slope(result.scene)
    _, at_zero = slope(torch.zeros_like(result.scene))
    assert result.objective == pytest.approx(value, rel=1e-3)
    lit = result.scene > 1e-2 * white
    assert lit.any() and not lit.all()
    assert float(here[lit].abs().max()) < 0.01 * float(at_zero.abs().max())
    assert float(here.min()) > -0.01 * float(at_zero.abs().max())
    assert seen[-1].iteration == result.iterations > result.history[0]["iteration"] > 1
    assert result.history[-1] == seen[-1].row()


def test_units_do_not_matter() -> None:
    """A PSF three times as bright, a measurement seven times: the scene follows."""
    solver, data = reconstructor(smooth)
    other, _ = reconstructor(smooth, 4.0)
    plain, scaled = solver.solve(data).scene, other.solve(8 * data).scene
    torch.testing.assert_close(scaled, 2 * plain, rtol=1e-3, atol=1e-3 * float(plain.max()))


@pytest.mark.parametrize("prior", ["ridge", "denoiser", smooth])
def test_detail_is_that_of_the_last_call(prior: object) -> None:
    """A sweep asks one reconstructor for one detail after the other."""
    solver, _ = reconstructor(prior)
    chosen = Weight(1e-3, 0.0)
    once, twice = solver.with_detail(chosen, 4.0), solver.with_detail(chosen, 2.0)
    twice = twice.with_detail(chosen, 4.0)
    assert once.tau == twice.tau == pytest.approx(2.5e-4)
    assert once.prior == twice.prior != solver.with_detail(chosen, 2.0).prior
    if prior is smooth:
        first, scene = torch.ones(2, 6, 7), torch.rand(2, 6, 7)
        weak = scene_prior(once.prior)(first)
        assert float(weak(scene)) == pytest.approx(float(smooth(first)(scene)) / 4)


def test_what_a_prior_can_be() -> None:
    assert scene_prior("tv") is Prior.TV and scene_prior(Prior.L1) is Prior.L1
    norm = 2.0 * L1()
    first = torch.ones(1, 2, 2)
    assert scene_prior(norm)(first) is norm  # type: ignore[operator]
    assert scene_prior(smooth) is smooth
    with pytest.raises(OptionError, match="prior is 'tvv'; give one of auto, tv, "):
        scene_prior("tvv")
    solver, data = reconstructor(lambda _: "smooth")
    with pytest.raises(OptionError, match="the prior gave str; it must give a Functional"):
        solver.solve(data)
    with pytest.raises(OptionError, match="a stream has no prior of one's own"):
        solver.stream(data)
    stopped = solver.solve(data, callback=lambda _: True)
    assert stopped.stop_reason == "callback"
