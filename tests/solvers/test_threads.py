"""Results do not depend on how many threads compute them, but for rounding.

Of a product of complex numbers torch computes most in vectors and the rest of each thread's part
one by one, which rounds differently in the last bit: a thread more moves that rest. Twenty
iterations in float32 make up to 2e-6 of it.
"""

from itertools import product

import pytest
import torch
from posed import Case, pose

from nolens.operators import PixelRectangle
from nolens.solvers import admm, fista

CASES = {
    "a view": Case(sensor=(67, 90), psf=(67, 90), channels=3, view=True, saturated=0.02),
    "a region": Case(
        sensor=(80, 61), psf=(80, 61), support=PixelRectangle(20, 10, 40, 45), channels=2
    ),
}


# Sparse light does not fill a view.
RUNS = [
    each
    for each in product(CASES, ("tv", "isotropic-tv", "l1"), (False, True))
    if each != ("a view", "l1", True)
]


@pytest.mark.parametrize(("name", "prior", "low_frequency"), RUNS)
def test_one_and_two_threads(name, prior, low_frequency):
    case = CASES[name]
    problem = pose(Case(**{**vars(case), "prior": prior})).problem
    pictures = []
    # The scene is zero at first where sparse light meets the measurement in the linear step.
    iterations = 80 if prior == "l1" and low_frequency else 20
    for threads in (1, 2):
        torch.set_num_threads(threads)
        result = admm(problem, iterations=iterations, tolerance=0.0, low_frequency=low_frequency)
        pictures.append(result.scene)
    one, two = pictures
    assert one.any()
    # Lengths of conjugate gradients are sums over all pixels, and their rounding counts.
    most = 3e-4 if low_frequency else 1e-5
    assert float(torch.linalg.vector_norm(one - two)) <= most * float(torch.linalg.vector_norm(one))


@pytest.mark.parametrize("prior", ["tv", "l1"])
def test_fista_on_one_and_two_threads(prior):
    problem = pose(Case(**{**vars(CASES["a view"]), "prior": prior})).problem
    pictures = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        pictures.append(fista(problem, iterations=20, tolerance=0.0).scene)
    one, two = pictures
    assert float(torch.linalg.vector_norm(one - two)) <= 1e-5 * float(torch.linalg.vector_norm(one))
