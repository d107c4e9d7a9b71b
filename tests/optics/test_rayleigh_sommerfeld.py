"""Propagation against Rayleigh and Sommerfeld's integral, summed directly by torchoptics."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
import torch
import torchoptics
from optical_bench import WAVELENGTH_UM, places_um, relative_error
from torch import Tensor

from nolens.optics import Stack, propagate

_FINE_UM = 0.3125  # Below λ/(2 sin 40°): torchoptics samples the tilted carrier itself.
_COARSE = 4  # propagate does not: so many times its pitch is enough.


@pytest.fixture(autouse=True)
def float64() -> Iterator[None]:
    before = torchoptics.get_default_dtype()
    torchoptics.set_default_dtype(torch.float64)
    yield
    torchoptics.set_default_dtype(before)


def _behind_lenslet(places: Tensor) -> Tensor:
    """A lenslet of R = 200 µm with edges as smooth as a Hann window, 120 µm wide."""
    radius = torch.hypot(places[:, None], places)
    amplitude = torch.cos(math.pi / 2 * (radius / 60).clamp_max(1)).square()
    return torch.polar(amplitude, -(2 * math.pi / WAVELENGTH_UM) * 0.47 * radius**2 / 400)


@dataclass(frozen=True)
class _Plane:
    """A field that torchoptics samples, in a plane, about the chief ray's place."""

    data: Tensor
    column_um: float

    def through(self, thickness_um: float, index: float, column_um: float) -> "_Plane":
        """The field behind a layer, about another place."""
        field = torchoptics.Field(
            self.data, WAVELENGTH_UM / index, 0, _FINE_UM, (0.0, self.column_um)
        )
        after = field.propagate(
            self.data.shape,
            thickness_um,
            _FINE_UM,
            (0.0, column_um),
            propagation_method="DIM",
        )
        return _Plane(after.data, column_um)


def _carrier(p: float, places: Tensor) -> Tensor:
    return torch.exp(2j * math.pi * p / WAVELENGTH_UM * places)


@pytest.mark.parametrize("index", [1.0, 1.47])
@pytest.mark.parametrize("angle_deg", [0.0, 40.0])
def test_one_medium(angle_deg, index):
    """Field and phase, in the frame of the chief ray; the angle is that in the medium."""
    angle = math.radians(angle_deg)
    distance = 250 / math.tan(math.radians(40))
    p, moved = index * math.sin(angle), distance * math.tan(angle)
    assert abs(moved / _FINE_UM - round(moved / _FINE_UM)) < 1e-9

    fine = places_um(513, _FINE_UM)
    start = _Plane(_behind_lenslet(fine) * _carrier(p, fine), 0.0)
    expected = start.through(distance, index, moved).data
    phase = 2 * math.pi / WAVELENGTH_UM * index * math.cos(angle) * distance
    expected = expected / _carrier(p, fine + moved) * torch.exp(torch.tensor(-1j * phase))

    pitch = _COARSE * _FINE_UM
    field = _behind_lenslet(places_um(256, pitch)).to(torch.complex64)
    got = propagate(field, pitch, Stack((distance,), (index,)), WAVELENGTH_UM, carrier=(0.0, p))
    middle = slice(128 - 64, 128 + 65)
    assert float(expected.abs().max()) > 1.5  # The lenslet gathers the light.
    assert relative_error(got[middle, middle], expected[::_COARSE, ::_COARSE]) < 4e-4


def test_layer_by_layer():
    """Resin, glass and air, a fifth as thick as the paper's; the source at 30°.

    The chief ray's places are no whole numbers of samples: the last ones are wanted beside it.
    """
    stack = Stack((212.0, 98.0, 47.0), (1.47, 1.52, 1.0))
    p = 0.5
    fine = places_um(513, _FINE_UM)
    plane = _Plane(_behind_lenslet(fine) * _carrier(p, fine), 0.0)
    moved, phase = 0.0, 0.0
    for thickness, index in zip(stack.thicknesses_um, stack.indices, strict=True):
        angle = math.asin(p / index)
        moved += thickness * math.tan(angle)
        phase += 2 * math.pi / WAVELENGTH_UM * index * math.cos(angle) * thickness
        plane = plane.through(thickness, index, round(moved / _FINE_UM) * _FINE_UM)
    offset = plane.column_um - moved
    assert abs(offset) > 0.01
    expected = plane.data / _carrier(p, fine + plane.column_um)
    expected = expected * torch.exp(torch.tensor(-1j * phase))

    pitch = _COARSE * _FINE_UM
    field = _behind_lenslet(places_um(256, pitch)).to(torch.complex64)
    got = propagate(field, pitch, stack, WAVELENGTH_UM, carrier=(0.0, p), offset_um=(0.0, offset))
    middle = slice(128 - 64, 128 + 65)
    assert relative_error(got[middle, middle], expected[::_COARSE, ::_COARSE]) < 4e-4
