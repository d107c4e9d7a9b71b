"""A PSF from photographs behind a mask whose PSF is known."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from known_pairs import SENSOR, Taken, alike, caustic, photograph, take

from nolens.calibrate.known_scenes import KnownScenes, ManyScenes, over_the_field
from nolens.calibrate.psf_from_scenes import PsfSolver, _refined, psf_from_scenes, unexplained
from nolens.errors import DataError
from nolens.operators import CroppedConvolution, PixelRectangle


def test_comes_back_in_place_and_size() -> None:
    taken = take(4)
    found = psf_from_scenes(taken.known)
    assert float(found.psf.min()) >= 0
    assert alike(found.psf, taken.psf) > 0.97
    for axis in (0, 1):
        moved = [alike(found.psf.roll(by, axis), taken.psf) for by in (-1, 1)]
        assert max(moved) < alike(found.psf, taken.psf)
    assert float(found.psf.sum()) == pytest.approx(1, abs=0.04)
    assert torch.equal(found.psf > 0, (found.psf > 0) & found.support)
    assert float(found.residual.max()) < 0.15


def test_more_pairs_are_better_where_there_is_much_noise() -> None:
    """Of a PSF that fills the sensor's reach, of which a single picture says little."""
    quality = []
    for count in (1, 2, 5):
        taken = take(count, aperture=(90, 130), noise=1e-2)
        lit = taken.psf > 0
        quality.append(alike(psf_from_scenes(taken.known, support=lit, steps=12).psf, taken.psf))
    assert quality[0] + 0.1 < quality[1] < quality[2]


def test_light_beside_the_sensor_is_found() -> None:
    """A third of the PSF's light lies farther out than half the sensor, where no periodic model of
    the sensor's size has a cell for it."""
    size = (2 * SENSOR[0], 2 * SENSOR[1])
    psf = caustic(size, (100, 150), seed=3)
    camera = CroppedConvolution(psf[None], SENSOR, PixelRectangle(0, 0, *SENSOR))
    scenes = [photograph(number) for number in range(6)]
    known = KnownScenes.of(scenes, [camera(scene) for scene in scenes])
    support = psf > 0
    found = psf_from_scenes(known, support=support).psf
    outside = torch.ones(size, dtype=torch.bool)
    outside[SENSOR[0] // 2 : -SENSOR[0] // 2, SENSOR[1] // 2 : -SENSOR[1] // 2] = False
    assert float(psf[outside].sum()) > 0.3
    assert alike(found[outside], psf[outside]) > 0.8
    assert alike(found, psf) > 0.85


@settings(max_examples=4)
@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_units_do_not_matter(bright, shown):
    taken = take(2)
    lit = taken.psf > 0
    before = psf_from_scenes(taken.known, support=lit, steps=4).psf
    scaled = KnownScenes.of(
        list(taken.known.scenes[:, None] * shown), list(taken.known.measured[:, None] * bright)
    )
    after = psf_from_scenes(scaled, support=lit, steps=4).psf * shown / bright
    assert torch.allclose(after, before, atol=2e-3 * float(before.max()))


def test_every_exposure_has_its_own_gain() -> None:
    taken = take(3, gains=(0.5, 1.0, 1.5))
    found = psf_from_scenes(taken.known)
    assert found.gains.tolist() == pytest.approx([0.5, 1.0, 1.5], rel=0.01)
    assert alike(found.psf, taken.psf) > 0.97


def test_saturated_pixels_say_nothing() -> None:
    """A patch of nonsense that is marked as saturated is not fitted."""
    taken = take(3)
    measured, valid = taken.known.measured.clone(), torch.ones_like(taken.known.valid)
    measured[:, 20:30, 40:60] = 2 * float(measured.max())
    valid[:, 20:30, 40:60] = False
    pairs = [list(each[:, None]) for each in (taken.known.scenes, measured, valid)]
    assert alike(psf_from_scenes(KnownScenes.of(*pairs)).psf, taken.psf) > 0.9
    assert alike(psf_from_scenes(KnownScenes.of(*pairs[:2])).psf, taken.psf) < 0.8


def aslant() -> Taken:
    """A PSF that changes over the scene: other lines the farther from the middle."""
    scenes = torch.cat([photograph(number) for number in range(5)])
    known = KnownScenes.of(list(scenes[:, None]), list(scenes[:, None]))
    middle, edge = (caustic(known.extent, (40, 44), seed) for seed in (0, 5))
    bowl = over_the_field(known)[3]
    share = 0.6 * (bowl - bowl.min()) / (bowl.max() - bowl.min())
    model = ManyScenes(scenes, known.support, SENSOR, known.extent, torch.stack([1 - share, share]))
    measured = model(torch.stack([middle, edge]))
    mean = float((share * scenes.mean(dim=0)).sum() / scenes.mean(dim=0).sum())
    psf = (1 - mean) * middle + mean * edge
    return Taken(KnownScenes.of(list(scenes[:, None]), list(measured[:, None])), psf)


def test_the_mean_of_a_psf_that_changes() -> None:
    taken = aslant()
    found = psf_from_scenes(taken.known)
    assert alike(found.psf, taken.psf) > 0.95
    assert bool((found.residual_varying < 0.8 * found.residual).all())
    support = found.support.float()
    unchanging = PsfSolver(taken.known, None, support).solve(24)
    assert alike(found.psf, taken.psf) > alike(unchanging[0], taken.psf)


def test_what_another_pair_leaves() -> None:
    taken = take(4)
    one = KnownScenes.of([taken.known.scenes[:1]], [taken.known.measured[:1]])
    assert float(unexplained(one, taken.psf)) < 0.06
    assert float(unexplained(one, taken.psf.roll(3, 0))) > 0.3


def test_coarse_support_lies_over_the_psf() -> None:
    """Found on cells of 2×2, of a PSF beside the middle: what is outside has little light."""
    sensor = (131, 150)
    size = (sensor[0] + sensor[0], sensor[1] + sensor[1])
    psf = caustic(size, (60, 70)).roll((21, -30), (0, 1))
    camera = CroppedConvolution(psf[None], sensor, PixelRectangle(0, 0, *sensor))
    scenes = [photograph(number, sensor) for number in range(3)]
    known = KnownScenes.of(scenes, [camera(scene) for scene in scenes])
    support = psf_from_scenes(known, steps=1).support
    lit = psf > 0
    assert float(psf[support].sum()) > 0.85
    assert float((support & ~lit).sum()) < 0.15 * float(lit.sum())


@settings(max_examples=20)
@given(
    st.integers(1, 5), st.tuples(st.integers(-3, 3), st.integers(-4, 4)),
    st.tuples(st.integers(40, 50), st.integers(50, 60)),
)  # fmt: skip
def test_a_coarse_cell_lies_where_its_shift_is(by, shift, size):
    coarse = torch.zeros(9, 12)
    coarse[9 // 2 + shift[0], 12 // 2 + shift[1]] = 1
    fine = _refined(coarse, by, size)
    place = [
        float((fine.sum(1 - axis) * (torch.arange(size[axis]) - size[axis] // 2)).sum()) / by**2
        for axis in (0, 1)
    ]
    assert float(fine.sum()) == pytest.approx(by**2, rel=1e-5)
    assert place == pytest.approx([by * each for each in shift], abs=1e-3)


def test_another_picture_is_refused_or_seen() -> None:
    taken = take(4)
    scenes = list(taken.known.scenes[:, None])
    turned = KnownScenes.of([scenes[0].flip(-1), *scenes[1:]], list(taken.known.measured[:, None]))
    residual = psf_from_scenes(turned).residual
    assert float(residual[0]) > 1.5 * float(residual[1:].max())
    negative = KnownScenes.of(scenes, list(1 - taken.known.scenes[:, None]))
    try:
        assert float(psf_from_scenes(negative).residual.max()) > 0.5
    except DataError as error:
        assert "no PSF explains" in str(error)
