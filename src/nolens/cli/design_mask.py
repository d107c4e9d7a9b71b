"""`nolens design mask`."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from nolens.cli.app import Json, Output, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import MaskOptions, design_mask

Lenslets = Parameter(group="Lenslets")
Process = Parameter(group="Process (contour, optimised)")
Wanted = Parameter(group="Wanted PSF")
Result = Parameter(group="Result")
Optics = Parameter(group="Camera and light")


def mask(
    kind: Literal["random-lenslets", "lenslet-array", "diffuser", "contour", "optimised"]
    | None = None,
    /,
    *,
    output: Annotated[Path | None, Output, Result] = None,
    camera: Annotated[str | None, Optics] = None,
    light: Annotated[str | None, Optics] = None,
    seed: Annotated[int | None, Result, Whole] = None,
    overhang: Annotated[str | None, Quantity, Result] = None,
    radius: Annotated[str | None, Quantity, Lenslets] = None,
    pitch: Annotated[str | None, Quantity, Lenslets] = None,
    smoothing: Annotated[str | None, Quantity, Lenslets] = None,
    arrangement: Annotated[Literal["square", "hexagonal"] | None, Lenslets] = None,
    angle: Annotated[str | None, Quantity, Wanted] = None,
    line: Annotated[str | None, Quantity, Wanted] = None,
    spacing: Annotated[str | None, Quantity, Wanted] = None,
    width: Annotated[str | None, Quantity, Wanted] = None,
    sparsity: Annotated[str | None, Quantity, Wanted] = None,
    magnitude: Annotated[str | None, Quantity, Wanted] = None,
    feature: Annotated[str | None, Quantity, Process] = None,
    height: Annotated[str | None, Quantity, Process] = None,
    slope: Annotated[str | None, Quantity, Process] = None,
    levels: Annotated[int | None, Process, Whole] = None,
    period: Annotated[str | None, Quantity, Process] = None,
    iterations: Annotated[int | None, Process, Whole] = None,
    device: Annotated[Literal["auto", "cpu", "cuda"] | None, Optics] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Design a mask for a camera, and write the camera that has it.

    nolens design mask optimised --camera paper -o designed

    The kinds: random-lenslets (the paper's model of its diffuser), lenslet-array (regular),
    diffuser (a Gaussian surface), contour (a PSF of thin lines, by near-field phase retrieval; such
    masks made by edge filtering are the subject of the patent application US 2025/0377536 A1),
    optimised (a PSF of wanted width, sparsity and spectrum, by following the gradient through the
    camera's own layers).

    Parameters
    ----------
    kind
        random-lenslets, lenslet-array, diffuser, contour or optimised. Needed.
    output
        Folder of the new camera: camera.toml, relief.tif, mask.png (a picture of relief and PSF)
        and mask.json (the record). Needed.
    camera
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file: its layers and
        sensor are kept.  [default: paper]
    light
        white-led, daylight, equal-energy, or one wavelength such as 535nm.  [default: white-led]
    seed
        Of what is random.  [default: 0]
    overhang
        How far the mask reaches beyond the sensor.  [default: as in the camera, or 1.5mm]
    radius
        Radius of curvature of lenslets, and of the lines that contour begins with.
        [default: what focuses on the sensor]
    pitch
        Mean distance of lenslets; of those that optimised begins with.
        [default: 70um; for optimised, as large as the slope allows]
    smoothing
        Width of the Gaussian that rounds the edges between lenslets.
        [default: 11um; for lenslet-array 2um]
    arrangement
        For lenslet-array.  [default: hexagonal]
    angle
        For diffuser, full width at half maximum of the light that it scatters.  [default: 1deg]
    line
        For contour, width of a line.  [default: 12um]
    spacing
        For contour, lines lie about half of this apart.  [default: 250um]
    width
        For optimised, of the PSF's autocorrelation, at most.  [default: 8um]
    sparsity
        For optimised, share of the sensor without light, at least.  [default: 98%]
    magnitude
        For optimised, spectral magnitude of 1 mm2 of the PSF, at least, up to a spatial frequency
        on the sensor.  [default: 6%@80/mm]
    feature
        Smallest feature; for diffuser, the distance over which heights are alike.
        [default: 8um; for diffuser 30um]
    height
        Largest height of the relief.  [default: 12um]
    slope
        Steepest slope.  [default: 5.4deg]
    levels
        Number of heights that the process makes, from the lowest to --height above it.
        [default: any height]
    period
        Side of the square that the mask repeats.  [default: the width of a 75deg scene on the
        sensor, or of the aperture]
    iterations
        Steps of the descent.  [default: 60; for optimised 100]
    device
        Where to compute; auto takes CUDA where there is one.  [default: auto]
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = design_mask(MaskOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 130 if reporter.interrupted else 0
    for text in _table(summary):
        show(text)
    if "target_correlation" in summary:
        values = ", ".join(f"{each:.3f}" for each in summary["target_correlation"])
        show(f"correlation of the PSF with its target, channel by channel: {values}")
    show(f"{summary['seconds']:.1f} s on {summary['device']}")
    for path in summary["outputs"]:
        show(path)
    return 130 if reporter.interrupted else 0


def _table(summary: dict[str, Any]) -> list[str]:
    """Figures of the mask beside the paper's diffuser in the same camera."""
    own, papers = summary["figures"], summary["paper_diffuser"]
    rows = [
        ("width of the PSF's autocorrelation, µm", "width_um", 1, ".1f"),
        ("line width, µm", "line_um", 1, ".1f"),
        ("pitch of the PSF, µm", "pitch_um", 1, ".1f"),
        ("sparsity, %", "sparsity", 100, ".1f"),
        ("height of the relief, µm", "height_um", 1, ".2f"),
        ("steepest slope", "slope", 1, ".3f"),
    ]
    papers_name = "the paper's"
    lines = [f"{'':42}{'this mask':>12}{papers_name:>12}"]
    for name, key, factor, form in rows:
        cells = (_text(side[key], factor, form) for side in (own, papers))
        lines.append(f"{name:42}" + "".join(f"{cell:>12}" for cell in cells))
    for number, per_mm in enumerate(summary["magnitude_per_mm"]):
        cells = (_text(side["magnitude"][number], 100, ".2f") for side in (own, papers))
        name = f"spectral magnitude of 1 mm² at {per_mm:g}/mm, %"
        lines.append(f"{name:42}" + "".join(f"{cell:>12}" for cell in cells))
    return lines


def _text(value: float | None, factor: float, form: str) -> str:
    return "-" if value is None else format(factor * value, form)
