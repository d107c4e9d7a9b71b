"""The application that the commands are part of, and what their options have in common."""

import inspect
from collections.abc import Iterable, Sequence

from cyclopts import (
    App,
    CycloptsError,
    MissingArgumentError,
    Parameter,
    Token,
    UnusedCliTokensError,
)
from rich.console import Console

from nolens import __version__
from nolens.errors import OptionError
from nolens.files.input import set_read_limit
from nolens.printable import quoted


class _Application(App):
    """The command; a list of a group's commands shows what each says of itself."""

    def help_print(
        self, tokens: str | Iterable[str] | None = None, *, console: Console | None = None
    ) -> None:
        """Print the help page; commands that are registered by name are loaded for a list."""
        *_, listed = self.parse_commands(tokens)[1]
        if listed is not self:  # All commands have their sentence in `commands.py`.
            listed.resolved_commands()
        super().help_print(tokens, console=console)


def application() -> App:
    """The command without its commands."""
    return _Application(
        name="nolens",
        help="Lensless cameras: design, simulate and make them, and reconstruct what they measure.",
        help_epilogue="Every command takes --read-limit: how much one read of a file may decode, "
        "such as 4GB.  [default: 1.5GB]",
        version=__version__,
        help_format="plaintext",
        suppress_keyboard_interrupt=False,
        default_parameter=Parameter(negative_iterable=()),
    )


def _whole(kind: type, tokens: Sequence[Token]) -> int:
    """A whole number; cyclopts would round 2.5 without a word."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value} is no whole number, such as 2") from None


Whole = Parameter(converter=_whole)

_MOST_BRACKETS = 100
_READ_LIMIT = "--read-limit"


def without_read_limit(arguments: Sequence[str]) -> list[str]:
    """Arguments of any command but for ``--read-limit SIZE``, which is set here.

    Raises
    ------
    OptionError
        If it is given without a size, or with one that is none.
    """
    rest = list(arguments)
    end = rest.index("--") if "--" in rest else len(rest)
    for place in reversed(range(end)):
        name, equals, size = rest[place].partition("=")
        if name == _READ_LIMIT:
            if not equals and place + 1 == end:
                raise OptionError(f"{_READ_LIMIT} needs a size, such as {_READ_LIMIT} 4GB")
            set_read_limit(size if equals else rest[place + 1])
            del rest[place : place + (1 if equals else 2)]
            break
    return rest


def run(app: App, arguments: Sequence[str]) -> int:
    """Run one command of an application and return its exit code.

    Raises
    ------
    OptionError
        If the arguments name no command, or an option or value that it does not have.
    """
    nested = next((each for each in arguments if sum(map(each.count, "[{")) > _MOST_BRACKETS), None)
    if nested is not None:  # Lists may be written as JSON, whose parser recurses into brackets.
        raise OptionError(f"{quoted(nested)} has more than {_MOST_BRACKETS} brackets: give fewer")
    try:
        code = app(
            list(arguments), exit_on_error=False, print_error=False, result_action="return_value"
        )
    except CycloptsError as error:
        raise OptionError(_explain(error)) from None
    return code if isinstance(code, int) else 0


def _explain(error: CycloptsError) -> str:
    """What cyclopts says, but for what it says in its own terms."""
    command = " ".join(error.command_chain or ())
    if isinstance(error, UnusedCliTokensError):
        extra = " ".join(error.unused_tokens or ())
        return f"{extra!r} is more than {command} takes: nolens {_usage(error, command)}"
    if isinstance(error, MissingArgumentError) and not error.tokens_so_far and not error.keyword:
        name = error.argument.name if error.argument is not None else "argument"
        if not name.startswith("-"):
            return f"no {name} is given: nolens {_usage(error, command)}"
    return str(error)


def _usage(error: CycloptsError, command: str) -> str:
    """The shortest way to run a command: that of its job, or by what it takes without a name."""
    target = error.target
    if target is None:
        return f"{command} --help"
    by_place = [
        each.name.upper()
        for each in inspect.signature(target).parameters.values()
        if each.kind is inspect.Parameter.POSITIONAL_ONLY
    ]
    return getattr(target, "usage", "") or " ".join((command, *by_place))
