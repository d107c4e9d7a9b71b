"""The application that the commands are part of, and what their options have in common."""

from collections.abc import Mapping, Sequence
from typing import Any

from cyclopts import (
    App,
    CycloptsError,
    MissingArgumentError,
    Parameter,
    Token,
    UnusedCliTokensError,
)

from nolens import __version__
from nolens.errors import OptionError
from nolens.files.limits import set_read_limit
from nolens.printable import quoted


def application() -> App:
    """The command without its commands."""
    return App(
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
Quantity = Parameter(allow_leading_hyphen=True)
"""A number with its unit, which may be negative; the job's options read it."""
Json = Parameter(name="--json", negative=(), show_default=False)
Output = Parameter(name=("--output", "-o"))

_MOST_BRACKETS = 100
_READ_LIMIT = "--read-limit"
_USAGE = {
    "reconstruct": "reconstruct RAW --psf PSF -o out.png (-o again for each further picture)",
    "refocus": "refocus RAW --psfs FOLDER -o FOLDER",
    "capture": "capture -o shot.dng",
    "info": "info FILE",
    "calibrate": "calibrate FRAME... --distance 300mm -o FOLDER",
    "calibrate distances": "calibrate distances FOLDER --at 8cm --at 20cm",
    "calibrate pairs": "calibrate pairs MEASURED PICTURES --distance 300mm -o FOLDER",
    "calibrate plan": "calibrate plan CAMERA --angle 56deg",
    "calibrate stitch": "calibrate stitch FOLDER",
    "calibrate surround": "calibrate surround FOLDER RAW... --region 414x414",
    "simulate": "simulate SCENE -o raw.dng",
    "psf": "psf -o psf.tif",
    "camera show": "camera show NAME",
    "camera relief": "camera relief CAMERA MAP -o FOLDER",
    "material list": "material list",
    "material show": "material show NAME",
    "design thickness": "design thickness --film 0.305mm --film-distance 0.4mm --material pua311",
    "design tolerance": "design tolerance CAMERA [TOLERANCES.toml] -o FOLDER",
    "design mask": "design mask KIND -o FOLDER",
    "fabricate": "fabricate CAMERA -o FOLDER",
    "measure field": "measure field FOLDER, --simulate CAMERA, or --dots PICTURE",
    "measure psf": "measure psf PSF --pixel 3.1um",
    "measure resolution two-points": "measure resolution two-points --simulate CAMERA",
    "measure resolution siemens": "measure resolution siemens FRAME --psf PSF --camera FOLDER",
    "measure resolution edge": "measure resolution edge FRAME --psf PSF --camera FOLDER",
    "measure target": "measure target siemens -o star.png",
    "reproduce": "reproduce -o FOLDER",
    "studio": "studio [FOLDER...]",
    "demo": "demo -o FOLDER",
}


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


def given_options(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """What a person gave of a command's arguments, but for how its result is printed."""
    return {
        name: value
        for name, value in arguments.items()
        if value is not None and value != () and name != "json_"
    }


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
        return f"{extra!r} is more than {command} takes: nolens {_USAGE.get(command, '--help')}"
    if isinstance(error, MissingArgumentError) and not error.tokens_so_far and not error.keyword:
        name = error.argument.name if error.argument is not None else "argument"
        if not name.startswith("-"):
            return f"no {name} is given: nolens {_USAGE.get(command, '--help')}"
    return str(error)
