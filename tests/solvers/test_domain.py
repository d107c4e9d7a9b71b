"""The short period of a region gives the picture of the large domain with the same support."""

from dataclasses import replace

import numpy as np
import pytest
from posed import Case, pose

from nolens.operators import Geometry, Region
from nolens.solvers import admm
from reference import Reference

CASES = {
    "within the sensor": Case(region=Region(1, 2, 4, 4), saturated=0.1),
    "beyond the sensor": Case(sensor=(7, 5), psf=(7, 5), region=Region(-2, 1, 5, 6)),
    "wide psf": Case(sensor=(5, 6), psf=(9, 8), region=Region(-1, -1, 4, 5)),
}


@pytest.mark.parametrize("prior", ["tv", "isotropic-tv"])
@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_solution_is_that_of_the_large_domain(case: Case, prior: str) -> None:
    posed = pose(replace(case, prior=prior))
    region, short = case.region, posed.problem.forward.geometry
    assert region is not None
    whole = Geometry.build(case.sensor, case.psf, None)
    assert np.prod(short.padded) < np.prod(whole.padded)
    top, left = whole.sensor[:2]
    scene = (top + region.top, left + region.left, region.height, region.width)
    large = replace(whole, scene=scene, origin=(region.top, region.left))
    reference = Reference(
        posed.psf[0], posed.data[0], posed.valid[0], large, case.tau, prior
    )  # fmt: skip
    expected = reference.scene(reference.minimum())
    result = admm(
        posed.problem, iterations=3000, tolerance=1e-7, penalties=(0.5, 0.5, 0.5), balance=None
    )
    got = (result.scene / posed.problem.scale)[0].double().numpy()
    assert np.linalg.norm(got - expected) <= 1e-4 * np.linalg.norm(expected)
