"""The Raspberry Pi's camera, by a stand-in for Picamera2: counts, levels, settings, failures."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from fake_picamera2 import Sensor, module
from nolens.camera import develop
from nolens.capture import (
    RaspberrySource,
    TwinSource,
    available_sources,
    open_source,
    raspberry,
)
from nolens.errors import CameraError, OptionError


@pytest.fixture
def sensor(monkeypatch: pytest.MonkeyPatch) -> Sensor:
    made = Sensor()
    monkeypatch.setitem(sys.modules, "picamera2", module(made))
    return made


@pytest.fixture
def source(sensor: Sensor) -> Any:
    source = RaspberrySource()
    source.open()
    yield source
    source.close()


def test_counts_are_the_sensors_without_the_padding_of_the_rows(
    sensor: Sensor, source: RaspberrySource
) -> None:
    frame = source.shot().frame
    assert torch.equal(frame.counts, torch.from_numpy(sensor.pixels.astype(np.float32))[None])
    assert (frame.mosaic, frame.black, frame.white) == ("BGGR", (256.0,), 4095.0)
    assert frame.black_stated and frame.stored_as == "uint16"


def test_asks_for_unpacked_raw_of_all_pixels_and_switches_corrections_off(
    sensor: Sensor, source: RaspberrySource
) -> None:
    assert sensor.configured["raw"] == {"format": "SRGGB12", "size": (60, 40)}
    assert "transform" not in sensor.configured
    assert sensor.controls["AeEnable"] is False and sensor.controls["AwbEnable"] is False
    assert sensor.controls["NoiseReductionMode"] == 0


def test_the_pi_5_fills_up_to_16_bits_and_the_counts_are_the_same(sensor: Sensor) -> None:
    sensor.given = "SBGGR16"
    source = open_source("raspberry")
    source.open()
    frame = source.shot().frame
    assert torch.equal(frame.counts, torch.from_numpy(sensor.pixels.astype(np.float32))[None])
    assert (frame.black, frame.white) == ((256.0,), 4095.0)


@pytest.mark.parametrize(
    ("mosaic", "black"),
    [("RGGB", (64, 65, 66, 67)), ("BGGR", (67, 66, 65, 64)), ("GRBG", (65, 64, 67, 66))],
)
def test_black_of_each_colour_and_of_ten_bits(
    sensor: Sensor, mosaic: str, black: tuple[int, ...]
) -> None:
    sensor.given, sensor.native, sensor.bits = f"S{mosaic}10", "SRGGB10_CSI2P", 10
    sensor.black = (4096, 4160, 4224, 4288)  # Of R, green beside R, green beside B, and B.
    sensor.pixels = np.full((40, 60), 100, np.uint16)
    sensor.pixels[0, 0] = 101
    source = RaspberrySource()
    source.open()
    frame = source.shot().frame
    assert (frame.black, frame.white) == (black, 1023.0)
    # R, the mean of both G, and B of a cell, each less its own black.
    assert develop(frame).values[:, 1, 1].tolist() == [36.0, 34.5, 33.0]


def test_a_monochrome_sensor(sensor: Sensor) -> None:
    sensor.native, sensor.given = "R12_CSI2P", "R16"
    source = RaspberrySource()
    source.open()
    frame = source.shot().frame
    assert (frame.channels, frame.mosaic, frame.black) == (("grey",), None, (256.0,))
    assert torch.equal(frame.counts[0], torch.from_numpy(sensor.pixels.astype(np.float32)))


def test_frames_from_before_a_setting_are_passed_over(
    sensor: Sensor, source: RaspberrySource
) -> None:
    for exposure_s, gain in ((0.04, 1.0), (0.002, 8.0), (3.0, 2.0)):
        source.set(exposure_s=exposure_s, gain=gain)
        shot = source.shot()
        # The time that was used is told, in whole lines, not the one that was asked for.
        lines = round(1e6 * exposure_s / sensor.line_us)
        assert shot.exposure_s == pytest.approx(1e-6 * int(lines * sensor.line_us))
        assert shot.frame.exposure_s == shot.exposure_s
        assert shot.gain == pytest.approx(gain, rel=0.01)
    assert shot.camera == "Raspberry Pi imx477"
    assert shot.details["SensorTemperature"] == 31.0
    assert sensor.held == 0


def test_a_setting_that_a_sensor_takes_only_roughly(
    sensor: Sensor, source: RaspberrySource
) -> None:
    sensor.line_us = 150.0
    source.set(exposure_s=4e-4, gain=1.0)
    assert source.shot().exposure_s == pytest.approx(4.5e-4)
    before = sensor.frames
    assert source.shot().exposure_s == pytest.approx(4.5e-4)
    assert sensor.frames == before + 1


def test_a_short_exposure_is_not_taken_for_the_one_before(
    sensor: Sensor, source: RaspberrySource
) -> None:
    for exposure_s in (2e-4, 1.4e-4):
        source.set(exposure_s=exposure_s, gain=1.0)
        assert source.shot().exposure_s == pytest.approx(exposure_s, abs=24e-6)


def test_a_sensor_that_corrects_defects_itself(
    source: RaspberrySource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "defect_correction" not in source.shot().details
    monkeypatch.setattr(raspberry, "_MODULES", tmp_path)
    parameter = tmp_path / "imx477" / "parameters" / "dpc_enable"
    parameter.parent.mkdir(parents=True)
    for text, found in (("1\n", 1), ("0\n", 0)):
        parameter.write_text(text)
        assert source.shot().details["defect_correction"] == found


def test_settings_beyond_the_camera_are_refused(source: RaspberrySource) -> None:
    limits = source.limits
    assert limits is not None
    assert limits.exposure_s == pytest.approx((114e-6, 694.422939))
    for exposure_s, gain in ((1e-5, 1.0), (1000.0, 1.0), (0.01, 0.5), (0.01, 30.0)):
        with pytest.raises(OptionError, match="beyond this camera: give"):
            source.set(exposure_s=exposure_s, gain=gain)


def test_a_camera_that_keeps_its_own_settings(sensor: Sensor) -> None:
    sensor.ignores = True
    source = RaspberrySource()
    source.open()
    with pytest.raises(CameraError, match=r"asked for 10 ms .* still exposes 19\.9\d* ms"):
        source.shot()
    assert sensor.held == 0


@pytest.mark.parametrize("given", ["BGGR_PISP_COMP1", "SBGGR12_CSI2P", "MONO_PISP_COMP1"])
def test_compressed_and_packed_raw_is_refused_with_the_way_round(
    sensor: Sensor, given: str
) -> None:
    sensor.given = given
    with pytest.raises(CameraError, match=rf"{given}.*--mode 4056:3040:12:U"):
        RaspberrySource().open()
    assert sensor.log[-1] == "close"


def test_a_pi_5_that_names_its_native_mode_by_its_compression(sensor: Sensor) -> None:
    sensor.native, sensor.given = "BGGR_PISP_COMP1", "SBGGR16"
    source = RaspberrySource()
    source.open()
    assert sensor.configured["raw"]["format"] == "SBGGR12"
    assert source.shot().frame.white == 4095


def test_a_web_camera_has_no_raw(sensor: Sensor) -> None:
    sensor.native = "MJPEG"
    with pytest.raises(CameraError, match="not the counts of its pixels"):
        RaspberrySource().open()


def test_camera_in_use(sensor: Sensor) -> None:
    sensor.busy = True
    with pytest.raises(CameraError, match=r"in use by another program.*fuser"):
        RaspberrySource().open()


def test_unplugged_while_running(sensor: Sensor) -> None:
    sensor.unplugged_after = 5
    source = RaspberrySource()
    source.open()
    source.shot()
    with pytest.raises(CameraError, match="unplugged"):
        for _ in range(9):
            source.shot()
    assert sensor.log[-2:] == ["flush", "close"]
    with pytest.raises(CameraError, match="not open"):
        source.shot()
    source.close()


def test_no_camera_is_connected(sensor: Sensor) -> None:
    sensor.connected = False
    with pytest.raises(CameraError, match="no camera is connected"):
        RaspberrySource().open()
    fact = available_sources()[0]
    assert (fact.id, fact.available) == ("raspberry", False)
    assert "ribbon cable" in fact.why
    assert isinstance(open_source("auto"), TwinSource)


def test_auto_takes_the_camera_that_is_there(sensor: Sensor) -> None:
    assert isinstance(open_source("auto"), RaspberrySource)
    assert [fact.id for fact in available_sources() if fact.available] == [
        "raspberry", "twin:live", "folder", "micromanager", "genicam",
    ]  # fmt: skip
    with pytest.raises(CameraError, match="no camera number 1"):
        open_source("raspberry:1").open()


def test_without_picamera2(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "picamera2", None)
    with pytest.raises(CameraError, match=r"apt install python3-picamera2.*system-site-packages"):
        RaspberrySource().open()


def test_a_numpy_that_the_system_was_not_made_for(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "picamera2":
                raise ValueError("numpy.dtype size changed, may indicate binary incompatibility")

    monkeypatch.delitem(sys.modules, "picamera2", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    with pytest.raises(CameraError, match=r"numpy.dtype size changed.*'numpy<2'"):
        RaspberrySource().open()
