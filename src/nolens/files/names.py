"""File names in texts."""

import os
import re
from pathlib import Path

_HALF_CHARACTERS = re.compile("[\ud800-\udfff]")


def readable(text: str | Path) -> str:
    """A path, or a text with one in it, to print and store: bytes that are no UTF-8 as U+FFFD."""
    return _HALF_CHARACTERS.sub("\ufffd", os.fspath(text))
