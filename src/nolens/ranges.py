"""Ranges of numbers and quantities, declared where the field of a model is."""

from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

from nolens.quantities import Quantity


@dataclass(frozen=True)
class Between:
    """Least and largest value of a field: ``Annotated[Length, Between("1 nm", "10 m")]``.

    Attributes
    ----------
    low, high
        Both are allowed. Numbers for a number, text with a unit for a quantity.
    advice
        What else the message says: why, or what to do instead.
    """

    low: float | str
    high: float | str
    advice: str = ""

    def check(self, value: Any) -> Any:
        """Give the value back.

        Raises
        ------
        PydanticCustomError
            If it lies outside; says the range.
        """
        if not self.holds(value):
            reason = f"it must be {_text(self.low)} to {_text(self.high)}"
            if self.advice:
                reason += f": {self.advice}"
            raise PydanticCustomError("range", "{reason}", {"reason": reason})
        return value

    def holds(self, value: Any) -> bool:
        """Whether a value lies inside."""
        if isinstance(value, Quantity):
            kind = type(value)
            low, high = (kind.parse(each).exact for each in (self.low, self.high))
            return bool(low <= value.exact <= high)
        return bool(self.low <= value <= self.high)

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Check what the type itself has accepted."""
        return core_schema.no_info_after_validator_function(self.check, handler(source))


def _text(bound: float | str) -> str:
    if isinstance(bound, str | int):
        return str(bound)
    return f"{bound:.0f}" if bound.is_integer() and bound < 1e15 else f"{bound:g}"
