"""The command `nolens`: its list of commands, and what their options have in common."""

import inspect
from collections.abc import Sequence

from cyclopts import (
    App,
    CycloptsError,
    MissingArgumentError,
    Parameter,
    Token,
    UnusedCliTokensError,
)

from nolens import __version__
from nolens.cli.messages import show
from nolens.errors import OptionError
from nolens.files.input import set_read_limit
from nolens.printable import quoted

COMMANDS = {
    "reconstruct:reconstruct": "Reconstruct a photograph from a measurement and a PSF.",
    "refocus:refocus": "Focus a photograph at any depth, after it was taken.",
    "batch:batch": "Do a job for every item of a set, on all cores or a cluster.",
    "capture:capture": "Take raw frames with a camera: "
    "one, many, averaged, bracketed, or over a long time.",
    "reconstruct:info": "Say what a file holds: size, channels, mosaic, levels, range.",
    "calibrate:calibrate": "Make a PSF of "
    "pictures of one point source, and add it to a camera's folder.",
    "measure:measure": "Measure how good a camera is: PSF, resolution, field of view.",
    "collect:collect": "Show pictures on a screen, and take a raw frame of each: pairs of "
    "measurement and picture.",
    "compare:compare": "Say how near pictures come to the truth: PSNR, SSIM, MS-SSIM and LPIPS.",
    "simulate:simulate": "Simulate what a lensless camera measures of a scene.",
    "simulate:psf": "Simulate what a lensless camera shows of a point source.",
    "dataset:dataset": "Make data sets of simulated measurements and their truths.",
    "train:train": "Train a prior that knows pictures, for any camera or for yours.",
    "camera:camera": "Descriptions of cameras.",
    "material:material": "Materials that layers of a camera are made of.",
    "design:design": "Design a camera: thickness, tolerances and masks.",
    "fabricate:fabricate": "Write the files that a camera is made from: "
    "frame, mask, process sheet.",
    "reproduce:reproduce": "Make every figure of the paper again that simulation can give, "
    "beside the paper's values.",
    "studio:studio": "Open a page on which to see through a camera, design it, calibrate it and "
    "take pictures.",
    "demo:demo": "Simulate a small lensless camera, and reconstruct a photograph from its files.",
}
"""Every command by file and name, and the first sentence of its help.

A command loads only what it uses, which is why they are known by name here.
"""


_HELP, _HELP_ALL = ("--help", "-h"), "--help-all"
_READ_LIMIT_HELP = (
    "Every command takes --read-limit: how much one read of a file may decode, such as 4GB.  "
    "[default: 1.5GB]"
)
_TWO_HELPS = "nolens COMMAND --help lists what most people need, --help-all every option."


def application(epilogue: str | None = None) -> App:
    """The command without its commands.

    Parameters
    ----------
    epilogue
        What every help ends with.
    """
    return App(
        name="nolens",
        help="Lensless cameras: design, simulate and make them, and reconstruct what they measure.",
        help_epilogue=epilogue,
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
    end = _end_of_options(rest)
    for place in reversed(range(end)):
        name, equals, size = rest[place].partition("=")
        if name == _READ_LIMIT:
            if not equals and place + 1 == end:
                raise OptionError(f"{_READ_LIMIT} needs a size, such as {_READ_LIMIT} 4GB")
            set_read_limit(size if equals else rest[place + 1])
            del rest[place : place + (1 if equals else 2)]
            break
    return rest


def _end_of_options(arguments: Sequence[str]) -> int:
    """Place of ``--``, after which nothing is an option."""
    return list(arguments).index("--") if "--" in arguments else len(arguments)


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code.

    Raises
    ------
    OptionError
        If the arguments name no command, or an option or value that it does not have.
    """
    arguments = without_read_limit(arguments)
    end = _end_of_options(arguments)
    options, names = arguments[:end], arguments[end:]
    everything = _HELP_ALL in options
    if everything:
        arguments = [*(_HELP[0] if each == _HELP_ALL else each for each in options), *names]
    listed = not arguments or arguments[0].startswith("-")
    epilogue = f"{_TWO_HELPS} {_READ_LIMIT_HELP}" if listed else _READ_LIMIT_HELP
    app = application(epilogue if listed or everything else None)
    for path, sentence in COMMANDS.items():
        # A help that is given here replaces the command's own, so only the list of all has it.
        app.command(f"nolens.cli.{path}", help=sentence if listed else None)
    if everything or not any(each in options for each in _HELP):
        return run_app(app, arguments)
    # What only help needs is loaded here.
    from nolens.cli.help import BriefFormatter

    app.help_formatter = brief = BriefFormatter()
    code = run_app(app, arguments)
    if brief.more:
        command = " ".join(app.parse_commands(_without_help(arguments))[0])
        show("")
        show(f"{brief.more} more options: nolens {command} {_HELP_ALL}")
    return code


def _without_help(arguments: Sequence[str]) -> list[str]:
    return [each for each in arguments if each not in _HELP]


def run_app(app: App, arguments: Sequence[str]) -> int:
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
        *_, group = app.parse_commands(_without_help(arguments))[1]
        if group is not app:  # A list of its commands has what each says of itself.
            group.resolved_commands()
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
