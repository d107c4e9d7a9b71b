"""PSFs of other distances: where the rays carry the pattern, and as the twin computes it."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from point_light import bench, rms, spots

from nolens.calibrate.distances import Layers, scaled_psf, with_mean_light
from nolens.errors import OptionError
from nolens.optics import PointSource, Stack
from nolens.quantities import Angle
from nolens.twin import REFERENCE_NM

CELLS = (150, 180)
AIR = Layers.of_air(1280.0)


@settings(max_examples=8)
@given(measured=st.floats(60, 900), wanted=st.floats(25, 900))
def test_spots_move_with_the_rays(measured: float, wanted: float) -> None:
    """Through air a ray goes straight: places and widths grow by (z + D) / z."""
    growth = [1 + 1.28 / each for each in (measured, wanted)]
    expected = spots(CELLS, growth[1]) / spots(CELLS, growth[1]).sum()
    source = spots(CELLS, growth[0])
    found = scaled_psf(
        source, 3.1, AIR, measured_um=measured * 1e3, target_um=wanted * 1e3
    )  # fmt: skip
    assert found.magnification == pytest.approx(growth[1] / growth[0], rel=1e-6)
    inner = (slice(None), slice(12, -12), slice(12, -12))
    got = found.psf / source.sum()
    assert rms((got - expected)[inner]) < 2e-3 * rms(expected[inner])
    shrinks = found.magnification < 1
    assert (found.unknown_fraction > 0) == shrinks
    lost = 1 - found.magnification**2 if shrinks else 0
    assert found.unknown_fraction == pytest.approx(lost, abs=0.035)


def test_infinity() -> None:
    far = scaled_psf(spots(CELLS, 1 + 1.28 / 300), 3.1, AIR, measured_um=3e5, target_um=math.inf)
    expected = spots(CELLS)
    inner = (slice(None), slice(12, -12), slice(12, -12))
    assert rms((far.psf - expected)[inner]) < 2e-3 * rms(expected[inner])
    assert AIR.magnification(math.inf) == 1


@settings(max_examples=20)
@given(mask=st.floats(0, 4000), distance=st.floats(1e4, 1e7), split=st.integers(0, 2))
def test_rays_are_snells(mask: float, distance: float, split: int) -> None:
    """Through the place on the mask and back; and layer by layer, thickness times tangent."""
    stack = ((1060.0, 490.0, 235.0), (1.47, 1.52, 1.0))
    layers = Layers(
        Stack(stack[0][:split], stack[1][:split]), Stack(stack[0][split:], stack[1][split:])
    )
    place = torch.tensor([mask], dtype=torch.float64)
    there = layers.on_sensor(place, distance)
    assert float(layers.on_mask(there, distance)) == pytest.approx(mask, abs=1e-6)
    low, high = 0.0, 1.0  # Sine of the angle in air, by bisection.

    def moved(sine: float, thicknesses: tuple[float, ...], indices: tuple[float, ...]) -> float:
        pairs = zip(thicknesses, indices, strict=True)
        return sum(t * math.tan(math.asin(sine / n)) for t, n in pairs)

    for _ in range(80):
        middle = (low + high) / 2
        front = moved(middle, (distance, *stack[0][:split]), (1.0, *stack[1][:split]))
        low, high = (middle, high) if front < mask else (low, middle)
    expected = mask + moved(low, stack[0][split:], stack[1][split:])
    assert float(there) == pytest.approx(expected, abs=1e-5)


def test_layers_of_a_camera() -> None:
    camera = bench("paper", (512, 640)).twin
    layers = Layers.of_camera(camera.camera)
    light = camera.illumination(PointSource(), REFERENCE_NM)
    assert layers.after == light.after and layers.before == light.before
    angle = Angle("20", "deg"), Angle("-5", "deg")
    tangents = [math.tan(each.rad) for each in angle]
    row, column = camera.shift_um(PointSource((-tangents[1], tangents[0])))
    assert layers.shift_um(angle) == pytest.approx((column, -row), rel=1e-9)
    assert layers.shift_um((Angle("0", "deg"), Angle("0", "deg"))) == (0, 0)


@pytest.mark.parametrize("distance_mm", [80.0, 200.0])
def test_scaled_is_what_the_twin_simulates(distance_mm: float) -> None:
    camera = bench("paper", (512, 640))
    near, far = (camera.psf(PointSource(distance_um=z * 1e3)) for z in (distance_mm, 300.0))
    layers = Layers.of_camera(camera.twin.camera)
    found = scaled_psf(
        far, camera.twin.pixel_um, layers, measured_um=3e5, target_um=distance_mm * 1e3
    ).psf
    assert correlation(found, near) > 0.9995
    assert correlation(far, near) < 0.997
    ratio = found.double().sum(dim=(-2, -1)) / near.double().sum(dim=(-2, -1))
    assert ratio.tolist() == pytest.approx([1, 1, 1], rel=0.01)


def correlation(one: torch.Tensor, other: torch.Tensor) -> float:
    a, b = (each.double() - each.double().mean() for each in (one, other))
    return float((a * b).sum() / (a.norm() * b.norm()))


def test_unknown_light_is_that_of_the_neighbourhood() -> None:
    psf = torch.ones(2, 60, 80) * torch.tensor([2.0, 5.0])[:, None, None]
    known = torch.ones(60, 80, dtype=torch.bool)
    known[:, 50:] = False
    broken = psf * known
    assert torch.allclose(with_mean_light(broken, known), psf, rtol=1e-5)
    known[:, 1:] = False  # Farther away than the neighbourhood reaches.
    assert torch.allclose(with_mean_light(psf * known, known), psf, rtol=1e-5)


def test_nothing_left() -> None:
    with pytest.raises(OptionError, match="nothing of the PSF"):
        scaled_psf(spots((16, 16)), 3.1, Layers.of_air(1e9), measured_um=1.0, target_um=math.inf)
