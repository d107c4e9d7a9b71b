"""The first lines of the `nolens` command, and `python -m nolens`."""

import os
import sys

from nolens.interrupt import catch, ignore

_TUNABLES, _TUNABLE = "GLIBC_TUNABLES", "glibc.malloc.tcache_count"


def begin_again() -> None:
    """Begin the command again, in this process, with what glibc reads only at the beginning.

    torch asks for arrays at multiples of 64 bytes, and a few bytes beside each are left over. glibc
    keeps such small pieces at hand for each thread; an array that is freed then leaves a hole in
    which the next one, as large, does not fit. Without them, a photo of the paper's size with light
    from everywhere holds 2.3 GB in place of 2.9, in the same time. Processes that this one starts
    have it from here. Nothing happens with another C library.
    """
    before = os.environ.get(_TUNABLES, "")
    if sys.platform != "linux" or _TUNABLE in before:
        return
    try:
        os.confstr("CS_GNU_LIBC_VERSION")
        os.environ[_TUNABLES] = f"{before}:{_TUNABLE}=0".lstrip(":")
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    except (OSError, ValueError):  # Another C library, or no file to begin with.
        return


catch()  # Before anything is loaded: this module is the command's alone.


def main() -> None:
    """Run the command and leave with its exit code."""
    begin_again()
    from nolens.cli.main import main as command

    try:
        command()
    finally:
        ignore()  # What Python puts away now takes a while; the exit code stands.


if __name__ == "__main__":
    main()
