"""The passes of ADMM: compiled against torch, both against the equations, and sums."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from nolens.kernels import (
    SplitState,
    admm_numba,
    admm_torch,
    fft2_,
    ifft2_,
    solve_numba,
    update_splits_,
)
from nolens.kernels.admm import solve_normal_equation_
from nolens.operators import Geometry, Region
from reference import Reference

Triple = tuple[float, float, float]
Window = tuple[int, int, int, int]
MU: Triple = (0.3, 2.0, 0.7)
LATER: Triple = (0.5, 1.5, 0.9)


@dataclass(frozen=True)
class Case:
    size: tuple[int, int] = (12, 10)
    sensor: Window = (3, 2, 6, 5)
    region: Window = (0, 0, 12, 10)
    tv: float = 0.4
    isotropic: bool = False
    l1: float = 0.0
    masked: float = 0.2
    later: Triple = MU
    relaxation: float = 1.0


BASE = Case()
CASES = {
    "even": BASE,
    "odd": replace(BASE, size=(9, 7), sensor=(2, 1, 5, 5), region=(0, 0, 9, 7)),
    "more rows than blocks": replace(
        BASE, size=(75, 6), sensor=(31, 0, 33, 4), region=(0, 0, 75, 6)
    ),
    "as many rows as blocks": replace(
        BASE, size=(32, 5), sensor=(0, 0, 32, 5), region=(0, 0, 32, 5)
    ),
    "one row": replace(BASE, size=(1, 8), sensor=(0, 2, 1, 3), region=(0, 1, 1, 6)),
    "two rows": replace(BASE, size=(2, 3), sensor=(0, 0, 1, 2), region=(0, 0, 2, 3)),
    "region": replace(BASE, region=(4, 3, 5, 6)),
    "region beside the sensor": replace(BASE, sensor=(0, 0, 6, 5), region=(7, 6, 5, 4)),
    "sensor at the far corner": replace(BASE, sensor=(6, 5, 6, 5), region=(0, 0, 3, 4)),
    "all valid": replace(BASE, masked=0.0),
    "none valid": replace(BASE, masked=1.0),
    "isotropic": replace(BASE, isotropic=True, region=(4, 3, 5, 6)),
    "isotropic, odd": replace(BASE, isotropic=True, size=(35, 7), region=(0, 0, 35, 7)),
    "l1": replace(BASE, tv=0.0, l1=0.3),
    "no prior": replace(BASE, tv=0.0),
    "relaxed": replace(BASE, relaxation=1.8),
    "under-relaxed": replace(BASE, relaxation=0.6, isotropic=True),
    "still": replace(BASE, relaxation=0.0),
    "penalties change": replace(BASE, later=LATER),
    "penalties change, isotropic": replace(BASE, later=LATER, isotropic=True, relaxation=1.5),
    "penalties change, l1": replace(BASE, later=LATER, tv=0.0, l1=0.3, relaxation=1.5),
}


def _draw(case: Case) -> tuple[torch.Tensor, SplitState]:
    generator = torch.Generator().manual_seed(11)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=generator)

    of_tv = case.size if case.tv > 0 else (0, 0)
    valid = torch.rand(case.sensor[2:], generator=generator) >= case.masked
    state = SplitState(
        data=normal(*case.sensor[2:]),
        valid=valid.to(torch.uint8),
        sensor=case.sensor,
        region=case.region,
        tv=case.tv,
        isotropic=case.isotropic,
        l1=case.l1,
        measured=normal(*case.size),
        rows=normal(*of_tv),
        columns=normal(*of_tv),
        scene=normal(*case.size),
    )
    return torch.complex(normal(*case.size), normal(*case.size)), state


def _arrays(state: SplitState) -> tuple[torch.Tensor, ...]:
    return (state.measured, state.rows, state.columns, state.scene)


def _run(module, case: Case) -> tuple[torch.Tensor, SplitState, list[float]]:  # type: ignore[no-untyped-def]
    pair, state = _draw(case)
    pair, sums = module.update_splits_(
        pair,
        (state.data, state.valid),
        _arrays(state),
        (state.sensor, state.region),
        (state.tv, state.isotropic, state.l1),
        (MU, case.later, case.relaxation),
    )
    return pair, state, sums


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_compiled_update_is_the_torch_update(case):
    pair, state, sums = _run(admm_numba, case)
    pair_2, state_2, sums_2 = _run(admm_torch, case)
    torch.testing.assert_close(pair, pair_2, rtol=1e-5, atol=2e-5)
    for name in ("measured", "rows", "columns", "scene"):
        torch.testing.assert_close(
            getattr(state, name), getattr(state_2, name), rtol=1e-5, atol=2e-5, msg=name
        )
    assert len(sums) == len(sums_2) == 15
    np.testing.assert_allclose(sums, sums_2, rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("module", [admm_numba, admm_torch], ids=["numba", "torch"])
def test_data_under_the_mask_do_not_matter(module, monkeypatch):
    case = replace(BASE, masked=0.5)
    pair, state, sums = _run(module, case)
    draw = _draw

    def draw_other(case: Case) -> tuple[torch.Tensor, SplitState]:
        other, changed = draw(case)
        changed.data = torch.where(changed.valid.bool(), changed.data, 1e6)
        return other, changed

    monkeypatch.setitem(globals(), "_draw", draw_other)
    pair_2, state_2, sums_2 = _run(module, case)
    assert torch.equal(pair, pair_2)
    assert torch.equal(state.measured, state_2.measured)
    assert sums == sums_2


@pytest.mark.parametrize("isotropic", [False, True])
def test_update_does_not_depend_on_the_number_of_threads(set_threads, isotropic):
    case = replace(BASE, size=(131, 70), isotropic=isotropic, sensor=(9, 7, 90, 50))
    results = []
    for threads in (1, 2):
        set_threads(threads)
        pair, state, sums = _run(admm_numba, case)
        results.append((torch.view_as_real(pair), *_arrays(state), torch.tensor(sums)))
    for one, two in zip(*results, strict=True):
        assert torch.equal(one, two)


@pytest.mark.parametrize("penalties", [MU, (1e-4, 3.0, 1e-2)])
@pytest.mark.parametrize("size", [(8, 10), (7, 9), (5, 8), (6, 5), (1, 6), (4, 1), (2, 2)])
@pytest.mark.parametrize("module", [solve_numba, admm_torch], ids=["numba", "torch"])
def test_normal_equation(module, size, penalties, set_threads):
    """(μ₁MᵀM + μ₂ΨᵀΨ + μ₃) v = μ₁Mᵀq + r at every frequency, against numpy."""
    rng = np.random.default_rng(2)
    kernel, q, r = rng.normal(size=(3, *size))
    h = np.fft.fft2(kernel)
    rows = 2 - 2 * np.cos(2 * np.pi * np.arange(size[0]) / size[0])
    columns = 2 - 2 * np.cos(2 * np.pi * np.arange(size[1]) / size[1])
    mu_x, mu_u, mu_w = penalties
    normal = mu_x * np.abs(h) ** 2 + mu_u * (rows[:, None] + columns) + mu_w
    v = (mu_x * h.conj() * np.fft.fft2(q) + np.fft.fft2(r)) / normal
    expected = v + 1j * h * v
    spectrum = torch.from_numpy(np.fft.fft2(q + 1j * r).astype(np.complex64))
    transfer = torch.from_numpy(np.fft.rfft2(kernel).astype(np.complex64))
    for threads in (1, 2):
        set_threads(threads)
        got = module.solve_normal_equation_(spectrum.clone(), transfer, penalties).numpy()
        assert np.abs(got - expected).max() <= 1e-5 * np.abs(expected).max()


SCHEDULE: list[Triple] = [MU, MU, LATER, LATER, (0.05, 0.4, 3.0), MU, MU, MU]


@pytest.mark.parametrize("relaxation", [1.0, 1.7])
@pytest.mark.parametrize("region", [None, Region(-1, 1, 5, 4)], ids=["whole", "region"])
@pytest.mark.parametrize("prior", ["tv", "isotropic-tv", "l1", "none"])
def test_iterations_and_sums_follow_the_equations(prior, region, relaxation):
    """Penalties that change, relaxation and every sum, against plain float64 ADMM."""
    rng = np.random.default_rng(8)
    sensor = (5, 4)
    geometry = Geometry.lay_out(sensor, (5, 5), region)
    data, valid = rng.uniform(0, 1, sensor), rng.random(sensor) > 0.2
    reference = Reference(rng.random((5, 5)), data, valid, geometry, 0.02, prior)
    start = reference.region * 0.3
    tall, wide = reference.period

    def tensor(flat: np.ndarray, shape: tuple[int, ...]) -> torch.Tensor:
        return torch.from_numpy(flat.reshape(shape).astype(np.float32))

    gradient = tensor(reference.difference @ start, (2, tall, wide))
    empty = torch.empty(0, 0)
    state = SplitState(
        data=tensor(reference.b[reference.sensor], sensor),
        valid=torch.from_numpy(valid.astype(np.uint8)),
        sensor=geometry.sensor,
        region=geometry.scene,
        tv=0.02 if reference.has_tv else 0.0,
        isotropic=prior == "isotropic-tv",
        l1=0.02 if prior == "l1" else 0.0,
        measured=tensor(reference.blur @ start, (tall, wide)),
        rows=gradient[0].clone() if reference.has_tv else empty,
        columns=gradient[1].clone() if reference.has_tv else empty,
        scene=tensor(start, (tall, wide)),
    )
    transfer = torch.from_numpy(
        np.fft.rfft2(reference.blur[:, 0].reshape(tall, wide)).astype(np.complex64)
    )
    # A split that is absent has no penalty.
    schedule = [mu if reference.has_tv else (mu[0], 0.0, mu[2]) for mu in SCHEDULE]
    still = torch.zeros(tall, wide, dtype=torch.complex64)
    pair, _ = update_splits_(still, state, schedule[0], schedule[0], 0.0)
    run = reference.admm(SCHEDULE[:-1], start, relaxation)
    for mu, later, iterate in zip(schedule, schedule[1:], run, strict=False):
        pair = ifft2_(solve_normal_equation_(fft2_(pair), transfer, mu))
        torch.testing.assert_close(pair.real, tensor(iterate.v, (tall, wide)), rtol=1e-4, atol=2e-5)
        pair, sums = update_splits_(pair, state, mu, later, relaxation)
        w = tensor(iterate.splits[2], (tall, wide))
        torch.testing.assert_close(state.estimate(later[2]), w, rtol=1e-4, atol=2e-5)
        misfit = reference.weight * (reference.b - reference.blur @ iterate.v)
        assert sums.misfit == pytest.approx(misfit @ misfit, rel=1e-3, abs=1e-6)
        if reference.has_tv:
            assert sums.variation == pytest.approx(reference.regulariser(iterate.v), rel=1e-4)
        assert sums.magnitude == pytest.approx(np.abs(iterate.v).sum(), rel=1e-4)
        for k in range(3):
            kv, x, before = iterate.fields[k], iterate.splits[k], iterate.splits_before[k]
            d, d_before = (
                y[k] / max(mu[k], 1e-9) for y in (iterate.multipliers, iterate.multipliers_before)
            )
            for got, part in (
                (sums.primal, kv - x),
                (sums.split, x),
                (sums.change, x - before),
                (sums.multiplier_change, d - d_before),
            ):
                assert got[k] == pytest.approx(part @ part, rel=1e-3, abs=1e-6)
