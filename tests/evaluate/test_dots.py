"""Dots in pictures that are known, and how they are judged."""

import math

import pytest
import torch
from torch import Tensor

from nolens.evaluate import Dot, angles_of, brightest_places, grade, spots_at

SIZE = 120


def picture(places: list[tuple[float, float]], sigma: float, power: float = 100.0) -> Tensor:
    """Gaussian dots of one power on a level of 5."""
    at = torch.arange(SIZE, dtype=torch.float64)
    found = torch.full((SIZE, SIZE), 5.0, dtype=torch.float64)
    for row, column in places:
        squared = (at[:, None] - row) ** 2 + (at - column) ** 2
        found += power / (2 * math.pi * sigma**2) * torch.exp(-squared / (2 * sigma**2))
    return found


def grid(spacing: float, shift: tuple[float, float] = (0.0, 0.0)) -> list[tuple[float, float]]:
    most = int(45 / spacing)
    return [
        (60 + shift[0] + i * spacing, 60 + shift[1] + j * spacing)
        for i in range(-most, most + 1)
        for j in range(-most, most + 1)
    ]


@pytest.mark.parametrize("sigma", [1.0, 1.5, 2.5])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.4)])
def test_place_width_and_light(sigma: float, shift: tuple[float, float]) -> None:
    """A Gaussian is brighter than half its height in a circle of 2√(2 ln 2) σ."""
    spacing = 20.0
    places = grid(spacing, shift)
    found = spots_at(picture(places, sigma), places, [spacing] * len(places))
    for place, spot in zip(places, found, strict=True):
        assert spot is not None
        assert math.dist(spot.place, place) < 0.05
        assert spot.width == pytest.approx(2 * math.sqrt(2 * math.log(2)) * sigma, rel=0.04)
        assert spot.light == pytest.approx(100, rel=0.02)
        assert spot.peak == pytest.approx(100 / (2 * math.pi * sigma**2), rel=0.05)


def test_dots_beside_their_places_are_found_where_they_are() -> None:
    meant = grid(20.0)
    there = [(row + 3.0, column - 2.0) for row, column in meant]
    for place, spot in zip(there, spots_at(picture(there, 1.5), meant, [20.0] * 25), strict=True):
        assert spot is not None and math.dist(spot.place, place) < 0.05


def test_missing_dots_and_places_outside_are_not_found() -> None:
    places = grid(20.0)
    noisy = picture(places[::2], 1.5) + 0.3 * torch.randn(
        SIZE, SIZE, generator=torch.manual_seed(2)
    )
    found = spots_at(noisy, [*places, (130.0, 60.0)], [20.0] * 26)
    assert [spot is not None for spot in found] == [n % 2 == 0 for n in range(25)] + [False]
    assert spots_at(torch.full((SIZE, SIZE), 5.0), places, [20.0] * 25) == [None] * 25


def test_a_dot_fainter_than_the_clutter_is_not_found() -> None:
    """Five times the scatter (Rose)."""
    places = grid(20.0)
    for height, seen in ((20.0, True), (2.0, False)):
        noise = torch.randn(SIZE, SIZE, generator=torch.manual_seed(3)).double()
        faint = picture(places, 1.5, height * 2 * math.pi * 1.5**2) + noise
        found = [spot is not None for spot in spots_at(faint, places, [20.0] * 25)]
        assert (sum(found) == 25) if seen else (sum(found) < 5)


def test_brightest_places() -> None:
    places = grid(15.0, (0.2, 0.4))
    found = brightest_places(picture(places, 1.2))
    assert len(found) == len(places)
    for place, at in zip(sorted(places), sorted(found), strict=True):
        assert math.dist(place, at) < 0.25
    assert brightest_places(torch.zeros(20, 20)) == []


@pytest.mark.parametrize(
    ("figures", "expected"),
    [
        ((1.0, 0.0, 1.0), "good"),
        ((1.4, 0.49, 0.51), "good"),
        ((1.42, 0.0, 1.0), "distorted"),
        ((1.0, 0.51, 1.0), "distorted"),
        ((1.0, 0.0, 0.49), "distorted"),
        ((1.0, 0.0, 0.09), "lost"),
        ((3.0, 2.0, 0.11), "distorted"),
    ],
)
def test_grades(figures: tuple[float, float, float], expected: str) -> None:
    width, error, light = figures
    assert grade(width=width, error=error, light=light) == expected


def test_grades_with_other_limits() -> None:
    assert grade(width=1.5, error=0, light=1, widest=2) == "good"
    assert grade(width=1, error=0.2, light=1, farthest=0.1) == "distorted"
    assert grade(width=1, error=0, light=0.7, least_light=0.8) == "distorted"
    assert grade(width=1, error=0, light=0.7, faint_light=0.8) == "lost"


def dots(*grades: tuple[float, str]) -> list[Dot]:
    return [
        Dot(angle, (0, 0), None, None, None, None, None, None, 1.0, kind)  # type: ignore[arg-type]
        for angle, kind in grades
    ]


def test_angles_part_the_grades() -> None:
    found = angles_of(
        dots((0, "good"), (10, "good"), (20, "distorted"), (30, "distorted"), (40, "lost"))[::-1]
    )
    assert (found.good_deg, found.distorted_deg, found.lost_deg) == (10, 30, 40)


def test_angles_bear_with_single_dots() -> None:
    """One bad dot among many good ones near the middle, and one good one far out."""
    near = [(float(n), "good") for n in range(10)] + [(4.5, "distorted")]
    far = [(20.0 + n, "lost") for n in range(10)] + [(24.5, "good")]
    found = angles_of(dots(*near, *far))
    assert (found.good_deg, found.distorted_deg, found.lost_deg) == (9, 9, 20)


def test_angles_of_a_whole_ring() -> None:
    """Dots of one angle stand on one side together."""
    ring = [(15.0, "good"), (15.0, "lost"), (15.0, "good")]
    found = angles_of(dots((5, "good"), *ring, (30, "lost")))
    assert (found.good_deg, found.lost_deg) == (15, 30)


def test_angles_without_an_end() -> None:
    found = angles_of(dots((0, "good"), (10, "good")))
    assert (found.good_deg, found.distorted_deg, found.lost_deg) == (10, 10, None)
    found = angles_of(dots((0, "lost"), (10, "lost")))
    assert (found.good_deg, found.distorted_deg, found.lost_deg) == (None, None, 0)
