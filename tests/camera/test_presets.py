"""Cameras that come with the package."""

import numpy as np
import pytest

from nolens.camera import PRESETS, LoadedCamera, preset, preset_text, to_toml
from nolens.errors import OptionError


@pytest.mark.parametrize("name", PRESETS)
def test_text_is_what_would_be_written(name):
    camera = preset(name)
    assert camera.name == name
    assert to_toml(camera) == preset_text(name)
    assert LoadedCamera.of(camera).relief_um is None


@pytest.mark.parametrize("name", PRESETS)
def test_what_is_a_placeholder_is_called_one(name):
    camera = LoadedCamera.of(preset(name))
    assert camera.acceptance.source.startswith("placeholder")
    assert "infrared-cut filter" in camera.quantum_efficiency.source


# `ct_curve` of imx477.json in raspberrypi/libcamera, but for 9505 K: kelvin, R/G and B/G of a grey.
MEASURED_GREYS = """
2360 .6009 .3093   2848 .5071 .4000   2903 .4905 .4392   3628 .4261 .5564   3643 .4228 .5623
4660 .3529 .6800   5579 .3227 .7000   6125 .3129 .7100   6671 .3065 .7200   7217 .3014 .7300
7763 .2950 .7400
"""


@pytest.mark.parametrize("name", PRESETS)
def test_colours_of_greys_are_those_that_were_measured(name):
    """In Planck's light R/G within 3 %; B/G, which no smooth curves follow closer, within 12 %."""
    curve = LoadedCamera.of(preset(name)).quantum_efficiency
    nm = np.arange(400.0, 701.0)
    points = np.array(MEASURED_GREYS.split(), float).reshape(-1, 3)
    off = []
    for kelvin, *ratios in points:
        photons = nm**-4 / np.expm1(1.438777e7 / (nm * kelvin))
        red, green, blue = (photons @ curve.at(channel, nm) for channel in "RGB")
        off.append(np.array([red / green, blue / green]) / ratios - 1)
    assert np.all(np.abs(off).max(axis=0) < [0.03, 0.12])


def test_black_level_and_gain_are_those_of_the_same_file():
    """It has a black level of 4096 and a noise slope of 2.767, both of 16 bits."""
    sensor = preset("paper").sensor
    assert sensor.black_counts == 4096 / 16
    assert sensor.counts_per_electron == pytest.approx(2.767**2 / 16, rel=0.03)


def test_the_papers_sensor():
    sensor = preset("paper").sensor
    assert sensor.channels == ("R", "G", "B")
    assert sensor.white_counts == 4095
    assert (sensor.height_mm, sensor.width_mm) == pytest.approx((4.712, 6.2868))
    assert sensor.clip_electrons == pytest.approx((4095 - 256) / 0.47)
    assert sensor.model_copy(update={"gain": 0.5}).clip_electrons == 8180


def test_the_papers_layers():
    layers = preset("paper").layers
    assert [layer.thickness.mm for layer in layers] == [1.06, 0.49, 0.235]
    assert preset("paper").indices(587.56) == pytest.approx((1.47, 1.52, 1))
    film = preset("paper-film").layers
    assert [layer.thickness.mm for layer in film] == [0.305, 0.4, 0.49, 0.235]


def test_the_small_aperture_fits_its_sensor():
    camera = preset("small")
    aperture = camera.mask.aperture
    assert aperture.width.mm < camera.sensor.width_mm
    assert aperture.height.mm < camera.sensor.height_mm


@pytest.mark.parametrize(
    ("name", "words"), [("Papr", "did you mean 'paper'"), ("xyz", "paper, paper-film, small")]
)
def test_unknown_preset(name, words):
    with pytest.raises(OptionError, match=words):
        preset(name)
