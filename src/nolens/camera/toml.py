"""Descriptions of cameras, materials and sets of PSFs as TOML text."""

import re
import textwrap
from typing import Any

import tomli_w

from nolens.camera.description import Camera
from nolens.camera.explain import (
    camera_from_mapping,
    material_from_mapping,
    psf_set_from_mapping,
)
from nolens.camera.materials import Material
from nolens.camera.part import Part
from nolens.camera.psf_set import PsfSet
from nolens.documents import parse_toml

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
