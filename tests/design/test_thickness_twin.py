"""Where the waves of the twin are brightest, against the thickness that the matrices give."""

import math
from typing import Literal

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from nolens.camera import Layer, LoadedCamera, Mask, preset
from nolens.design.focus import LensletStack
from nolens.design.replica import Cover, Film, Replica
from nolens.optics import (
    Grid,
    Illumination,
    MaskSurface,
    Media,
    Opening,
    PointSource,
    Relief,
    Stack,
    monochromatic_psf,
)
from nolens.quantities import Length
from nolens.twin import Light, Twin, point_spread

WAVELENGTH_UM = 0.55
WIDTH_UM = 300.0
COVER = Cover((490.0, 235.0), (1.52, 1.0))
BARE = Cover((), ())
GAP = Cover((235.0,), (1.0,))


def cap(radius_um: float, sign: float) -> MaskSurface:
    """One parabolic lenslet in a round opening, bulging to the scene (1) or the sensor (−1)."""
    grid = Grid(401, 401, 1.0)
    rows, columns = (grid.positions_um(axis) for axis in (0, 1))
    squared = rows[:, None].square() + columns.square()
    height = sign * ((WIDTH_UM / 2 + 20) ** 2 - squared).clamp_min(0) / (2 * radius_um)
    return MaskSurface(Relief(height.float(), 1.0), Opening("ellipse", WIDTH_UM, WIDTH_UM))


def brightness(stack: LensletStack, layer: int, thickness_um: float) -> float:
    """Of the pattern's middle, with one layer of another thickness."""
    s = stack.surface
    thicknesses = [float(t) for t in stack.thicknesses_um]
    thicknesses[layer] = thickness_um
    indices = [float(n) for n in stack.indices]
    light = Illumination(
        PointSource(distance_um=stack.source_um),
        Stack(tuple(thicknesses[:s]), tuple(indices[:s])),
        Stack(tuple(thicknesses[s:]), tuple(indices[s:])),
    )
    media = Media(WAVELENGTH_UM, float(stack.before), indices[s])
    mask = cap(float(stack.radius_um), math.copysign(1.0, indices[s] - float(stack.before)))
    return float(monochromatic_psf(light, mask, media, Grid(1, 1, 1.0))[0, 0])


CASES = {
    "imprinted": (Replica(1.47, 678.0, COVER).stack(0.0), 0),
    "bare sensor": (Replica(1.43, 678.0, BARE).stack(0.0), 0),
    "bare sensor, gap, near": (Replica(1.6, 800.0, GAP, 1.5e4).stack(0.0), 0),
    "film": (Film(305.0, 1.59, 0.0, "scene").over(COVER, 678.0, math.inf), 1),
    "flipped film": (Film(305.0, 1.59, 0.0, "sensor").over(COVER, 678.0, math.inf), 1),
    "flipped film, near": (Film(305.0, 1.59, 0.0, "sensor").over(GAP, 600.0, 1e4), 1),
}


@pytest.mark.parametrize("name", CASES)
def test_brightest_where_the_matrices_say(name: str) -> None:
    check_brightest(*CASES[name])


@settings(max_examples=8)
@given(
    st.floats(1.35, 1.65), st.floats(600.0, 900.0),
    st.lists(st.tuples(st.floats(20.0, 400.0), st.floats(1.0, 1.7)), max_size=3),
)  # fmt: skip
def test_brightest_over_random_layers(
    index: float, radius_um: float, layers: list[tuple[float, float]]
) -> None:
    cover = Cover(tuple(t for t, _ in layers), tuple(n for _, n in layers))
    stack = Replica(index, radius_um, cover).stack(0.0)
    assume(float(stack.focused_thickness_um(0)) > 100.0)
    check_brightest(stack, 0)


def check_brightest(stack: LensletStack, layer: int) -> None:
    """To 0.3 % of the way behind the lenslet, beside the share that diffraction draws it nearer.

    Behind a round lenslet of the Fresnel number F the brightest place lies 12/(π²F²) nearer:
    there the falling of 1/z² outweighs the loss by defocus of sinc²(F/2 · share).
    """
    focused = float(stack.focused_thickness_um(layer))
    reach = float(stack.behind_um - stack.thicknesses_um[layer] / stack.indices[layer])
    reach += focused / float(stack.indices[layer])
    fresnel = (WIDTH_UM / 2) ** 2 / (WAVELENGTH_UM * reach)
    steps = (-0.025, 0.0, 0.025)
    values = [
        brightness(stack, layer, focused + step * reach * float(stack.indices[layer]))
        for step in steps
    ]
    curved, slope, _ = np.polyfit(steps, values, 2)
    assert curved < 0
    nearer = 12 / (math.pi * fresnel) ** 2
    assert -slope / (2 * curved) == pytest.approx(-nearer, abs=0.003)


@pytest.mark.parametrize(("side", "surface"), [("scene", 0), ("sensor", 1)])
def test_film_that_is_turned_over(side: Literal["scene", "sensor"], surface: int) -> None:
    """Random lenslets of the twin gather light whichever way they face, where the matrices say."""
    film = Film(100.0, 1.59, 0.0, side)
    focused = float(film.over(BARE, 1200.0, math.inf).focused_thickness_um(1))
    peaks = [peak_over_mean(surface, share * focused) for share in (0.5, 0.8, 1.25, 2.0, 1.0)]
    assert max(peaks) == peaks[-1]
    assert peaks[-1] > 20 > 2 * max(peaks[0], peaks[3])


def peak_over_mean(surface: int, distance_um: float) -> float:
    """Of the pattern behind a film of lenslets with R = 1.2 mm, at a distance from a sensor."""
    camera = preset("paper-film")
    size = camera.sensor.model_copy(update={"rows": 192, "columns": 192})
    changes = {"radius": "1.2 mm", "pitch": "120 um", "smoothing": "4 um", "overhang": "0.3 mm"}
    relief = camera.mask.relief.model_copy(
        update={name: Length.parse(text) for name, text in changes.items()}
    )
    layers = (
        Layer(thickness=Length("100", "um"), index=1.59),
        Layer(thickness=Length.of(distance_um, "um"), material="air"),
    )
    made = camera.model_copy(
        update={"sensor": size, "layers": layers, "mask": Mask(surface=surface, relief=relief)}
    )
    pattern = point_spread(
        Twin.of(LoadedCamera.of(made)), PointSource(), (192, 192), superpixel=1,
        light=Light("550nm"), wavelengths=1,
    )[1]  # fmt: skip
    return float(pattern.max() / pattern.mean())
