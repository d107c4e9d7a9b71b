"""`nolens simulate` and `nolens psf`."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from nolens.cli.app import Json, Output, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import PsfOptions, SimulateOptions, simulate_psf
from nolens.jobs import simulate as run_simulate

Scene = Parameter(group="Scene")
Point = Parameter(group="Point source")
Result = Parameter(group="Result")
Exposure = Parameter(group="Exposure")
Optics = Parameter(group="Camera and light")


def simulate(
    *scenes: Path,
    output: Annotated[Path | None, Output, Result] = None,
    truth: Annotated[Path | None, Result] = None,
    response: Annotated[Path | None, Result] = None,
    distance: Annotated[tuple[str, ...] | None, Quantity, Scene] = None,
    angle: Annotated[tuple[str, ...] | None, Quantity, Scene] = None,
    camera: Annotated[str | None, Optics] = None,
    light: Annotated[str | None, Optics] = None,
    wavelengths: Annotated[int | None, Optics, Whole] = None,
    field_points: Annotated[int | None, Optics, Whole] = None,
    fresnel: Annotated[bool | None, Optics] = None,
    fill: Annotated[str | None, Quantity, Exposure] = None,
    exposure: Annotated[str | None, Quantity, Exposure] = None,
    luminance: Annotated[str | None, Quantity, Exposure] = None,
    seed: Annotated[int | None, Exposure, Whole] = None,
    device: Annotated[Literal["auto", "cpu", "cuda"] | None, Optics] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Simulate what a lensless camera measures of a scene.

    nolens simulate scene.png --distance 300mm --angle 60deg -o raw.dng --truth truth.tif

    Lengths, angles and the like are given with their unit: 300mm, 60deg, 40ms, 90%.

    Parameters
    ----------
    scenes
        Pictures: .png, .jpg or .tif of 8 or 16 bits (sRGB; alpha is opacity), or float .tif and
        .npy (linear, 1 is white). Of several ones, nearer ones hide farther ones. Needed.
    output
        Raw file to write: .dng, or .tif (16-bit counts). Needed. The record of the run goes
        beside it, as .json.
    truth
        Writes what a reconstruction is to show: the scene's radiance on its cells, as linear
        float .tif.
    response
        Writes how much light of each cell reaches the sensor, 1 for the most, as float .tif. A
        reconstruction with one PSF shows truth × response.
    distance
        From the camera to the picture, or infinity; once, or once for each picture.
        [default: the camera's reference_distance]
    angle
        Field angle of the picture's longer side, from edge to edge; once, or once for each.
        [default: 60deg]
    camera
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file.  [default:
        paper]
    light
        white-led, daylight, equal-energy, or one wavelength such as 535nm.  [default: white-led]
    wavelengths
        Wavelengths that stand for a channel.  [default: 3]
    field_points
        PSFs along each side of the scene, an odd number; between them they are blended. 1 takes
        one PSF for all of it, as a reconstruction does.  [default: 5]
    fresnel
        Light is lost to reflection at the surfaces between layers.  [default: on]
    fill
        Exposes so that the brightest pixel is filled to this share of what saturates it.
        [default: 90%]
    exposure
        Exposure time, such as 40ms, instead of --fill.
    luminance
        Of the scene's white.  [default: 200cd/m2, a usual screen]
    seed
        Of the sensor's noise.  [default: 0]
    device
        Where to compute; auto takes CUDA where there is one.  [default: auto]
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = run_simulate(SimulateOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    show(
        f"exposed {1e3 * summary['exposure_s']:.4g} ms: the brightest pixel has "
        f"{summary['brightest_electrons']:.0f} electrons, "
        f"{100 * summary['saturated_share']:.2g} % of the pixels are saturated"
    )
    show(_field_text(summary))
    show(f"the scene's corners are {summary['largest_angle_deg']:.1f}° off the axis")
    show(_next_text(summary))
    show(f"{summary['seconds']:.1f} s on {summary['device']}")
    for path in summary["outputs"]:
        show(path)
    return 0


def psf(
    *,
    output: Annotated[Path | None, Output, Result] = None,
    angle: Annotated[str | None, Quantity, Point, Parameter(name=("--angle", "--at"))] = None,
    distance: Annotated[
        str | None, Quantity, Point, Parameter(name=("--distance", "--depth"))
    ] = None,
    size: Annotated[str | None, Quantity, Point] = None,
    cells: Annotated[str | None, Result] = None,
    bin: Annotated[int | None, Result, Whole] = None,  # noqa: A002 (the option's name)
    frame: Annotated[Literal["chief-ray", "sensor"] | None, Result] = None,
    camera: Annotated[str | None, Optics] = None,
    light: Annotated[str | None, Optics] = None,
    wavelengths: Annotated[int | None, Optics, Whole] = None,
    fresnel: Annotated[bool | None, Optics] = None,
    fill: Annotated[str | None, Quantity, Exposure] = None,
    seed: Annotated[int | None, Exposure, Whole] = None,
    device: Annotated[Literal["auto", "cpu", "cuda"] | None, Optics] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Simulate what a lensless camera shows of a point source.

    nolens psf --camera paper --angle 20deg,0deg --distance 80mm -o psf.tif

    Parameters
    ----------
    output
        .tif (linear floats without noise), .dng (every pixel, exposed, with noise) or .png (for
        looking at). Needed. The record of the run goes beside it, as .json. A .dng states the
        exposure time that a source needs which gives 1 lx at the camera, straight ahead.
    angle
        Angles to the right and up, as the photographer sees them.  [default: 0deg,0deg]
    distance
        From the camera, or infinity.  [default: the camera's reference_distance]
    size
        Diameter of the light.  [default: 50um; 0um at infinity]
    cells
        HEIGHTxWIDTH of the result; more than the sensor has shows the light beside it too, for
        reconstruct --psf-wider.  [default: the sensor]
    bin
        Pixels along a cell; 1 for all pixels.
        [default: the cells of a reconstruction; for .dng 1]
    frame
        The middle of the result follows the ray through the middle of the camera, or stays on
        the sensor's.  [default: chief-ray; for .dng sensor]
    camera
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file.  [default:
        paper]
    light
        white-led, daylight, equal-energy, or one wavelength such as 535nm.  [default: white-led]
    wavelengths
        Wavelengths that stand for a channel.  [default: 3]
    fresnel
        Light is lost to reflection at the surfaces between layers.  [default: on]
    fill
        For .dng, share of what saturates it to which the brightest pixel is filled.
        [default: 90%]
    seed
        For .dng, of the sensor's noise.  [default: 0]
    device
        Where to compute; auto takes CUDA where there is one.  [default: auto]
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = simulate_psf(PsfOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    right, up = summary["shift_um"]
    show(
        f"{summary['angle_deg']:.4g}° off the axis: the pattern moves {right:z.1f} µm to the right "
        f"and {up:z.1f} µm up"
    )
    show(
        f"mean {summary['mean']:.4g}, peak {summary['peak_over_mean']:.1f} times that; "
        f"{summary['seconds']:.1f} s on {summary['device']}"
    )
    for path in summary["outputs"]:
        show(path)
    return 0


def _next_text(summary: dict[str, Any]) -> str:
    rows, columns = summary["cells"]
    psf, wider = "nolens psf", ""
    if summary["psf_cells"] != f"{rows}x{columns}":
        psf, wider = f"nolens psf --cells {summary['psf_cells']}", " --psf-wider"
    return f"reconstruct with{wider} --region {summary['region']} and the PSF of {psf}"


def _field_text(summary: dict[str, Any]) -> str:
    points, error = summary["field_points"], summary["field_error"]
    if error is None:
        return "one PSF for the whole scene; how far off that is, is not known"
    return (
        f"{points}×{points} field points: off by {100 * error['of_contrast']:.2g} % of the "
        f"picture's contrast, {error['of_noise']:.2g} of the noise"
    )
