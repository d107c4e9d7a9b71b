"""Text from files and people, made fit for a line of a message."""

import difflib
import os
import unicodedata
from collections.abc import Iterable

_OBEYED = ("Cc", "Cf", "Cs", "Zl", "Zp")
_LONGEST_VALUE = 60
_LONGEST_MESSAGE = 1500


def printable(text: str) -> str:
    r"""Write what is not printable as escapes, such as ``\u001b``, and new lines as ``\n``.

    Control characters, those that turn the direction of writing, and halves of surrogate pairs:
    what a terminal would obey, or what cannot be printed. JSON keeps its meaning: of these it
    leaves but U+007F, and has such escapes too.
    """
    if text.isprintable():
        return text
    return "".join(
        _escape(each) if unicodedata.category(each) in _OBEYED else each for each in text
    )


def _escape(character: str) -> str:
    return repr(character)[1:-1].replace(r"\x", r"\u00")


def quoted(value: object) -> str:
    """A value as Python writes it, short enough to stand in a message; the middle gives way."""
    try:
        text = repr(os.fspath(value) if isinstance(value, os.PathLike) else value)
    except (ValueError, RecursionError):
        # Whole numbers of more than 4300 digits, or tables in tables without end.
        return "too long to be shown"
    return _without_middle(text, _LONGEST_VALUE, "…")


def suggestion(name: str, known: Iterable[str]) -> str:
    """What follows an unknown name in a message: the nearest known one as a question, or ``;``."""
    near = difflib.get_close_matches(name.lower(), list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ";"


def message(text: str) -> str:
    """A whole message on one line of some length at most: how it begins, and its advice at the end.

    A line for a terminal, which is some lines there.
    """
    text = printable(text)
    left_out = len(text) - _LONGEST_MESSAGE
    return _without_middle(text, _LONGEST_MESSAGE, f" … ({left_out} characters left out) … ")


def _without_middle(text: str, longest: int, between: str) -> str:
    if len(text) <= longest:
        return text
    end = longest // 3
    return f"{text[: longest - end]}{between}{text[-end:]}"
