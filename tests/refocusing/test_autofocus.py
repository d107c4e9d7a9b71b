"""The sharpest depth of scenes whose depth is known."""

import math

import pytest
import torch

from depth_spots import (
    CELL_UM,
    FAR_UM,
    LEFT,
    NEAR_UM,
    REDUCED_UM,
    RIGHT,
    SENSOR,
    SUPPORT,
    light,
    measurement,
    noisy,
    objects,
    spots,
    two_objects,
)
from nolens.refocusing import (
    Autofocus,
    DepthReconstructor,
    depth_of_focus_per_m,
    line_pixels,
    per_m,
    sharpness,
)

FOCUS = depth_of_focus_per_m(
    line_pixels(spots(1e6)) * CELL_UM, REDUCED_UM, max(SENSOR) / 2 * CELL_UM
)
PLACES = {NEAR_UM: (14.0, 11.0), FAR_UM: (14.0, 36.0)}


def search(values: torch.Tensor, near: float = 12e3, far: float = 1e6, **more: object) -> Autofocus:
    asked = {"tau": 0.011, "iterations": 40, **more}
    reconstructor = DepthReconstructor(measurement(values), SUPPORT, **asked)  # type: ignore[arg-type]
    return Autofocus(reconstructor, spots, near, far, FOCUS)


@pytest.mark.parametrize("depth_um", [15e3, 200e3])
def test_one_depth(depth_um: float) -> None:
    left, right = objects()
    found = search(noisy(light({depth_um: left + right}), 0.003)).run()
    assert per_m(found.depth_um) == pytest.approx(per_m(depth_um), abs=0.2 * FOCUS)
    assert found.finished and not found.at_end


def test_two_objects_are_found_where_they_are() -> None:
    """Each within the depth of focus, and each sharper in its own plane."""
    sought = search(noisy(two_objects(), 0.003))
    assert per_m(NEAR_UM) - per_m(FAR_UM) > 2 * FOCUS
    for depth, place in PLACES.items():
        found = sought.run(place)
        assert per_m(found.depth_um) == pytest.approx(per_m(depth), abs=0.4 * FOCUS)
    pictures = {z: sought.reconstructor.solve(spots(z)).scene for z in PLACES}
    for own, other, window in ((NEAR_UM, FAR_UM, LEFT), (FAR_UM, NEAR_UM, RIGHT)):
        sharp = {z: float(sharpness(pictures[z], 3.0)[window].mean()) for z in PLACES}
        assert sharp[own] > 1.5 * sharp[other]
        truth = sum(objects(), torch.zeros(1, 1, 1))[0][window]
        shown = {z: pictures[z][0][window] for z in PLACES}
        errors = {z: float((shown[z] - truth).norm() / truth.norm()) for z in PLACES}
        assert errors[own] < 0.6 * errors[other]


def test_false_edges_do_not_mislead() -> None:
    """With hardly any prior, depths that explain little show more edges than the right one."""
    found = search(noisy(two_objects(), 0.003), tau=1.1e-4, iterations=60).run(PLACES[NEAR_UM])
    assert per_m(found.depth_um) == pytest.approx(per_m(NEAR_UM), abs=0.5 * FOCUS)
    most = max(found.tried, key=lambda each: each.sharpness)
    assert per_m(most.depth_um) - per_m(NEAR_UM) > FOCUS


def test_a_brighter_object_elsewhere_does_not_mislead() -> None:
    """At the near object's depth more than twice as much is unexplained as at the other's."""
    left, right = objects()
    found = search(noisy(light({NEAR_UM: left, FAR_UM: 2 * right}), 0.001)).run(PLACES[NEAR_UM])
    assert per_m(found.depth_um) == pytest.approx(per_m(NEAR_UM), abs=0.5 * FOCUS)
    least = min(each.objective for each in found.tried)
    own = next(each for each in found.tried if each.depth_um == found.depth_um)
    assert own.objective > 2 * least


def test_noise_does_not_mislead_the_whole_picture() -> None:
    left, right = objects()
    found = search(noisy(light({33e3: left + right}), 0.04)).run()
    assert per_m(found.depth_um) == pytest.approx(per_m(33e3), abs=FOCUS)


def test_the_end_is_told() -> None:
    left, right = objects()
    values = light({15e3: left + right})
    found = search(values, 40e3, math.inf).run()
    assert found.at_end and found.depth_um == pytest.approx(40e3, rel=0.05)


def test_steps_are_counted_and_can_end_it() -> None:
    left, right = objects()
    sought = search(light({33e3: left + right}), iterations=20)
    seen: list[tuple[int, int]] = []

    def count(done: int, limit: int) -> bool:
        seen.append((done, limit))
        return False

    found = sought.run(step=count)
    assert len({limit for _, limit in seen}) == 1
    assert [done for done, _ in seen] == list(range(4, len(found.tried) * 20 + 1, 4))
    assert seen[-1][0] <= seen[-1][1] <= seen[-1][0] + 2 * 20
    early = sought.run(step=lambda done, _: done >= 50)
    assert not early.finished and len(early.tried) == 2
    assert sought.run(step=lambda done, _: True).tried[0].depth_um == pytest.approx(1e6)


def test_coarser_cells_cover_the_same() -> None:
    reconstructor = DepthReconstructor(measurement(two_objects()), SUPPORT)
    coarse = reconstructor.coarser(2, 30)
    assert coarse.support is not None and coarse.sensor == (30, 40) and coarse.iterations == 30
    top, left = coarse.support.top * 2, coarse.support.left * 2
    assert top <= SUPPORT.top and left <= SUPPORT.left
    assert top + 2 * coarse.support.height >= SUPPORT.top + SUPPORT.height
    assert left + 2 * coarse.support.width >= SUPPORT.left + SUPPORT.width
    unlimited = DepthReconstructor(measurement(two_objects()), None)
    psf = spots(NEAR_UM)
    assert unlimited.solve(psf).photograph.shape[-2:] == SENSOR


def test_sharpness_is_the_gradients_energy() -> None:
    """Of a wave of amplitude a and frequency f: a² (2 sin πf)² / 2 in every window."""
    rows = torch.arange(200.0)
    wave = (2.0 * torch.sin(2 * math.pi * 0.05 * rows))[:, None].expand(200, 200)[None]
    wanted = 4.0 * (2 * math.sin(math.pi * 0.05)) ** 2 / 2
    assert float(sharpness(wave, 12.0)[100, 100]) == pytest.approx(wanted, rel=1e-3)
