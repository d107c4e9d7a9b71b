"""The support that is chosen holds all light, and little else."""

import itertools
import math
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as nnf
from test_held_out import SENSOR, mask_psf, photograph
from torch import Tensor

from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Method, Reconstructor
from nolens.solvers.scene_edges import NO_EDGES, centred_edges, scene_edges
from nolens.solvers.scene_support import SupportChoice, choose_support

FRAME = PixelRectangle(0, 0, *SENSOR)
NOISE = 0.003


def picture(objects: dict[tuple[int, int], Tensor]) -> Tensor:
    """Objects on the sensor's frame, by the row and column of their corner."""
    scene = torch.zeros(1, *SENSOR)
    for (top, left), each in objects.items():
        scene[:, top : top + each.shape[-2], left : left + each.shape[-1]] = each
    return scene


def measured(psf: Tensor, scene: Tensor, noise: float = NOISE) -> Tensor:
    light = CroppedConvolution(psf, SENSOR, FRAME)(scene)
    light /= light.square().mean().sqrt()
    return light + noise * torch.randn(light.shape)


def noise() -> Tensor:
    return 0.075 * torch.randn(1, *SENSOR)


def holds(support: PixelRectangle, top: int, left: int, height: int, width: int) -> bool:
    return support.union(PixelRectangle(top, left, height, width)) == support


def chosen(psf: Tensor, data: Tensor) -> PixelRectangle | None:
    return Reconstructor(psf).choose_support(data).support


@pytest.mark.parametrize(("corner", "by"), [((64, 80), 1), ((20, 131), 2)])
def test_is_the_scene(corner: tuple[int, int], by: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """To the pixel, as its photograph on the measurement's own pixels shows where it ends."""
    fewer = math.prod(SENSOR) // by**2
    monkeypatch.setattr("nolens.solvers.reconstructor._SUPPORT_PIXELS", fewer)
    psf = mask_psf()
    support = chosen(psf, measured(psf, picture({corner: photograph()})))
    assert support == PixelRectangle(*corner, 64, 64)


def lines(*values: float) -> Tensor:
    """A scene of even rows, 40 of them and more, with 1 after those that are given."""
    rows = torch.tensor([*values, *[1.0] * 40])
    return rows[:, None].expand(-1, 50)[None].clone()


@pytest.mark.parametrize(
    ("rows", "top"),
    [
        ([0.01, 0.02, 0.04, 0.05], 4),
        # A line that is lit in part belongs to the scene; so does the first.
        ([0.01, 0.02, 0.14], 2),
        ([], None),
        # A support that is too small: the light rises slowly.
        ([0.02, 0.05, 0.18, 0.34, 0.52, 0.71, 0.79, 0.87], None),
        # A dim wall, and a dark sky that is wider than a margin.
        ([0.13] * 4, None),
        ([0.05] * 10, None),
    ],
)
def test_edges_of_a_photograph(rows: list[float], top: int | None) -> None:
    support = PixelRectangle(-3, 5, 40 + len(rows), 50)
    scene = lines(*rows)
    expected = None if top is None else support.top + top
    assert scene_edges(scene, support) == (expected, None, None, None)
    upside_down = scene_edges(scene.flip(1), support)
    assert upside_down[1] == (None if top is None else support.top + support.height - top)
    aside = scene_edges(scene.mT.flip(2), replace(support, height=50, width=support.height))
    assert aside[3] == (None if top is None else support.left + support.height - top)
    # A small object in the dark stays.
    scene[:, :1, 20:25] = 0.5
    assert scene_edges(scene, support)[0] is None


@pytest.mark.parametrize(
    ("rows", "top"),
    [
        # The last of the dark lines is no part of the scene on the measurement's own pixels, but
        # one that is lit in part is, and so is a small object in it.
        ([0.0, 0.01, 0.05], 3),
        ([0.0, 0.01, 0.2], 2),
        ([0.05], 1),
        # More than the margin is no edge that was missed by it, but the scene's own dark.
        ([0.05] * 4, 0),
    ],
)
def test_sides_at_exact_edges(rows: list[float], top: int) -> None:
    support = PixelRectangle(-3, 5, 40 + len(rows), 50)
    choice = SupportChoice(support).at_fine_edges(lines(*rows), 3)
    assert choice.support == replace(support, top=top - 3, height=support.height - top)
    scene = lines(*rows)
    scene[:, len(rows) - 1, 20:25] = 0.5
    choice = SupportChoice(support).at_fine_edges(scene, 3)
    assert choice.support is not None and choice.support.top <= len(rows) - 1 - 3


GLOW = [0.01, 0.03, 0.06, 0.1, 0.14, 0.2, 0.24, 0.28, 0.3, 0.31]
"""Of noise, beside a scene."""


@pytest.mark.parametrize(
    ("above", "below", "edges", "expected"),
    [
        # A side that is clear has the other opposite, as far as that is dim or a step.
        ([], GLOW[:6], (0, None), (0, 40)),
        (GLOW, [], (None, 40), (0, 40)),
        ([], [0.1, 0.2, 0.8, 0.9, 1.0], (0, None), (0, None)),
        # Two steps as far from the middle, and two that are not.
        (GLOW, GLOW, (None, None), (0, 40)),
        (GLOW, [*GLOW[:9], 0.4], (None, None), (0, 40)),
        ([0.2] * 10, [*[0.2] * 7, 1.0, 1.0, 1.0], (None, None), None),
        # Steps of a fifth, in glow that goes on on both sides of them.
        ([each + 0.5 for each in GLOW], [each + 0.45 for each in GLOW], (None, None), (0, 40)),
        # Light that rises slowly, as in a scene that is cut, is no step.
        (GLOW, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0], (None, None), None),
        # Nor is a line in a scene that goes on beyond it.
        ([1.0] * 8 + [0.5] * 2, [1.0] * 8 + [0.5] * 2, (None, None), None),
    ],
)
def test_edges_opposite(
    above: list[float],
    below: list[float],
    edges: tuple[int | None, int | None],
    expected: tuple[int | None, int | None] | None,
) -> None:
    """Of 40 lines from the frame's first to its last, in a support that is larger."""
    rows = torch.tensor([*above, *[1.0] * 40, *below[::-1]])
    scene = rows[:, None].expand(-1, 50)[None] / rows.mean()
    support = PixelRectangle(-len(above), 5, len(rows), 50)
    turned = replace(support, top=5, left=-len(above), height=50, width=len(rows))
    pairs = [] if expected is None else [expected]
    known, turned_known = (*edges, None, None), (None, None, *edges)
    afar = PixelRectangle(-90, -90, 200, 200)
    assert centred_edges(scene, support, known, (40, 60), afar) == (pairs, [])
    assert centred_edges(scene.mT, turned, turned_known, (60, 40), afar) == ([], pairs)
    # Where the PSF ends is a step, too.
    if known == NO_EDGES:
        ends = PixelRectangle(2, 2, 36, 36)
        assert centred_edges(scene, support, known, (40, 60), ends) == ([], [])


def test_edges_of_a_dim_sky() -> None:
    """A step along the whole line counts, be it small, and not a large one in a part of it."""
    sky = torch.full((1, 80, 100), 0.3)
    sky[:, 20:60] += 0.1
    sky[:, 30:50, 40:70] += 2
    support = PixelRectangle(-20, 0, 80, 100)
    afar = PixelRectangle(-90, -90, 220, 280)
    assert centred_edges(sky, support, NO_EDGES, (40, 100), afar)[0] == [(0, 40)]
    # Where glow hides half of the step, the other half is enough; less is a thing in the scene.
    for hidden, rows in ((50, [(0, 40)]), (65, [])):
        glow = torch.full((1, 80, 100), 0.3)
        glow[:, 20:60] += 0.4
        glow[:, :, :hidden] = 0.7
        assert centred_edges(glow, support, NO_EDGES, (40, 100), afar)[0] == rows


def test_is_found_in_much_noise() -> None:
    """Where no level of detail limits the scene surely better than no limit.

    No side is clear by itself: the glow of the noise lies beside it.
    """
    psf = mask_psf()
    support = chosen(psf, measured(psf, picture({(64, 80): photograph()}), noise=0.15))
    assert support is not None and holds(support, 64, 80, 64, 64)
    assert max(support.height, support.width) <= 70


def test_a_mask_that_repeats_itself_makes_no_ghosts() -> None:
    """Its PSF is about the same a period on, and what it is not exactly leaves a scene there."""
    period = 120
    psf = mask_psf()[..., :period].repeat(1, 1, 4)[..., : 2 * SENSOR[1]]
    inexact = psf * (1 + 0.3 * torch.rand_like(psf))
    support = chosen(psf, measured(inexact, picture({(64, 80): photograph()})))
    assert support is not None and holds(support, 64, 80, 64, 64)
    assert support.width < period


def of_quarters(psf: Tensor, corner: tuple[int, int], scene: Tensor, larger: list[float]) -> Tensor:
    """Light of a scene whose quarters have PSFs a little larger or smaller than one."""
    light, side = torch.zeros(1, *SENSOR), scene.shape[-1] // 2
    for (down, right), by in zip(itertools.product((0, side), repeat=2), larger, strict=True):
        quarter = scene[:, down : down + side, right : right + side]
        part = picture({(corner[0] + down, corner[1] + right): quarter})
        light += CroppedConvolution(magnified(psf, by), SENSOR, FRAME)(part)
    return light / light.square().mean().sqrt()


def test_does_not_grow_to_ghosts() -> None:
    """The PSF of each quarter of the scene is a little larger or smaller than that of the first."""
    period = 165
    psf = mask_psf()[..., :period].repeat(1, 1, 4)[..., : 2 * SENSOR[1]]
    scene = photograph()[:, :48, :48]
    light = of_quarters(psf, (64, 80), scene, [1.0, 0.994, 1.009, 1.003])
    support = chosen(psf, light + NOISE * torch.randn(light.shape))
    assert support is not None and holds(support, 64, 80, 48, 48)
    assert support.width < period


def magnified(psf: Tensor, by: float) -> Tensor:
    to = torch.tensor([[[1 / by, 0.0, 0.0], [0.0, 1 / by, 0.0]]])
    grid = nnf.affine_grid(to, [1, *psf.shape], align_corners=False)
    return nnf.grid_sample(psf[None], grid, align_corners=False)[0]


def test_an_even_sky_over_a_tower_stays() -> None:
    """It shows no detail: the rectangle goes as far on the other side of the frame's middle."""
    psf, tower = mask_psf(), photograph()
    tower[:, :20] = 0.01
    support = chosen(psf, measured(psf, picture({(64, 80): tower})))
    assert support is not None and holds(support, 64, 80, 64, 64)
    assert max(support.height, support.width) <= 70


@pytest.mark.parametrize("places", [[(2, 3)], [(2, 110), (184, 214)]])
def test_dim_objects_at_edges_and_corners_stay(places: list[tuple[int, int]]) -> None:
    psf = mask_psf()
    bright, dim = torch.ones(1, 6, 6), torch.full((1, 5, 5), 0.02)
    data = measured(psf, picture({(90, 100): bright, **dict.fromkeys(places, dim)}))
    support = chosen(psf, data)
    assert support is not None and holds(support, 90, 100, 6, 6)
    assert all(holds(support, *place, 5, 5) for place in places)
    if len(places) == 1:  # Fits without a limit take seconds.
        return

    def radiances(limit: PixelRectangle | None) -> list[float]:
        solver = Reconstructor(psf, limit, tau=1e-5)
        problem = solver.problem(data)
        scene, (top, left) = solver.solve(problem).scene, problem.forward.geometry.origin
        return [
            float(scene[:, row - top : row - top + 5, column - left : column - left + 5].sum())
            for row, column in places
        ]

    # They may be brighter than without a limit, where the glow around takes light from them.
    for limited, free in zip(radiances(support), radiances(None), strict=True):
        assert limited > 0.8 * free


def test_is_what_the_psf_is_of_where_nothing_else_tells() -> None:
    """More than half of the light is by another PSF, as where it changes over the field."""
    torch.manual_seed(1)
    psf, scene = mask_psf(), picture({(64, 80): photograph()})
    other = measured(psf.flip(-1), scene, 0)
    support = chosen(psf, 0.55 * other + 0.45 * measured(psf, scene, 0) + noise())
    assert support == PixelRectangle(63, 79, 65, 65)
    # All of it: then no scene of this PSF explains anything.
    assert chosen(psf, other + noise()) is None


def test_is_the_likeliest_part_of_that() -> None:
    """A PSF without fine lines, which changes over the field, in noise."""
    torch.manual_seed(2)
    smooth = torch.randn(1, 1, 256, 288)
    for _ in range(3):
        smooth = nnf.avg_pool2d(smooth, 9, 1, 4)
    psf = torch.exp(smooth / smooth.std())[0]
    light = of_quarters(psf, (80, 96), photograph()[:, ::2, ::2], [1.0, 0.99, 1.01, 1.005])
    support = chosen(psf, light + 0.05 * torch.randn(light.shape))
    assert support is not None and holds(support, 80, 96, 32, 32)
    assert max(support.height, support.width) < 60  # Of 65.


def test_is_half_of_the_way_to_the_likeliest_part_where_nearly_all_is_noise() -> None:
    """A night: a bright place, and next to nothing around it, which the data cannot exclude."""
    psf = mask_psf()
    scene = 0.003 * torch.ones(1, 64, 64)
    scene[:, 24:40, 16:48] = photograph()[:, 24:40, 16:48]
    light = measured(psf, picture({(64, 80): scene}), 0)
    support = chosen(psf, light + 3 * light.std() * torch.randn(light.shape))
    assert support is not None and holds(support, 88, 96, 16, 32)
    assert max(support.height, support.width) < 60  # Of 65.


def test_is_full_where_light_comes_from_everywhere() -> None:
    psf = mask_psf()
    scene = torch.rand(1, 17, 19).repeat_interleave(30, -1).repeat_interleave(30, -2)
    data = CroppedConvolution(psf, SENSOR)
    full = torch.zeros(1, *data.geometry.padded)
    height, width = full.shape[-2:]
    full[:] = scene[:, :height, :width]
    light = data(full)
    light /= light.square().mean().sqrt()
    assert chosen(psf, light + NOISE * torch.randn(light.shape)) is None


def test_noise_alone_has_no_support() -> None:
    psf = mask_psf()
    assert chosen(psf, 1 + 0.1 * torch.randn(1, *SENSOR)) is None


def test_is_found_on_coarse_pixels_in_all_channels() -> None:
    psf = mask_psf()
    scene = picture({(64, 80): photograph()})
    data = torch.cat([measured(psf, scene), 0.3 * measured(psf, scene)])
    choice = Reconstructor(psf).choose_support(data)
    assert choice.support is not None and holds(choice.support, 64, 80, 64, 64)
    assert choice.steps and holds(choice.steps[-1].support, 64, 80, 64, 64)
    # The Wiener filter, which is quick, asks the brightest channel, and all where that has none.
    even = 1 + 0.1 * torch.randn(1, *SENSOR)
    for measurement in (data, torch.cat([even, 0.8 * data[:1], 0.8 * data[:1]])):
        quick = Reconstructor(psf, method=Method.WIENER).choose_support(measurement).support
        assert quick is not None and holds(quick, 64, 80, 64, 64)


def test_is_the_acceptance_where_no_smaller_one_shows() -> None:
    """Dim objects at its edge stay; light beyond shows that it is not the camera's."""
    psf = mask_psf()
    solver = Reconstructor(psf)
    data = measured(psf, picture({(8, 8): nnf.interpolate(photograph()[None], (176, 208))[0]}))
    whole = solver.choose_support(data, acceptance=FRAME)
    assert whole.support == FRAME and whole.is_acceptance
    assert solver.accept(data, FRAME) == SupportChoice(FRAME, acceptance=FRAME)
    assert solver.accept(data, PixelRectangle.centred(100, 120, SENSOR)).support is None
    dim = 0.2 * photograph()[:, :12, :12]
    small = measured(psf, picture({(64, 80): photograph(), (70, 0): dim}))
    choice = solver.choose_support(small, acceptance=FRAME)
    assert choice.acceptance == FRAME and not choice.is_acceptance
    assert choice.support is not None and choice.support.union(FRAME) == FRAME
    assert holds(choice.support, 64, 80, 64, 64) and holds(choice.support, 70, 0, 12, 12)
    assert solver.accept(small, replace(FRAME, left=20)).support is None


def test_a_caller_can_stop_it() -> None:
    psf = mask_psf()
    data = measured(psf, picture({(64, 80): photograph()}))
    valid = torch.ones_like(data, dtype=torch.bool)
    stopped = choose_support(psf, data, valid, lambda _: None, lambda _: True)
    assert stopped.interrupted and stopped.support is None
