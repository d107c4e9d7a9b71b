"""Numbers with a unit: lengths, angles, durations, fractions and luminances.

A quantity keeps the number as it was written, so that a file which is read and written again
does not change, and compares by its exact value, so that ``1060 um`` equals ``1.06 mm``.
"""

import re
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from typing import Any, ClassVar, Self

from pydantic_core import PydanticCustomError, core_schema

from nolens.errors import OptionError

_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_TEXT = re.compile(rf"({_NUMBER})\s*([^\s0-9.,+-].*)?")
_SIZES = 30
_LONGEST = 100
_PI = Fraction("3.14159265358979323846264338327950288419716939937511")


@dataclass(frozen=True, eq=False)
class Quantity:
    """A number and its unit; `Length`, `Angle` and the others say which units there are.

    Attributes
    ----------
    number
        The number as it was written, in any decimal notation: ``"1.06"``, ``"-3e-2"``.
    unit
        Its unit, in the spelling of `units`.

    Raises
    ------
    OptionError
        If the number is none, is not zero and its power of ten is beyond ±30, or the unit is
        unknown.
    """

    number: str
    unit: str

    what: ClassVar[str]
    """Name of such a quantity for messages, with its article."""
    units: ClassVar[dict[str, Fraction]]
    """Units in the spelling that is written, with their size in the first one."""
    usual: ClassVar[str]
    """Such a quantity, for messages."""
    spellings: ClassVar[dict[str, str]] = {}
    """Other spellings of units that are accepted."""

    def __post_init__(self) -> None:
        unit = self.spellings.get(self.unit, self.unit)
        object.__setattr__(self, "unit", unit)
        if re.fullmatch(_NUMBER, self.number) is None:
            raise OptionError(f"{self.number!r} is no number: {self._advice()}")
        if unit not in self.units:
            raise OptionError(
                f"{self.number} {unit} is not {self.what}, the unit {unit!r} is unknown: "
                f"{self._advice()}"
            )
        # Fractions of numbers such as 1e999999999 would fill the memory.
        digits = self.number.lower().partition("e")
        power = int(digits[2][:9] or 0)
        zero = not digits[0].strip("+-0.")
        if not zero and (abs(power) > 999 or abs(Decimal(self.number).adjusted()) > _SIZES):
            raise OptionError(
                f"{self.number} {unit} is beyond any {self.what.split()[-1]}: give a number "
                f"between 1e-{_SIZES} and 1e{_SIZES}, or 0"
            )

    @classmethod
    def parse(cls, value: object) -> Self:
        """Read a quantity from text such as ``"1.06 mm"``, with or without the space.

        Raises
        ------
        OptionError
            If it is no text, no number, or has no unit or one that is not known.
        """
        if isinstance(value, int | float) and abs(value) < 10**_SIZES:
            raise OptionError(cls._no_unit(value))
        if not isinstance(value, str):
            kind = type(value).__name__
            raise OptionError(f"a value of type {kind} is not {cls.what}: {cls._advice()}")
        if len(value) > _LONGEST:
            raise OptionError(f"{value[:20]!r}... is not {cls.what}: {cls._advice()}")
        match = _TEXT.fullmatch(value.strip())
        if match is None:
            raise OptionError(f"{value!r} is not {cls.what}: {cls._advice()}")
        if match[2] is None:
            raise OptionError(cls._no_unit(match[1]))
        return cls(match[1], match[2])

    @classmethod
    def of(cls, number: float, unit: str) -> Self:
        """Make a quantity of a number, such as ``Length.of(1.06, "mm")``.

        Raises
        ------
        OptionError
            If the number is NaN, infinite or beyond any size, or the unit is unknown.
        """
        text = str(number) if isinstance(number, int) else repr(float(number)).removesuffix(".0")
        return cls(text, unit)

    @property
    def exact(self) -> Fraction:
        """The value without rounding, in the first of `units`."""
        # The exponent of a zero can be anything, and would be worked out.
        number = self.number.lower().partition("e")[0]
        return Fraction(self.number if number.strip("+-0.") else 0) * self.units[self.unit]

    def to(self, unit: str) -> float:
        """Value in one of `units`, correctly rounded."""
        return float(self.exact / self.units[unit])

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self.exact == other.exact

    def __hash__(self) -> int:
        return hash((type(self), self.exact))

    def __str__(self) -> str:
        return f"{self.number} {self.unit}"

    @classmethod
    def _advice(cls) -> str:
        return f"write {cls.what} as {cls.usual} (units: {', '.join(cls.units)})"

    @classmethod
    def _no_unit(cls, number: object) -> str:
        unit = cls.usual.split()[-1]
        return (
            f"{number} has no unit: write {cls.what} as {number} {unit} "
            f"(units: {', '.join(cls.units)})"
        )

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> core_schema.CoreSchema:
        """Accept quantities of this type and text; text is what it becomes again."""
        return core_schema.no_info_plain_validator_function(
            cls._validate, serialization=core_schema.to_string_ser_schema(when_used="always")
        )

    @classmethod
    def _validate(cls, value: object) -> Self:
        if isinstance(value, cls):
            return value
        try:
            return cls.parse(value)
        except OptionError as error:
            raise PydanticCustomError("quantity", "{reason}", {"reason": str(error)}) from None


class Length(Quantity):
    """A length in nm, um (or µm), mm, cm or m."""

    what = "a length"
    usual = "1.06 mm"
    units: ClassVar = {
        "nm": Fraction(1),
        "um": Fraction(10**3),
        "mm": Fraction(10**6),
        "cm": Fraction(10**7),
        "m": Fraction(10**9),
    }
    # The micro sign and the Greek letter look the same; keyboards write either.
    spellings: ClassVar = {"\u00b5m": "um", "\u03bcm": "um"}

    @property
    def nm(self) -> float:
        """Nanometres."""
        return self.to("nm")

    @property
    def um(self) -> float:
        """Micrometres."""
        return self.to("um")

    @property
    def mm(self) -> float:
        """Millimetres."""
        return self.to("mm")

    @property
    def m(self) -> float:
        """Metres."""
        return self.to("m")


class Angle(Quantity):
    """An angle in deg (or °), rad or mrad."""

    what = "an angle"
    usual = "30 deg"
    units: ClassVar = {"deg": Fraction(1), "rad": 180 / _PI, "mrad": 180 / _PI / 1000}
    spellings: ClassVar = {"°": "deg"}

    @property
    def deg(self) -> float:
        """Degrees."""
        return self.to("deg")

    @property
    def rad(self) -> float:
        """Radians."""
        return self.to("rad")


class Duration(Quantity):
    """A time in us (or µs), ms or s."""

    what = "a duration"
    usual = "10 ms"
    units: ClassVar = {"us": Fraction(1), "ms": Fraction(10**3), "s": Fraction(10**6)}
    spellings: ClassVar = {"\u00b5s": "us", "\u03bcs": "us"}

    @property
    def s(self) -> float:
        """Seconds."""
        return self.to("s")

    @property
    def ms(self) -> float:
        """Milliseconds."""
        return self.to("ms")


class Percentage(Quantity):
    """A fraction in %."""

    what = "a fraction"
    usual = "90 %"
    units: ClassVar = {"%": Fraction(1)}

    @property
    def value(self) -> float:
        """The fraction as a factor: 0.9 for 90 %."""
        return float(self.exact / 100)

    @classmethod
    def _no_unit(cls, number: object) -> str:
        # 0.9 may stand for 90 % or 0.9 %, so the message must not repeat it.
        return f"{number} has no unit: {cls._advice()}"


class Luminance(Quantity):
    """A luminance in cd/m2 (or cd/m², nit)."""

    what = "a luminance"
    usual = "100 cd/m2"
    units: ClassVar = {"cd/m2": Fraction(1)}
    spellings: ClassVar = {"cd/m²": "cd/m2", "nit": "cd/m2"}

    @property
    def cd_m2(self) -> float:
        """Candela per square metre."""
        return self.to("cd/m2")


class DataSize(Quantity):
    """An amount of data in MB or GB; its first unit is the byte."""

    what = "a size"
    usual = "4 GB"
    units: ClassVar = {"B": Fraction(1), "MB": Fraction(10**6), "GB": Fraction(10**9)}
