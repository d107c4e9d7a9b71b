"""The passes of ADMM: compiled against torch, both against the equations, and sums."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from update_cases import BASE, CASES, LATER, MU, Triple, arrays, draw, normal_equation, update

from nolens.kernels import (
    SplitState,
    admm_numba,
    admm_torch,
    fft2_,
    ifft2_,
    update_splits_,
)
from nolens.kernels.admm import solve_normal_equation_
from nolens.operators import Geometry, PixelRectangle
from reference import Reference


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_compiled_update_is_the_torch_update(case):
    (pair, state), (pair_2, state_2) = draw(case), draw(case)
    pair, sums = update(admm_numba, case, pair, state)
    pair_2, sums_2 = update(admm_torch, case, pair_2, state_2)
    torch.testing.assert_close(pair, pair_2, rtol=1e-5, atol=2e-5)
    for got, expected in zip(arrays(state), arrays(state_2), strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-5, atol=2e-5)
    assert len(sums) == len(sums_2) == 15
    np.testing.assert_allclose(sums, sums_2, rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
@pytest.mark.parametrize("module", [admm_numba, admm_torch], ids=["numba", "torch"])
def test_update_without_sums(module, case):
    (pair, state), (pair_2, state_2) = draw(case), draw(case)
    pair, _ = update(module, case, pair, state)
    pair_2, sums = update(module, case, pair_2, state_2, counted=False)
    assert sums is None
    for one, two in zip((pair, *arrays(state)), (pair_2, *arrays(state_2)), strict=True):
        torch.testing.assert_close(one, two, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("module", [admm_numba, admm_torch], ids=["numba", "torch"])
def test_data_under_the_mask_do_not_matter(module):
    case = replace(BASE, masked=0.5)
    (pair, state), (pair_2, state_2) = draw(case), draw(case)
    state_2.data = torch.where(state_2.valid.bool(), state_2.data, 1e6)
    pair, sums = update(module, case, pair, state)
    pair_2, sums_2 = update(module, case, pair_2, state_2)
    assert torch.equal(pair, pair_2)
    assert torch.equal(state.measured, state_2.measured)
    assert sums == sums_2


@pytest.mark.parametrize("isotropic", [False, True])
def test_update_does_not_depend_on_the_number_of_threads(isotropic):
    case = replace(BASE, size=(131, 70), isotropic=isotropic, sensor=(9, 7, 90, 50))
    results = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        pair, state = draw(case)
        pair, sums = update(admm_numba, case, pair, state)
        results.append((torch.view_as_real(pair), *arrays(state), torch.tensor(sums)))
    for one, two in zip(*results, strict=True):
        assert torch.equal(one, two)


@pytest.mark.parametrize("penalties", [MU, (1e-4, 3.0, 1e-2)])
@pytest.mark.parametrize("size", [(8, 10), (7, 9), (5, 8), (6, 5), (1, 6), (4, 1), (2, 2)])
@pytest.mark.parametrize("module", [admm_numba, admm_torch], ids=["numba", "torch"])
def test_normal_equation(module, size, penalties):
    spectrum, transfer, expected = normal_equation(size, penalties)
    mu = torch.tensor(penalties)
    for threads in (1, 2):
        torch.set_num_threads(threads)
        got = module.solve_normal_equation_(spectrum.clone(), transfer, mu).numpy()
        assert np.abs(got - expected).max() <= 1e-5 * np.abs(expected).max()


SCHEDULE: list[Triple] = [MU, MU, LATER, LATER, (0.05, 0.4, 3.0), MU, MU, MU]


@pytest.mark.parametrize("relaxation", [1.0, 1.7])
@pytest.mark.parametrize("support", [None, PixelRectangle(-1, 1, 5, 4)], ids=["whole", "region"])
@pytest.mark.parametrize("prior", ["tv", "isotropic-tv", "l1", "none"])
def test_iterations_and_sums_follow_the_equations(prior, support, relaxation):
    """Penalties that change, relaxation and every sum, against plain float64 ADMM."""
    rng = np.random.default_rng(8)
    sensor = (5, 4)
    geometry = Geometry.build(sensor, (5, 5), support)
    data, valid = rng.uniform(0, 1, sensor), rng.random(sensor) > 0.2
    reference = Reference(rng.random((5, 5)), data, valid, geometry, 0.02, prior)
    start = reference.support * 0.3
    tall, wide = reference.period

    def tensor(flat: np.ndarray, shape: tuple[int, ...]) -> torch.Tensor:
        return torch.from_numpy(flat.reshape(shape).astype(np.float32))

    gradient = tensor(reference.difference @ start, (2, tall, wide))
    empty = torch.empty(0, 0)
    state = SplitState(
        data=tensor(reference.b[reference.sensor], sensor),
        valid=torch.from_numpy(valid.astype(np.uint8)),
        sensor=geometry.sensor,
        support=geometry.scene,
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
        top, left, height, width = state.support
        inside = w[top : top + height, left : left + width]
        torch.testing.assert_close(state.estimate(later[2]), inside, rtol=1e-4, atol=2e-5)
        residual = reference.weight * (reference.b - reference.blur @ iterate.v)
        assert sums.residual == pytest.approx(residual @ residual, rel=1e-3, abs=1e-6)
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
