"""Triton's passes against torch's: on CUDA, or as Triton interprets them on the CPU.

Collected by `test_triton.py` alone: whether Triton interprets is settled when it is imported.
"""

import os

import numpy as np
import pytest
import torch
from update_cases import CASES, MU, arrays, draw, normal_equation, update

from nolens.kernels import admm_torch, admm_triton
from nolens.kernels.admm import step_constants

DEVICE = "cpu" if os.environ.get("TRITON_INTERPRET") == "1" else "cuda"

# In lanes past the last cell, which numpy computes and nobody reads.
pytestmark = pytest.mark.filterwarnings(
    "ignore:(overflow|invalid value) encountered:RuntimeWarning"
)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_update(case):
    (pair, state), (pair_2, state_2) = draw(case, DEVICE), draw(case, DEVICE)
    pair, sums = update(admm_triton, case, pair, state)
    pair_2, sums_2 = update(admm_torch, case, pair_2, state_2)
    torch.testing.assert_close(pair, pair_2, rtol=1e-5, atol=2e-5)
    for got, expected in zip(arrays(state), arrays(state_2), strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-5, atol=2e-5)
    assert len(sums) == len(sums_2) == 15
    np.testing.assert_allclose(sums, sums_2, rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_update_without_sums(case):
    (pair, state), (pair_2, state_2) = draw(case, DEVICE), draw(case, DEVICE)
    pair, _ = update(admm_triton, case, pair, state)
    pair_2, sums = update(admm_triton, case, pair_2, state_2, counted=False)
    assert sums is None
    for one, two in zip((pair, *arrays(state)), (pair_2, *arrays(state_2)), strict=True):
        torch.testing.assert_close(one, two, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", ["even", "isotropic", "no prior"])
def test_update_into_another_pair(name):
    case = CASES[name]
    (pair, state), (expected, state_2) = draw(case, DEVICE), draw(case, DEVICE)
    before, out = pair.clone(), torch.full_like(pair, torch.nan)
    constants = torch.tensor(step_constants(state, MU, case.later, case.relaxation), device=DEVICE)
    admm_triton.update_splits_(pair, state, constants, counted=False, out=out)
    expected, _ = update(admm_triton, case, expected, state_2, counted=False)
    assert torch.equal(pair, before)
    assert torch.equal(out, expected)


def test_data_under_the_mask_do_not_matter():
    case = CASES["even"]
    (pair, state), (pair_2, state_2) = draw(case, DEVICE), draw(case, DEVICE)
    state_2.data = torch.where(state_2.valid.bool(), state_2.data, torch.nan)
    pair, sums = update(admm_triton, case, pair, state)
    pair_2, sums_2 = update(admm_triton, case, pair_2, state_2)
    assert torch.equal(pair, pair_2)
    assert sums == sums_2


@pytest.mark.parametrize("penalties", [MU, (1e-4, 3.0, 1e-2), (0.3, 0.0, 0.7)])
@pytest.mark.parametrize(
    "size", [(8, 10), (7, 9), (5, 8), (6, 5), (1, 6), (4, 1), (1, 1), (2, 2), (40, 31), (31, 40)]
)
def test_normal_equation(size, penalties):
    spectrum, transfer, expected = normal_equation(size, penalties)
    mu = torch.tensor(penalties, device=DEVICE)
    got = admm_triton.solve_normal_equation_(spectrum.to(DEVICE), transfer.to(DEVICE), mu)
    assert np.abs(got.cpu().numpy() - expected).max() <= 1e-5 * np.abs(expected).max()
