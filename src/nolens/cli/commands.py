"""What `nolens` can be told to do: its commands, their options and their help."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

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
from nolens.cli.terminal import TerminalReporter
from nolens.errors import OptionError
from nolens.files import describe, read_frame, readable
from nolens.jobs import Method, ReconstructOptions, expand_home, run_demo
from nolens.jobs import reconstruct as run_reconstruct
from nolens.solvers import Prior

app = App(
    name="nolens",
    help="Photographs from lensless cameras: a raw measurement and a PSF in, a picture out.",
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


Input = Parameter(group="Input")
Model = Parameter(group="Model and solver")
Picture = Parameter(group="Picture")
Whole = Parameter(converter=_whole)
Json = Parameter(name="--json", negative=(), show_default=False)

_USAGE = {
    "reconstruct": "reconstruct RAW --psf PSF -o out.png (-o again for each further picture)",
    "info": "info FILE",
    "demo": "demo -o FOLDER",
}


@app.command
def reconstruct(
    measurement: Path | None = None,
    *,
    psf: Path | None = None,
    output: Annotated[tuple[Path, ...] | None, Parameter(name=("--output", "-o"))] = None,
    config: Path | None = None,
    dark: Annotated[Path | None, Input] = None,
    flat: Annotated[Path | None, Input] = None,
    black: Annotated[str | None, Input] = None,
    white: Annotated[float | None, Input] = None,
    mosaic: Annotated[str | None, Input] = None,
    bgr: Annotated[bool | None, Input] = None,
    channels: Annotated[str | None, Input] = None,
    bin: Annotated[int | None, Input, Whole] = None,  # noqa: A002 (the option's name)
    psf_scale: Annotated[int | None, Input, Whole] = None,
    psf_wider: Annotated[bool | None, Input] = None,
    region: Annotated[str | None, Model] = None,
    method: Annotated[Method | None, Model] = None,
    tau: Annotated[float | None, Model] = None,
    prior: Annotated[Prior | None, Model] = None,
    iterations: Annotated[int | None, Model, Whole] = None,
    tolerance: Annotated[float | None, Model] = None,
    penalties: Annotated[tuple[float, float, float] | None, Model] = None,
    balance: Annotated[bool | None, Model] = None,
    relaxation: Annotated[float | None, Model] = None,
    device: Annotated[Literal["auto", "cpu", "cuda"] | None, Model] = None,
    crop: Annotated[str | None, Picture] = None,
    flip: Annotated[Literal["none", "vertical", "horizontal", "both"] | None, Picture] = None,
    tiff_bits: Annotated[Literal[16, 32] | None, Picture] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Reconstruct a photograph from a measurement and a PSF.

    nolens reconstruct raw.dng --psf psf.dng -o out.png

    Parameters
    ----------
    measurement
        What the sensor measured: camera raw, .png, .tif or .npy. Needed, here or in --config.
    psf
        What the sensor measures of a point of light: the same kinds of file. Needed too.
    output
        Picture to write: .png (8-bit sRGB; the 99.5th percentile is white) or .tif (linear).
        Needed, and may be given several times. The record of the run goes beside the first,
        as .json.
    config
        TOML file that holds any of these options, with _ or - in their names. Relative paths
        in it start from its folder; what is given here wins.
    dark
        Dark frame; it is subtracted, and holds the black level too.
    flat
        Flat field; the measurement is divided by it.
    black
        Black level in counts, or "auto": read off the PSF's darkest corner. Camera raw says it.
    white
        Count from which a pixel is saturated. Camera raw and 8 or 16-bit files say it.
    mosaic
        RGGB, BGGR, GRBG or GBRG: a .tif, .png or .npy holds raw counts of a colour mosaic.
    bgr
        Colour channels are stored as B, G, R.
    channels
        all, grey, or letters such as g or rg.  [default: all]
    bin
        Average N×N cells into one.  [default: 1]
    psf_scale
        The PSF file is finer: N×N of its cells are one of the measurement's.
    psf_wider
        The PSF file is wider: it shows light that falls beside the sensor too.
    region
        Cells that light can come from: HEIGHTxWIDTH around the middle of the sensor, or
        HEIGHTxWIDTH+TOP+LEFT in cells of the sensor's frame.  [default: no limit]
    method
        How to solve.  [default: admm]
    tau
        Weight of the prior.  [default: 1e-4; wiener 0.1]
    prior
        What the scene is assumed to be like.  [default: tv]
    iterations
        Limit of the iterations.  [default: 100; fista 300]
    tolerance
        Relative residual at which to stop.  [default: 3e-4; fista 1e-4]
    penalties
        Three penalties of ADMM to start with, as three numbers.
    balance
        Balance ADMM's penalties while it runs.  [default: on]
    relaxation
        Over-relaxation of ADMM, between 0 and 2.  [default: 1.8]
    device
        Where to compute; auto takes CUDA where there is one.  [default: auto]
    crop
        Part of the scene to write, written like --region, or all.
        [default: the region, or without one the sensor's frame]
    flip
        Turn the picture over.  [default: none]
    tiff_bits
        16 (white is 65535) or 32 (radiance as float).  [default: 16]
    json_
        Print one JSON object on standard output.
    """
    given = {
        name: value
        for name, value in locals().items()
        if value is not None and name not in ("config", "json_")
    }
    reporter = TerminalReporter()
    with reporter:
        outcome = run_reconstruct(ReconstructOptions.gather(given, config), reporter)
    summary = outcome.summary
    if json_:
        show(json.dumps(summary))
    else:
        show(
            f"{summary['method']}: {summary['iterations']} iterations "
            f"({summary['stop_reason']}), objective {summary['objective']:.4g}, "
            f"{summary['seconds']:.1f} s on {summary['device']}"
        )
        for path in summary["outputs"]:
            show(path)
    return 130 if reporter.interrupted else 0


@app.command
def info(
    file: Path,
    /,
    *,
    mosaic: str | None = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Say what a file holds: size, channels, mosaic, levels, range.

    Parameters
    ----------
    file
        Camera raw, .png, .tif or .npy.
    mosaic
        Colour mosaic of a .tif, .png or .npy that holds raw counts.
    json_
        Print one JSON object on standard output.
    """
    found = describe(read_frame(expand_home(file), mosaic=mosaic))
    if json_:
        show(json.dumps(found))
    else:
        width = max(len(name) for name in found)
        for name, value in found.items():
            show(f"{name.replace('_', ' '):{width}}  {_readable(value)}")
    return 0


@app.command
def demo(
    *,
    output: Annotated[Path, Parameter(name=("--output", "-o"))] = Path("demo"),
    json_: Annotated[bool, Json] = False,
) -> int:
    """Simulate a small lensless camera, and reconstruct a photograph from its files.

    Parameters
    ----------
    output
        Folder for the files of the camera and the pictures.
    json_
        Print one JSON object on standard output.
    """
    reporter = TerminalReporter()
    with reporter:
        result = run_demo(expand_home(output), reporter)
    if json_:
        show(
            json.dumps(
                {
                    **result.outcome.summary,
                    "psnr_db": result.psnr_db,
                    "picture": readable(result.picture),
                }
            )
        )
    else:
        summary = result.outcome.summary
        show(
            f"PSNR {result.psnr_db:.1f} dB after {summary['iterations']} iterations "
            f"({summary['seconds']:.1f} s on {summary['device']})"
        )
        show(f"measurement | reconstruction | truth: {readable(result.picture)}")
    return 130 if reporter.interrupted else 0


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code.

    Raises
    ------
    OptionError
        If the arguments name no command, or an option or value that it does not have.
    """
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


def _readable(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_readable(each)}" for key, each in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_readable(each) for each in value)
    if isinstance(value, float):
        return f"{value:.6g}"
    return "not stated" if value is None else str(value)
