"""Cameras that come with the package."""

import pytest

from nolens.camera import PRESETS, camera_to_toml, opened, preset, preset_text
from nolens.errors import OptionError


@pytest.mark.parametrize("name", PRESETS)
def test_text_is_what_would_be_written(name):
    camera = preset(name)
    assert camera.name == name
    assert camera_to_toml(camera) == preset_text(name)
    assert opened(camera).relief_um is None


@pytest.mark.parametrize("name", PRESETS)
def test_curves_are_called_placeholders(name):
    camera = opened(preset(name))
    assert camera.quantum_efficiency.source.startswith("placeholder")
    assert camera.acceptance.source.startswith("placeholder")


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
