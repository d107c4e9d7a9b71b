"""`nolens calibrate`, of frames of a point source."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from nolens.cli.app import Json, Output, Quantity, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import CalibratePointOptions, calibrate_point

Frames = Parameter(group="Frames")
Source = Parameter(group="Point source")
Result = Parameter(group="Result")


def point(
    *frames: Path,
    distance: Annotated[str | None, Quantity, Source] = None,
    angle: Annotated[str | None, Quantity, Source] = None,
    dark: Annotated[tuple[Path, ...] | None, Frames, Parameter(consume_multiple=True)] = None,
    exposure: Annotated[tuple[str, ...] | None, Quantity, Frames] = None,
    camera: Annotated[str | None, Frames] = None,
    pixel: Annotated[str | None, Quantity, Frames] = None,
    mosaic: Annotated[Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None, Frames] = None,
    stray_light: Annotated[Literal["auto", "none", "floor"] | None, Result] = None,
    as_is: Annotated[bool | None, Result] = None,
    output: Annotated[Path | None, Output, Result] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Make a PSF of pictures of one point source, and add it to a camera's folder.

    nolens calibrate point*.dng --distance 300mm --camera paper -o mycamera

    Once for each place of the light: the folder gathers the PSFs of all distances and angles. Use
    a white LED behind a pinhole of 50 um in a dark room; more frames make less noise, and frames
    of several exposure times keep the faint parts where the long ones clip.

    Parameters
    ----------
    frames
        Camera raw (.dng and others), .tif, .png or .npy, all of the same light. Needed.
    distance
        Of the light from the camera, such as 300mm, or infinity. Needed.
    angle
        Field angles of the light, to the right and up as the photographer sees it, such as
        20deg,-10deg.  [default: 0deg,0deg]
    dark
        Frames with the light off, after the others; those of each exposure time are subtracted
        from its frames.  [default: none, and the black level of the files]
    exposure
        Exposure time, such as 10ms: once for all frames, or once for each in their order.
        [default: what the files say]
    camera
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file; it is copied
        into the folder.  [default: that of the folder, if it has one]
    pixel
        Distance of the pixels in the frames, such as 1.55um, where no camera is known.
    mosaic
        Colours of the 2×2 cell of frames whose files do not say it.
    stray_light
        auto takes away a smooth background where an aperture leaves a dark area, none leaves all
        in, floor takes the darkest light there is for stray light.  [default: auto]
    as_is
        The frames are a finished PSF, such as another group's: subtract its black level and
        nothing else, and warn where frames of a camera would be refused. The middle of the file
        is its zero shift.  [default: off]
    output
        Folder of the camera's PSFs; made if it is not there. The PSF, the list psfs.toml and the
        record calibrate-….json go into it. Needed.
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = calibrate_point(CalibratePointOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    for line in _lines(summary):
        show(line)
    return 0


def _lines(summary: dict[str, Any]) -> list[str]:
    noise = summary["frame_noise"]
    known = {"frames": "the frames", "camera": "the camera's description", "picture": "one frame"}
    signal = ", ".join("-" if each is None else f"{each:.1f}" for each in summary["snr_db"])
    energy = ", ".join(
        f"{name} {each:.3f}"
        for name, each in zip(summary["channels"], summary["energy"], strict=True)
    )
    usable = summary["usable_per_mm"]
    rows, columns = summary["cells"]
    lines = [
        *(_exposure(each) for each in summary["exposures"]),
        f"{100 * summary['saturated_share']:.2g} % saturated in all of them",
        f"noise of a frame: {noise['read_counts']:.3g} counts in the dark, and "
        f"{noise['counts_per_electron']:.3g} counts to the electron (from {known[noise['from']]})",
        f"{rows}×{columns} cells of {summary['cell']}; peak over noise {signal} dB",
        f"energy: {energy}",
        _background(summary),
        _centre(summary),
        "no spatial frequency stands out of the noise"
        if usable is None
        else f"stands out of the noise up to {usable:.1f} lines to the mm",
    ]
    return [*lines, *summary["outputs"]]


def _exposure(figures: dict[str, Any]) -> str:
    time = "unknown exposure time" if figures["ms"] is None else f"{figures['ms']:g} ms"
    text = f"{figures['frames']} frame{'' if figures['frames'] == 1 else 's'} of {time}"
    if figures["dark_frames"]:
        text += f" less {figures['dark_frames']} dark"
    if figures["clipped_share"] > 0:
        text += f", {100 * figures['clipped_share']:.2g} % clipped"
    return text


def _background(summary: dict[str, Any]) -> str:
    stray = ", ".join(f"{100 * each:.3g}" for each in summary["stray_over_peak"])
    floor = ", ".join(f"{100 * each:.3g}" for each in summary["floor_over_peak"])
    if summary["dark_share"] > 0:
        area = f"{100 * summary['dark_share']:.0f} % of the sensor is dark"
    else:
        area = "the pattern fills the sensor"
    return f"{area}; stray light taken away {stray} %, darkest light left {floor} % of the peak"


def _centre(summary: dict[str, Any]) -> str:
    by = summary["centred_by"]
    if summary["frame"] == "sensor":
        text = "as the sensor saw it"
        if "expected_shift_um" in summary:
            text += _place(", its light expected", summary["expected_shift_um"])
        if "shift_um" in summary:
            text += _place(", seen", summary["shift_um"])
        return text
    if by == "its file":
        return "as its file has it: the middle of the file is its zero shift"
    if by == "stated angle":
        return "in the middle, as its light was straight ahead"
    text = _place(f"centred by {by}: its light was", summary["shift_um"])
    if "magnification" in summary:
        text += f"; {summary['magnification']:.5f} times as large as there"
        if summary["expected_magnification"] is not None:
            text += f" ({summary['expected_magnification']:.5f} by the layers)"
    return text


def _place(what: str, shift_um: list[float]) -> str:
    return f"{what} {shift_um[0]:z.1f} µm to the right and {shift_um[1]:z.1f} µm up"
