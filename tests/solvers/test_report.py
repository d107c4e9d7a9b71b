"""The figures of a report, against a Gaussian PSF of which all is known."""

import math
from dataclasses import replace

import pytest
import torch

from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Method, Problem, Reconstructor
from nolens.solvers.held_out import Prediction
from nolens.solvers.report import Report, resolved_frequency

SENSOR = (128, 160)
SUPPORT = PixelRectangle.centred(96, 96, SENSOR)
SIGMA = 1.5


def gaussian() -> torch.Tensor:
    rows, columns = torch.arange(SENSOR[0]) - 64.0, torch.arange(SENSOR[1]) - 80.0
    squared = rows[:, None].square() + columns.square()
    return torch.exp(-squared / (2 * SIGMA**2))[None]


@pytest.mark.parametrize("noise", [2e-5, 1e-4, 4e-4])
def test_resolution_of_a_gaussian(noise: float) -> None:
    """Its transfer is known, and with it the frequency at which bars drown."""
    psf, scene = gaussian(), torch.ones(1, 96, 96)
    data = CroppedConvolution(psf, SENSOR, SUPPORT)(scene)
    problem = Problem.build(psf, data, support=SUPPORT)
    # The normalised PSF is exp(-r²/2s²)/(s√π), and the scene is even.
    mean = 1 / float(problem.scale)

    def signal_to_noise(frequency: float) -> float:
        transfer = 2 * math.sqrt(math.pi) * SIGMA
        transfer *= math.exp(-2 * (math.pi * SIGMA * frequency) ** 2)
        return 0.1 * mean * transfer / math.sqrt(2) / noise * 3 / frequency

    wanted = next(step / 1000 for step in range(1, 500) if signal_to_noise(step / 1000) < 5)
    assert 0.05 < wanted < 0.35
    assert resolved_frequency(problem, scene, psf, noise) == pytest.approx(wanted, abs=0.02)
    assert resolved_frequency(problem, scene, psf, 1e3) == 0


def test_figures_and_lines() -> None:
    psf, scene = gaussian(), torch.zeros(1, 96, 96)
    scene[:, 20:70, 30:80] = torch.rand(1, 50, 50) + 1
    light = CroppedConvolution(psf, SENSOR, SUPPORT)(scene)
    deviation = 0.03 * float(light.mean())
    data = light + deviation * torch.randn(light.shape)
    solver = Reconstructor(psf, SUPPORT, tau=1e-5)
    problem = solver.problem(data)
    result = solver.solve(problem)

    def report(prediction: Prediction | None, pixel_rad: float | None) -> Report:
        return Report.of(
            problem, result, psf, prediction=prediction, method=Method.ADMM.value,
            automatic_tau=False, seconds=0.42, pixel_rad=pixel_rad,
            automatic_support=False,
        )  # fmt: skip

    fitted = report(None, None)
    assert fitted.noise == pytest.approx(0.03, rel=0.1)
    # All but the noise is explained.
    assert 0.7 < fitted.chi_square < 1.2
    assert not fitted.held_out and fitted.summary()["resolution_mrad"] is None
    text = dict(fitted.lines)
    assert list(text) == ["noise", "unexplained", "resolution", "support", "run"]
    assert "the pixels of the fit" in text["unexplained"]
    assert text["support"] == "96×96 pixels"
    assert text["run"].startswith("admm, ") and "τ 1e-05, 0.42 s on cpu" in text["run"]
    held_out = report(Prediction(0.35, 1.0, 0.1), 2e-3)
    assert "12 % of the local contrast of held-out pixels" in dict(held_out.lines)["unexplained"]
    assert "noise alone would be 1 % (χ² 12)" in dict(held_out.lines)["unexplained"]
    row = {"iteration": 4.0, "primal_residual": 1e-2, "dual_residual": 1e-2}
    for change, still in ((1e-4, True), (1e-2, False)):
        history = [{**row, "scene_change": change}]
        result = replace(result, stop_reason="iteration limit", history=history)
        run = dict(report(None, None).lines)["run"]
        assert "iteration limit" in run and ("hardly changes" in run) == still
    summary = held_out.summary()
    assert summary["resolution_mrad"] == pytest.approx(2 * summary["resolution_pixels"])
    assert "mrad" in dict(held_out.lines)["resolution"]
