"""Values with their uncertainty ±, as a person writes them, and what becomes of it."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import torch
from pydantic import GetCoreSchemaHandler
from pydantic_core import core_schema
from torch import Tensor

from nolens.camera.part import refusal
from nolens.errors import OptionError
from nolens.quantities import Length
from nolens.ranges import Between

_BETWEEN = re.compile(r"±|\+/-|\+-")
_NUMBER = re.compile(r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*")
_LARGEST = 1e30


@dataclass(frozen=True)
class Uncertain:
    """A value, and by how much it may be off.

    Attributes
    ----------
    value
        The value; a length in um.
    plus_minus
        ±, 0 or more, in the same unit: a standard uncertainty or a limit, whichever the person
        means; what follows from it is of the same kind.
    """

    value: float
    plus_minus: float = 0.0

    def summary(self, scale: float = 1.0) -> dict[str, Any]:
        """The value and its ± in another unit, of which one of its own is `scale`."""
        return {"value": self.value * scale, "plus_minus": self.plus_minus * scale}

    @classmethod
    def length(cls, text: str) -> Self:
        """Read ``0.4mm``, ``0.4mm±0.2mm`` or ``0.4±0.2mm``, with ± or +-.

        Raises
        ------
        OptionError
            If it is no length, a unit is missing, or ± is negative.
        """
        middle, off = _parts(text)
        if off is None:
            return cls(Length.parse(middle).um)
        spread = Length.parse(off)
        if _NUMBER.fullmatch(middle):
            middle = f"{middle.strip()} {spread.unit}"
        return cls._checked(text, Length.parse(middle).um, spread.um)

    @classmethod
    def number(cls, text: str) -> Self:
        """Read ``1.47`` or ``1.47±0.005``, with ± or +-.

        Raises
        ------
        OptionError
            If it is no number, or ± is negative.
        """
        middle, off = _parts(text)
        for part in (middle, off):
            if part is not None and not (_NUMBER.fullmatch(part) and abs(float(part)) < _LARGEST):
                raise OptionError(f"{text!r} is no number: write one such as 1.47 or 1.47±0.005")
        return cls._checked(text, float(middle), float(off or 0))

    @classmethod
    def _checked(cls, text: str, value: float, plus_minus: float) -> Self:
        if plus_minus < 0:
            raise OptionError(f"{text!r} has a negative ±: write how far off it may be, 0 or more")
        return cls(value, plus_minus)


@dataclass(frozen=True)
class Around(Between):
    """Range of an `Uncertain` in a model, which is read from text; its ± is at most the high end.

    Bounds with a unit are those of a length, numbers those of a number.
    """

    def holds(self, value: Uncertain) -> bool:
        """Whether a value lies inside."""
        low, high = (
            Length.parse(each).um if isinstance(each, str) else each
            for each in (self.low, self.high)
        )
        return low <= value.value <= high and value.plus_minus <= high

    def _read(self, value: Any) -> Any:
        if isinstance(value, Uncertain):
            return value
        try:
            return (Uncertain.length if isinstance(self.low, str) else Uncertain.number)(value)
        except OptionError as error:
            raise refusal(str(error)) from None

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Read text, and check what it says."""
        text = core_schema.no_info_before_validator_function(self._read, handler(source))
        return core_schema.no_info_after_validator_function(self.check, text)


@dataclass(frozen=True)
class Propagated(Uncertain):
    """A result with its ±, and where that comes from.

    Attributes
    ----------
    parts
        Of every input whose ± is not 0, what it contributes alone, with the sign of the slope.
    """

    parts: dict[str, float] = field(default_factory=dict)

    @property
    def fractions(self) -> dict[str, float]:
        """Of every input in the square of ±; they add up to 1."""
        if self.plus_minus == 0:
            return {}
        return {name: (part / self.plus_minus) ** 2 for name, part in self.parts.items()}

    def summary(self, scale: float = 1.0) -> dict[str, Any]:
        """The same, with what the ± is made of."""
        summary = super().summary(scale)
        if self.parts:
            summary["parts"] = {name: part * scale for name, part in self.parts.items()}
            summary["fractions"] = self.fractions
        return summary


def propagate(
    inputs: Mapping[str, Uncertain], results: Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]]
) -> dict[str, Propagated]:
    r"""Carry the ± of inputs over to results, to first order.

    For independent inputs :math:`u^2(y) = \sum_i (∂y/∂x_i)^2 u^2(x_i)` (`jcgm100`, 5.1.2), with
    the slopes by automatic differentiation.

    Parameters
    ----------
    inputs
        By name.
    results
        Gives the results by name, float64 scalars, from such scalars.
    """
    names = list(inputs)
    values = torch.tensor(
        [inputs[name].value for name in names], dtype=torch.float64, requires_grad=True
    )
    propagated = {}
    for name, result in results(dict(zip(names, values.unbind(), strict=True))).items():
        slopes = torch.zeros_like(values)
        if result.requires_grad:
            (gradient,) = torch.autograd.grad(result, values, retain_graph=True, allow_unused=True)
            slopes = slopes if gradient is None else gradient
        parts = {
            each: float(slope) * inputs[each].plus_minus
            for each, slope in zip(names, slopes, strict=True)
            if inputs[each].plus_minus > 0
        }
        propagated[name] = Propagated(float(result.detach()), math.hypot(*parts.values()), parts)
    return propagated


def _parts(text: object) -> tuple[str, str | None]:
    """What stands before and behind ±."""
    if not isinstance(text, str):
        raise OptionError(f"{text!r} is no text: write a value such as 0.4mm±0.2mm")
    parts = _BETWEEN.split(text)
    if len(parts) > 2:
        raise OptionError(f"{text!r} has ± more than once: write a value such as 0.4mm±0.2mm")
    return (parts[0], parts[1]) if len(parts) == 2 else (text, None)
