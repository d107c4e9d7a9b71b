"""Numbers as people and JSON read them: with units, plain decimals, µm, and some digits."""

import math
from typing import Any

_UNITS = {"um": "µm", "us": "µs"}
_LEAST = {"um": 1e-3, "nm": 1e-3, "mm": 1e-5, "deg": 1e-4, "%": 1e-3}
"""What is smaller than half of this, in its unit, is what rounding left of zero."""
_LEAST_NUMBER = 1e-6


def amount(value: float, unit: str = "", *, digits: int = 3, sign: bool = False) -> str:
    """A number and its unit, such as ``14.3 µm``.

    Parameters
    ----------
    value
        Any finite number; residues of rounding become 0.
    unit
        As `nolens.quantities` writes it, or "" for a number.
    digits
        Significant digits; zeros at the end of the decimals are left out.
    sign
        Whether + is written too.
    """
    return f"{_plain(value, unit, digits, '+' if sign else '')} {unit_text(unit)}".rstrip()


def percent(fraction: float) -> str:
    """A fraction of something in per cent, with two digits; 100 % at most."""
    return amount(100 * min(fraction, 1.0), "%", digits=2)


def unit_text(unit: str) -> str:
    """A unit as people read it: um as µm."""
    return _UNITS.get(unit, unit)


def _plain(value: float, unit: str, digits: int, sign: str) -> str:
    if not math.isfinite(value):
        return f"{value:{sign}g}"
    if abs(value) < _LEAST.get(unit, _LEAST_NUMBER) / 2:
        return "0"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    text = f"{round(value, decimals):{sign}.{max(decimals, 0)}f}"
    return text.rstrip("0").rstrip(".") if decimals > 0 else text


def size_text(size: float) -> str:
    """Bytes, such as "1.28 MB" or "5 GB"."""
    return f"{size / 1e9:.3g} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"


def duration_text(seconds: float) -> str:
    """A duration as a person waits it: ``40 s``, ``3 min``, ``1.5 h``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def finite_or_none(value: float) -> float | None:
    """A figure as JSON has it: nothing where it is infinite or no number."""
    return value if math.isfinite(value) else None


def rounded(value: Any, digits: int = 6) -> Any:
    """Figures in values that JSON has, each number with some significant digits.

    Parameters
    ----------
    value
        Numbers, texts, lists and dicts of them; keys become text.
    digits
        Of every number that is no whole one.
    """
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, dict):
        return {str(key): rounded(each, digits) for key, each in value.items()}
    return [rounded(each, digits) for each in value] if isinstance(value, list | tuple) else value
