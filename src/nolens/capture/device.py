"""What sources over drivers of others have in common: names of devices, and counted frames."""

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
import psutil
import torch
from numpy.typing import NDArray

from nolens.camera import MOSAICS, Frame
from nolens.errors import CameraError, OptionError

PATIENCE_S = 5.0
"""How long a frame may come after its exposure."""
_BUFFERED = 0.25
"""Of the memory that is free."""


@dataclass(frozen=True)
class DeviceName:
    """A device and its settings: ``NAME,PROPERTY=VALUE,...``.

    Attributes
    ----------
    name
        Of the device, as its driver has it; empty where it is not said.
    settings
        Values of the driver's properties, in their order.
    """

    name: str
    settings: Mapping[str, str]

    @classmethod
    def of(cls, text: str) -> "DeviceName":
        """Take a text apart.

        Raises
        ------
        OptionError
            If a setting has no value.
        """
        name, *pairs = (each.strip() for each in text.split(","))
        settings = {}
        for each in pairs:
            key, equals, value = each.partition("=")
            if not key.strip() or not equals:
                raise OptionError(
                    f"{each!r} sets nothing: after the device, give PROPERTY=VALUE, such as "
                    "TriggerSource=Line1"
                )
            settings[key.strip()] = value.strip()
        return cls(name, settings)


def load_driver(module: str, package: str, extra: str) -> ModuleType:
    """Import the package of an extra.

    Raises
    ------
    CameraError
        If it is not installed, or does not load.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise CameraError(
            f"such cameras need {package}, and there is no {error.name} here: "
            f"pip install 'nolens[{extra}]'"
        ) from error
    except (ImportError, OSError) as error:
        raise CameraError(f"{package} does not load: {error}") from error


def choose_device(asked: str, there: Sequence[str], what: str, usage: str) -> int:
    """Number of the device that is asked for, or of the only one.

    Parameters
    ----------
    asked
        Its name, or a part that no other has; empty for the only one.
    there
        Names of all.
    what
        What they are in messages, such as "camera of DemoCamera".
    usage
        How one is named, with ``{}`` for its name.

    Raises
    ------
    CameraError
        If there is none, or it is not clear which; lists them.
    """
    found = [at for at, each in enumerate(there) if each == asked] or [
        at for at, each in enumerate(there) if asked.lower() in each.lower()
    ]
    if len(found) == 1:
        return found[0]
    if not there:
        raise CameraError(
            f"there is no {what}: see that it is connected, has power, and no other program uses it"
        )
    names = ", ".join(there)
    if asked and not found:
        near = difflib.get_close_matches(asked, there, n=1)
        meant = f". Did you mean {near[0]}?" if near else ""
        raise CameraError(f"there is no {what} {asked!r}; there are {names}{meant}")
    first = usage.format(there[found[0]])
    raise CameraError(f"there is more than one {what}: {names}. Name the one, such as {first}")


def frame_of_counts(
    counts: NDArray[Any],
    source: str,
    *,
    bits: int,
    mosaic: str | None,
    black: float | None,
    exposure_s: float | None,
) -> Frame:
    """Frame of counts (height, width) or (height, width, 3) of so many bits.

    Raises
    ------
    CameraError
        If the mosaic is none that is known.
    """
    if mosaic is not None and mosaic not in MOSAICS:
        raise CameraError(f"{source} has the mosaic {mosaic}; accepted are {', '.join(MOSAICS)}")
    colours = counts.ndim == 3
    planes = np.moveaxis(counts, -1, 0) if colours else counts[None]
    return Frame(
        counts=torch.from_numpy(np.require(planes, np.float32, ["C", "W"])),
        channels=("R", "G", "B") if colours else ("grey",) if mosaic is None else ("mosaic",),
        mosaic=None if colours else mosaic,
        black=(black or 0.0,),
        white=2.0**bits - 1,
        stored_as=counts.dtype.name,
        source=source,
        exposure_s=exposure_s,
        black_stated=black is not None,
    )


def burst_room() -> float:
    """Bytes that frames of a burst may take which are still to be written."""
    return _BUFFERED * float(psutil.virtual_memory().available)


class FrameCounter:
    """Counts the frames of a burst by the device's own numbers.

    Parameters
    ----------
    warn
        Called with a sentence about frames that are missing.
    """

    def __init__(self, warn: Callable[[str], None] | None) -> None:
        self._warn = warn
        self._last: int | None = None
        self.taken, self.lost = 0, 0

    def count(self, number: int) -> None:
        """Count a frame; those between it and the one before are lost."""
        if self._last is not None and number > self._last + 1:
            self.lost += number - self._last - 1
        self._last = number
        self.taken += 1

    def finish(self, name: str) -> None:
        """Warn where frames were lost."""
        if self.lost and self._warn is not None:
            self._warn(
                f"{self.lost} frames of {name} were lost between the {self.taken} that were taken, "
                "by the numbers that it gives them: take a longer exposure, fewer frames a second "
                "or fewer pixels, or write to a faster disk"
            )
