"""The sources there are, by the texts that people write for them."""

import importlib.util
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nolens.errors import CameraError, OptionError
from nolens.plugins import load_plugin, plugin_names

if TYPE_CHECKING:
    from nolens.capture.source import CameraSource

_ACCEPTED = (
    "auto, raspberry, raspberry:1 (the second camera), twin, twin:CAMERA (a preset, or a folder "
    "with camera.toml), or folder:PATH"
)
_LIVE = "live"


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
    """

    id: str
    label: str
    available: bool
    why: str


def available_sources() -> tuple[SourceFact, ...]:
    """The Raspberry Pi's cameras, or why there are none, the simulated one, and folders."""
    try:
        models = _raspberry_models()
    except CameraError as error:
        found = [SourceFact("raspberry", "Raspberry Pi camera", False, str(error))]
    else:
        found = [
            SourceFact(
                f"raspberry:{number}" if number else "raspberry", f"Raspberry Pi {model}", True, ""
            )
            for number, model in enumerate(models)
        ]
    return (
        *found,
        SourceFact(f"twin:{_LIVE}", "Simulated camera", True, ""),
        SourceFact("folder", "Watched folder", True, ""),
        *(SourceFact(name, name, True, "") for name in plugin_names("nolens.sources")),
    )


def open_source(
    text: str,
    *,
    existing: bool = False,
    mosaic: str | None = None,
    tell: Callable[[str], None] | None = None,
) -> "CameraSource":
    """Give the source that a text names; it is still to be opened (`CameraSource.open`).

    Parameters
    ----------
    text
        ``auto`` (the Raspberry Pi's camera where there is one, else the simulated one),
        ``raspberry``, ``raspberry:1``, ``twin``, ``twin:CAMERA`` or ``folder:PATH``; or the name
        under which another package adds one (entry point ``nolens.sources``), which is called
        with what follows the colon.
    existing, mosaic, tell
        For folders, as `FolderSource` takes them.

    Raises
    ------
    OptionError
        If the text names no source.
    NolensError
        If the simulated camera cannot be read.
    """
    kind, _, rest = text.partition(":")
    if kind == "auto" and not rest:
        try:
            _raspberry_models()
        except CameraError:
            kind = "twin"
        else:
            kind = "raspberry"
    if kind == "raspberry" and (not rest or rest.isdecimal()):
        from nolens.capture.raspberry import RaspberrySource

        return RaspberrySource(int(rest or 0))
    if kind == "twin":
        from nolens.camera import opened, preset
        from nolens.capture.twin import TwinSource
        from nolens.files import read_camera

        return TwinSource(read_camera(rest) if rest else opened(preset(_LIVE)))
    if kind == "folder" and rest:
        from nolens.capture.folder import FolderSource

        path = Path(rest)
        with suppress(RuntimeError):  # No such user: then it is a name like any other.
            path = path.expanduser()
        return FolderSource(path, existing=existing, mosaic=mosaic, tell=tell)
    make: Callable[[str], CameraSource] | None = load_plugin("nolens.sources", kind)
    if make is not None:
        return make(rest)
    more = "".join(f", or {name}" for name in plugin_names("nolens.sources"))
    raise OptionError(f"there is no source {text!r}; accepted are {_ACCEPTED}{more}")


def _raspberry_models() -> list[str]:
    """Models of the Raspberry Pi's cameras, at least one.

    Raises
    ------
    CameraError
        If there is none, or Picamera2 is missing.
    """
    if importlib.util.find_spec("picamera2") is None:
        raise CameraError(
            "this is no Raspberry Pi, or Picamera2 is missing (sudo apt install "
            "python3-picamera2, and a virtual environment with --system-site-packages)"
        )
    from nolens.capture.picamera import connected_models

    return connected_models()
