"""Sources of frames: what each can do, which there are, and how a text names one."""

import importlib
import importlib.util
import math
from collections.abc import Callable, Generator
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

from nolens.errors import CameraError, OptionError
from nolens.plugins import load_plugin, plugin_names

if TYPE_CHECKING:
    # It brings torch, and who only lists the sources does not need that.
    from nolens.camera import Frame


@dataclass(frozen=True)
class Shot:
    """One exposure of a camera.

    Attributes
    ----------
    frame
        Counts as they were stored, with mosaic, black and white level.
    taken
        When, in UTC.
    exposure_s, gain
        Those that were really in effect; 0 where the camera does not say.
    camera
        Such as ``"Raspberry Pi imx477"`` or ``"twin of live"``.
    details
        What else the camera says, in values that JSON has.
    """

    frame: "Frame"
    taken: datetime
    exposure_s: float
    gain: float
    camera: str
    details: dict[str, float | int | str]


@dataclass(frozen=True)
class Limits:
    """What a camera can be set to.

    Attributes
    ----------
    exposure_s
        Shortest and longest exposure time.
    gain
        Least and most analogue gain.
    """

    exposure_s: tuple[float, float]
    gain: tuple[float, float]

    def check(self, exposure_s: float, gain: float) -> None:
        """Refuse settings beyond these limits.

        Raises
        ------
        OptionError
            If one is, or is no number.
        """
        shortest, longest = self.exposure_s
        # Cameras count in whole us; a limit that was read as seconds must stay within.
        within = shortest * (1 - 1e-6) <= exposure_s <= longest * (1 + 1e-6)
        if not (math.isfinite(exposure_s) and within):
            raise OptionError(
                f"an exposure time of {1e3 * exposure_s:g} ms is beyond this camera: give "
                f"{1e3 * shortest:g} ms to {longest:g} s"
            )
        least, most = self.gain
        if not (math.isfinite(gain) and least * (1 - 1e-6) <= gain <= most * (1 + 1e-6)):
            raise OptionError(
                f"a gain of {gain:g} is beyond this camera: give {least:g} to {most:g}"
            )


class CameraSource(Protocol):
    """Something that frames come from.

    It is used by one thread at a time: `open`, any number of `set` and `shot`, `close`.
    """

    @property
    def name(self) -> str:
        """Of the camera, for people."""

    @property
    def limits(self) -> Limits | None:
        """What it can be set to, known once it is open; None where nothing can be set."""

    def open(self) -> None:
        """Make it ready to take frames.

        Raises
        ------
        CameraError
            If there is no camera or folder, it is in use, or has no raw mode that can be read here.
        """

    def set(self, *, exposure_s: float, gain: float) -> None:
        """Set exposure time and gain of all shots from the next one on.

        Raises
        ------
        OptionError
            If they are beyond the limits, or nothing can be set.
        CameraError
            If the camera is not open.
        """

    def shot(self) -> Shot:
        """Wait for the next frame that was exposed as set, and hand it over.

        Raises
        ------
        CameraError
            If the camera is not open, does not take the settings, or gives no frame any more, as
            where it was unplugged, or closed from another thread.
        """

    def close(self) -> None:
        """Give the camera back; nothing happens where it is closed already."""


@runtime_checkable
class BurstSource(Protocol):
    """A source whose device keeps frames that follow one another until they are taken."""

    def burst(self, frames: int) -> Generator[Shot]:
        """So many frames, exposed as set; none is lost unsaid.

        Raises
        ------
        CameraError
            If the camera is not open, or gives no frame any more.
        """
        ...


class _BuiltIn(NamedTuple):
    """A source of our own.

    `path` has its module, beside this one, and its class, which is loaded when a source is opened.
    Its class method ``of(text, **options)`` takes what follows the colon and gives the source, or
    None where the text names none. `usage` says what can be written for it; `listed_as` is the
    text under which `available_sources` lists it; `asks` says what follows the colon, for people.
    `needs` is a package that comes with an extra of ours.
    """

    path: str
    label: str
    usage: tuple[str, ...]
    listed_as: str
    asks: str = ""
    needs: str = ""
    extra: str = ""


_SOURCES = {
    "raspberry": _BuiltIn(
        "raspberry:RaspberrySource",
        "Raspberry Pi camera",
        ("raspberry", "raspberry:1 (the second camera)"),
        "raspberry",
    ),
    "twin": _BuiltIn(
        "twin:TwinSource",
        "Simulated camera",
        ("twin", "twin:CAMERA (a preset, or a folder with camera.toml)"),
        "twin:live",
    ),
    "folder": _BuiltIn("folder:FolderSource", "Watched folder", ("folder:PATH",), "folder"),
    "micromanager": _BuiltIn(
        "micromanager:MicroManagerSource",
        "Micro-Manager",
        ("micromanager:ADAPTER:DEVICE", "micromanager:FILE.cfg"),
        "micromanager",
        "Adapter and device, or a .cfg",
        "pymmcore",
        "micromanager",
    ),
    "genicam": _BuiltIn(
        "genicam:GenicamSource",
        "GenICam (GigE, USB3)",
        ("genicam", "genicam:NAME (a part of its model or serial number)"),
        "genicam",
        "Model or serial number",
        "harvesters",
        "genicam",
    ),
}


@dataclass(frozen=True)
class SourceFact:
    """What is known of a source before it is opened.

    Attributes
    ----------
    id
        Text for `open_source`; `folder` needs a colon and a path after it.
    label
        For people.
    available
        Whether it can be opened here.
    why
        Why not; empty where it can.
    asks
        What may follow a colon, for people; empty where nothing or a folder does.
    """

    id: str
    label: str
    available: bool = True
    why: str = ""
    asks: str = ""


def available_sources() -> tuple[SourceFact, ...]:
    """The Raspberry Pi's cameras, or why there are none, then all other sources."""
    return (
        *_raspberry_facts(),
        *(_fact(each) for name, each in _SOURCES.items() if name != "raspberry"),
        *(SourceFact(name, name) for name in plugin_names("nolens.sources")),
    )


def open_source(
    text: str,
    *,
    existing: bool = False,
    mosaic: str | None = None,
    warn: Callable[[str], None] | None = None,
) -> CameraSource:
    """Give the source that a text names; it is still to be opened (`CameraSource.open`).

    Parameters
    ----------
    text
        ``auto`` (the Raspberry Pi's camera where there is one, else the simulated one),
        ``raspberry``, ``raspberry:1``, ``twin``, ``twin:CAMERA``, ``folder:PATH``,
        ``micromanager:ADAPTER:DEVICE`` or ``genicam:NAME``; or the name under which another
        package adds one (entry point ``nolens.sources``), which is called with what follows the
        colon.
    existing
        For folders, as `FolderSource` takes it.
    mosaic
        Of the sensor, where frames do not say it.
    warn
        Called with a sentence about a file that cannot be read, or frames that were lost.

    Raises
    ------
    OptionError
        If the text names no source.
    NolensError
        If the simulated camera cannot be read.
    """
    name, _, rest = text.partition(":")
    if name == "auto" and not rest:
        name = "raspberry" if _raspberry_facts()[0].available else "twin"
    source: CameraSource | None = None
    if name in _SOURCES:
        module, _, attribute = _SOURCES[name].path.partition(":")
        kind = getattr(importlib.import_module(f"{__package__}.{module}"), attribute)
        source = kind.of(rest, existing=existing, mosaic=mosaic, warn=warn)
    elif (make := load_plugin("nolens.sources", name)) is not None:
        source = make(rest)
    if source is None:
        usages = ["auto", *(usage for each in _SOURCES.values() for usage in each.usage)]
        more = "".join(f", or {name}" for name in plugin_names("nolens.sources"))
        raise OptionError(
            f"there is no source {text!r}; accepted are {', '.join(usages[:-1])}, or "
            f"{usages[-1]}{more}"
        )
    return source


def _fact(source: _BuiltIn) -> SourceFact:
    """A source, or why it cannot be opened."""
    why = ""
    if source.needs and importlib.util.find_spec(source.needs) is None:
        why = f"{source.needs} is not installed (pip install 'nolens[{source.extra}]')"
    return SourceFact(source.listed_as, source.label, not why, why, source.asks)


def _raspberry_facts() -> list[SourceFact]:
    """The Raspberry Pi's cameras; one that is not available where there is none."""
    name, label = "raspberry", _SOURCES["raspberry"].label
    if importlib.util.find_spec("picamera2") is None:
        return [
            SourceFact(
                name,
                label,
                False,
                "this is no Raspberry Pi, or Picamera2 is missing (sudo apt install "
                "python3-picamera2, and a virtual environment with --system-site-packages)",
            )
        ]
    from nolens.capture.picamera import connected_models

    try:
        models = connected_models()
    except CameraError as error:
        return [SourceFact(name, label, False, str(error))]
    return [
        SourceFact(f"{name}:{number}" if number else name, f"Raspberry Pi {model}")
        for number, model in enumerate(models)
    ]
