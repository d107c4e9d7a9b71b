"""Spectra: Gauss's quadrature against the dense sum, and electrons against photometry by hand."""

import math

import numpy as np
import pytest
from cameras import WHITE
from hypothesis import given
from hypothesis import strategies as st

from nolens.camera import SpectralCurve, preset
from nolens.errors import OptionError
from nolens.twin import LIGHTS, POWER, Light

PLANCK, SPEED = 6.62607015e-34, 2.99792458e8
LUMENS_PER_WATT = 683.0

# CIE 1924, every 10 nm from 400 nm.
EYE = (
    0.000396, 0.00121, 0.0040, 0.0116, 0.023, 0.038, 0.060, 0.09098, 0.13902, 0.20802, 0.323,
    0.503, 0.710, 0.862, 0.954, 0.99495, 0.995, 0.952, 0.870, 0.757, 0.631, 0.503, 0.381, 0.265,
    0.175, 0.107, 0.061, 0.032, 0.017, 0.00821, 0.004102,
)  # fmt: skip


def _curve() -> SpectralCurve:
    curve = preset("paper").sensor.quantum_efficiency
    assert isinstance(curve, SpectralCurve)
    return curve


CURVE = _curve()


def _dense(light: Light, channel: str) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths 1 nm apart, and photons times efficiency, of sum 1."""
    nm = np.arange(400.0, 701.0)
    weight = light.power(nm) * nm * CURVE.at(channel, nm)
    return nm, weight / weight.sum()


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("channel", ["R", "G", "B"])
@pytest.mark.parametrize("count", [1, 2, 3, 5, 9])
def test_quadrature_is_exact_up_to_degree_2n_minus_1(name, channel, count):
    pairs = Light(name).wavelengths(CURVE, channel, count)
    nodes, weights = np.array(pairs).T
    assert len(nodes) == count
    assert (weights > 0).all()
    assert weights.sum() == pytest.approx(1, abs=1e-12)
    assert nodes.min() > 400
    assert nodes.max() < 700
    nm, dense = _dense(Light(name), channel)

    def moment(at: np.ndarray, weight: np.ndarray, degree: int) -> float:
        return float(weight @ ((at - 550) / 150) ** degree)

    for degree in range(2 * count):
        expected = moment(nm, dense, degree)
        assert moment(nodes, weights, degree) == pytest.approx(expected, abs=1e-10), degree
    # And no further: the next one takes another node.
    beyond = moment(nodes, weights, 2 * count)
    assert abs(beyond - moment(nm, dense, 2 * count)) > 1e-8


@given(
    st.lists(st.floats(0, 1), min_size=2, max_size=6),
    st.integers(1, 30),
    st.sampled_from(LIGHTS),
)
def test_quadrature_of_any_curve(values, count, name):
    """However many nodes, and whatever gaps the curve has: weights of sum 1 and the mean kept."""
    steps = tuple(400.0 + 7.0 * k for k in range(len(values)))
    curve = SpectralCurve(source="drawn", wavelength_nm=steps, values={"grey": tuple(values)})
    nm = np.arange(steps[0], steps[-1] + 0.5)
    dense = Light(name).power(nm) * nm * curve.at("grey", nm)
    if not dense.sum() > 1e-200:
        return
    nodes, weights = np.array(Light(name).wavelengths(curve, "grey", count)).T
    assert (weights >= 0).all()
    assert weights.sum() == pytest.approx(1, abs=1e-9)
    assert (nodes >= steps[0] - 1e-6).all()
    assert (nodes <= steps[-1] + 1e-6).all()
    assert weights @ nodes == pytest.approx(nm @ dense / dense.sum(), abs=1e-6)


def test_a_curve_of_two_wavelengths_has_no_more_nodes():
    """Three at 1 nm, of which one is blind: the light's own two are all there is."""
    curve = SpectralCurve(
        source="a laser line", wavelength_nm=(532, 533, 534), values={"grey": (0.2, 0.6, 0.0)}
    )
    pairs = Light("equal-energy").wavelengths(curve, "grey", 9)
    nodes, weights = np.array(pairs).T
    np.testing.assert_allclose(nodes, [532, 533], rtol=1e-9)
    photons = np.array([532 * 0.2, 533 * 0.6])
    np.testing.assert_allclose(weights, photons / photons.sum(), rtol=1e-9)


def test_spectra():
    """Two lines of the white LED at half height, Planck's law, and the same power everywhere."""
    led = WHITE.power(np.array([440.0, 450.0, 460.0, 560.0, 620.0]))
    phosphor = [0.5 * 2 ** -((nm - 560) ** 2 / 60**2) for nm in (440, 450, 460, 560, 620)]
    expected = np.array([0.5, 1.0, 0.5, 0.0, 0.0]) + phosphor
    np.testing.assert_allclose(led, expected, rtol=0, atol=1e-6)

    second = PLANCK * SPEED / 1.380649e-23
    metres = np.array([400e-9, 560e-9, 700e-9])
    planck = metres**-5 / np.expm1(second / metres / 6504)
    daylight = Light("daylight").power(metres * 1e9)
    np.testing.assert_allclose(daylight / daylight[1], planck / planck[1], rtol=1e-6)

    assert Light("equal-energy").power(metres * 1e9) == pytest.approx([1, 1, 1])


@pytest.mark.parametrize("name", ["535nm", "535 nm", "535.0nm"])
def test_one_wavelength_stands_for_itself(name):
    light = Light(name)
    assert light.single_nm == 535
    for channel in "RGB":
        assert light.wavelengths(CURVE, channel, 7) == ((535.0, 1.0),)
    assert WHITE.single_nm is None


@pytest.mark.parametrize("name", ["candle", "", "535", "535um", "349nm", "1101nm", "nm", "-535nm"])
def test_unknown_light_is_refused_with_what_is_known(name):
    with pytest.raises(OptionError, match="unknown light") as caught:
        Light(name)
    for known in (*LIGHTS, "535nm"):
        assert known in str(caught.value)


def test_a_channel_that_sees_nothing_is_refused():
    values = {"R": (0.0, 0.0, 0.0), "G": (0.5, 0.5, 0.5), "B": (0.5, 0.5, 0.5)}
    curve = SpectralCurve(source="blind", wavelength_nm=(400, 550, 700), values=values)
    with pytest.raises(OptionError, match="channel R sees nothing of the light daylight"):
        Light("daylight").wavelengths(curve, "R", 3)
    assert Light("daylight").electrons(curve, "R", 100.0) == 0
    assert len(Light("daylight").wavelengths(curve, "G", 3)) == 3


# --- Electrons -------------------------------------------------------------------------------


@pytest.mark.parametrize("luminance", [1.0, 250.0])
def test_electrons_of_a_line_by_hand(luminance):
    """L / 683 in W/(m² sr), each photon hc/λ, and of those the quantum efficiency at 555 nm."""
    photons = luminance / LUMENS_PER_WATT * 555e-9 / (PLANCK * SPEED)
    efficiency = (0.547 + 0.459) / 2  # Of G, between 550 and 560 nm.
    got = Light("555nm").electrons(CURVE, "G", luminance)
    assert got == pytest.approx(photons * efficiency, rel=1e-9)
    assert 2e15 * luminance < got < 3e15 * luminance


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("channel", ["R", "G", "B"])
def test_electrons_of_a_spectrum_by_the_eyes_table(name, channel):
    """With the CIE's table instead of the fit to it, 10 nm apart."""
    nm = np.arange(400.0, 701.0, 10.0)
    power = Light(name).power(nm)  # To the nm; at 1 cd/m² after the division.
    power = power / (LUMENS_PER_WATT * 10 * (power * np.array(EYE)).sum())
    photons = power * nm * 1e-9 / (PLANCK * SPEED)
    expected = 10 * (photons * CURVE.at(channel, nm)).sum()
    got = Light(name).electrons(CURVE, channel, 1.0)
    assert got == pytest.approx(expected, rel=0.02)


def test_electrons_are_linear_in_luminance():
    one = WHITE.electrons(CURVE, "R", 1.0)
    assert WHITE.electrons(CURVE, "R", 1234.5) == pytest.approx(1234.5 * one, rel=1e-12)
    assert WHITE.electrons(CURVE, "R", 0.0) == 0


def test_electrons_of_a_white_led_are_some_1e15():
    """Some 300 lm to the watt make 9e15 photons; a third of them counts, and a fifth passes."""
    total = sum(WHITE.electrons(CURVE, channel, 1.0) for channel in "RGB")
    assert 1e15 < total < 1e16
    assert math.isfinite(total)


@pytest.mark.parametrize("name", LIGHTS)
def test_the_table_s_reach_does_not_change_how_bright_the_light_is(name):
    """Where a table ends the sensor is blind, but the eye is not: zeros written out or not."""
    short = SpectralCurve(
        source="blue only", wavelength_nm=(400, 480, 481), values={"grey": (0.5, 0.5, 0.0)}
    )
    long = SpectralCurve(
        source="the same", wavelength_nm=(400, 480, 481, 700), values={"grey": (0.5, 0.5, 0.0, 0.0)}
    )
    got = Light(name).electrons(short, "grey", 100.0)
    assert got == pytest.approx(Light(name).electrons(long, "grey", 100.0), rel=0.01)


def test_a_spectrum_of_ones_own_is_that_of_its_table():
    """A table of daylight is daylight, whatever its unit."""
    nm = np.arange(400.0, 701.0, 5)
    daylight = Light("daylight").power(nm)
    values = {POWER: tuple((daylight / daylight.max()).tolist())}
    table = SpectralCurve(source="table", wavelength_nm=tuple(nm.tolist()), values=values)
    own = np.array(Light("table", table).wavelengths(CURVE, "G", 3))
    assert own == pytest.approx(np.array(Light("daylight").wavelengths(CURVE, "G", 3)), rel=1e-4)
