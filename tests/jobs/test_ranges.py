"""Every field of a description and every option has a range: found by looking at the models."""

import importlib
import pkgutil
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import annotated_types
import pytest
from pydantic import BaseModel, TypeAdapter
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

import nolens
from nolens.camera.part import Part
from nolens.design.uncertain import Uncertain
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions
from nolens.quantities import Quantity
from nolens.ranges import Between
from nolens.studio import schemas

WITHOUT = {
    # A quantity of the kind that the parameter's name asks for, or a number: see `_value` there.
    "_Row.tolerance", "_Row.mean", "_Row.at_most",
    # Options of a job, which go through that job's own model.
    "JobRequest.options",
}  # fmt: skip
"""Fields whose range another model knows."""


def models() -> list[type[BaseModel]]:
    """All options, all parts of descriptions, and what the page sends to the server."""
    for module in pkgutil.walk_packages(nolens.__path__, "nolens."):
        if module.name.startswith(
            (
                "nolens.jobs.",
                "nolens.reproduction.",
                "nolens.camera.",
                "nolens.design.",
            )
        ):
            importlib.import_module(module.name)
    found: list[type[BaseModel]] = [JobOptions, Part, schemas._PageRequest]
    for each in found:
        found += [child for child in each.__subclasses__() if child not in found]
    assert len(found) > 40
    return found


def unbounded(kind: Any, about: list[Any]) -> Iterator[str]:
    """Parts of a type that have no range; `about` are the annotations on it."""
    bounds = {type(bound) for each in about for bound in _parts(each)}
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        yield from unbounded(inner[0], [*inner[1:], *about])
    elif origin in (Union, UnionType):
        for arm in inner:
            yield from unbounded(arm, about if len(inner) == 1 or arm is not NoneType else [])
    elif origin is Literal or kind in (bool, NoneType):
        return
    elif origin in (tuple, list, dict):
        fixed = origin is tuple and Ellipsis not in inner
        if not fixed and annotated_types.MaxLen not in bounds:
            yield f"{kind} of any length"
        for each in inner:
            if each is not Ellipsis:
                yield from unbounded(each, [])
    elif isinstance(kind, type) and issubclass(kind, Enum | BaseModel):
        return
    elif kind is str:
        if annotated_types.MaxLen not in bounds:
            yield "text of any length"
    elif kind is Path:
        if not any(each in about for each in get_args(FilePath)[1:]):
            yield "a path that is no FilePath"
    elif kind in (int, float) or kind is Uncertain or issubclass(kind, Quantity):
        low = bounds & {annotated_types.Ge, annotated_types.Gt}
        high = bounds & {annotated_types.Le, annotated_types.Lt}
        if not any(issubclass(each, Between) for each in bounds) and not (low and high):
            yield f"{kind.__name__} without both bounds"
    else:
        yield f"{kind}, which nothing is known of"


def _parts(about: Any) -> list[Any]:
    return about.metadata if isinstance(about, FieldInfo) else [about]


@pytest.mark.parametrize("model", models(), ids=lambda each: each.__name__)
def test_every_field_has_a_range(model: type[BaseModel]) -> None:
    hints = get_type_hints(model, include_extras=True)
    for name, field in model.model_fields.items():
        if f"{model.__name__}.{name}" not in WITHOUT:
            assert list(unbounded(hints[name], field.metadata)) == [], name
            if field.default not in (None, PydanticUndefined):
                kind = Annotated[field.annotation, *field.metadata, "with its range"]
                TypeAdapter(kind).validate_python(field.default)
