"""`nolens reconstruct` and `nolens info`."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter

from nolens.cli.app import Json, Output, Whole
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.files import describe, read_frame
from nolens.jobs import ReconstructOptions, expand_home
from nolens.jobs import reconstruct as run_reconstruct
from nolens.solvers import Method, Prior, Quality

Main = Parameter(group=Group("What matters most", sort_key=1))
Input = Parameter(group=Group("Files and channels", sort_key=2))
Model = Parameter(group=Group("Model and solver", sort_key=3))
Picture = Parameter(group=Group("Picture", sort_key=4))


def reconstruct(
    measurement: Path | None = None,
    *,
    psf: Path | None = None,
    output: Annotated[tuple[Path, ...] | None, Output] = None,
    psf_wider: Annotated[bool | None, Main] = None,
    region: Annotated[str | None, Main] = None,
    tau: Annotated[float | None, Main] = None,
    quality: Annotated[Quality | None, Main] = None,
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
    field: Annotated[str | None, Model] = None,
    camera: Annotated[str | None, Model] = None,
    method: Annotated[Method | None, Model] = None,
    prior: Annotated[Prior | None, Model] = None,
    iterations: Annotated[int | None, Model, Whole] = None,
    tolerance: Annotated[float | None, Model] = None,
    smooth_part: Annotated[bool | None, Model] = None,
    resume: Annotated[Path | None, Model] = None,
    latency: Annotated[str | None, Model] = None,
    penalties: Annotated[tuple[float, float, float] | None, Model] = None,
    balance: Annotated[bool | None, Model] = None,
    relaxation: Annotated[float | None, Model] = None,
    device: Annotated[Literal["auto", "cpu", "cuda"] | None, Model] = None,
    crop: Annotated[str | None, Picture] = None,
    flip: Annotated[Literal["none", "vertical", "horizontal", "both"] | None, Picture] = None,
    tiff_bits: Annotated[Literal[16, 32] | None, Picture] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Reconstruct a photograph from a measurement and a PSF, or a sequence of them.

    nolens reconstruct raw.dng --psf psf.dng -o out.png

    nolens reconstruct frames/ --psf psf.dng -o pictures

    Parameters
    ----------
    measurement
        What the sensor measured: camera raw, .png, .tif or .npy; or a sequence of frames: a folder
        of such files, a .tif of many pages, a .npy of (frames, height, width[, 1 or 3]). Needed,
        here or in --config.
    psf
        What the sensor measures of a point source: the same kinds of file. Needed too.
    output
        Picture to write: .png (8-bit sRGB; the 99.5th percentile is white) or .tif (linear).
        Needed, and may be given several times. The record of the run goes beside the first,
        as .json. For a sequence, a folder: a .png for every frame, with one white for all.
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
        Average N×N cells into one.  [default: to what the PSF carries with draft, to a quarter of
        that otherwise; 1 beside --region or --crop]
    psf_scale
        The PSF file is finer: N×N of its cells are one of the measurement's.
    psf_wider
        The PSF file is wider: it shows light that falls beside the sensor too.
    region
        Cells that light can come from: HEIGHTxWIDTH around the middle of the sensor, or
        HEIGHTxWIDTH+TOP+LEFT in cells of the sensor's frame.  [default: no limit]
    field
        The same as an angle from side to side, such as 56deg; needs --camera.
    camera
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file: for --field.
    quality
        draft: one pass of the Wiener filter. photo: until the picture no longer changes visibly.
        exact: until all relative residuals are below 1e-4.  [default: photo]
    method
        How to solve.  [default: admm]
    tau
        Weight of the prior: less shows more detail, more hides noise. Try 1e-5 where the PSF is
        exact.  [default: 1e-4; wiener 0.1]
    prior
        What the scene is assumed to be like.  [default: tv]
    iterations
        Limit of the iterations; in a sequence, those of a frame after the first.
        [default: 200; exact 5000; fista 300; in a sequence 8]
    tolerance
        Relative residual at which to stop, instead of the preset's rule.
    smooth_part
        Solve directly for the shading of a scene that fills the view. It needs a PSF that is
        exactly the camera's.  [default: with exact]
    resume
        State that an interrupted run left (.state.npz): goes on with it, given the same files
        and options.
    latency
        Longest time for a frame of a sequence, such as 200ms.  [default: no bound]
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
        options = ReconstructOptions.gather(given, config)
        summary = run_reconstruct(options, reporter).summary
    if json_:
        show(json.dumps(summary))
    else:
        show(_told(summary, default_tau=options.tau is None))
        for path in summary["outputs"]:
            show(path)
    return 130 if reporter.interrupted else 0


def _told(summary: dict[str, Any], *, default_tau: bool) -> str:
    """What came of it, in a line, and what could make it better."""
    end = f"{summary['seconds']:.1f} s on {summary['device']}"
    if "frames" in summary:
        dropped = f", {len(summary['dropped'])} dropped" if summary["dropped"] else ""
        return f"{summary['frames']} frames{dropped} ({summary['stop_reason']}), {end}"
    stop, tau = summary["stop_reason"], f"tau {summary['tau']:g}"
    if stop == "iteration limit":
        stop += ": it still moves; more --iterations, larger cells (--bin 2) or --region help"
    if default_tau and summary["method"] != "wiener":
        tau += " (default: a smaller --tau shows more detail, a larger one less noise)"
    return (
        f"{summary['method']}: {summary['iterations']} iterations ({stop}), {tau}, objective "
        f"{summary['objective']:.4g}, {end}"
    )


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


def _readable(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_readable(each)}" for key, each in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_readable(each) for each in value)
    if isinstance(value, float):
        return f"{value:.6g}"
    return "not stated" if value is None else str(value)
