"""Descriptions of cameras, materials and PSFs: TOML text, its errors, and the presets."""

import re
import textwrap
from collections.abc import Mapping
from importlib.resources import files
from typing import Any, TypeVar

import tomli_w
from pydantic import ValidationError

from nolens.camera.description import Camera
from nolens.camera.materials import Material, check_own_name
from nolens.camera.part import Part
from nolens.documents import parse_toml
from nolens.errors import DataError, OptionError
from nolens.printable import quoted, suggestion

PRESETS = ("paper", "paper-film", "small", "live")
"""Names of the cameras that come with the package."""

_CHOICES = ("relief", "quantum_efficiency", "acceptance", "transmission")
_MOST = 3
_SUBJECT = re.compile(r"^(Input|Tuple|String|Dictionary) should ")
_WIDTH = 100
_NUMBERS = re.compile(r"^([^\n\"]+ = )\[\n((?: {4}[-+.0-9e]+,\n)+)\]$", re.MULTILINE)
_Kind = TypeVar("_Kind", bound=Part)


def from_mapping(kind: type[_Kind], mapping: Mapping[str, Any], source: str) -> _Kind:
    """Check a description.

    Parameters
    ----------
    kind
        `Camera`, `Material` (a person's own) or `PsfSet`.
    mapping
        The description, as it stands in a TOML file.
    source
        Where it comes from, usually the path of a file, for messages.

    Raises
    ------
    DataError
        If it is none of this kind, or a material with the name of another one; says at which key,
        what was given and what would be accepted.
    """
    try:
        part = kind.model_validate(dict(mapping))
        if isinstance(part, Material):
            check_own_name(part)
    except ValidationError as error:
        raise DataError(f"{source}: {explain(error)}") from None
    except OptionError as error:
        raise DataError(f"{source}: {error}") from None
    return part


def from_toml(kind: type[_Kind], text: str, source: str) -> _Kind:
    """Read a description from TOML text.

    Raises
    ------
    DataError
        As `from_mapping` does, and if it is no TOML (with line and column).
    """
    return from_mapping(kind, parse_toml(text, source), source)


def to_toml(part: Part) -> str:
    """Write a description as TOML text.

    Fields that have their default are left out. Reading the text and writing it again gives
    the same text.
    """
    text = tomli_w.dumps(_plain(part.model_dump(exclude_defaults=True)))
    return _NUMBERS.sub(_in_line, text)


def preset(name: str) -> Camera:
    """Give a camera that comes with the package.

    Raises
    ------
    OptionError
        If there is none of this name.
    """
    return from_toml(Camera, preset_text(name), f"preset {name}")


def preset_text(name: str) -> str:
    """Give the TOML text of a camera that comes with the package.

    Raises
    ------
    OptionError
        If there is none of this name; with the nearest name and all of them.
    """
    if name not in PRESETS:
        raise OptionError(
            f"there is no preset {name!r}{suggestion(name, PRESETS)} Presets are "
            f"{', '.join(PRESETS)}"
        )
    return (files("nolens.camera") / "presets" / f"{name}.toml").read_text(encoding="utf-8")


def explain(error: ValidationError) -> str:
    """Say on one line what was given where, and what would be accepted."""
    errors = error.errors(include_url=False)
    places = [each["loc"] for each in errors]
    # A list whose only item is wrong is called empty as well.
    texts = [
        _explain_one(each)
        for each in errors
        if not any(place != each["loc"] == place[: len(each["loc"])] for place in places)
    ]
    more = len(texts) - _MOST
    return "; ".join(texts[:_MOST]) + (f"; and {more} more" if more > 0 else "")


def _explain_one(error: Any) -> str:
    place, value, message = _path(error["loc"]), error["input"], error["msg"]
    kind = error["type"]
    if kind == "union_tag_not_found":
        message = "kind is missing: give kind = random-lenslets, file or flat"
    elif kind == "union_tag_invalid":
        place, value = f"{place}.kind", value["kind"]
        message = f"known are {error['ctx']['expected_tags']}"
    elif kind in ("model_type", "model_attributes_type", "dict_type"):
        message = "it should be a table of keys and values"
    elif kind == "tuple_type":
        message = "it should be a list"
    else:
        message = _SUBJECT.sub("it should ", message).replace(" after validation", "")
    # A whole table would bury the message, which names what is wrong in it.
    if isinstance(value, Mapping):
        return f"{place}: {message}" if place else str(message)
    return f"{place} is {quoted(value)}: {message}"


def _path(location: tuple[int | str, ...]) -> str:
    path = ""
    for before, step in zip((None, *location), location, strict=False):
        if isinstance(step, int):
            path += f"[{step}]"
        # Behind a key with several kinds of value comes the kind, which is no key.
        elif before not in _CHOICES:
            path += f".{step}"
    return path.removeprefix(".")


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
