"""Words for the person at the terminal, and results for whoever reads standard output."""

import os
import sys
from contextlib import suppress

from nolens.errors import FileError
from nolens.printable import message, printable


def say(text: str) -> None:
    """Tell a person on standard error, if there is one to read it: one line, not too long."""
    if sys.stderr is not None:
        # A handler of Ctrl-C may be within a write to it, which Python refuses to begin again.
        with suppress(OSError, RuntimeError):
            print(f"nolens: {message(text)}", file=sys.stderr, flush=True)


def show(text: str) -> None:
    r"""Print a line of a result on standard output; what is not printable in it as ``\u001b``.

    Raises
    ------
    FileError
        If it cannot be written there; a reader that has left already has what it wanted.
    """
    try:
        print(printable(text), flush=True)
    except OSError as error:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())  # Python flushes once more at exit.
        os.close(nowhere)
        if not isinstance(error, BrokenPipeError):
            raise FileError(
                f"cannot write to standard output: {error.strerror or error}"
            ) from error
