"""Cameras of the Raspberry Pi, by way of Picamera2."""

import re
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray

from nolens.camera import MOSAICS, Frame
from nolens.capture.picamera import camera_trouble, connected_models, load_picamera2
from nolens.capture.source import CameraSource, Limits, Shot
from nolens.errors import CameraError

_FORMAT = re.compile(r"(?:S?([RGB]{4})|R|MONO)(\d+)?(?:_(\w+))?")
"""Of raw pixels: colours of the mosaic (none for monochrome sensors), bits, packing."""
_COMPRESSED = ("PISP_COMP1", "PISP_COMP2")
_DEFAULT_S = 0.01
_PATIENCE_S = 5.0
"""For a frame, beyond what its exposure and those before it take."""
_PIPELINE = 4
"""Exposures that are under way when a new exposure time is asked for."""
_SETTLED = 12
"""Frames after which a setting is in effect, though it is not quite what was asked for."""
_MOST_FRAMES = 30
"""After which a camera that does not take a setting is given up."""
_NEAR, _ROUGH = 0.02, 0.25
_LINE_S, _GAIN_STEP = 3e-5, 0.05
"""Sensors expose whole lines, and their gain goes in steps: what is near was asked for."""
_MODULES = Path("/sys/module")
"""Of the kernel: parameters of the sensor's driver."""
_DETAILS = ("SensorTemperature", "DigitalGain", "ColourTemperature", "Lux", "FrameDuration")


class RaspberrySource(CameraSource):
    """The first camera of a Raspberry Pi: all pixels, undeveloped, exposure and gain fixed.

    Parameters
    ----------
    number
        Which camera, from 0, where there are several.
    """

    def __init__(self, number: int = 0) -> None:
        self._number = number
        self._device: Any = None
        self._model = "camera"
        self._limits: Limits | None = None
        self._target: tuple[float, float] | None = None
        self._longest_s = 0.0
        self._settled = False
        self._bits = 12

    @classmethod
    def of(cls, text: str, **_: object) -> Self | None:
        """The source of ``raspberry`` or ``raspberry:1``, for `open_source`."""
        return cls(int(text or 0)) if not text or text.isdecimal() else None

    @property
    def name(self) -> str:
        """Such as ``Raspberry Pi imx477``."""
        return f"Raspberry Pi {self._model}"

    @property
    def limits(self) -> Limits | None:
        """What it can be set to; None before it is open."""
        return self._limits

    def open(self) -> None:
        """Configure the camera for all its pixels as unpacked raw, and start it."""
        if self._device is not None:
            return
        models = connected_models()
        if self._number >= len(models):
            raise CameraError(
                f"there is no camera number {self._number}: this Raspberry Pi has {len(models)} "
                f"({', '.join(models)}), counted from 0"
            )
        module = load_picamera2()
        try:
            device = module.Picamera2(self._number)
        except (RuntimeError, IndexError, OSError) as error:
            raise CameraError(camera_trouble(error)) from error
        try:
            self._configure(device)
            device.start()
        except CameraError:
            _close(device)
            raise
        except (RuntimeError, OSError, ValueError) as error:
            _close(device)
            raise CameraError(camera_trouble(error)) from error
        self._device = device
        exposure_s, gain = self._target or (_DEFAULT_S, 1.0)
        limits = self._limits
        assert limits is not None
        self._target = None
        self.set(
            exposure_s=min(max(exposure_s, limits.exposure_s[0]), limits.exposure_s[1]),
            gain=min(max(gain, limits.gain[0]), limits.gain[1]),
        )

    def set(self, *, exposure_s: float, gain: float) -> None:
        """Set exposure time and gain of all shots from the next one on."""
        device = self._open_device()
        assert self._limits is not None
        self._limits.check(exposure_s, gain)
        before = self._target[0] if self._target is not None else exposure_s
        self._longest_s = max(before, exposure_s)
        self._target = exposure_s, gain
        self._settled = False
        device.set_controls({"ExposureTime": round(1e6 * exposure_s), "AnalogueGain": float(gain)})

    def shot(self) -> Shot:
        """Wait for the next frame that was exposed as set."""
        device = self._open_device()
        assert self._target is not None
        exposure_s, gain = self._target
        for number in range(_MOST_FRAMES):
            request = self._next(device)
            try:
                metadata = request.get_metadata()
                near = _NEAR if number < _SETTLED else _ROUGH
                if not (self._settled or _is_as_set(metadata, exposure_s, gain, near)):
                    continue
                taken = datetime.now(UTC)
                values = request.make_array("raw")
            finally:
                request.release()
            self._longest_s, self._settled = exposure_s, True
            return self._shot(values, device.camera_configuration()["raw"], metadata, taken)
        used_s, used_gain = _used(metadata)
        raise CameraError(
            f"{self.name} was asked for {1e3 * exposure_s:g} ms at gain {gain:g}, and still "
            f"exposes {1e3 * used_s:g} ms at gain {used_gain:g} after {_MOST_FRAMES} frames: "
            "another program may set it, or its driver has other limits; try another exposure"
        )

    def close(self) -> None:
        """Give the camera back."""
        device, self._device = self._device, None
        if device is not None:
            _close(device)

    def _open_device(self) -> Any:
        if self._device is None:
            raise CameraError(f"{self.name} is not open, or was closed: open it first")
        return self._device

    def _configure(self, device: Any) -> None:
        """Ask for unpacked raw of all pixels, nothing corrected; check what the camera gives."""
        self._model = str(device.camera_properties.get("Model", "camera"))
        native = str(device.sensor_format)
        sensor = _FORMAT.fullmatch(native)
        if sensor is None:
            raise CameraError(
                f"{self._model} gives finished pictures ({native}), not the counts of its pixels: "
                "a camera with a raw mode is needed, such as the Raspberry Pi HQ camera"
            )
        # A compressed mode is told by 16 bits, which no sensor has.
        bits = int(sensor[2]) if sensor[2] and sensor[3] not in _COMPRESSED else 12
        kind = f"S{sensor[1]}" if sensor[1] else "R"
        fixed = {"AeEnable": False, "AwbEnable": False, "NoiseReductionMode": 0}
        config = device.create_still_configuration(
            main={"size": (640, 480)},
            raw={"format": f"{kind}{bits}", "size": tuple(device.sensor_resolution)},
            buffer_count=2,
            queue=False,
        )
        device.configure(config)
        configuration = device.camera_configuration()
        raw = configuration.get("raw")
        if raw is None:
            raise CameraError(
                f"{self._model} gives no raw stream: a camera with a raw mode is needed, such as "
                "the Raspberry Pi HQ camera"
            )
        match = _FORMAT.fullmatch(str(raw["format"]))
        if match is None or match[3] is not None or match[2] is None:
            raise CameraError(_refused(self._model, str(raw["format"]), f"{kind}{bits}"))
        self._bits = int((configuration.get("sensor") or {}).get("bit_depth") or bits)
        offered = device.camera_controls
        device.set_controls({name: value for name, value in fixed.items() if name in offered})
        exposure, gain = offered["ExposureTime"], offered["AnalogueGain"]
        self._limits = Limits(
            (1e-6 * max(1, exposure[0]), 1e-6 * exposure[1]), (float(gain[0]), float(gain[1]))
        )

    def _next(self, device: Any) -> Any:
        patience_s = _PATIENCE_S + _PIPELINE * self._longest_s
        try:
            return device.capture_request(wait=patience_s)
        except (TimeoutError, RuntimeError, OSError) as error:
            with suppress(Exception):
                device.cancel_all_and_flush()
            self.close()
            raise CameraError(
                f"{self.name} gave no frame for {patience_s:.0f} s: it was unplugged, or its cable "
                "is loose. Put it right with the power off, and start again"
            ) from error

    def _shot(
        self, values: NDArray[Any], raw: dict[str, Any], metadata: dict[str, Any], taken: datetime
    ) -> Shot:
        frame = frame_of(values, raw, metadata, self._bits, self.name)
        exposure_s, gain = _used(metadata)
        details: dict[str, float | int | str] = {
            "format": str(raw["format"]),
            "sensor_bits": self._bits,
        }
        correction = _MODULES / self._model / "parameters" / "dpc_enable"
        with suppress(OSError):  # Most sensors' drivers have none.
            details["defect_correction"] = int(correction.read_text().strip() not in ("0", "N"))
        for key in _DETAILS:
            if isinstance(metadata.get(key), (int, float)):
                details[key] = metadata[key]
        return Shot(frame, taken, exposure_s, gain, self.name, details)


def frame_of(
    values: NDArray[Any], raw: dict[str, Any], metadata: dict[str, Any], bits: int, source: str
) -> Frame:
    """Frame of a buffer of unpacked raw.

    Parameters
    ----------
    values
        uint8, (rows, stride), as `make_array` gives it: two bytes to a pixel, then padding.
    raw
        Configuration of the raw stream.
    metadata
        Of the request.
    bits
        Of the sensor.
    source
        Name of the camera.
    """
    width, height = raw["size"]
    match = _FORMAT.fullmatch(str(raw["format"]))
    assert match is not None and match[2] is not None
    stored = int(match[2])
    rows = np.ascontiguousarray(values[:height])
    pixels = rows.view("<u2" if stored > 8 else "u1")[:, :width]
    # The Pi 5 fills 16 bits up with zeros below the sensor's; they are taken away again.
    padding = 2 ** (stored - bits) if stored > bits else 1
    if padding > 1 and np.any(pixels % padding):
        padding, bits = 1, stored
    counts = torch.from_numpy((pixels // padding).astype(np.float32))[None]
    # Stated for 16 bits, whatever the sensor has.
    levels = metadata.get("SensorBlackLevels")
    black = tuple(float(level) / 2 ** (16 - bits) for level in levels) if levels else (0.0,)
    mosaic = match[1]
    assert mosaic is None or mosaic in MOSAICS
    if mosaic is not None and len(black) == 4:
        black = _by_place(black, mosaic)
    return Frame(
        counts=counts,
        channels=("grey",) if mosaic is None else ("mosaic",),
        mosaic=mosaic,
        black=black if len(set(black)) > 1 and mosaic is not None else black[:1],
        white=float(2**bits - 1),
        stored_as="uint16",
        source=source,
        exposure_s=_used(metadata)[0],
        black_stated=bool(levels),
    )


def _by_place(black: tuple[float, ...], mosaic: str) -> tuple[float, ...]:
    """Levels of the mosaic's 2×2 pixels, row by row; `black` is of R, both greens and B."""
    red, beside_red, beside_blue, blue = black
    rows = (mosaic[:2], mosaic[2:])
    greens = [beside_red if "R" in row else beside_blue for row in rows]
    by_colour = {"R": red, "B": blue}
    return tuple(by_colour.get(colour, greens[n]) for n, row in enumerate(rows) for colour in row)


def _used(metadata: dict[str, Any]) -> tuple[float, float]:
    """Exposure time in s and gain that a frame really had."""
    return 1e-6 * float(metadata["ExposureTime"]), float(metadata["AnalogueGain"])


def _is_as_set(metadata: dict[str, Any], exposure_s: float, gain: float, near: float) -> bool:
    used_s, used_gain = _used(metadata)
    return (
        abs(used_s - exposure_s) <= max(near * exposure_s, _LINE_S)
        and abs(used_gain - gain) <= max(near, _GAIN_STEP) * gain
    )


def _refused(model: str, stream: str, mode: str) -> str:
    what = "compressed, with a loss" if "COMP" in stream else "packed"
    return (
        f"{model} gives its raw as {stream}, which is {what}, though {mode} was asked for: bring "
        "Picamera2 and libcamera up to date (sudo apt full-upgrade). Until then, take frames with "
        "rpicam-still --raw --mode 4056:3040:12:U (U is for unpacked), and give nolens their "
        "folder: --source folder:PATH"
    )


def _close(device: Any) -> None:
    # A camera that was unplugged raises whatever it can.
    with suppress(Exception):
        device.stop()
    with suppress(Exception):
        device.close()
