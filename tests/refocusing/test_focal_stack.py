"""Focal stacks, and the one picture and the depths that they give."""

import math

import pytest
import torch
from torch import Tensor

from depth_spots import (
    FAR_UM,
    LEFT,
    NEAR_UM,
    RIGHT,
    SCENE,
    SUPPORT,
    measurement,
    noisy,
    objects,
    spots,
    two_objects,
)
from nolens.refocusing import (
    DepthReconstructor,
    FocalStack,
    all_in_focus,
    even_depths,
    focal_stack,
    per_m,
)

RECONSTRUCTOR = DepthReconstructor(
    measurement(noisy(two_objects(), 0.003)), SUPPORT, tau=0.011, iterations=80
)


@pytest.fixture(scope="module")
def stack() -> FocalStack:
    return focal_stack(RECONSTRUCTOR, spots, even_depths(14e3, 1e6, 9))


def error(picture: Tensor, truth: Tensor) -> float:
    return float((picture - truth).norm() / truth.norm())


def test_pages_are_reconstructions(stack: FocalStack) -> None:
    assert stack.pages.shape == (9, 1, *SCENE)
    alone = RECONSTRUCTOR.solve(spots(stack.depths_um[3])).scene
    assert torch.equal(stack.pages[3], alone)


def test_depths_of_both_objects(stack: FocalStack) -> None:
    found = all_in_focus(stack, 3.0)
    for depth, window in ((NEAR_UM, LEFT), (FAR_UM, RIGHT)):
        middle = found.per_m[window][4:-4, 4:-4]
        apart = per_m(NEAR_UM) - per_m(FAR_UM)
        assert float(middle.median()) == pytest.approx(per_m(depth), abs=0.2 * apart)
        assert float((middle - per_m(depth)).abs().quantile(0.9)) < 0.35 * apart


def test_sharp_everywhere(stack: FocalStack) -> None:
    """Better than any one page, in both objects at once."""
    truth = sum(objects(), torch.zeros(1, 1, 1))[0]
    found = all_in_focus(stack, 3.0).picture[0]
    both = torch.zeros(SCENE, dtype=torch.bool)
    both[LEFT] = both[RIGHT] = True
    own = error(found[both], truth[both])
    pages = [error(page[0][both], truth[both]) for page in stack.pages]
    assert own < 0.8 * min(pages)


def test_what_has_no_texture_is_not_sure() -> None:
    pages = torch.full((5, 1, 40, 60), 0.5)
    generator = torch.Generator().manual_seed(2)
    pages[2, 0, :, :20] += torch.rand(40, 20, generator=generator)
    found = all_in_focus(FocalStack(even_depths(2e4, math.inf, 5), pages, (1e-4,) * 5), 2.0)
    assert float(found.confidence[5:-5, 4:14].min()) > 0.5
    assert float(found.confidence[5:-5, 45:].max()) < 0.05
    assert torch.allclose(found.per_m[5:-5, 4:14], torch.tensor(25.0), atol=0.5)
    assert torch.allclose(found.picture[:, :, 4:14], pages[2][:, :, 4:14], atol=0.05)


def test_between_two_pages() -> None:
    """A peak between two depths is found between them, and the picture blended."""
    generator = torch.Generator().manual_seed(3)
    pattern = torch.rand(1, 40, 40, generator=generator)
    strength = [math.exp(-((n - 2.3) ** 2) / 2) for n in range(6)]
    # The energy of a gradient is the square of its strength.
    pages = torch.stack([pattern * math.sqrt(each) for each in strength])
    found = all_in_focus(FocalStack(even_depths(2e4, math.inf, 6), pages, (1e-4,) * 6), 2.0)
    assert torch.allclose(found.per_m, torch.tensor(50 - 10 * 2.3), atol=0.6)
    wanted = 0.7 * pages[2] + 0.3 * pages[3]
    assert torch.allclose(found.picture, wanted, atol=0.08)


def test_edges_that_come_of_what_is_not_explained_count_less() -> None:
    """A page of strong structure that explains the measurement badly is not the sharpest."""
    generator = torch.Generator().manual_seed(4)
    pages = torch.rand(3, 1, 40, 40, generator=generator)
    pages[2] *= 1.3
    found = all_in_focus(FocalStack(even_depths(2e4, math.inf, 3), pages, (1e-4, 5e-4, 1e-3)), 3.0)
    assert torch.allclose(found.per_m, torch.tensor(50.0), atol=1)


def test_ended_early_keeps_what_is_done() -> None:
    reconstructor = DepthReconstructor(
        measurement(two_objects()), SUPPORT, iterations=10, tolerance=0.0
    )
    depths = even_depths(14e3, 1e6, 5)
    ended = focal_stack(reconstructor, spots, depths, step=lambda done, limit: done >= 25)
    assert ended.depths_um == depths[:2] and len(ended.pages) == 2
    seen: list[tuple[int, int]] = []
    first = focal_stack(
        reconstructor,
        spots,
        depths,
        step=lambda done, limit: bool(seen.append((done, limit))) or True,
    )
    assert seen == [(4, 50)] and len(first.pages) == 1
    alone = all_in_focus(first, 3.0)
    assert torch.equal(alone.picture, first.pages[0])
    assert torch.allclose(alone.per_m, torch.tensor(per_m(14e3)))
