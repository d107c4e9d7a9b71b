"""TOML and JSON of any origin, parsed within limits.

A text is scanned once, in time proportional to its length, before a parser sees it: parsers
recurse into brackets, and turn digits into numbers in time that grows as their square.
"""

import json
import math
import re
import tomllib
from typing import Any

from nolens.errors import DataError
from nolens.printable import printable

_LONGEST_TOML = 2 * 10**6
"""Characters of a TOML text; tomllib takes a second for them."""
LONGEST_JSON = 16 * 10**6
"""Characters of a JSON text."""
_DEEPEST = 40
"""Tables and lists inside one another."""
_LONGEST_WORD = 100
"""Characters of a number, or of a key without quotes."""
_LONGEST_TEXT = 10**6
"""Characters of a text in quotes."""

_LONGEST_REASON = 160
_WORD = rf"[0-9A-Za-z_+.\-]{{{_LONGEST_WORD + 1},}}"
# Texts without an end run to the end, so that no part of them is looked at twice; the parser
# refuses them.
_TOML = re.compile(
    r'"""(?:[^\\]|\\.)*?(?:"{3,5}|\Z)'
    r"|'''.*?(?:'{3,5}|\Z)"
    r'|"(?:[^"\\\n]|\\.)*"?'
    r"|'[^'\n]*'?"
    r"|\#[^\n]*"
    rf"|(?P<word>{_WORD})"
    r"|(?P<open>[\[{])|(?P<close>[\]}])|(?P<dot>\.)|(?P<end>[\n=,])",
    re.DOTALL,
)
_JSON = re.compile(
    rf'"(?:[^"\\]|\\.)*"?|(?P<word>{_WORD})|(?P<open>[\[{{])|(?P<close>[\]}}])', re.DOTALL
)
_HALF_CHARACTER = re.compile("[\ud800-\udfff]")


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Read a TOML text.

    Parameters
    ----------
    text
        The text.
    source
        Where it comes from, usually the path of a file, for messages.

    Raises
    ------
    DataError
        If it is no TOML (with line and column), too long, nested too deep, or holds a number or
        a text that is too long.
    """
    _scan(text, source, _TOML, _LONGEST_TOML, "TOML file")
    try:
        value = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{source} is no TOML file: {_reason(error)}") from None
    _check(value, source)
    return value


def parse_json(text: str, source: str) -> Any:
    """Read a JSON text; NaN, Infinity and numbers beyond 1.8e308 are none.

    Parameters
    ----------
    text
        The text.
    source
        Where it comes from, usually the path of a file, for messages.

    Raises
    ------
    DataError
        If it is no JSON (with line and column), too long, nested too deep, or holds a number or
        a text that is too long, or half of a surrogate pair.
    """
    _scan(text, source, _JSON, LONGEST_JSON, "JSON")
    try:
        value = json.loads(text, parse_float=_finite, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{source} is no JSON: {_reason(error)}") from None
    _check(value, source)
    return value


def _scan(text: str, source: str, tokens: re.Pattern[str], longest: int, kind: str) -> None:
    if len(text) > longest:
        raise DataError(
            f"{source} has {len(text)} characters: a {kind} may have {longest // 10**6} million"
        )
    depth = dots = 0
    for token in tokens.finditer(text):
        match token.lastgroup:
            case "open":
                depth, dots = depth + 1, 0
            case "close":
                depth, dots = depth - 1, 0
            case "dot":
                dots += 1
            case "end":
                dots = 0
            case "word":
                line = text.count("\n", 0, token.start()) + 1
                raise DataError(
                    f"{source} has a number or key of {len(token[0])} characters in line {line}: "
                    f"give at most {_LONGEST_WORD}"
                )
        # A dotted key costs its length again at every line below it.
        if depth > _DEEPEST or dots > _DEEPEST:
            raise _too_deep(source)


def _check(value: object, source: str) -> None:
    """Refuse what only shows in the values: the depth of dotted keys, and texts."""
    ahead = [(value, 0)]
    while ahead:
        each, depth = ahead.pop()
        if depth > _DEEPEST:
            raise _too_deep(source)
        if isinstance(each, dict):
            ahead += [(inner, depth + 1) for pair in each.items() for inner in pair]
        elif isinstance(each, list):
            ahead += [(inner, depth + 1) for inner in each]
        elif isinstance(each, str):
            if len(each) > _LONGEST_TEXT:
                raise DataError(
                    f"{source} has a text of {len(each)} characters: give at most {_LONGEST_TEXT}"
                )
            if _HALF_CHARACTER.search(each):
                raise DataError(
                    f"{source} has a text with half of a character in it (a lone surrogate, "
                    "\\ud800 to \\udfff): give the whole character"
                )


def _too_deep(source: str) -> DataError:
    return DataError(
        f"{source} has tables or lists inside one another more than {_DEEPEST} deep: give a "
        "flatter one"
    )


def _finite(number: str) -> float:
    value = float(number)
    if math.isinf(value):
        raise ValueError(f"{number} is beyond the largest number, 1.8e308")
    return value


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is no number")


def _reason(error: Exception) -> str:
    text = printable(str(error))
    return text if len(text) <= _LONGEST_REASON else f"{text[:_LONGEST_REASON]}..."
