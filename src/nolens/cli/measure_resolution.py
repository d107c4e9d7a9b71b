"""`nolens measure resolution`."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

from nolens.cli.app import Json, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import (
    EdgeOptions,
    ResolutionOutcome,
    SiemensOptions,
    TwoPointOptions,
    measure_edge,
    measure_siemens,
    measure_two_points,
)

Frames = Parameter(group="Frames")
Simulation = Parameter(group="Simulation")
Solver = Parameter(group="Solver")
Target = Parameter(group="Target")
Result = Parameter(group="Result")


@Parameter(name="*")
@dataclass(frozen=True)
class Common:
    """Options of all targets.

    Parameters
    ----------
    distance
        From the camera to the target.  [default: the simulated camera's reference_distance]
    psf
        PSF to reconstruct raw frames with, captured at that distance.
    psf_wider
        The PSF is wider than the sensor, as nolens calibrate stitch makes it.  [default: no]
    dark
        Dark frame.
    region
        Cells that light can come from, as nolens reconstruct takes it; of pictures, the cells
        that they show.  [default: the sensor's; of pictures, as many around its middle]
    camera
        That took the frames: paper, paper-film, small, live, a folder with camera.toml, or a .toml
        file. It tells the angles of cells.  [default: camera.toml beside the PSF]
    cell_angle
        The angle of a cell, in place of a camera, such as 0.138deg.
    simulate
        Camera to simulate in place of frames: paper, paper-film, small, live, a folder with
        camera.toml, or a .toml file.
    light
        white-led, daylight, equal-energy, or one wavelength such as 535nm.  [default: white-led]
    wavelengths
        How many stand for a channel of the sensor.  [default: 1]
    fill
        Share of a full pixel that the brightest one is exposed to.  [default: 90%]
    seed
        Of the noise.  [default: 0]
    iterations
        Of ADMM; all of them are done.  [default: 300; two points 100]
    tau
        Weight of the prior.  [default: 1e-5]
    plot
        Picture to write (.png) of what was measured. The record of the run goes beside it, as
        .json.
    """

    distance: Annotated[str | None, Quantity, Target] = None
    psf: Annotated[Path | None, Frames] = None
    psf_wider: Annotated[bool | None, Parameter(negative=()), Frames] = None
    dark: Annotated[Path | None, Frames] = None
    region: Annotated[str | None, Frames] = None
    camera: Annotated[str | None, Frames] = None
    cell_angle: Annotated[str | None, Quantity, Frames] = None
    simulate: Annotated[str | None, Simulation] = None
    light: Annotated[str | None, Simulation] = None
    wavelengths: Annotated[int | None, Simulation, Whole] = None
    fill: Annotated[str | None, Quantity, Simulation] = None
    seed: Annotated[int | None, Simulation, Whole] = None
    iterations: Annotated[int | None, Solver, Whole] = None
    tau: Annotated[float | None, Solver] = None
    plot: Annotated[Path | None, Result] = None


_NONE = Common()
resolution = App(
    name="resolution", help="Measure how fine a camera resolves, by one of three targets."
)


@resolution.command(name="two-points")
def two_points(
    *frames: Path,
    separation: Annotated[tuple[str, ...] | None, Quantity, Target] = None,
    dip: Annotated[str | None, Quantity, Target] = None,
    direction: Annotated[str | None, Quantity, Simulation] = None,
    draws: Annotated[int | None, Simulation, Whole] = None,
    common: Common = _NONE,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Find the smallest angle between two point sources that is resolved.

    nolens measure resolution two-points a.dng b.dng --separation 1.5mm --separation 1.9mm
    --distance 180mm --psf psf.dng --camera paper

    nolens measure resolution two-points --simulate paper --distance 180mm

    Two points are resolved where the light between them dips by 26.5 %, as Rayleigh's criterion
    has it. How deep it dips depends on the scene, the noise and the solver, as in every camera
    that reconstructs its pictures: the result says with which. A simulation searches for the
    smallest separation.

    Parameters
    ----------
    frames
        Raw frames of two points at one separation each; or pictures of them that nolens
        reconstruct wrote (.tif, .npy).
    separation
        Distance of the two points, such as 1.9mm; once for each frame, in their order.
    dip
        Dip of the light between the points that counts as resolved.  [default: 26.5%]
    direction
        Of the line through the points, from the right towards up.  [default: 0deg]
    draws
        Pictures of each separation, with other noise and at other places within a cell; their
        dips are averaged.  [default: 3]
    json_
        Print one JSON object on standard output.
    """
    options = TwoPointOptions.gather(_given(locals()))
    with TerminalReporter() as reporter:
        outcome = measure_two_points(options, reporter)
    return _tell(outcome, _pair_lines, json_)


@resolution.command
def siemens(
    *frames: Path,
    spokes: Annotated[int | None, Target, Whole] = None,
    angle: Annotated[str | None, Quantity, Target] = None,
    threshold: Annotated[str | None, Quantity, Target] = None,
    common: Common = _NONE,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Measure the contrast of a Siemens star by angular frequency in every direction.

    nolens measure resolution siemens star.dng --psf psf.dng --camera paper --spokes 36

    nolens measure resolution siemens --simulate paper --distance 300mm --plot star.png

    The star is found in the picture by itself. The result is the angle of one bright spoke and
    one dark gap (a line pair, the distance of two bright lines) at which their contrast has
    fallen to the threshold in the worst of eight directions; a spoke alone is half as wide.

    Parameters
    ----------
    frames
        One raw frame of a star, or a picture of it that nolens reconstruct wrote (.tif, .npy).
    spokes
        Bright spokes of the star.  [default: as found; 36 to simulate]
    angle
        Field angle of the star from side to side; a picture of another one is refused.
        [default: as found; 20deg to simulate]
    threshold
        Share of the contrast of the widest spokes at which others count as just resolved. 15.3%
        is the contrast of lines that dip by Rayleigh's 26.5 %.  [default: 10%]
    json_
        Print one JSON object on standard output: all curves.
    """
    options = SiemensOptions.gather(_given(locals()))
    with TerminalReporter() as reporter:
        outcome = measure_siemens(options, reporter)
    return _tell(outcome, _star_lines, json_)


@resolution.command
def edge(
    *frames: Path,
    angle: Annotated[str | None, Quantity, Simulation] = None,
    common: Common = _NONE,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Measure the contrast by angular frequency across a slanted edge (ISO 12233).

    nolens measure resolution edge edge.dng --psf psf.dng --camera paper --region 80x80

    nolens measure resolution edge --simulate paper --distance 300mm

    Parameters
    ----------
    frames
        One raw frame of an edge, about 5 deg from upright or level, or a picture of it that
        nolens reconstruct wrote (.tif, .npy). It must show the edge from end to end.
    angle
        Field angle of the simulated edge's picture.  [default: 10deg]
    json_
        Print one JSON object on standard output: all curves.
    """
    options = EdgeOptions.gather(_given(locals()))
    with TerminalReporter() as reporter:
        outcome = measure_edge(options, reporter)
    return _tell(outcome, _edge_lines, json_)


def _given(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """What a person gave, the common options among the others."""
    own = dict(arguments)
    common = own.pop("common")
    return given_options({**own, **vars(common)})


def _tell(
    outcome: ResolutionOutcome, lines: Callable[[dict[str, Any]], list[str]], json_: bool
) -> int:
    summary = outcome.summary
    if json_:
        show(json.dumps(summary))
        return 0
    for line in [*lines(summary), *_solver_line(summary), *summary["outputs"]]:
        show(line)
    return 0


def _pair_lines(found: dict[str, Any]) -> list[str]:
    lines = [
        f"{each['separation_deg']:.3f} deg: dip {100 * each['dip']:5.1f} %"
        + (f" ± {100 * each['dip_noise']:.1f} %" if each["dip_noise"] else "")
        + ("  resolved" if each["resolved"] else "")
        for each in found["separations"]
    ]
    if found["resolved_deg"] is not None:
        lines.append(
            f"smallest resolved angle: {found['resolved_deg']:.3f} deg ± "
            f"{found['plus_minus_deg']:.3f} deg (dip of {100 * found['dip_needed']:.1f} %)"
        )
    return lines


def _star_lines(found: dict[str, Any]) -> list[str]:
    lines = [
        f"star of {found['spokes']} bright spokes, {found['diameter_deg']:.1f} deg wide; contrast "
        f"of its widest spokes {found['contrast_of_wide_spokes']:.2f}"
    ]
    lines += [
        f"spokes at {each['direction_deg']:3.0f} deg: resolved from {each['resolved_deg']:.3f} deg "
        f"± {each['plus_minus_deg']:.3f} deg a pair"
        for each in found["directions"]
    ]
    limit = " or less" if found["finest_of_the_cells"] else ""
    lines.append(
        f"resolved in all directions: {found['resolved_deg']:.3f} deg ± "
        f"{found['plus_minus_deg']:.3f} deg a pair of lines{limit}, {found['spoke_deg']:.3f} deg a "
        f"line (contrast of {found['contrast_needed']:.3f})"
    )
    return lines


def _edge_lines(found: dict[str, Any]) -> list[str]:
    def frequency(value: float | None) -> str:
        if value is None:
            return "nowhere up to the cells' limit"
        return f"{value:.2f} cycles/deg ({1 / value:.3f} deg a pair of lines)"

    return [
        f"edge at {found['tilt_deg']:.2f} deg; contrast along {found['direction_deg']:.1f} deg",
        f"contrast of one half at {frequency(found['half_contrast_per_deg'])}",
        f"contrast of a tenth at {frequency(found['tenth_contrast_per_deg'])}",
    ]


def _solver_line(found: dict[str, Any]) -> list[str]:
    if found["iterations"] is None:
        return []
    return [f"reconstructed with {found['iterations']} iterations, tau {found['tau']:g}"]
