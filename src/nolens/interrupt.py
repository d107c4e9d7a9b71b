"""Ctrl-C, where nolens is the process: the command ends at once, whatever it is about to do.

Python raises `KeyboardInterrupt` wherever it happens to be. In a destructor that is lost, in C++
that is being loaded it aborts, and what nobody catches is shown as a traceback. So the command
takes away what is not finished and ends by itself. Only `__main__` asks for that: whoever imports
the package keeps their own signal handlers.

Until `catch` is called, Ctrl-C is Python's. So this loads nothing that Python has not loaded as it
starts: neither `typing` nor `signal`, which makes enumerations of what `_signal` has.
"""

import _signal  # type: ignore[import-not-found]
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

MESSAGE = "stopped at once; files that were not finished are not written"

_unfinished: dict[str, None] = {}
"""Temporary files, and folders made for them, in the order in which they were made."""
_committing: set[object] = set()
_ending = False


def catch() -> None:
    """From now on Ctrl-C takes away what is not finished and ends the process with 130."""
    _signal.signal(_signal.SIGINT, _interrupted)


def ignore() -> None:
    """From now on Ctrl-C does nothing: all is done, and the exit code is to say so."""
    _signal.signal(_signal.SIGINT, _signal.SIG_IGN)


class Unfinished:
    """A block that makes files, or folders, which are of no use before its end.

    Parameters
    ----------
    paths
        They go with Ctrl-C; a folder goes if nothing is left in it.
    """

    def __init__(self, *paths: str | os.PathLike[str]) -> None:
        self._paths = [os.fspath(path) for path in paths]

    def __enter__(self) -> None:
        for path in self._paths:
            _unfinished[path] = None

    def __exit__(self, *_: object) -> None:
        for path in self._paths:
            _unfinished.pop(path, None)


class Uninterrupted:
    """A block, a short one, for whose end Ctrl-C waits: files that become one result."""

    def __enter__(self) -> None:
        _committing.add(self)

    def __exit__(self, *_: object) -> None:
        _committing.discard(self)
        if _ending and not _committing:
            _leave()


def _interrupted(*_: object) -> None:
    global _ending
    _ending = True
    if not _committing:
        _leave()


def _leave() -> None:
    # Python's own streams may be in the midst of a write, which they refuse to begin again.
    if sys.stderr is not None:
        _try(os.write, 2, f"nolens: {MESSAGE}\n".encode())
    for path in reversed(list(_unfinished)):
        _try(os.unlink, path)
        _try(os.rmdir, path)
    os._exit(130)


def _try(call: "Callable[..., object]", *arguments: object) -> None:
    try:
        call(*arguments)
    except OSError:
        return
