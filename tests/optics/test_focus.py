"""A lenslet's focus by wave optics, against the ray transfer matrices of the same layers."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from optical_bench import GLASS, NOTHING, WAVELENGTH_UM, caps
from scipy.optimize import brentq

from nolens.optics import (
    Grid,
    Illumination,
    MaskSurface,
    Media,
    Opening,
    PointSource,
    Stack,
    monochromatic_psf,
)

RADIUS_UM, WIDTH_UM = 670.0, 300.0
GLASS_UM, GAP_UM = 490.0, 235.0


def _system(resin_um: float, index: float, source_um: float) -> NDArray[np.float64]:
    """Ray transfer matrix, for (place, angle), from the source to the sensor."""

    def over(length: float) -> NDArray[np.float64]:
        return np.array([[1, length], [0, 1]])

    def into(before: float, after: float, curvature: float = 0.0) -> NDArray[np.float64]:
        return np.array([[1, 0], [(before - after) * curvature / after, before / after]])

    parts = [
        over(source_um) if math.isfinite(source_um) else np.eye(2),
        into(1.0, index, 1 / RADIUS_UM),
        over(resin_um),
        into(index, GLASS),
        over(GLASS_UM),
        into(GLASS, 1.0),
        over(GAP_UM),
    ]
    system: NDArray[np.float64] = np.linalg.multi_dot(parts[::-1])
    return system


def _focus_um(index: float, source_um: float) -> float:
    """Resin thickness at which all rays of the source meet: A = 0, or B = 0 of a near one."""
    column = 0 if math.isinf(source_um) else 1
    return float(brentq(lambda t: _system(t, index, source_um)[0, column], 1.0, 10_000.0))


def _stack(resin_um: float, index: float) -> Stack:
    return Stack((resin_um, GLASS_UM, GAP_UM), (index, GLASS, 1.0))


@pytest.fixture(scope="module")
def lenslet() -> MaskSurface:
    """One cap in a round opening, which leaves its foot out."""
    relief = caps(401, 1.0, RADIUS_UM, WIDTH_UM + 40, [(0.0, 0.0)])
    return MaskSurface(relief, Opening("ellipse", WIDTH_UM, WIDTH_UM))


def _brightness(lenslet: MaskSurface, resin_um: float, index: float, source_um: float) -> float:
    """In the middle of the pattern."""
    light = Illumination(PointSource(distance_um=source_um), NOTHING, _stack(resin_um, index))
    media = Media(WAVELENGTH_UM, 1.0, index)
    return float(monochromatic_psf(light, lenslet, media, Grid(1, 1, 1.0))[0, 0])


# PDMS and the resin of the paper; the last source is so near that the focus moves by a quarter.
@pytest.mark.parametrize(("index", "source_um"), [(1.47, math.inf), (1.43, math.inf), (1.47, 1e4)])
def test_focus_is_where_the_matrices_say(index, source_um, lenslet):
    """To 0.6 % of the resin's thickness, and as bright as a perfect lens to 1.6 %.

    The Fresnel number is 28: diffraction alone draws the brightest place 0.25 % nearer.
    """
    expected = _focus_um(index, source_um)
    shares = np.linspace(-0.05, 0.05, 7)
    brightness = [_brightness(lenslet, float(expected * (1 + s)), index, source_um) for s in shares]
    curved, slope, _ = np.polyfit(shares, brightness, 2)
    assert curved < 0
    assert abs(-slope / (2 * curved)) < 0.006
    # Of a lens that brings light to one place at the reduced length L: (area / λL)².
    length = _stack(expected, index).reduced_um
    perfect = (math.pi * WIDTH_UM**2 / 4 / (WAVELENGTH_UM * length)) ** 2
    assert brightness[3] == pytest.approx(perfect, rel=0.016)
    assert max(brightness) < 1.016 * perfect


def test_design_of_the_paper():
    """Eq. 3 with its missing factor: 0.678 mm focus 1.46 mm of PDMS and 1.30 mm of resin.

    This holds the matrices of this file, by which the waves are judged, to the closed form.
    """
    for index, thickness in ((1.43, 1460.0), (1.47, 1300.0)):
        reduced = thickness / index + GLASS_UM / GLASS + GAP_UM
        assert (index - 1) * reduced == pytest.approx(678, rel=0.01)
        focal = RADIUS_UM / (index - 1)
        closed = index * (focal - GLASS_UM / GLASS - GAP_UM)
        assert _focus_um(index, math.inf) == pytest.approx(closed, rel=1e-9)
