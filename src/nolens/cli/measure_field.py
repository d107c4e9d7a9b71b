"""`nolens measure field`."""

import json
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from nolens.cli.app import Json, Output, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import MeasureFieldOptions
from nolens.jobs import measure_field as run_measure_field

Source = Parameter(group="What to measure")
Grid = Parameter(group="Light and grid of dots")
Result = Parameter(group="Result")


def field(
    psfs: Path | None = None,
    /,
    *,
    simulate: Annotated[str | None, Source] = None,
    dots: Annotated[Path | None, Source] = None,
    camera: Annotated[str | None, Source] = None,
    angles: Annotated[str | None, Quantity, Grid] = None,
    dot_pitch: Annotated[str | None, Quantity, Grid] = None,
    distance: Annotated[str | None, Quantity, Grid] = None,
    reach: Annotated[str | None, Quantity, Grid] = None,
    seed: Annotated[int | None, Grid, Whole] = None,
    plot: Annotated[Path | None, Result] = None,
    output: Annotated[Path | None, Output, Result] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Measure how far to the side a camera sees.

    nolens measure field mycamera --plot field.png

    nolens measure field --simulate paper --angles 0deg,10deg,20deg,30deg,40deg,50deg

    nolens measure field --dots dots.tif --dot-pitch 20mm --distance 300mm --camera mycamera

    nolens measure field --simulate paper --dot-pitch 20mm -o dots.tif

    The first two compare PSFs from the side with the central one, as the paper's Fig. 6c does:
    by the correlation of the frames, each by its own norm; where exposures are known, at one
    exposure by the central norm, so that lost light counts; and over their overlap alone. The
    others find every dot of a grid in its picture, as in Fig. 6d: where it is by Snell's law,
    how wide, how bright; good, distorted or lost. All angles are half angles.

    Parameters
    ----------
    psfs
        Folder with PSFs captured at angles (nolens calibrate).
    simulate
        Camera to simulate: paper, paper-film, small, live, a folder with camera.toml, or a .toml
        file.
    dots
        Reconstructed picture of a grid of dots, its middle cell on the camera's axis, as
        nolens reconstruct --region writes it: float .tif.
    camera
        Camera that the PSFs or the picture are from.
        [default: camera.toml beside the PSFs; for a picture paper]
    angles
        Of the simulated point sources, rising.  [default: 0deg,5deg, and so on to 50deg]
    dot_pitch
        Distance of neighbouring dots; with --simulate, a grid is shown to the camera.
    distance
        Of the grid or of the point sources; these also infinity.
        [default: with --simulate the camera's reference_distance]
    reach
        Half angle up to which there are dots.  [default: 50deg]
    seed
        Of the simulated noise.  [default: 0]
    plot
        Plot to write (.png). The record of the run goes beside it, as .json.
    output
        Picture of the simulated grid: .png, or .tif (linear floats) that --dots reads.
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = run_measure_field(MeasureFieldOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    for line in _dots_lines(summary) if "dots" in summary else _angle_lines(summary):
        show(line)
    for path in summary["outputs"]:
        show(path)
    return 0


def _angle_lines(found: dict[str, Any]) -> list[str]:
    lines = ["half angle  correlation  at one exposure  of the overlap  overlap  light"]
    for each in found["angles"]:
        overlap, light = (
            "-" if each[name] is None else f"{100 * each[name]:.1f} %"
            for name in ("overlap_width", "light")
        )
        exposed = each["correlation_one_exposure"]
        lines.append(
            f"{each['angle_deg']:9.2f}°  {each['correlation']:11.3f}  "
            f"{'-' if exposed is None else format(exposed, '.3f'):>15}  "
            f"{each['correlation_overlap']:14.3f}  {overlap:>7}  {light:>6}"
        )
    for name, what in (
        ("correlation", "correlation of the frames"),
        ("correlation_one_exposure", "at one exposure it"),
        ("correlation_overlap", "correlation of the overlap"),
    ):
        if f"{name}_falls_to_deg" not in found:
            continue
        falls = [
            f"to {level} at {angle:.1f}°" if angle is not None else f"nowhere to {level}"
            for level, angle in found[f"{name}_falls_to_deg"].items()
        ]
        lines.append(f"{what} falls {', '.join(falls)}")
    return lines


def _dots_lines(found: dict[str, Any]) -> list[str]:
    counts = {
        name: sum(dot["grade"] == name for dot in found["dots"])
        for name in ("good", "distorted", "lost")
    }
    good, lost = found["good_deg"], found["lost_deg"]
    return [
        f"{len(found['dots'])} dots: " + ", ".join(f"{n} {name}" for name, n in counts.items()),
        f"{found['pitch_found_mm']:.3f} mm apart, turned by {found['turned_deg']:.2f}°",
        "good: " + ("nowhere" if good is None else f"up to {good:.1f}°"),
        "lost: " + ("nowhere" if lost is None else f"from {lost:.1f}° on"),
    ]
