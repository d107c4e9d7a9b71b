"""The `nolens` command, and its exit codes.

0; 2 for what the user can mend; 3 where some items of a set failed; 1 for a bug; 130 if stopped.
"""

import errno
import sys
from collections.abc import Sequence

from nolens.cli.messages import say
from nolens.errors import NolensError
from nolens.interrupt import MESSAGE
from nolens.process import leave, prepare


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and leave with its exit code."""
    prepare()
    code = _guard(list(sys.argv[1:] if arguments is None else arguments))
    leave()
    sys.exit(code)


def _guard(arguments: list[str]) -> int:
    try:
        # The commands bring torch with them, for which the process is prepared by now.
        from nolens.cli.app import run

        return run(arguments)
    except NolensError as error:
        say(str(error))
        return 2
    except OSError as error:
        # Files of the user's are FileErrors by now: this is a library that stores something.
        if error.errno not in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT):
            raise
        say(f"the disk has no space left: {error}. Make room and run it again")
        return 2
    except KeyboardInterrupt:
        # Where the command is called from Python, whose Ctrl-C it is.
        say(MESSAGE)
        return 130
