"""Picamera2, which comes with the system of a Raspberry Pi, and what it says when it fails."""

import importlib
import os
import re
from types import ModuleType

from nolens.errors import CameraError

_CABLE = (
    "check the ribbon cable at both ends with the power off, and see what rpicam-hello "
    "--list-cameras says"
)


def load_picamera2() -> ModuleType:
    """Import Picamera2.

    Raises
    ------
    CameraError
        If it is missing, or does not go with the numpy that is installed.
    """
    # libcamera tells every step on standard error.
    os.environ.setdefault("LIBCAMERA_LOG_LEVELS", "*:ERROR")
    try:
        return importlib.import_module("picamera2")
    except ModuleNotFoundError as error:
        raise CameraError(
            f"a Raspberry Pi's camera needs Picamera2, and there is no {error.name} here. On a "
            "Raspberry Pi: sudo apt install python3-picamera2, and make the virtual environment "
            "with python3 -m venv --system-site-packages (docs/pi.md)"
        ) from error
    # The system's compiled packages raise a ValueError beside a numpy they were not made for.
    except (ImportError, ValueError, AttributeError) as error:
        raise CameraError(
            f"Picamera2 does not load ({error}): the system's packages and the numpy of this "
            "virtual environment do not go together. Use Raspberry Pi OS trixie (2025) or newer, "
            "or a numpy that fits: pip install 'numpy<2' (docs/pi.md)"
        ) from error


def connected_models() -> list[str]:
    """Models of the cameras that are connected, in the order of their numbers; at least one.

    Raises
    ------
    CameraError
        If there is none, or Picamera2 cannot be used.
    """
    module = load_picamera2()
    try:
        cameras = module.Picamera2.global_camera_info()
    except (RuntimeError, OSError) as error:
        raise CameraError(camera_trouble(error)) from error
    if not cameras:
        raise CameraError(f"no camera is connected to this Raspberry Pi: {_CABLE}")
    return [str(each.get("Model", "camera")) for each in cameras]


def camera_trouble(error: BaseException) -> str:
    """Say what an error of libcamera means, and what to do."""
    said: list[str] = []
    each: BaseException | None = error
    while each is not None and len(said) < 9:
        said.append(str(each))
        each = each.__cause__ or each.__context__
    texts = "; ".join(dict.fromkeys(said))
    if re.search(r"busy|acquire|in use|-16\b", texts, re.IGNORECASE):
        return (
            f"the camera is in use by another program ({texts}): close that one (rpicam-hello, "
            "nolens studio or a viewfinder), or wait until it has ended. fuser /dev/media* shows "
            "its number"
        )
    return (
        f"the camera cannot be opened ({texts}): see whether rpicam-hello shows its picture, and "
        "start the Raspberry Pi anew if it does not"
    )
