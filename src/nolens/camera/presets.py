"""Cameras that come with the package."""

import difflib
from importlib.resources import files

from nolens.camera.description import Camera
from nolens.camera.toml import camera_from_toml
from nolens.errors import OptionError

PRESETS = ("paper", "paper-film", "small", "live")
"""Names of the cameras that come with the package."""


def preset(name: str) -> Camera:
    """Give a camera that comes with the package.

    Raises
    ------
    OptionError
        If there is none of this name.
    """
    return camera_from_toml(preset_text(name), f"preset {name}")


def preset_text(name: str) -> str:
    """Give the TOML text of a camera that comes with the package.

    Raises
    ------
    OptionError
        If there is none of this name; with the nearest name and all of them.
    """
    if name not in PRESETS:
        near = difflib.get_close_matches(name.lower(), PRESETS, n=1)
        raise OptionError(
            f"there is no preset {name!r}"
            + (f"; did you mean {near[0]!r}?" if near else ";")
            + f" Presets are {', '.join(PRESETS)}"
        )
    return (files("nolens.camera") / "presets" / f"{name}.toml").read_text(encoding="utf-8")
