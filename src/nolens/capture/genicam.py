"""GenICam cameras (GigE, USB3, CoaXPress), by way of harvesters and a GenTL producer."""

import logging
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

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
from nolens.files.packed import PixelFormat

FOLDERS = "GENICAM_GENTL64_PATH"
"""Variable of the environment with the folders of GenTL producers (GenICam GenTL 1.6, 2.3)."""
_AUTOMATIC = ("ExposureAuto", "GainAuto", "BlackLevelAuto", "BalanceWhiteAuto")
_COLOURS = {"RGB8": (0, 1, 2), "BGR8": (2, 1, 0), "RGBa8": (0, 1, 2), "BGRa8": (2, 1, 0)}
"""Places of R, G and B in finished colours, which are taken where there is no other format."""
_TRIGGER_S = 3600.0
_POLL_S = 0.5
_MOST_BUFFERS, _FEWEST_BUFFERS = 500, 4


class GenicamSource(CameraSource):
    """A camera that describes itself by GenICam.

    Parameters
    ----------
    device
        A part of its model, serial number or id, or ``PRODUCER.cti:NAME``; and values of its
        features, in their order.
    mosaic
        Colours of the sensor's superpixel, where the format of its pixels does not say them.
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
        self._harvester: Any = None
        self._acquirer: Any = None
        self._limits: Limits | None = None
        self._name = f"GenICam {device.name or 'camera'}"

    @classmethod
    def of(
        cls,
        text: str,
        *,
        mosaic: str | None = None,
        warn: Callable[[str], None] | None = None,
        **_: object,
    ) -> Self | None:
        """The source of ``genicam:NAME``, for `open_source`."""
        return cls(DeviceName.of(text), mosaic, warn)

    @property
    def name(self) -> str:
        """Such as ``GenICam Basler acA1300-30gc 21334``."""
        return self._name

    @property
    def limits(self) -> Limits | None:
        """What it can be set to, known once it is open; None where nothing can be set."""
        return self._limits

    def open(self) -> None:
        """Connect the camera, with everything automatic off and its pixels undeveloped."""
        if self._acquirer is not None:
            return
        core = load_driver("harvesters.core", "harvesters", "genicam")
        producer, mark, asked = self._asked.name.rpartition(".cti")
        files = [Path(f"{producer}{mark}")] if mark else _producers()
        if not files:
            raise CameraError(
                "no GenTL producer (.cti) is found: install the driver of the camera's maker, and "
                f"set {FOLDERS} to the folder of its .cti, or give genicam:FILE.cti "
                "(docs/cameras.md)"
            )
        # Its errors become ours.
        logging.getLogger("harvesters").setLevel(logging.CRITICAL + 1)
        self._harvester = core.Harvester()
        try:
            for file in files:
                if not file.is_file():
                    raise CameraError(f"there is no GenTL producer {file}: give its .cti")
                with _trouble(str(file)):
                    self._harvester.add_file(str(file), check_existence=True, check_validity=True)
            self._harvester.update()
            names = [_device_name(each) for each in self._harvester.device_info_list]
            asked = asked.removeprefix(":")
            number = choose_device(asked, names, "GenICam camera", "'genicam:{}'")
            self._name = f"GenICam {names[number]}"
            with _trouble(self._name), _interrupt_kept():
                self._acquirer = self._harvester.create(number)
            self._configure()
        except BaseException:
            self.close()
            raise

    def _configure(self) -> None:
        for name in _AUTOMATIC:
            self._try("Off", name)
        self._try(False, "GammaEnable")
        asked = self._asked.settings
        if "PixelFormat" not in asked:
            formats = getattr(self._node("PixelFormat"), "symbolics", ())
            best = max(formats, key=_worth, default=None)
            if best is not None:
                self._try(best, "PixelFormat")
        if "TriggerMode" not in asked:
            self._try("On" if "TriggerSource" in asked else "Off", "TriggerMode")
        for name, value in asked.items():
            self._set_feature(name, value)
        self._try("Continuous", "AcquisitionMode")
        exposure, gain = self._node("ExposureTime"), self._node("Gain")
        if exposure is not None:
            self._limits = Limits(
                (1e-6 * exposure.min, 1e-6 * exposure.max),
                (1.0, 1.0) if gain is None else (_factor(gain, gain.min), _factor(gain, gain.max)),
            )

    def set(self, *, exposure_s: float, gain: float) -> None:
        """Set exposure time and gain, as a factor where the camera says dB."""
        self._open_acquirer()
        if self._limits is None:
            raise OptionError(f"{self.name} has no exposure time that can be set")
        self._limits.check(exposure_s, gain)
        with _trouble(self.name):
            self._node("ExposureTime").value = 1e6 * exposure_s
            node = self._node("Gain")
            if node is not None:
                node.value = 20 * math.log10(gain) if _in_decibels(node) else gain

    def shot(self) -> Shot:
        """Take the first frame that is exposed from now on, and hand it over."""
        with closing(self._frames(1, FrameCounter(None))) as frames:
            return next(frames)

    def burst(self, frames: int) -> Generator[Shot]:
        """Frames one after the other, as fast as the camera or its trigger gives them.

        Frames that are lost between them are counted by the camera's own numbers.

        Raises
        ------
        CameraError
            If no frame comes any more.
        """
        counter = FrameCounter(self._warn)
        yield from self._frames(frames, counter)
        counter.finish(self.name)

    def _frames(self, frames: int, counter: FrameCounter) -> Generator[Shot]:
        acquirer = self._open_acquirer()
        by_software = self._value("TriggerMode") == "On" and (
            self._value("TriggerSource") == "Software"
        )
        with _trouble(self.name):
            acquirer.num_buffers = self._buffers(frames)
            acquirer.start()
        try:
            for _ in range(frames):
                if by_software:
                    with _trouble(self.name):
                        self._node("TriggerSoftware").execute()
                buffer = self._fetch(counter)
                try:
                    shot = self._shot(buffer)
                finally:
                    with _trouble(self.name):
                        buffer.queue()
                counter.count(int(shot.details["frame_number"]))
                yield shot
        finally:
            with suppress(Exception):
                acquirer.stop()

    def _buffers(self, frames: int) -> int:
        size = self._value("PayloadSize")
        room = burst_room()
        most = int(room / size) if isinstance(size, int) and size > 0 else _MOST_BUFFERS
        return max(_FEWEST_BUFFERS, min(frames, most, _MOST_BUFFERS))

    def _fetch(self, counter: FrameCounter) -> Any:
        exposure_s = 1e-6 * (self._value("ExposureTime") or 0.0)
        waits = self._value("TriggerMode") == "On"
        patience = exposure_s + (_TRIGGER_S if waits else PATIENCE_S)
        until = time.monotonic() + patience
        while time.monotonic() < until:
            with _trouble(self.name):
                buffer = self._open_acquirer().try_fetch(timeout=_POLL_S)
            if buffer is not None:
                return buffer
        why = (
            f"its trigger ({self._value('TriggerSource')}) did not come"
            if waits
            else "it may be unplugged, or its network too slow"
        )
        raise CameraError(
            f"{self.name} gave no frame in {patience:g} s after {counter.taken} frames: {why}"
        )

    def close(self) -> None:
        """Give the camera back."""
        acquirer, self._acquirer = self._acquirer, None
        harvester, self._harvester = self._harvester, None
        with suppress(Exception):
            if acquirer is not None:
                acquirer.destroy()
        with suppress(Exception):
            if harvester is not None:
                harvester.reset()

    def _open_acquirer(self) -> Any:
        if self._acquirer is None:
            raise CameraError(f"{self.name} is not open, or was closed: open it first")
        return self._acquirer

    def _node(self, name: str) -> Any:
        """A feature of the camera; None where it has none of that name."""
        return getattr(self._open_acquirer().remote_device.node_map, name, None)

    def _value(self, name: str) -> Any:
        try:
            return self._node(name).value
        except Exception:  # It is missing, or cannot be read as the camera is set.
            return None

    def _try(self, value: Any, name: str) -> None:
        """Set a feature where the camera has it and lets it be set."""
        with suppress(Exception):
            self._node(name).value = value

    def _set_feature(self, name: str, value: str) -> None:
        node = self._node(name)
        if node is None:
            raise OptionError(
                f"{name}={value}: {self.name} has no such feature; its names are those of GenICam "
                "(SFNC), such as TriggerSource"
            )
        try:
            now = node.value
            kind = type(now) if isinstance(now, int | float) else str
            node.value = value.lower() in ("1", "true", "on") if kind is bool else kind(value)
        except Exception as error:
            allowed = getattr(node, "symbolics", ())
            known = f"accepted are {', '.join(allowed)}" if allowed else str(error)
            raise OptionError(f"{name}={value} is not taken by {self.name}: {known}") from error

    def _shot(self, buffer: Any) -> Shot:
        taken = datetime.now(UTC)
        with _trouble(self.name):
            component = buffer.payload.components[0]
            form, number = str(component.data_format), int(buffer.frame_id)
            counts = _counts(component)
        bits, mosaic = 8, None
        if form not in _COLOURS:
            try:
                pixels = PixelFormat.of(form)
            except OptionError as error:
                raise CameraError(f"{self.name}: {error}") from error
            bits, mosaic = pixels.bits, pixels.mosaic
        else:
            counts = counts[..., _COLOURS[form]]
        exposure_s = 1e-6 * (self._value("ExposureTime") or 0.0)
        frame = frame_of_counts(
            counts,
            self.name,
            bits=bits,
            mosaic=mosaic or (self._mosaic if counts.ndim == 2 else None),
            black=self._black(bits),
            exposure_s=exposure_s or None,
        )
        gain = self._value("Gain")
        used = 0.0 if gain is None else _factor(self._node("Gain"), gain)
        details: dict[str, float | int | str] = {"frame_number": number, "pixel_format": form}
        return Shot(frame, taken, exposure_s, used, self.name, details)

    def _black(self, bits: int) -> float | None:
        """The black level in counts, which some cameras say as a part of the range."""
        black = self._value("BlackLevel")
        if black is None:
            return None
        percent = getattr(self._node("BlackLevel"), "unit", "") == "%"
        return float(black) * (2**bits - 1) / 100 if percent else float(black)


def _in_decibels(gain: Any) -> bool:
    return str(getattr(gain, "unit", "")).lower() == "db"


def _factor(gain: Any, value: float) -> float:
    """A gain as a factor, where the camera says it in dB."""
    return 10 ** (value / 20) if _in_decibels(gain) else value


def _counts(component: Any) -> NDArray[Any]:
    """(height, width) or (height, width, channels), unpacked; they are the buffer's no more."""
    width, height = int(component.width), int(component.height)
    channels = max(1, int(component.num_components_per_pixel))
    rows = np.asarray(component.data).reshape(height, -1)[:, : width * channels]
    copied: NDArray[Any] = rows.reshape(height, width, channels).copy()
    return copied[..., 0] if channels == 1 else copied


def _worth(form: str) -> tuple[bool, bool, int, bool]:
    """How much of what the sensor measured a format of pixels keeps."""
    try:
        pixels = PixelFormat.of(form)
    except OptionError:
        return form in _COLOURS, False, 0, False
    return True, pixels.mosaic is not None, pixels.bits, pixels.packing is None


def _producers() -> list[Path]:
    folders = [Path(each) for each in os.environ.get(FOLDERS, "").split(os.pathsep) if each]
    return sorted(file for folder in folders for file in folder.glob("*.cti"))


def _device_name(info: Any) -> str:
    """Model, serial number and id of a device, as far as it says them."""
    parts = []
    for name in ("model", "serial_number", "id_"):
        with suppress(Exception):
            parts.append(str(getattr(info, name)))
    return " ".join(each for each in parts if each and each != "None")


@contextmanager
def _interrupt_kept() -> Generator[None]:
    """Keep what Ctrl-C does: harvesters takes it for itself, and no longer ends the process."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, before)


@contextmanager
def _trouble(name: str) -> Iterator[None]:
    """Say what an error of a GenTL producer means, and what to do."""
    try:
        yield
    except CameraError:
        raise
    except Exception as error:
        kind = type(error).__name__
        said = " ".join(str(error).split()) or kind
        if "InUse" in kind or "AccessDenied" in kind:
            raise CameraError(
                f"{name} is in use by another program ({said}): close that one, such as the "
                "viewer of the camera's maker"
            ) from error
        raise CameraError(
            f"{name} does not work ({said}): see that it is connected and has power, and that the "
            "viewer of its maker shows its picture"
        ) from error
