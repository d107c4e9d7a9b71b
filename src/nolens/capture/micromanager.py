"""Cameras of Micro-Manager, by way of pymmcore."""

import difflib
import os
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Self

import numpy as np

from nolens.capture.device import (
    PATIENCE_S,
    DeviceName,
    FrameCounter,
    burst_room,
    choose_device,
    frame_of_counts,
    load_driver,
)
from nolens.capture.source import CameraSource, Limits, Shot
from nolens.errors import CameraError, OptionError

FOLDER = "MICROMANAGER_PATH"
"""Variable of the environment with the folder of Micro-Manager, where its device adapters are."""
_DEVICE = "camera"
"""Label of the device that is loaded."""
_EXPOSURES_S = (1e-6, 3600.0)
"""Where the device says no limits."""
_BLACK = ("BlackLevel", "Black Level")
_DEEP = ("16bit", "16-bit", "Mono16", "GREY16", "16bit mono")
"""Values of PixelType that have all bits of a sensor."""
_INTEGER = 3
"""The kind of a property, MM::Integer."""
_POLL_S = 1e-3


class MicroManagerSource(CameraSource):
    """A camera that Micro-Manager has a device adapter for.

    Parameters
    ----------
    device
        ``ADAPTER``, ``ADAPTER:DEVICE``, ``CONFIGURATION.cfg`` or ``CONFIGURATION.cfg:LABEL``, and
        settings.
    mosaic
        Colours of the sensor's superpixel, which adapters do not say.
    warn
        Called with a sentence about frames that were lost.
    """

    def __init__(
        self,
        device: DeviceName,
        mosaic: str | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> None:
        self._asked, self._mosaic, self._warn = device, mosaic, warn
        self._core: Any = None
        self._label = _DEVICE
        self._limits: Limits | None = None
        self._gain: str | None = None
        self._name = f"Micro-Manager {device.name}"

    @classmethod
    def of(
        cls,
        text: str,
        *,
        mosaic: str | None = None,
        warn: Callable[[str], None] | None = None,
        **_: object,
    ) -> Self | None:
        """The source of ``micromanager:ADAPTER:DEVICE``, for `open_source`."""
        return cls(DeviceName.of(text), mosaic, warn)

    @property
    def name(self) -> str:
        """Such as ``Micro-Manager DemoCamera DCam``."""
        return self._name

    @property
    def limits(self) -> Limits | None:
        """What it can be set to; None before it is open."""
        return self._limits

    def open(self) -> None:
        """Load the device, with all bits of its sensor unless a configuration says otherwise."""
        if self._core is not None:
            return
        module = load_driver("pymmcore", "pymmcore", "micromanager")
        core = module.CMMCore()
        core.enableStderrLog(False)
        core.setDeviceAdapterSearchPaths(_folders())
        try:
            configuration, mark, label = self._asked.name.partition(".cfg")
            if mark:
                self._configured(core, f"{configuration}{mark}", label.removeprefix(":"), module)
            else:
                self._loaded(core, module)
            for name, value in self._asked.settings.items():
                _set_property(core, self._label, name, value)
            self._limits = self._known_limits(core)
        except BaseException:
            with suppress(RuntimeError):
                core.reset()
            raise
        self._core = core

    def _configured(self, core: Any, file: str, label: str, module: Any) -> None:
        if not Path(file).is_file():
            raise CameraError(f"there is no file {file}: give a configuration of Micro-Manager")
        with _trouble(file):
            core.loadSystemConfiguration(file)
        cameras = core.getLoadedDevicesOfType(module.CameraDevice)
        number = choose_device(label, cameras, f"camera in {file}", f"micromanager:{file}:{{}}")
        self._label, self._name = cameras[number], f"Micro-Manager {cameras[number]}"
        core.setCameraDevice(self._label)

    def _loaded(self, core: Any, module: Any) -> None:
        adapter, _, device = self._asked.name.partition(":")
        adapters = core.getDeviceAdapterNames()
        if not adapters:
            raise CameraError(
                "no device adapter of Micro-Manager is in "
                f"{', '.join(_folders()) or 'any folder'}: install Micro-Manager, and set {FOLDER} "
                "to its folder (docs/cameras.md)"
            )
        at = choose_device(adapter, adapters, "device adapter", "micromanager:{}")
        adapter = adapters[at]
        with _trouble(adapter):
            names = core.getAvailableDevices(adapter)
            kinds = core.getAvailableDeviceTypes(adapter)
        cameras = [
            name
            for name, kind in zip(names, kinds, strict=True)
            if kind == int(module.CameraDevice)
        ]
        usage = f"micromanager:{adapter}:{{}}"
        device = cameras[choose_device(device, cameras, f"camera of {adapter}", usage)]
        self._name = f"Micro-Manager {adapter} {device}"
        with _trouble(self._name):
            core.loadDevice(self._label, adapter, device)
            core.initializeDevice(self._label)
            core.setCameraDevice(self._label)
        _all_bits(core, self._label)

    def _known_limits(self, core: Any) -> Limits:
        has, label = core.getDevicePropertyNames(self._label), self._label
        exposures = _EXPOSURES_S
        if "Exposure" in has and core.hasPropertyLimits(label, "Exposure"):
            low, high = _range(core, label, "Exposure")
            exposures = max(1e-3 * low, _EXPOSURES_S[0]), 1e-3 * high
        self._gain = None
        if "Gain" in has and core.hasPropertyLimits(label, "Gain"):
            self._gain = "Gain"
        return Limits(exposures, (1.0, 1.0) if self._gain is None else _range(core, label, "Gain"))

    def set(self, *, exposure_s: float, gain: float) -> None:
        """Set exposure time, and the property Gain where the device has one."""
        core = self._open_core()
        assert self._limits is not None
        self._limits.check(exposure_s, gain)
        with _trouble(self.name):
            core.setExposure(self._label, 1e3 * exposure_s)
            if self._gain is not None:
                whole = core.getPropertyType(self._label, self._gain) == _INTEGER
                core.setProperty(self._label, self._gain, round(gain) if whole else gain)

    def shot(self) -> Shot:
        """Expose one frame, as set, and hand it over."""
        core = self._open_core()
        with _trouble(self.name):
            core.snapImage()
            return self._shot(core.getImage(), datetime.now(UTC), {})

    def burst(self, frames: int) -> Generator[Shot]:
        """Frames one after the other, as fast as the device takes them.

        Raises
        ------
        CameraError
            If frames are lost, with their number.
        """
        core, counter = self._open_core(), FrameCounter(self._warn)
        module = load_driver("pymmcore", "pymmcore", "micromanager")
        with _trouble(self.name):
            self._make_room(frames)
            core.startSequenceAcquisition(self._label, frames, 0.0, True)
        try:
            for _ in range(frames):
                self._wait(counter, frames)
                told = module.Metadata()
                with _trouble(self.name):
                    image = core.popNextImageMD(told)
                taken = datetime.now(UTC)
                number = int(told.GetSingleTag("ImageNumber").GetValue())
                counter.count(number)
                yield self._shot(image, taken, {"frame_number": number})
        finally:
            with suppress(RuntimeError):
                core.stopSequenceAcquisition(self._label)
        counter.finish(self.name)

    def _make_room(self, frames: int) -> None:
        core = self._core
        size = core.getImageWidth() * core.getImageHeight() * core.getBytesPerPixel()
        room = min(2 * frames * size, burst_room())
        megabytes = int(room / 2**20) + 1
        if megabytes > core.getCircularBufferMemoryFootprint():
            core.setCircularBufferMemoryFootprint(megabytes)

    def _wait(self, counter: FrameCounter, frames: int) -> None:
        core = self._core
        until = time.monotonic() + 1e-3 * core.getExposure() + PATIENCE_S
        while core.getRemainingImageCount() == 0:
            ended = not core.isSequenceRunning(self._label)
            # A frame may have come between the two questions.
            if (ended and core.getRemainingImageCount() == 0) or time.monotonic() > until:
                full = "its buffer was full" if core.isBufferOverflowed() else "it gave no more"
                raise CameraError(
                    f"{frames - counter.taken} of {frames} frames of {self.name} were lost, as "
                    f"{full}: take a longer exposure, fewer frames or fewer pixels, or write to a "
                    "faster disk"
                )
            time.sleep(_POLL_S)

    def close(self) -> None:
        """Give the camera back."""
        core, self._core = self._core, None
        if core is not None:
            with suppress(RuntimeError):
                core.reset()

    def _open_core(self) -> Any:
        if self._core is None:
            raise CameraError(f"{self.name} is not open, or was closed: open it first")
        return self._core

    def _shot(self, image: Any, taken: datetime, details: dict[str, float | int | str]) -> Shot:
        core, label = self._open_core(), self._label
        counts = np.asarray(image)
        if counts.ndim != 2 or counts.dtype not in (np.uint8, np.uint16):
            raise CameraError(
                f"{self.name} gives {counts.dtype.name} of shape {counts.shape}, and counts of 8 "
                f"or 16 bits are needed: add a setting such as {self._asked.name},PixelType=16bit"
            )
        exposure_s = 1e-3 * core.getExposure(label)
        has = core.getDevicePropertyNames(label)
        black = next((float(core.getProperty(label, each)) for each in _BLACK if each in has), None)
        frame = frame_of_counts(
            counts,
            self.name,
            bits=core.getImageBitDepth(),
            mosaic=self._mosaic,
            black=black,
            exposure_s=exposure_s,
        )
        gain = 1.0 if self._gain is None else float(core.getProperty(label, self._gain))
        return Shot(frame, taken, exposure_s, gain, self.name, details)


def _folders() -> list[str]:
    """Where device adapters are looked for: Micro-Manager's, and those of mm-test-adapters."""
    folders = [os.environ[FOLDER]] if os.environ.get(FOLDER) else []
    if not folders and find_spec("mm_test_adapters") is not None:
        import mm_test_adapters

        folders.append(str(mm_test_adapters.device_adapter_path()))
    return folders


def _all_bits(core: Any, label: str) -> None:
    """Choose the most bits, up to 16, of a device that has the usual properties."""
    has = core.getDevicePropertyNames(label)
    if "PixelType" in has:
        deep = [e for e in core.getAllowedPropertyValues(label, "PixelType") if e in _DEEP]
        if deep:
            core.setProperty(label, "PixelType", deep[0])
    if "BitDepth" in has:
        allowed = core.getAllowedPropertyValues(label, "BitDepth")
        bits = [int(e) for e in allowed if e.isdecimal() and int(e) <= 16]
        if bits:
            core.setProperty(label, "BitDepth", max(bits))


def _set_property(core: Any, label: str, name: str, value: str) -> None:
    has = core.getDevicePropertyNames(label)
    if name not in has:
        near = difflib.get_close_matches(name, has, n=1)
        known = f"did you mean {near[0]}?" if near else f"it has {', '.join(has)}"
        raise OptionError(f"{name}={value}: the camera has no such property; {known}")
    allowed = core.getAllowedPropertyValues(label, name)
    try:
        core.setProperty(label, name, value)
    except RuntimeError as error:
        known = f"; accepted are {', '.join(allowed)}" if allowed else ""
        if core.hasPropertyLimits(label, name):
            low, high = _range(core, label, name)
            known = f"; accepted are {low:g} to {high:g}"
        raise OptionError(f"{name}={value} is not taken by the camera{known}") from error


def _range(core: Any, label: str, name: str) -> tuple[float, float]:
    return core.getPropertyLowerLimit(label, name), core.getPropertyUpperLimit(label, name)


@contextmanager
def _trouble(name: str) -> Iterator[None]:
    """Say what an error of a device adapter means, and what to do."""
    try:
        yield
    except CameraError:
        raise
    except (RuntimeError, OSError, ValueError, IndexError, MemoryError) as error:
        raise CameraError(
            f"{name} does not work ({error}): see that it is connected and has power, that no "
            "other program uses it, and that Micro-Manager itself shows its picture"
        ) from error
