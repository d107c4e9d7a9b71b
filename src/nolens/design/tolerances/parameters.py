"""What of a camera can come out differently, how it is distributed, and both as TOML text."""

import math
import re
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args

import numpy as np
import tomli_w
import torch
from numpy.typing import NDArray
from pydantic import Field, ValidationError
from pydantic_core import PydanticCustomError
from scipy.special import ndtr, ndtri
from torch import Tensor

from nolens.amounts import amount
from nolens.camera import Camera, Flat
from nolens.camera.part import Part, Text
from nolens.camera.toml import explain
from nolens.documents import parse_toml
from nolens.errors import DataError, OptionError
from nolens.printable import printable, quoted, suggestion
from nolens.quantities import Angle, Length, Percentage, Quantity
from nolens.ranges import Between
from nolens.twin import REFERENCE_NM

Distribution = Literal["normal", "uniform", "triangular"]
_DISTRIBUTIONS: tuple[str, ...] = get_args(Distribution)
"""Names of all distributions."""

_SIGMAS = 2.0
"""Standard deviations in the tolerance of a normal distribution: 95.4 % lie within it."""
_AIR_BELOW = 1.05
_SCALE_LIMIT = 10.0
_WEDGE_LIMIT_DEG = 10.0
_NUMBERED = re.compile(r"layers\.(\d+)(\..+)?")
_KINDS: dict[str, type[Quantity]] = {"um": Length, "deg": Angle, "%": Percentage}
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


@dataclass(frozen=True)
class Parameter:
    r"""One quantity that comes out a little different in every camera.

    All distributions are symmetric around `middle`. The tolerance ± is 2 σ of a normal one, and
    the farthest value of a uniform or triangular one.

    Parameters
    ----------
    name
        Such as ``"resin.thickness"``.
    distribution
        One of `Distribution`.
    middle
        Mean value, in `unit`.
    tolerance
        ±, in `unit`; 0 or more.
    unit
        ``"um"``, ``"deg"``, ``"%"``, or ``""`` for an index.
    at_most
        Farthest from the middle that a normal one can come, where parts beyond are sorted out.
    note
        Why.
    """

    name: str
    distribution: Distribution
    middle: float
    tolerance: float
    unit: str
    at_most: float | None = None
    note: str = ""

    @property
    def tolerance_means(self) -> str:
        """What ± stands for: ``"2σ"``, or ``"at most"`` where nothing lies farther away."""
        return f"{_SIGMAS:g}σ" if self.distribution == "normal" else "at most"

    def with_tolerance(self, tolerance: float) -> "Parameter":
        """The same with another tolerance; where it is cut changes in proportion."""
        at_most = self.at_most
        if at_most is not None and self.tolerance > 0:
            at_most *= tolerance / self.tolerance
        return replace(self, tolerance=tolerance, at_most=at_most)

    def values(self, fractions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values below which the given fractions of all cameras lie: the inverse of the CDF.

        Parameters
        ----------
        fractions
            More than 0 and less than 1, any shape.
        """
        if self.distribution == "normal":
            tail = ndtr(-self._cut)
            unit = ndtri(tail + fractions * (1 - 2 * tail)) / _SIGMAS
        elif self.distribution == "uniform":
            unit = 2 * fractions - 1
        else:
            nearer = np.minimum(fractions, 1 - fractions)
            unit = np.copysign(1 - np.sqrt(2 * nearer), fractions - 0.5)
        values: NDArray[np.float64] = self.middle + self.tolerance * unit
        return values

    @property
    def variance(self) -> float:
        """Second central moment, in the unit's square."""
        if self.distribution == "normal":
            tails = (
                2 * self._cut * self._density / self._retained if math.isfinite(self._cut) else 0.0
            )
            return (1 - tails) * (self.tolerance / _SIGMAS) ** 2
        return self.tolerance**2 / (3 if self.distribution == "uniform" else 6)

    @property
    def fourth_moment(self) -> float:
        """Fourth central moment."""
        if self.distribution == "normal":
            cut = self._cut
            tails = (
                2 * (cut**3 + 3 * cut) * self._density / self._retained if cut < math.inf else 0.0
            )
            return (3 - tails) * (self.tolerance / _SIGMAS) ** 4
        return self.tolerance**4 / (5 if self.distribution == "uniform" else 15)

    @property
    def _cut(self) -> float:
        """Standard deviations at which a normal distribution is cut."""
        if self.at_most is None or self.tolerance == 0:
            return math.inf
        return self.at_most / (self.tolerance / _SIGMAS)

    @property
    def _density(self) -> float:
        return math.exp(-(self._cut**2) / 2) / math.sqrt(2 * math.pi)

    @property
    def _retained(self) -> float:
        """Fraction that is not cut off."""
        return float(1 - 2 * ndtr(-self._cut))


def random_fractions(name: str, trials: int, seed: int) -> NDArray[np.float64]:
    """Random fractions between 0 and 1 for one parameter, the same for one name and seed.

    More trials begin with those of fewer, and other parameters change nothing.

    Parameters
    ----------
    name
        Of the parameter.
    trials
        How many.
    seed
        0 or more.
    """
    generator = np.random.default_rng([seed, *name.encode()])
    # Never 0, whose normal value is infinite.
    return np.maximum(generator.random(trials), np.finfo(np.float64).tiny)


def draw(parameters: tuple[Parameter, ...], trials: int, seed: int) -> Tensor:
    """Draw cameras.

    Parameters
    ----------
    parameters
        Independent of each other.
    trials
        How many cameras.
    seed
        0 or more.

    Returns
    -------
    Tensor
        float64, (trials, parameters), each in its unit.
    """
    columns = [each.values(random_fractions(each.name, trials, seed)) for each in parameters]
    return torch.from_numpy(np.stack(columns, axis=1))


@dataclass(frozen=True)
class Variable:
    """A quantity of a camera that can vary.

    Parameters
    ----------
    name
        In tolerance files.
    unit
        As in `Parameter`.
    middle
        What the camera's description says.
    lowest, highest
        Between these, ends included, it is possible.
    usual
        ± that is assumed where nobody gives one, with its middle; None: it does not vary.
    note
        Why that is assumed.
    """

    name: str
    unit: str
    middle: float
    lowest: float
    highest: float
    usual: tuple[float, float] | None
    note: str

    @property
    def accepted(self) -> str:
        """What values are possible, for messages."""
        if self.lowest == math.nextafter(0, 1):
            return f"it must be more than 0 {self.unit}"
        return f"it must be {self.lowest:g} to {amount(self.highest, self.unit, digits=6)}"


def variables(camera: Camera) -> dict[str, Variable]:
    """All quantities of a camera that can vary, by name.

    Thickness and index (at 550 nm) of every layer; wedge of the mask's layer, of which
    the sensor's longer side sees thicker and thinner parts; relief.gain, a factor on its heights;
    relief.shrinkage, which makes the relief smaller in all directions and its layer thinner;
    decentre of the mask along the sensor's rows, in which the wedge rises.

    Raises
    ------
    OptionError
        If the camera's mask is flat, so that it has no PSF.
    """
    if isinstance(camera.mask.relief, Flat):
        raise OptionError(
            f"the mask of {camera.name!r} is flat, so it casts no PSF that could be sharp: "
            "give a camera whose relief is random-lenslets or a file"
        )
    varying = []
    for number, name in enumerate(layer_names(camera)):
        varying += _of_layer(camera, number, name)
    layer = camera.layers[camera.mask.surface]
    steepest = math.degrees(math.atan(0.2 * layer.thickness.um / lit_width_um(camera)))
    positive = math.nextafter(0, 1)
    sensor_um = camera.sensor.columns * camera.sensor.pitch.um
    varying += [
        Variable(
            "wedge",
            "deg",
            0.0,
            -_WEDGE_LIMIT_DEG,
            _WEDGE_LIMIT_DEG,
            (0.0, _rounded(min(0.5, steepest))),
            "assumed: the mould lies on a printed frame",
        ),
        Variable(
            "relief.gain",
            "%",
            100.0,
            positive,
            200.0,
            (100.0, 5.0),
            "assumed: depth of the mould's copy",
        ),
        Variable(
            "relief.shrinkage",
            "%",
            0.0,
            -_SCALE_LIMIT,
            _SCALE_LIMIT,
            (2.0, 1.0),
            "assumed: shrinkage of a resin as it cures",
        ),
        Variable(
            "decentre",
            "um",
            0.0,
            -sensor_um / 2,
            sensor_um / 2,
            (0.0, _rounded(min(100.0, sensor_um / 8))),
            "assumed: laid on by hand",
        ),
    ]
    return {each.name: each for each in varying}


def find(known: dict[str, Variable], camera: Camera, name: str) -> Variable:
    """Look a quantity up, also by the number of its layer, as in ``layers.0.thickness``.

    Raises
    ------
    OptionError
        If there is none of this name; with the nearest one and all of them.
    """
    numbered = _NUMBERED.fullmatch(name)
    if numbered is not None and numbered[2] and int(numbered[1][:3]) < len(camera.layers):
        name = layer_names(camera)[int(numbered[1][:3])] + numbered[2]
    if name in known:
        return known[name]
    raise OptionError(
        f"the camera {camera.name!r} has no parameter {name!r}{suggestion(name, known)} "
        f"Known are {', '.join(known)}"
    )


def default_parameters(camera: Camera) -> tuple[Parameter, ...]:
    """Assumptions for a camera of which nobody has measured how well it can be made.

    Normal distributions whose tolerance is 2 σ: the mask's layer ± 50 um and all others ± 20 um
    (a tenth of a thin layer), indices ± 0.005, wedge ± 0.5 deg, heights ± 5 %, shrinkage 2 ± 1 %,
    decentre ± 100 um.

    Raises
    ------
    OptionError
        If the camera's mask is flat.
    """
    return tuple(
        Parameter(each.name, "normal", *each.usual, each.unit, note=each.note)
        for each in variables(camera).values()
        if each.usual is not None
    )


def layer_names(camera: Camera) -> tuple[str, ...]:
    """Names of layers: their own where nothing else has them, else ``layers.`` and the number."""
    own = [layer.name or "" for layer in camera.layers]
    return tuple(
        name
        if own.count(name) == 1 and name and name != "relief" and not _NUMBERED.fullmatch(name)
        else f"layers.{number}"
        for number, name in enumerate(own)
    )


def lit_width_um(camera: Camera) -> float:
    """Length along the sensor's rows over which its PSF extends."""
    width = camera.sensor.columns * camera.sensor.pitch.um
    aperture = camera.mask.aperture
    return width if aperture is None else min(width, aperture.width.um)


def _of_layer(camera: Camera, number: int, name: str) -> list[Variable]:
    layer = camera.layers[number]
    thickness, index = layer.thickness.um, camera.indices(REFERENCE_NM)[number]
    moulded = number == camera.mask.surface
    usual = _rounded(min(50.0 if moulded else 20.0, thickness / 10))
    note = "a printed frame" if moulded else "the part's usual spread"
    air = index < _AIR_BELOW
    return [
        Variable(
            f"{name}.thickness",
            "um",
            thickness,
            math.nextafter(0, 1),
            math.inf,
            (thickness, usual),
            f"assumed: {note}",
        ),
        Variable(
            f"{name}.index",
            "",
            index,
            1.0,
            4.0,
            None if air else (index, 0.005),
            "" if air else "assumed: from batch to batch",
        ),
    ]


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")


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
    parameters: dict[str, Parameter] = {}
    for row in table.parameter:
        try:
            parameter = _parameter(row, known, camera)
            if parameter.name in parameters:
                raise OptionError(f"{row.name} is given twice: leave one out")
        except OptionError as error:
            raise OptionError(f"{source}: {error}") from None
        parameters[parameter.name] = parameter
    return tuple(parameters.values())


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
    if row.distribution not in _DISTRIBUTIONS:
        raise OptionError(
            f"{row.name}: there is no distribution {row.distribution!r}"
            f"{suggestion(row.distribution, _DISTRIBUTIONS)} Known are {', '.join(_DISTRIBUTIONS)}"
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


def _value(value: Any, where: str, unit: str) -> float:
    try:
        if unit:
            return float(_RANGES[unit].check(_KINDS[unit].parse(value)).to(unit))
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise OptionError("an index has no unit, give a number such as 0.005")
        return float(_RANGES[unit].check(value))
    except (OptionError, PydanticCustomError) as error:
        raise OptionError(f"{where} is {quoted(value)}: {error}") from None


def _text(value: float, unit: str) -> str | float:
    return f"{float(f'{value:.10g}'):.10g} {unit}" if unit else float(f"{value:.10g}")
