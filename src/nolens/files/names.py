"""File names in texts."""

import os
from pathlib import Path


def readable(text: str | Path) -> str:
    """A path, or a text with one in it, to print and store: bytes that are no UTF-8 as U+FFFD."""
    return os.fsencode(text).decode("utf-8", "replace")
