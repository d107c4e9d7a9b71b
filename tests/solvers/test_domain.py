"""The short period of a support gives the picture of the large domain with the same support."""

from dataclasses import replace

import numpy as np
import pytest
from posed import Case, pose

from nolens.operators import Geometry, PixelRectangle
from nolens.solvers import admm
from reference import Reference

CASES = {
    "within the sensor": Case(support=PixelRectangle(1, 2, 4, 4), saturated=0.1),
    "beyond the sensor": Case(sensor=(7, 5), psf=(7, 5), support=PixelRectangle(-2, 1, 5, 6)),
    "wide psf": Case(sensor=(5, 6), psf=(9, 8), support=PixelRectangle(-1, -1, 4, 5)),
}


@pytest.mark.parametrize("prior", ["tv", "isotropic-tv"])
@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_solution_is_that_of_the_large_domain(case: Case, prior: str) -> None:
    posed = pose(replace(case, prior=prior))
    support, short = case.support, posed.problem.forward.geometry
    assert support is not None
    whole = Geometry.build(case.sensor, case.psf, None)
    assert np.prod(short.padded) < np.prod(whole.padded)
    top, left = whole.sensor[:2]
    scene = (top + support.top, left + support.left, support.height, support.width)
    large = replace(whole, scene=scene, origin=(support.top, support.left))
    reference = Reference(
        posed.psf[0], posed.data[0], posed.valid[0], large, case.tau, prior
    )  # fmt: skip
    expected = reference.scene(reference.minimum())
    result = admm(
        posed.problem, iterations=1500, tolerance=1e-7, penalties=(0.5, 0.5, 0.5), balance=None
    )
    got = (result.scene / posed.problem.scale)[0].double().numpy()
    assert np.linalg.norm(got - expected) <= 1e-4 * np.linalg.norm(expected)
