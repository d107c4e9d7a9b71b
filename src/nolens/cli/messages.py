"""Words for the person at the terminal, and results for whoever reads standard output."""

import os
import sys
from contextlib import suppress

from nolens.errors import FileError


def say(text: str) -> None:
    """Tell a person on standard error, if there is one to read it."""
    if sys.stderr is not None:
        with suppress(OSError):
            print(f"nolens: {text}", file=sys.stderr, flush=True)


def show(text: str) -> None:
    """Print a result on standard output.

    Raises
    ------
    FileError
        If it cannot be written there; a reader that has left already has what it wanted.
    """
    try:
        print(text, flush=True)
    except OSError as error:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())  # Python flushes once more at exit.
        os.close(nowhere)
        if not isinstance(error, BrokenPipeError):
            raise FileError(
                f"cannot write to standard output: {error.strerror or error}"
            ) from error
