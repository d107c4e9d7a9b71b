"""A course of training: it learns, ends where it gets no better, and goes on where it stood."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from lessons import noise_lessons, trainer
from torch import Tensor

from nolens.errors import DivergenceError
from nolens.files import read_state, write_state
from nolens.solvers.denoising_network import DenoisingNetwork, noise_planes
from nolens.training.course import Course
from nolens.training.denoising import NoiseLessons
from nolens.training.pictures import training_picture
from nolens.training.validation import ALL, HeldOut, noisy_pictures

Make = Callable[..., Course]


@pytest.fixture(scope="module")
def lessons() -> NoiseLessons:
    return noise_lessons()


@pytest.fixture(scope="module")
def held_out() -> HeldOut:
    """Four of the pictures, each with three strengths of noise."""
    whole = noisy_pictures()
    return replace(whole, items={"generated": whole.items["generated"][:12]})


@pytest.fixture
def course(lessons: NoiseLessons, held_out: HeldOut) -> Callable[..., Course]:
    def made(steps: int, seed: int = 0, patience: int = 1000, rate: float = 1e-2) -> Course:
        return Course(trainer(steps, seed, rate), lessons, held_out, patience)

    return made


def run(made: Course, until: int = 10**9) -> dict[str, Tensor]:
    while not made.ended and made.trainer.step < until:
        made.advance()
    return made.best.state_dict()


def same(one: dict[str, Tensor], other: dict[str, Tensor]) -> bool:
    return all(torch.equal(one[name], other[name]) for name in one)


def test_it_learns_to_take_noise_out(course: Make, held_out: HeldOut) -> None:
    """Of pictures that it never saw: a fifth of strong noise, where doing nothing leaves all."""
    made = course(315)
    run(made)
    clean = torch.stack([training_picture(64, 64, seed) for seed in (10**6, 10**6 + 1)])
    noise = 0.3 * torch.randn(clean.shape, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        left = made.best(clean + noise, noise_planes(torch.full((2, 3), 0.3))) - clean
    assert float(left.square().mean().sqrt()) < 0.8 * 0.3
    assert made.scores[ALL] > held_out.scores_before()[ALL] + 1.2
    assert made.scores[ALL] > made.scores_start[ALL]
    assert [row["step"] for row in made.history] == [*range(40, 315, 40), 315]
    assert made.history[-1]["loss"] < 0.9 * made.history[0]["loss"]


def test_seed_decides_the_weights(course: Make) -> None:
    courses = [course(3, seed) for seed in (1, 1, 2)]
    for each in courses:
        run(each)
    one, again, other = (each.trainer.arrays() for each in courses)
    assert same(one, again) and not same(one, other)


def test_restored_course_is_the_same(course: Make, tmp_path: Path) -> None:
    """From its file, in the midst of what the losses are summed over."""
    whole = course(20)
    run(whole)
    half = course(20)
    run(half, until=8)
    assert half.trainer.step == 8  # Two steps after a check.
    write_state(tmp_path / "state.npz", half.arrays(), half.figures())
    figures: list[dict[str, object]] = []
    rest = course(20)
    arrays = read_state(
        tmp_path / "state.npz", rest.like_arrays(), lambda about: figures.append(dict(about))
    )
    rest.restore(arrays, figures[0])
    run(rest)
    assert same(rest.trainer.arrays(), whole.trainer.arrays())
    assert same(rest.best.state_dict(), whole.best.state_dict())
    assert rest.history == whole.history and rest.scores == whole.scores
    # One of before, whose best network is worse than the one that the course starts from.
    first = course(20)
    start, worse = first.best.state_dict(), {ALL: first.scores[ALL] - 1}
    first.restore(arrays, {**figures[0], "scores": worse})
    assert same(first.best.state_dict(), start) and first.scores == first.scores_start


@pytest.mark.parametrize(("start", "steps", "best"), [(19.0, 4, 2), (21.0, 2, 0)])
def test_it_ends_where_it_gets_no_better(
    start: float, steps: int, best: int, lessons: NoiseLessons
) -> None:
    """The weights that are kept are those with the best score, be they those at the start."""
    scores, seen = [start, 20.0, 21.0, 20.5, 20.7, 30.0], list[dict[str, Tensor]]()

    def score(network: DenoisingNetwork, item: object) -> float:
        seen.append(network.state_dict())
        return scores[len(seen) - 1]

    made = Course(trainer(8), lessons, HeldOut({"generated": [0]}, score, lambda _: 10.0), 2)
    kept = run(made)
    assert made.got_no_better and made.trainer.step == steps
    assert same(kept, seen[best]) and not same(kept, seen[steps])
    assert made.best_step == best
    assert made.scores == {ALL: 21.0, "generated": 21.0}
    assert made.scores_start == {ALL: start, "generated": start}


def test_a_course_that_diverges_is_refused(course: Make, lessons: NoiseLessons) -> None:
    """By its check, and before, where a checkpoint would have lost weights."""
    with pytest.raises(DivergenceError, match=r"by step 1: give a smaller --rate than 1e\+09"):
        run(course(3, rate=1e9))
    between = course(100, rate=1e9)
    run(between, until=3)
    with pytest.raises(DivergenceError, match=r"by step 3: .* smaller --rate"):
        between.figures()
    lost = HeldOut({"generated": [0]}, lambda *_: math.nan, lambda _: 10.0)
    with pytest.raises(DivergenceError, match=r"start from give NaN .*--start"):
        Course(trainer(3), lessons, lost, 2)
