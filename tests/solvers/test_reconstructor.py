"""A reconstructor solves as its parts do; a development knows how fine its pixels need be."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from nolens.camera import FieldPsf, Frame, Measurement, develop
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import (
    STOPS,
    AdmmState,
    Development,
    Method,
    Problem,
    Progress,
    Quality,
    Reconstructor,
    Result,
    admm,
    fista,
    stop_of,
    wiener,
)
from nolens.solvers.wiener_weight import likely_scene

SENSOR = (48, 56)
SUPPORT = PixelRectangle.centred(24, 24, SENSOR)


def spots(rows: int, columns: int, blur: int = 0) -> torch.Tensor:
    psf = (torch.rand(1, rows, columns) > 0.98).float()
    for _ in range(4 if blur else 0):  # Nearly a Gaussian.
        psf = torch.nn.functional.avg_pool2d(psf[None], 2 * blur + 1, 1, blur)[0]
    return psf


def measured(psf: torch.Tensor) -> torch.Tensor:
    return CroppedConvolution(psf, SENSOR, SUPPORT)(torch.rand(1, 24, 24)) + 0.01


def test_slow_light_counts_but_where_one_psf_explains_a_full_view() -> None:
    psf = spots(70, 80)
    full, dark = measured(psf), torch.zeros(1, *SENSOR)
    dark[:, 20, 30] = 1

    def counts(data: torch.Tensor, **options: Any) -> bool:
        return Reconstructor(psf, SUPPORT, 1e-4, **options).problem(data).slow_light

    assert not counts(full)
    assert not counts(full, prior="denoiser", stop=stop_of(Method.ADMM, low_frequency=False))
    assert counts(dark)
    assert counts(full, method=Method.WIENER)
    assert counts(full, method=Method.FISTA, stop=stop_of(Method.ADMM))
    assert counts(full, stop=stop_of(Method.ADMM, low_frequency=False))
    there = FieldPsf(psf[None].repeat(2, 1, 1, 1), torch.tensor([[0.0, -9.0], [0.0, 9.0]]))
    assert counts(full, field_psf=there)


SOLVED = {
    Method.ADMM: lambda problem: admm(
        problem, iterations=200, tolerance=0, scene_tolerance=1e-2, low_frequency=True
    ),
    Method.FISTA: lambda problem: fista(
        problem, iterations=300, tolerance=2e-5, start=likely_scene(problem)
    ),
    Method.WIENER: wiener,
}


@pytest.mark.parametrize("method", Method)
def test_solves_as_its_parts_do(method: Method) -> None:
    psf = spots(70, 80)
    data = measured(psf)
    weight = 0.1 if method is Method.WIENER else 1e-4
    solver = Reconstructor(psf, SUPPORT, weight, method=method)
    built = solver.problem(data)
    assert built.weight == pytest.approx(weight)
    problem = Problem.build(psf, data, support=SUPPORT, tau=built.tau)
    problem = replace(problem, slow_light=built.slow_light)
    result = solver.solve(data)
    assert torch.equal(result.scene, SOLVED[method](problem).scene)
    # A measurement brings its mask, and a problem may be given in its place.
    seen = Measurement(data, torch.ones_like(data, dtype=torch.bool), ("grey",), None, "here")
    assert torch.equal(solver.solve(seen).scene, result.scene)
    assert torch.equal(solver.solve(solver.problem(seen)).scene, result.scene)


def test_fista_starts_from_the_scene_of_least_squares() -> None:
    """From a dark one it does not come as far in ten times the iterations."""
    psf = spots(70, 80, blur=1)
    data = measured(psf) + 1e-3 * torch.randn(1, *SENSOR)
    stop = stop_of(Method.FISTA, iterations=20, tolerance=0.0)
    solver = Reconstructor(psf, SUPPORT, 1e-5, method=Method.FISTA, stop=stop)
    problem = solver.problem(data)
    dark = fista(problem, iterations=200, tolerance=0.0)
    assert solver.solve(problem).objective < dark.objective


def test_saturated_pixels_stay_out() -> None:
    psf = spots(48, 56)
    data = measured(psf)
    valid = data < data.quantile(0.9)
    spoilt = torch.where(valid, data, 100 * data)
    solver = Reconstructor(psf, SUPPORT)
    assert torch.equal(solver.solve(spoilt, valid).scene, solver.solve(data, valid).scene)


def test_stream_starts_as_a_photo() -> None:
    psf = spots(70, 80)
    data = measured(psf)
    solver = Reconstructor(psf, SUPPORT)
    frame = solver.stream(data).solve(data)
    plain = replace(solver, stop=stop_of(Method.ADMM, low_frequency=False))
    torch.testing.assert_close(frame.photograph, plain.solve(data).photograph)


def test_when_it_stops() -> None:
    assert stop_of(Method.ADMM) == STOPS[Quality.PHOTO]
    assert stop_of(Method.ADMM, Quality.EXACT) == STOPS[Quality.EXACT]
    given = stop_of(Method.ADMM, Quality.EXACT, iterations=7, tolerance=0.1, low_frequency=False)
    assert given == replace(
        STOPS[Quality.EXACT], iterations=7, tolerance=0.1, scene_tolerance=0.0, low_frequency=False
    )
    psf = spots(48, 56)
    assert Reconstructor(psf).for_iterations(5).solve(measured(psf)).iterations == 5


def frame(values: torch.Tensor) -> Frame:
    return Frame(values, ("grey",), None, (0.0,), None, "float32", "here", black_stated=True)


def test_pixels_no_finer_than_the_psf_carries() -> None:
    """A PSF that is blurred over many pixels; a sharp one keeps every pixel."""
    wide = Development(frame(spots(160, 160, blur=8)))
    seen = frame(torch.rand(1, 160, 160))
    coarse = wide.fitted(seen, 4, coarsen=True)
    side = coarse.development.bin_by
    assert side > 1 and f"{side}×{side}" in coarse.notes[0]
    assert coarse.measurement.size == (160 // side, 160 // side)
    assert torch.equal(coarse.measurement.values, develop(seen, bin_by=side).values)
    fine = wide.fitted(seen, 4, coarsen=False)
    assert fine.development is wide and "--bin" in fine.notes[0]
    sharp = Development(frame(spots(160, 160))).fitted(seen, 4, coarsen=True)
    assert sharp.development.bin_by == 1 and sharp.notes == ()


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> tuple[Reconstructor, Problem]:
    """A scene that fills the view, of as many pixels as photos start coarse from."""
    rows, columns = torch.meshgrid(torch.arange(48.0), torch.arange(60.0), indexing="ij")
    scene = 1 + 0.5 * torch.sin(rows / 5) * torch.cos(columns / 7) + ((columns - 30).abs() < 9)
    sensor, support = (96, 112), PixelRectangle.centred(48, 60, (96, 112))
    psf = spots(143, 171, blur=1)
    data = CroppedConvolution(psf, sensor, support)(scene[None])
    solver = Reconstructor(psf, support, 1e-3)
    problem = solver.problem(data + 1e-3 * data.mean() * torch.randn_like(data))
    monkeypatch.setattr("nolens.solvers.reconstructor._PHOTO_FROM", problem.padded_pixels)
    return solver, problem


def test_a_large_photo_starts_from_larger_pixels(
    large: tuple[Reconstructor, Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With few steps on its own pixels it comes near the minimum, which larger ones do not."""
    solver, problem = large
    exact = replace(solver, stop=STOPS[Quality.EXACT]).solve(problem)
    runs: list[tuple[int, Result]] = []

    def run(pixels: Problem, **options: Any) -> Result:
        runs.append((pixels.padded_pixels, admm(pixels, **options)))
        return runs[-1][1]

    monkeypatch.setattr("nolens.solvers.reconstructor.admm", run)
    photo = solver.solve(problem)
    (larger, first), (own, last) = runs
    assert larger < own / 3 and own == problem.padded_pixels
    assert photo.stop_reason == "converged" and photo.iterations == last.iterations
    assert 0 < last.iterations - first.iterations <= 8
    assert photo.history == [*first.history, *last.history]
    steps = [row["iteration"] for row in photo.history]
    assert steps == sorted(set(steps))
    doubled = first.scene[:, 1:-1, 1:-1].repeat_interleave(2, 1).repeat_interleave(2, 2) / 4
    before, after = (
        float((each - exact.scene).norm() / exact.scene.norm()) for each in (doubled, photo.scene)
    )
    assert after < 0.05 < before and photo.objective < 1.05 * exact.objective


def test_light_from_everywhere_is_solved_on_larger_pixels(
    large: tuple[Reconstructor, Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Down to the largest, smaller than a photo of one's own starts there, where it goes on for
    long; one check on its own pixels is all.
    """
    solver, problem = large
    solver = replace(solver, support=None)
    problem = solver.problem(problem.data * problem.scale * problem.psf_norm)
    smaller = problem.padded_pixels / 4
    monkeypatch.setattr("nolens.solvers.reconstructor._PHOTO_FROM", problem.padded_pixels)
    monkeypatch.setattr("nolens.solvers.reconstructor._LARGER_FROM", 0.9 * smaller)
    monkeypatch.setattr("nolens.solvers.coarse._TOLERATED", smaller)
    runs: list[tuple[int, dict[str, Any]]] = []

    def run(pixels: Problem, **options: Any) -> Result:
        runs.append((pixels.padded_pixels, options))
        return admm(pixels, **options)

    monkeypatch.setattr("nolens.solvers.reconstructor.admm", run)
    limits = list[int]()
    photo = solver.solve(problem, callback=lambda progress: limits.append(progress.end(4)))
    (largest, first), (between, second), (own, last) = runs
    assert 3 < between / largest < 5 and 3 < own / between < 5 and own == problem.padded_pixels
    assert first["scene_tolerance"] < second["scene_tolerance"] < last["scene_tolerance"]
    iterations = [row["iteration"] for row in photo.history]
    assert photo.stop_reason == "converged" and iterations[-1] - iterations[-2] == 4
    assert all(limit >= row for limit, row in zip(limits, iterations, strict=True))
    assert problem.objective(photo.scene / problem.scale) < problem.objective(0 * photo.scene) / 9
    runs.clear()
    dots = replace(solver, psf=spots(143, 171))  # On 4×4 pixels nothing is left of their detail.
    dots.solve(problem.data * problem.scale * problem.psf_norm)
    assert [pixels for pixels, _ in runs] == [between, own]


def test_a_large_photo_can_be_stopped_on_larger_pixels(
    large: tuple[Reconstructor, Problem],
) -> None:
    """The picture so far is on its own pixels, and a state saved then is that of a cold start."""
    solver, problem = large
    state, shapes = AdmmState.cold(problem), []

    def stop(progress: Progress) -> bool:
        shapes.append(progress.scene().shape)
        return True

    result = solver.solve(problem, state=state, callback=stop)
    assert result.stop_reason == "callback" and state.iteration == 0
    assert shapes == [problem.scene_shape] == [tuple(result.photograph.shape)]
    assert torch.equal(solver.solve(problem, state=state).scene, solver.solve(problem).scene)
