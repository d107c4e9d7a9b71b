"""PSFs between those that are known, against spots that are known at every distance."""

import math

import pytest
import torch
from torch import Tensor

from depth_spots import REDUCED_UM, SENSOR, spots
from nolens.errors import DataError
from nolens.refocusing import PsfAt, PsfBetween, measured_reduced_um


def inner(psf: Tensor) -> Tensor:
    """What can reach the sensor from the middle of the scene."""
    rows, columns = psf.shape[-2:]
    top, left = rows // 2 - SENSOR[0] // 2, columns // 2 - SENSOR[1] // 2
    return psf[..., top : top + SENSOR[0], left : left + SENSOR[1]]


def error(got: Tensor, wanted: Tensor) -> float:
    return float((inner(got) - inner(wanted)).norm() / inner(wanted).norm())


@pytest.mark.parametrize("distances_mm", [(20, 80), (20, 40, 400), (25, math.inf), (50,)])
@pytest.mark.parametrize("depth_mm", [20, 31, 60, 300])
def test_any_depth(distances_mm: tuple[float, ...], depth_mm: float) -> None:
    known = [PsfAt(spots(z * 1e3), z * 1e3) for z in distances_mm]
    between = PsfBetween.of(known, REDUCED_UM)
    assert error(between.at(depth_mm * 1e3), spots(depth_mm * 1e3)) < 0.02
    off = PsfBetween.of(known, 1.4 * REDUCED_UM)
    nearest = min(abs(1e3 / depth_mm - 1e3 / z) for z in distances_mm)
    if nearest > 10:
        assert error(off.at(depth_mm * 1e3), spots(depth_mm * 1e3)) > 0.05


def test_known_ones_are_kept() -> None:
    known = [PsfAt(spots(z), z) for z in (20e3, 50e3)]
    between = PsfBetween.of(known, REDUCED_UM)
    assert error(between.at(50e3), known[1].psf) < 1e-6
    assert error(between.at(20e3), known[0].psf) < 5e-3


def test_brought_to_one_place_and_brightness() -> None:
    """A source that stood aside, or was brighter, does not move or dim what lies between."""
    known = [PsfAt(3.0 * spots(20e3, moved=(2.3, -1.6)), 20e3), PsfAt(spots(80e3), 80e3)]
    between = PsfBetween.of(known, REDUCED_UM)
    assert between.moved[1] == pytest.approx((2.3, -1.6), abs=0.05)
    assert between.brightness[1] == pytest.approx(3.0, rel=0.02)
    assert between.alike[0] > 0.99
    for depth in (20e3, 32e3, 79e3):
        assert error(between.at(depth), spots(depth)) < 0.03


@pytest.mark.parametrize("reduced_um", [600.0, 1277.0, 4000.0, 9000.0])
def test_measured_distance(reduced_um: float) -> None:
    pairs = [(20e3, 100e3), (30e3, math.inf)]
    for near, far in pairs:
        known = [PsfAt(spots(z, reduced_um=reduced_um), z) for z in (near, far)]
        assert measured_reduced_um(known) == pytest.approx(reduced_um, rel=0.02)


def test_measured_distance_in_noise() -> None:
    generator = torch.Generator().manual_seed(5)
    known = []
    for z in (20e3, 100e3):
        psf = spots(z, moved=(1.4, 0.7))
        noise = 0.03 * torch.randn(psf.shape, generator=generator)
        known.append(PsfAt((psf + noise).clamp_min(0), z))
    assert measured_reduced_um(known) == pytest.approx(REDUCED_UM, rel=0.05)


def test_too_alike_to_tell() -> None:
    assert measured_reduced_um([PsfAt(spots(5e5), 5e5)]) is None
    alike = [PsfAt(spots(z), z) for z in (900e3, 1000e3)]
    assert measured_reduced_um(alike) is None


def test_other_patterns_are_not_alike() -> None:
    between = PsfBetween.of(
        [PsfAt(spots(20e3), 20e3), PsfAt(spots(80e3, seed=9), 80e3)], REDUCED_UM
    )
    assert between.alike[0] < 0.6


def test_noise_is_no_psf_of_a_camera():
    """Two frames of noise fit best at a size that no distance of mask and sensor makes."""
    draw = torch.Generator().manual_seed(2)
    noise = [PsfAt(torch.rand(1, 60, 80, generator=draw) ** 4, at) for at in (15e3, 60e3, 15e3)]
    with pytest.raises(DataError, match="more than the PSF of any camera"):
        measured_reduced_um([noise[0], noise[1]])
