"""A stand-in for Picamera2, as far as its documented behaviour matters here.

Its camera has a sensor of 12 bits behind a mosaic, whose rows are padded to a stride; settings come
into effect some frames after they were asked for; exposure times are whole lines.
"""

import importlib.machinery
import types
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Sensor:
    """What the camera is, and what goes wrong with it."""

    def __init__(self) -> None:
        self.model = "imx477"
        self.size = (60, 40)
        self.native = "SRGGB12_CSI2P"
        self.given = "SBGGR12"
        self.bits = 12
        self.stride = 128 + 32
        self.delay = 3
        self.line_us = 23.5
        self.black = (4096, 4096, 4096, 4096)
        self.exposure_us = (114, 694422939, 20000)
        self.gain = (1.0, 22.26, 1.0)
        self.pixels = np.arange(40 * 60, dtype=np.uint16).reshape(40, 60) % 4096
        self.light: Callable[[int], NDArray[np.uint16]] | None = None
        self.connected = True
        self.busy = False
        self.unplugged_after: int | None = None
        self.ignores = False
        self.log: list[str] = []
        self.controls: dict[str, Any] = {}
        self.configured: dict[str, Any] = {}
        self.held = 0
        self.frames = 0

    def counts(self) -> NDArray[np.uint16]:
        """Of the newest frame; `light` gives those of each by its number."""
        return self.pixels if self.light is None else self.light(self.frames)


class Request:
    def __init__(self, sensor: Sensor, exposure_us: int, gain: float) -> None:
        self.sensor, self.exposure_us, self.gain = sensor, exposure_us, gain
        self.values = sensor.counts()
        sensor.held += 1

    def make_array(self, name: str) -> Any:
        assert name == "raw"
        sensor = self.sensor
        width, height = sensor.size
        values = self.values.astype("<u2")
        if sensor.given.endswith("16"):
            values = (values << (16 - sensor.bits)).astype("<u2")
        rows = np.full((height, sensor.stride), 0xEE, dtype=np.uint8)
        rows[:, : 2 * width] = np.ascontiguousarray(values).view(np.uint8)
        return rows

    def get_metadata(self) -> dict[str, Any]:
        lines = max(1, round(self.exposure_us / self.sensor.line_us))
        return {
            "ExposureTime": int(lines * self.sensor.line_us),
            "AnalogueGain": 1024 / (1024 - round(1024 - 1024 / self.gain)),
            "DigitalGain": 1.0,
            "SensorBlackLevels": self.sensor.black,
            "SensorTemperature": 31.0,
            "ColourGains": (1.0, 1.0),
            "Lux": 12.5,
        }

    def release(self) -> None:
        self.sensor.held -= 1


def module(sensor: Sensor) -> types.ModuleType:
    """The module, to be put into sys.modules."""

    class Picamera2:
        def __init__(self, camera_num: int = 0) -> None:
            if sensor.busy:
                try:
                    raise RuntimeError("Failed to acquire camera: Device or resource busy")
                except RuntimeError:
                    # This one is all that a program sees; libcamera's is its context.
                    raise RuntimeError("Camera __init__ sequence did not complete.")  # noqa: B904
            self.sensor_format = sensor.native
            self.sensor_resolution = sensor.size
            self.camera_properties = {"Model": sensor.model, "Rotation": 180}
            self.started = False
            self._config: dict[str, Any] | None = None
            self._pending: list[tuple[int, float]] = []
            self._now = (20000, 1.0)
            sensor.log.append("open")

        @staticmethod
        def global_camera_info() -> list[dict[str, Any]]:
            return [{"Model": sensor.model, "Num": 0}] if sensor.connected else []

        @property
        def camera_controls(self) -> dict[str, Any]:
            found = {
                "AeEnable": (False, True, None),
                "NoiseReductionMode": (0, 4, 0),
                "ExposureTime": sensor.exposure_us,
                "AnalogueGain": sensor.gain,
                "FrameDurationLimits": (100000, 694434742, None),
            }
            if "RGGB" in sensor.native:
                found["AwbEnable"] = (False, True, None)
            return found

        def create_still_configuration(
            self, main: Any = None, lores: Any = None, raw: Any = None, buffer_count: int = 1,
            controls: Any = None, queue: bool = True, sensor: Any = None,
        ) -> dict[str, Any]:  # fmt: skip
            assert set(raw) <= {"format", "size", "stride"}
            return {"main": main, "raw": dict(raw), "buffer_count": buffer_count, "queue": queue}

        def configure(self, config: dict[str, Any]) -> None:
            assert not self.started, "Camera must be stopped before configuring"
            sensor.configured = config
            self._config = {
                **config,
                "raw": {**config["raw"], "format": sensor.given, "stride": sensor.stride},
                "sensor": {"bit_depth": sensor.bits, "output_size": sensor.size},
            }

        def camera_configuration(self) -> dict[str, Any]:
            assert self._config is not None
            return self._config

        def set_controls(self, controls: dict[str, Any]) -> None:
            for name in controls:
                if name not in self.camera_controls:
                    raise RuntimeError(f"Control {name} is not advertised by libcamera")
            assert isinstance(controls.get("ExposureTime", 0), int)
            sensor.controls |= controls
            if "ExposureTime" in controls and not sensor.ignores:
                setting = controls["ExposureTime"], controls["AnalogueGain"]
                self._pending += [self._now] * sensor.delay + [setting]

        def start(self) -> None:
            assert self._config is not None, "Camera has not been configured"
            self.started = True
            sensor.log.append("start")

        def capture_request(self, wait: float | None = None) -> Request:
            assert self.started
            assert isinstance(wait, float) and wait > 1e-6 * self._now[0]
            # With two buffers, a third request that is never released would stall the camera.
            assert sensor.held < 2
            sensor.frames += 1
            if sensor.unplugged_after is not None and sensor.frames > sensor.unplugged_after:
                raise TimeoutError
            if self._pending:
                self._now = self._pending.pop(0)
            return Request(sensor, *self._now)

        def cancel_all_and_flush(self) -> None:
            sensor.log.append("flush")

        def stop(self) -> None:
            self.started = False

        def close(self) -> None:
            sensor.log.append("close")

    made = types.ModuleType("picamera2")
    made.__spec__ = importlib.machinery.ModuleSpec("picamera2", None)
    made.Picamera2 = Picamera2  # type: ignore[attr-defined]
    return made
