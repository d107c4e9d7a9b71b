"""A command made of the declaration of its job: `nolens.jobs.options`."""

import inspect
import json
from collections.abc import Callable, Iterable
from enum import Enum
from pathlib import Path
from types import GenericAlias, NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from cyclopts import Group, Parameter
from pydantic import BeforeValidator

from nolens.cli.app import Whole
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.files.record import with_former_keys
from nolens.jobs.fields import RUN
from nolens.jobs.options import JobOptions, Option, default_text
from nolens.jobs.run import Job

Json = Annotated[
    bool,
    Parameter(
        name="--json",
        negative=(),
        show_default=False,
        help="Print one JSON object on standard output.",
    ),
]
_Config = Annotated[
    Path | None,
    Parameter(
        help="TOML file with any of these options, with _ or - in their names; relative paths in "
        "it start from its folder. What is given here comes before it."
    ),
]
_MOST_LISTED = 12
_FORMER = "_former"
"""What the parameter of a former name ends with, which may be that of one given by its place."""
_BY_NAME = inspect.Parameter.KEYWORD_ONLY


def command(
    job: Job[Any, Any],
    lines: Callable[[dict[str, Any]], Iterable[str]],
    *,
    name: str,
    options: type[JobOptions] | None = None,
    reporter: Callable[[], TerminalReporter] = TerminalReporter,
) -> Callable[..., int]:
    """Make the command of a job.

    Its options and its help are those that the job declares; ``--config`` and ``--json`` are
    every command's.

    Parameters
    ----------
    job
        The job.
    lines
        Text of the summary for a person at a terminal; the files that were written follow.
    name
        Of the command.
    options
        Model of the options where the job takes several; the job's own otherwise.
    reporter
        Makes what shows how far it is.
    """
    model: type[JobOptions] = options or job.options

    def run(*places: Any, **names: Any) -> int:
        values = dict(signature.bind_partial(*places, **names).arguments)
        as_json, config = values.pop("json_", False), values.pop("config", None)
        choices = {
            key.removesuffix(_FORMER): each
            for key, each in values.items()
            if each is not None and each != ()
        }
        watching = reporter()
        with watching:
            summary = job(model.gather(choices, config, watching.note), watching).summary
        text = (
            [json.dumps(with_former_keys(summary))]
            if as_json
            else [*lines(summary), *_listed(summary["outputs"])]
        )
        for line in text:
            show(line)
        if watching.interrupted:
            return 130
        return 3 if summary.get("failed") else 0

    signature = inspect.Signature(_parameters(model), return_annotation=int)
    run.__annotations__ = {each.name: each.annotation for each in signature.parameters.values()}
    run.__annotations__["return"] = int
    run.__doc__, run.__name__ = model.__doc__, name
    vars(run).update(__signature__=signature, usage=model.usage)
    return run


def _listed(outputs: list[str]) -> list[str]:
    """Files that were written, the last one for many."""
    more = len(outputs) - _MOST_LISTED
    return outputs if more <= 0 else [*outputs[:_MOST_LISTED], f"and {more} more, to {outputs[-1]}"]


def _parameters(model: type[JobOptions]) -> list[inspect.Parameter]:
    groups: dict[str, Group] = {RUN: Group(RUN, sort_key=len(model.model_fields))}
    parameters = []
    for field in model.model_fields:
        option = Option.of(model, field)
        heading = option.group
        if heading and heading not in groups:
            groups[heading] = Group(heading, sort_key=len(groups))
        parameter = _parameter(model, field, groups.get(heading))
        parameters.append(parameter)
        if option.former:
            parameters.append(_former(parameter, option))
    place = Parameter(group=groups[RUN])
    parameters += [
        inspect.Parameter("config", _BY_NAME, default=None, annotation=Annotated[_Config, place]),
        inspect.Parameter("json_", _BY_NAME, default=False, annotation=Annotated[Json, place]),
    ]
    return sorted(parameters, key=lambda each: each.kind)


def _parameter(model: type[JobOptions], name: str, group: Group | None) -> inspect.Parameter:
    """How one field is given at a terminal."""
    field, option = model.model_fields[name], Option.of(model, name)
    kind = _kind(field.annotation, field.metadata)
    text = option.help
    if field.is_required():
        text += " Needed."
    elif default := default_text(model, name):
        text += f"  [default: {default}]"
    settings: dict[str, Any] = {"help": text, "show_default": False}
    if group is not None:
        settings["group"] = group
    external = field.alias or name
    if option.flag:
        settings["name"] = (f"--{external.replace('_', '-')}", option.flag)
    elif external != name:
        settings["name"] = f"--{external.replace('_', '-')}"
    if kind is bool and not option.negative:
        settings["negative"] = ()
    if option.several:
        settings["consume_multiple"] = True
    if str in (kind, *get_args(kind)):
        settings["allow_leading_hyphen"] = _is_signed(field.annotation)
    about = [Parameter(**settings)]
    if int in (kind, *get_args(kind)):
        about.append(Whole)
    if option.positional and get_origin(kind) is tuple:
        return inspect.Parameter(
            name,
            inspect.Parameter.VAR_POSITIONAL,
            annotation=Annotated[get_args(kind)[0], *about],
        )
    place = inspect.Parameter.POSITIONAL_ONLY if option.positional else _BY_NAME
    return inspect.Parameter(name, place, default=None, annotation=Annotated[kind | None, *about])


def _former(parameter: inspect.Parameter, option: Option) -> inspect.Parameter:
    """The same option by its name of the version before, which the help does not show."""
    kind, *settings = get_args(parameter.annotation)
    if option.former_switch:
        kind, settings = bool | None, []
    hidden = Parameter(name=f"--{option.former.replace('_', '-')}", show=False)
    return parameter.replace(
        name=f"{option.former}{_FORMER}",
        kind=_BY_NAME,
        annotation=Annotated[kind, *settings, hidden],
    )


def _kind(annotation: Any, metadata: Iterable[Any] = ()) -> Any:
    """Type of what is typed: the model itself reads quantities and all else that has a notation."""
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return _kind(inner, more)
    if any(isinstance(each, BeforeValidator) for each in metadata):
        return str
    arguments = [each for each in get_args(annotation) if each is not NoneType]
    if get_origin(annotation) in (Union, UnionType):
        return _kind(arguments[0]) if len(arguments) == 1 else str
    if get_origin(annotation) is tuple:
        if arguments[-1] is Ellipsis:
            return GenericAlias(tuple, (_kind(arguments[0]), ...))
        return GenericAlias(tuple, tuple(_kind(each) for each in arguments))
    plain = annotation in (bool, int, float, Path) or get_origin(annotation) is Literal
    return annotation if plain or issubclass(annotation, Enum) else str


def _is_signed(annotation: Any) -> bool:
    """Whether a text may begin with a hyphen, as a quantity may."""
    if isinstance(annotation, type) and annotation.__module__.startswith("nolens."):
        return not issubclass(annotation, Enum)
    return any(_is_signed(each) for each in get_args(annotation))
