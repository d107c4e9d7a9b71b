"""Camera descriptions from plain mappings, with errors that people can act on."""

import difflib
import re
import textwrap
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import tomli_w
from pydantic import ValidationError

from nolens.camera.description import Camera
from nolens.camera.materials import Material, check_own_name
from nolens.camera.part import Part
from nolens.camera.psf_set import PsfSet
from nolens.documents import parse_toml
from nolens.errors import DataError, OptionError
from nolens.printable import quoted

_CHOICES = ("relief", "quantum_efficiency", "acceptance")
_MOST = 3
_SUBJECT = re.compile(r"^(Input|Tuple|String|Dictionary) should ")


def camera_from_mapping(mapping: Mapping[str, Any], source: str) -> Camera:
    """Check a camera's description.

    Parameters
    ----------
    mapping
        The description, as it stands in a TOML file.
    source
        Where it comes from, for messages.

    Raises
    ------
    DataError
        If it is no camera; says at which key, what was given and what would be accepted.
    """
    try:
        return Camera.model_validate(dict(mapping))
    except ValidationError as error:
        raise DataError(f"{source}: {explain(error)}") from None


def material_from_mapping(mapping: Mapping[str, Any], source: str) -> Material:
    """Check the description of a person's own material.

    Parameters
    ----------
    mapping
        The description, as it stands in a TOML file.
    source
        Where it comes from, for messages.

    Raises
    ------
    DataError
        If it is no material, or has the name of another one; says at which key, what was given
        and what would be accepted.
    """
    try:
        own = Material.model_validate(dict(mapping))
        check_own_name(own)
    except ValidationError as error:
        raise DataError(f"{source}: {explain(error)}") from None
    except OptionError as error:
        raise DataError(f"{source}: {error}") from None
    return own


def psf_set_from_mapping(mapping: Mapping[str, Any], source: str) -> PsfSet:
    """Check the list of a camera's PSFs.

    Parameters
    ----------
    mapping
        The list, as it stands in a TOML file.
    source
        Where it comes from, for messages.

    Raises
    ------
    DataError
        If it is none; says at which key, what was given and what would be accepted.
    """
    try:
        return PsfSet.model_validate(dict(mapping))
    except ValidationError as error:
        raise DataError(f"{source}: {explain(error)}") from None


def explain(error: ValidationError) -> str:
    """Say on one line what was given where, and what would be accepted."""
    errors = error.errors(include_url=False)
    places = [each["loc"] for each in errors]
    # A list whose only item is wrong is called empty as well.
    found = [
        _explain_one(each)
        for each in errors
        if not any(place != each["loc"] == place[: len(each["loc"])] for place in places)
    ]
    more = len(found) - _MOST
    return "; ".join(found[:_MOST]) + (f"; and {more} more" if more > 0 else "")


def _explain_one(error: Any) -> str:
    place, given, message = _path(error["loc"]), error["input"], error["msg"]
    kind = error["type"]
    if kind == "union_tag_not_found":
        message = "kind is missing: give kind = random-lenslets, file or flat"
    elif kind == "union_tag_invalid":
        place, given = f"{place}.kind", given["kind"]
        message = f"known are {error['ctx']['expected_tags']}"
    elif kind in ("model_type", "model_attributes_type", "dict_type"):
        message = "it should be a table of keys and values"
    elif kind == "tuple_type":
        message = "it should be a list"
    else:
        message = _SUBJECT.sub("it should ", message).replace(" after validation", "")
    # A whole table would bury the message, which names what is wrong in it.
    if isinstance(given, Mapping):
        return f"{place}: {message}" if place else str(message)
    return f"{place} is {quoted(given)}: {message}"


def _path(location: tuple[int | str, ...]) -> str:
    path = ""
    for before, step in zip((None, *location), location, strict=False):
        if isinstance(step, int):
            path += f"[{step}]"
        # Behind a key with several kinds of value comes the kind, which is no key.
        elif before not in _CHOICES:
            path += f".{step}"
    return path.removeprefix(".")


_WIDTH = 100
_NUMBERS = re.compile(r"^([^\n\"]+ = )\[\n((?: {4}[-+.0-9e]+,\n)+)\]$", re.MULTILINE)


def camera_from_toml(text: str, source: str) -> Camera:
    """Read a camera's description from TOML text.

    Parameters
    ----------
    text
        The text.
    source
        Where it comes from, usually the path of a file, for messages.

    Raises
    ------
    DataError
        If it is no TOML (with line and column) or no camera.
    """
    return camera_from_mapping(parse_toml(text, source), source)


def material_from_toml(text: str, source: str) -> Material:
    """Read the description of a person's own material from TOML text.

    Parameters
    ----------
    text
        The text.
    source
        Where it comes from, usually the path of a file, for messages.

    Raises
    ------
    DataError
        If it is no TOML (with line and column) or no material, or has the name of another one.
    """
    return material_from_mapping(parse_toml(text, source), source)


def camera_to_toml(camera: Camera) -> str:
    """Write a camera's description as TOML text.

    Fields that have their default are left out. Reading the text and writing it again gives
    the same text.
    """
    return _dumped(camera)


def material_to_toml(material: Material) -> str:
    """Write a material's description as TOML text, which `material_from_toml` reads."""
    return _dumped(material)


def psf_set_from_toml(text: str, source: str) -> PsfSet:
    """Read the list of a camera's PSFs from TOML text.

    Parameters
    ----------
    text
        The text.
    source
        Where it comes from, usually the path of a file, for messages.

    Raises
    ------
    DataError
        If it is no TOML (with line and column) or no list of PSFs.
    """
    return psf_set_from_mapping(parse_toml(text, source), source)


def psf_set_to_toml(psfs: PsfSet) -> str:
    """Write the list of a camera's PSFs as TOML text, which `psf_set_from_toml` reads."""
    return _dumped(psfs)


def _dumped(part: Part) -> str:
    text = tomli_w.dumps(_plain(part.model_dump(exclude_defaults=True)))
    return _NUMBERS.sub(_in_line, text)


def _plain(value: Any) -> Any:
    """Whole numbers without a fraction, so that lists of them are easy to read."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        return int(value)
    return value


def _in_line(match: re.Match[str]) -> str:
    """A list of numbers on one line, or on lines of `_WIDTH` where it is longer."""
    numbers = " ".join(match[2].split()).removesuffix(",")
    line = f"{match[1]}[{numbers}]"
    if len(line) <= _WIDTH:
        return line
    # 1e-05 must not be broken at its hyphen.
    lines = textwrap.wrap(numbers, _WIDTH - 4, break_on_hyphens=False)
    return "\n".join([f"{match[1]}[", *(f"    {line}" for line in lines)]) + ",\n]"


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
