"""Propagation through layers: Fresnel's pattern, conserved light, and the chief ray's frame."""

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from optical_bench import GLASS, MEDIA, PAPER, RESIN, WAVELENGTH_UM, Way, places_um, relative_error
from scipy.special import fresnel
from torch import Tensor

from nolens.optics import Grid, Margin, Opening, Stack, propagate, random_lenslets

AIR_ALONE = Stack((1280.0,), (1.0,))


def _fresnel_of_slit(
    places: NDArray[np.float64], width_um: float, distance_um: float
) -> NDArray[np.complex128]:
    """Field behind a slit by Fresnel's integrals (goodman2005, section 4.5), without e^{ikz}."""
    scale = math.sqrt(2 / (WAVELENGTH_UM * distance_um))
    (upper_s, upper_c), (lower_s, lower_c) = (
        fresnel(scale * (places + side * width_um / 2)) for side in (1, -1)
    )
    turned = np.exp(-0.25j * np.pi) / math.sqrt(2)
    field: NDArray[np.complex128] = (upper_c - lower_c + 1j * (upper_s - lower_s)) * turned
    return field


@pytest.mark.parametrize(
    ("distance_um", "of_intensity", "of_field"),
    [(20_000.0, 2.7e-4, 5.5e-4), (5_000.0, 2.7e-3, 5.4e-3)],
    ids=["fresnel number 0.9", "fresnel number 3.6"],
)
def test_square_aperture_by_fresnels_integrals(distance_um, of_intensity, of_field):
    """200 µm wide, at paraxial angles; the bounds are twice the errors measured."""
    samples = 1536
    grid = Grid(samples, samples, 1.0)
    places = grid.positions_um(0)
    open_ = Opening("rectangle", 200.0, 200.0).coverage(places, places, 1.0)
    field = propagate(
        open_.to(torch.complex64),
        1.0,
        Stack((distance_um,), (1.0,)),
        WAVELENGTH_UM,
        band_per_um=samples / 2 / (WAVELENGTH_UM * distance_um),
    )
    middle = places.abs() < 200
    slit = torch.from_numpy(_fresnel_of_slit(places[middle].numpy(), 200.0, distance_um))
    expected = slit[:, None] * slit
    got = field[middle][:, middle]
    assert relative_error(got, expected) < of_field
    assert relative_error(got.abs().square(), expected.abs().square()) < of_intensity


def _tapered_lenslets(way: Way, samples: int, open_um: float) -> tuple[Tensor, float]:
    """Field behind random lenslets in a smooth window; and how far they turn light, in p."""
    relief = random_lenslets(
        radius_um=670,
        pitch_um=70,
        smoothing_um=11,
        size_um=(samples * 1.55, samples * 1.55),
        grid_um=1.55,
        seed=1,
    )
    coupling = float(MEDIA.coupling(torch.tensor(way.p**2, dtype=torch.float64)))
    height = relief.height_um[:samples, :samples]
    places = places_um(samples, 1.55)
    window = torch.cos(math.pi / 2 * (places / open_um).clamp(-1, 1)).square().float()
    turns = height * coupling * 2 * math.pi / WAVELENGTH_UM
    return torch.polar(window[:, None] * window, turns), coupling * relief.steepest


@pytest.mark.parametrize("stack", [AIR_ALONE, PAPER], ids=["air", "paper"])
@pytest.mark.parametrize("way", [Way(0), Way(20, 30), Way(40, -90), Way(50), Way(50, 45)], ids=str)
def test_light_is_conserved_and_stays_with_its_chief_ray(way, stack):
    """All of it passes; and it lands within the margin that `Margin` foresees, not elsewhere."""
    samples, open_um = 704, 200.0
    field, turned = _tapered_lenslets(way, samples, open_um)
    before = float(field.abs().double().square().sum())
    after = propagate(field, 1.55, stack, WAVELENGTH_UM, carrier=way.along(way.p))
    light = after.abs().double().square()
    assert float(light.sum()) == pytest.approx(before, rel=2e-6)
    spread = float(stack.spread_um(torch.tensor(way.p, dtype=torch.float64)))
    margin = Margin.needed(turned, spread, WAVELENGTH_UM)
    reach = open_um + margin.geometric_um + margin.diffraction_um
    inside = places_um(samples, 1.55).abs() < reach
    assert int(inside.sum()) < 0.85 * samples
    assert float(light[inside][:, inside].sum()) == pytest.approx(before, rel=1e-4)


@pytest.mark.parametrize("way", [Way(0), Way(50, 30)], ids=str)
def test_finer_samples_have_the_same_mean(way):
    field, _ = _tapered_lenslets(way, 352, 150.0)
    coarse, fine = (
        propagate(field.clone(), 1.55, PAPER, WAVELENGTH_UM, carrier=way.along(way.p), finer=n)
        for n in (1, 3)
    )
    assert fine.shape == (1056, 1056)
    assert relative_error(fine[::3, ::3], coarse) < 1e-6
    mean = float(coarse.abs().double().square().mean())
    assert float(fine.abs().double().square().mean()) == pytest.approx(mean, rel=1e-6)


@pytest.mark.parametrize("shape", [(36, 45), (45, 36), (33, 35)])
def test_finer_samples_of_any_number(shape):
    """A wave of each sign and of a frequency below the highest: exact between the samples."""
    rows, columns = (torch.arange(n, dtype=torch.float64) for n in shape)
    for row, column in ((0, 0), (3, -5), (-16, 15), (7, 17)):

        def wave(y: Tensor, x: Tensor, row: int = row, column: int = column) -> Tensor:
            turns = row * y[:, None] / shape[0] + column * x / shape[1]
            return torch.exp(2j * math.pi * turns).to(torch.complex64)

        none = Stack((0.0,), (1.0,))
        got = propagate(wave(rows, columns), 1.55, none, WAVELENGTH_UM, finer=2)
        fine = [torch.arange(2 * n, dtype=torch.float64) / 2 for n in shape]
        torch.testing.assert_close(got, wave(*fine), rtol=0, atol=1e-5)


@pytest.mark.parametrize("way", [Way(0), Way(40, 70)], ids=str)
def test_layers_one_after_the_other(way):
    """Three stacks of one layer, or one of three: the frame moves on with the chief ray."""
    field, _ = _tapered_lenslets(way, 352, 150.0)
    carrier = way.along(way.p)
    at_once = propagate(field.clone(), 1.55, PAPER, WAVELENGTH_UM, carrier=carrier)
    for thickness, index in zip(PAPER.thicknesses_um, PAPER.indices, strict=True):
        layer = Stack((thickness,), (index,))
        field = propagate(field, 1.55, layer, WAVELENGTH_UM, carrier=carrier)
    assert relative_error(field, at_once) < 1e-5


@pytest.mark.parametrize("offset", [(0.0, 0.0), (3.1, -4.65), (-1.55, 15.5)])
def test_offset_moves_the_samples(offset):
    """Samples that are wanted further on: the same field, so many places earlier."""
    way = Way(30, 20)
    field, _ = _tapered_lenslets(way, 352, 120.0)
    carrier = way.along(way.p)
    still = propagate(field.clone(), 1.55, PAPER, WAVELENGTH_UM, carrier=carrier)
    moved = propagate(field, 1.55, PAPER, WAVELENGTH_UM, carrier=carrier, offset_um=offset)
    steps = [-round(each / 1.55) for each in offset]
    assert relative_error(moved, still.roll(steps, (0, 1))) < 1e-5


@pytest.mark.parametrize("deflection", [0.0, 0.02, -0.05])
@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 50.0])
def test_a_turned_beam_lands_where_its_own_ray_does(angle_deg, deflection):
    """A wide beam beside the carrier: its light arrives at the place of Snell's law."""
    samples, pitch = 512, 1.55
    p = math.sin(math.radians(angle_deg))
    places = places_um(samples, pitch)
    beam = torch.exp(-(places / 80).square())
    turns = 2 * math.pi * deflection / WAVELENGTH_UM * places
    field = torch.polar(beam[:, None] * beam, turns.expand(samples, -1)).to(torch.complex64)
    light = propagate(field, pitch, PAPER, WAVELENGTH_UM, carrier=(0.0, p)).abs().square().double()
    got = float((light.sum(0) * places).sum() / light.sum())
    rays = [torch.tensor(each, dtype=torch.float64).abs() for each in (p + deflection, p)]
    ends = [float(PAPER.displacement_um(ray)) for ray in rays]
    ends[0] = math.copysign(ends[0], p + deflection)
    # A Gaussian of 80 µm has directions of its own, of ±0.002, over which the ends curve.
    assert got == pytest.approx(ends[0] - ends[1], abs=0.05)


def test_only_the_band_is_kept():
    field = torch.zeros(64, 64, dtype=torch.complex64)
    field[0, 0] = 1
    got = propagate(field, 2.0, PAPER, WAVELENGTH_UM, band_per_um=0.1)
    frequency = torch.fft.fftfreq(64, 2.0)
    inside = frequency.abs() <= 0.1
    expected = (inside[:, None] & inside).float()
    torch.testing.assert_close(torch.fft.fft2(got).abs(), expected, rtol=0, atol=1e-5)


def test_surfaces_lose_light_by_the_angle():
    """A plane wave through air, resin, glass and air: the product of Fresnel's formulas."""
    way = Way(50, 30)
    field = torch.ones(16, 16, dtype=torch.complex64)
    indices = (1.0, RESIN, GLASS, 1.0)
    carrier = way.along(way.p)
    light = propagate(field, 1.55, PAPER, WAVELENGTH_UM, carrier=carrier, surfaces=indices)
    passed = 1.0
    for before, after in ((1.0, RESIN), (RESIN, GLASS), (GLASS, 1.0)):
        angles = [math.asin(way.p / n) for n in (before, after)]
        less, more = angles[0] - angles[1], angles[0] + angles[1]
        across = math.sin(less) / math.sin(more)
        along = math.tan(less) / math.tan(more)
        passed *= 1 - (across**2 + along**2) / 2
    torch.testing.assert_close(
        light.abs().square(), torch.full((16, 16), passed), rtol=1e-5, atol=0
    )


def test_light_that_a_layer_cannot_carry_is_gone():
    """Beyond p = 1 an air gap carries nothing, and the resin alone still does."""
    turns = 2 * math.pi * 0.25 * places_um(8, 1.0).expand(8, -1)
    field = torch.polar(torch.ones_like(turns), turns).to(torch.complex64)
    carrier = (0.0, 0.95)
    assert 0.95 + 0.25 * WAVELENGTH_UM > 1
    gone = propagate(field.clone(), 1.0, PAPER, WAVELENGTH_UM, carrier=carrier)
    assert float(gone.abs().max()) < 1e-6
    there = propagate(field, 1.0, Stack((9.0,), (RESIN,)), WAVELENGTH_UM, carrier=carrier)
    torch.testing.assert_close(there.abs(), torch.ones(8, 8), rtol=0, atol=1e-5)
