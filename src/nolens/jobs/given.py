"""What the options of all jobs have in common: their checks, and the files they name."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from nolens.camera.part import refusal
from nolens.errors import OptionError
from nolens.printable import quoted
from nolens.quantities import Quantity

# Of Linux; temporary files add some characters to a name.
_LONGEST_NAME, _LONGEST_PATH = 220, 4000
_CONTROL = re.compile(rb"[\x00-\x1f\x7f]")


class Written(NamedTuple):
    """A file that a job writes.

    Parameters
    ----------
    what
        Its role, for messages.
    path
        Where it goes.
    option
        The option that names it.
    """

    what: str
    path: Path
    option: str = "-o"


class JobOptions(BaseModel):
    """Options of a job: unchangeable, without unknown names."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _one_of_several(cls, value: Any, info: ValidationInfo) -> Any:
        """One text, path or quantity stands for a tuple of it, where any number is meant."""
        field = cls.model_fields[str(info.field_name)]
        read = any(isinstance(each, BeforeValidator) for each in field.metadata)
        one = isinstance(value, (str, Path, Quantity)) and not read
        return (value,) if one and _takes_several(field.annotation) else value

    @field_validator("*", mode="after")
    @classmethod
    def _paths_can_be(cls, value: Any) -> Any:
        """Refuse a path that no system has, before it is asked for."""
        for each in value if isinstance(value, tuple) else (value,):
            if isinstance(each, Path) and (reason := _no_path(each)):
                raise refusal(reason)
        return value

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> Self:
        """Options from values by name.

        Raises
        ------
        OptionError
            If a value cannot be used.
        """
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            raise OptionError(explain(error)) from None

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role."""
        raise NotImplementedError

    @property
    def written(self) -> tuple[Written, ...]:
        """Files that are written."""
        raise NotImplementedError


def _no_path(path: Path) -> str | None:
    """Why this cannot be a path; None if it can."""
    try:
        encoded = os.fsencode(path)
    except UnicodeEncodeError:
        return "it has half of a character in it (a lone surrogate): give the whole name"
    if _CONTROL.search(encoded):
        return "it has control characters, such as NUL or a new line: give a name without them"
    if len(encoded) > _LONGEST_PATH or max(map(len, encoded.split(b"/"))) > _LONGEST_NAME:
        return (
            f"a name may have {_LONGEST_NAME} bytes and a path {_LONGEST_PATH}: give a shorter one"
        )
    return None


def _takes_several(annotation: Any) -> bool:
    """Whether a type is a tuple of any length, or is one of several that a value may have."""
    if get_origin(annotation) is tuple:
        return get_args(annotation)[-1] is Ellipsis
    return any(_takes_several(each) for each in get_args(annotation))


def check_apart(options: JobOptions, read: Mapping[str, Path]) -> None:
    """Refuse to write over a file that is read, or over another one that is written.

    Parameters
    ----------
    options
        They name the files to write.
    read
        Files that are read, by role.

    Raises
    ------
    OptionError
        If two of them are one file.
    """
    before: list[Path] = []
    for what, path, option in options.written:
        for role, other in read.items():
            if _same(path, other):
                raise OptionError(
                    f"the {what} {path} would overwrite the {role} {other}: give another name "
                    f"({option})"
                )
        if any(_same(path, other) for other in before):
            raise OptionError(
                f"the {what} {path} is given twice: give each its own name ({option})"
            )
        before.append(path)


def explain(error: ValidationError, sources: Mapping[str, Path | None] | None = None) -> str:
    """Say on one line what was given for which option, and what would be accepted.

    Parameters
    ----------
    error
        Of the model of the options.
    sources
        For options from a file, that file.
    """
    found: dict[str, list[str]] = {}
    for each in error.errors(include_url=False):
        name = str(each["loc"][0]) if each["loc"] else ""
        if sources and name in sources:
            what = f"{name} in {sources[name]}"
        else:
            what = f"--{name.replace('_', '-')}"
        message = each["msg"][:1].lower() + each["msg"][1:]
        reasons = found.setdefault(f"{what} is {quoted(each['input'])}", [])
        reasons.append(message.removeprefix("input should be ") if reasons else message)
    return "; ".join(f"{what}: {' or '.join(reasons)}" for what, reasons in found.items())


def _same(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file."""
    try:
        return one.resolve() == other.resolve() or one.samefile(other)
    except (OSError, ValueError, RuntimeError):  # At least one of them does not exist.
        return False
