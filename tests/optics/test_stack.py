"""Snell's law and Fresnel's losses of plane layers, against their textbook forms."""

import math
from itertools import pairwise

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from optical_bench import PAPER, snell_um

from nolens.optics import Stack, transmittance

LAYERS = st.lists(st.tuples(st.floats(10, 2000), st.floats(1.0, 1.9)), min_size=1, max_size=4)
INDICES = st.floats(1.0, 2.5)


def _stack(layers: list[tuple[float, float]]) -> Stack:
    return Stack(tuple(t for t, _ in layers), tuple(n for _, n in layers))


def _float64(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@given(LAYERS, st.floats(0, 89))
def test_displacement_is_that_of_snells_angles(layers, angle_deg):
    stack = _stack(layers)
    got = float(stack.displacement_um(_float64(math.sin(math.radians(angle_deg)))))
    assert got == pytest.approx(snell_um(stack, angle_deg), rel=1e-9, abs=1e-9)


def test_chief_ray_of_the_paper():
    """0.224 mm at 10°, and 0.88 mm at 37.5°, to the last digit of the project's notes."""
    moved = PAPER.displacement_um(torch.sin(torch.deg2rad(_float64(10, 37.5))))
    assert float(moved[0]) == pytest.approx(224, abs=0.5)
    assert float(moved[1]) == pytest.approx(880, abs=5)
    assert PAPER.reduced_um == pytest.approx(1060 / 1.47 + 490 / 1.52 + 235)


@given(LAYERS, st.floats(0, 0.98))
def test_spread_is_the_derivative_of_displacement(layers, share):
    stack = _stack(layers)
    p = _float64(share * stack.critical).requires_grad_()
    (slope,) = torch.autograd.grad(stack.displacement_um(p).sum(), p)
    torch.testing.assert_close(stack.spread_um(p.detach()), slope, rtol=1e-9, atol=0)


@given(LAYERS, st.floats(0, 0.98))
def test_displacement_is_the_slope_of_the_axial_path(layers, share):
    """Of Φ(p) = Σ t √(n² − p²): where the phase is stationary, there the ray arrives."""
    stack = _stack(layers)
    p = _float64(share * stack.critical).requires_grad_()
    (slope,) = torch.autograd.grad(stack.axial_um(p.square()).sum(), p)
    torch.testing.assert_close(-slope, stack.displacement_um(p.detach()), rtol=1e-9, atol=1e-9)


@given(LAYERS, st.none() | st.floats(3, 8), st.floats(0, 4))
def test_ray_inverts_displacement(layers, decades, tangent):
    """Alone, and behind air as far as a source may be away."""
    stack = _stack(layers)
    if decades is not None:
        stack = Stack((10**decades,), (1.0,)).then(stack)
    wanted = _float64(tangent * stack.reduced_um)
    p = stack.ray(wanted)
    assert 0 <= float(p) < stack.critical
    error = (stack.displacement_um(p) - wanted).abs()
    assert float(error) < 1e-8 * (float(wanted) + stack.reduced_um)


@given(LAYERS, st.floats(0, 0.99))
def test_displacement_inverts_ray(layers, share):
    stack = _stack(layers)
    p = _float64(0.0, share * stack.critical)
    torch.testing.assert_close(stack.ray(stack.displacement_um(p)), p, rtol=1e-9, atol=1e-12)


def test_layers_add_up():
    first, second = Stack((300.0,), (1.59,)), Stack((490.0, 235.0), (1.52, 1.0))
    both, p = first.then(second), _float64(0.0, 0.3, 0.8)
    assert both == Stack((300.0, 490.0, 235.0), (1.59, 1.52, 1.0))
    assert both.critical == 1.0
    assert both.reduced_um == pytest.approx(first.reduced_um + second.reduced_um)
    torch.testing.assert_close(
        both.displacement_um(p), first.displacement_um(p) + second.displacement_um(p)
    )


@given(st.lists(INDICES, min_size=1, max_size=5))
def test_straight_ahead_each_surface_loses_the_square_of_the_contrast(indices):
    expected = math.prod(1 - ((b - a) / (b + a)) ** 2 for a, b in pairwise(indices))
    got = transmittance(tuple(indices), _float64(0.0))
    assert float(got) == pytest.approx(expected, rel=1e-12)


def _power_of_amplitudes(before: float, after: float, angle: float) -> tuple[float, float]:
    """Share that passes and share that returns, by amplitudes of both polarisations."""
    cosine = math.cos(angle)
    turned = math.cos(math.asin(before * math.sin(angle) / after))
    near, far = before * cosine, after * turned
    passed_s, returned_s = 2 * near / (near + far), (near - far) / (near + far)
    below = after * cosine + before * turned
    passed_p = 2 * near / below
    returned_p = (after * cosine - before * turned) / below
    passed = (passed_s**2 + passed_p**2) / 2 * far / near
    return passed, (returned_s**2 + returned_p**2) / 2


@given(INDICES, INDICES, st.floats(0, 1.5))
def test_what_does_not_return_passes(before, after, angle):
    """Against Fresnel's amplitudes of the light that passes; and energy is conserved."""
    if before * math.sin(angle) > 0.999 * after:
        angle = math.asin(0.999 * min(1.0, after / before))
    passed, returned = _power_of_amplitudes(before, after, angle)
    assert passed + returned == pytest.approx(1, rel=1e-9)
    squared = _float64((before * math.sin(angle)) ** 2)
    assert float(transmittance((before, after), squared)) == pytest.approx(passed, rel=1e-9)
    assert float(transmittance((after, before), squared)) == pytest.approx(passed, rel=1e-9)


@pytest.mark.parametrize(("before", "after"), [(1.0, 1.5), (1.47, 1.0), (1.0, 2.4)])
def test_brewsters_angle(before, after):
    """No light that is polarised along the plane returns; across it, (n₁²−n₂²)/(n₁²+n₂²)."""
    angle = math.atan(after / before)
    across = (before**2 - after**2) / (before**2 + after**2)
    got = transmittance((before, after), _float64((before * math.sin(angle)) ** 2))
    assert float(got) == pytest.approx(1 - across**2 / 2, rel=1e-12)


@given(INDICES, st.floats(0, 0.999))
def test_matched_media_lose_nothing(index, share):
    got = transmittance((index, index, index), _float64((share * index) ** 2))
    assert float(got) == pytest.approx(1, abs=1e-15)


def test_nothing_passes_at_grazing_incidence():
    got = transmittance((1.0, 1.5), _float64(1 - 1e-12, 1.0))
    assert float(got.max()) < 1e-5
