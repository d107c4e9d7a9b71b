"""Tolerances as TOML text."""

import difflib
from typing import Annotated, Any

import tomli_w
from pydantic import Field, ValidationError
from pydantic_core import PydanticCustomError

from nolens.camera import Camera
from nolens.camera.explain import explain
from nolens.camera.part import Part, Text
from nolens.design.tolerances.distributions import DISTRIBUTIONS, Parameter
from nolens.design.tolerances.variables import Variable, find, variables
from nolens.documents import parse_toml
from nolens.errors import DataError, OptionError
from nolens.printable import printable, quoted
from nolens.quantities import Angle, Length, Quantity, Share
from nolens.ranges import Between

_KINDS: dict[str, type[Quantity]] = {"um": Length, "deg": Angle, "%": Share}
_LEAST = 1e-9
"""Of a tolerance: its fourth power is still a number."""
_RANGES = {
    "um": Between("-10 m", "10 m"),
    "deg": Between("-89.9 deg", "89.9 deg"),
    "%": Between("-100 %", "100 %"),
    "": Between(-4, 4),
}
_HEAD = """\
# Tolerances of the camera {name}. What is called assumed was measured by nobody: put in your own.
# tolerance is ±: 2 sigma of a normal distribution, the farthest value of a uniform or triangular
# one. mean is left out where it is what the camera's description says. at_most cuts a normal
# distribution there.
"""


class _Row(Part):
    name: Text
    distribution: Text
    tolerance: Any
    mean: Any = None
    at_most: Any = None
    note: Annotated[str, Field(max_length=10_000)] = ""


class _Table(Part):
    parameter: tuple[_Row, ...] = Field(min_length=1, max_length=100)


def parameters_from_toml(text: str, source: str, camera: Camera) -> tuple[Parameter, ...]:
    """Read tolerances from TOML text.

    Parameters
    ----------
    text
        ``[[parameter]]`` tables with name, distribution, tolerance and perhaps mean, at_most and
        note.
    source
        Where it comes from, for messages.
    camera
        The camera that they are for.

    Raises
    ------
    DataError
        If it is no TOML or no such table.
    OptionError
        If a parameter or distribution is unknown or given twice, or a quantity has no unit, a
        wrong one, or a negative tolerance.
    """
    try:
        table = _Table.model_validate(parse_toml(text, source))
    except ValidationError as error:
        raise DataError(f"{source}: {explain(error)}") from None
    known = variables(camera)
    found: dict[str, Parameter] = {}
    for row in table.parameter:
        try:
            parameter = _parameter(row, known, camera)
            if parameter.name in found:
                raise OptionError(f"{row.name} is given twice: leave one out")
        except OptionError as error:
            raise OptionError(f"{source}: {error}") from None
        found[parameter.name] = parameter
    return tuple(found.values())


def parameters_to_toml(parameters: tuple[Parameter, ...], camera: Camera) -> str:
    """Write tolerances as TOML text, which `parameters_from_toml` reads."""
    known = variables(camera)
    parts = [_HEAD.format(name=printable(camera.name))]
    for each in parameters:
        lines: dict[str, str | float] = {"name": each.name, "distribution": each.distribution}
        if each.middle != known[each.name].middle:
            lines["mean"] = _text(each.middle, each.unit)
        lines["tolerance"] = _text(each.tolerance, each.unit)
        if each.at_most is not None:
            lines["at_most"] = _text(each.at_most, each.unit)
        if each.note:
            lines["note"] = each.note
        parts.append(f"[[parameter]]\n{tomli_w.dumps(lines)}")
    return "\n".join(parts)


def _parameter(row: _Row, known: dict[str, Variable], camera: Camera) -> Parameter:
    variable = find(known, camera, row.name)
    if row.distribution not in DISTRIBUTIONS:
        near = difflib.get_close_matches(row.distribution.lower(), DISTRIBUTIONS, n=1)
        raise OptionError(
            f"{row.name}: there is no distribution {row.distribution!r}"
            + (f"; did you mean {near[0]!r}?" if near else ";")
            + f" Known are {', '.join(DISTRIBUTIONS)}"
        )
    tolerance = _value(row.tolerance, f"{row.name}.tolerance", variable.unit)
    if tolerance < 0:
        raise OptionError(
            f"{row.name}: a tolerance of {row.tolerance} is negative: it is ±, so give 0 or more"
        )
    if 0 < tolerance < _LEAST:
        raise OptionError(
            f"{row.name}: a tolerance of {row.tolerance} is less than anything measures: give 0, "
            f"or at least {_LEAST:g} in the unit of the value"
        )
    at_most = None
    if row.at_most is not None:
        at_most = _value(row.at_most, f"{row.name}.at_most", variable.unit)
        if row.distribution != "normal" or not at_most > 0 or tolerance == 0:
            raise OptionError(
                f"{row.name}: at_most = {row.at_most} must be more than zero, and cuts only a "
                "normal distribution with a tolerance: mend it or leave it out"
            )
    middle = variable.middle
    if row.mean is not None:
        middle = _value(row.mean, f"{row.name}.mean", variable.unit)
    distribution: Any = row.distribution
    return Parameter(
        variable.name, distribution, middle, tolerance, variable.unit, at_most, row.note
    )


def _value(given: Any, where: str, unit: str) -> float:
    try:
        if unit:
            return float(_RANGES[unit].check(_KINDS[unit].parse(given)).to(unit))
        if isinstance(given, bool) or not isinstance(given, int | float):
            raise OptionError("an index has no unit, give a number such as 0.005")
        return float(_RANGES[unit].check(given))
    except (OptionError, PydanticCustomError) as error:
        raise OptionError(f"{where} is {quoted(given)}: {error}") from None


def _text(value: float, unit: str) -> str | float:
    return f"{float(f'{value:.10g}'):.10g} {unit}" if unit else float(f"{value:.10g}")
