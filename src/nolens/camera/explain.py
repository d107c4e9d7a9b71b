"""Camera descriptions from plain mappings, with errors that people can act on."""

import re
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from nolens.camera.description import Camera
from nolens.camera.materials import Material, check_own_name
from nolens.camera.psf_set import PsfSet
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
