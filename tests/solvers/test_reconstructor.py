"""A reconstructor solves as its parts do; a development knows how fine its pixels need be."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from nolens.camera import FieldPsf, Frame, Measurement, develop
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import (
    STOPS,
    Development,
    Method,
    Problem,
    Quality,
    Reconstructor,
    admm,
    fista,
    stop_of,
    wiener,
)

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
    Method.FISTA: lambda problem: fista(problem, iterations=300, tolerance=1e-4),
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
