"""`nolens measure psf`."""

import json
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from nolens.cli.app import Json, Quantity, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import MeasurePsfOptions
from nolens.jobs import measure_psf as run_measure_psf

Source = Parameter(group="PSF")
Result = Parameter(group="Result")


def psf(
    psf: Path,
    /,
    *,
    pixel: Annotated[str | None, Quantity, Source] = None,
    camera: Annotated[str | None, Source] = None,
    channels: Annotated[str | None, Source] = None,
    black: Annotated[str | None, Source] = None,
    noise: Annotated[float | None, Source] = None,
    plot: Annotated[Path | None, Result] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Measure a PSF: width of its lines, pitch, spectrum, contrast, noise.

    nolens measure psf psf.tif --pixel 3.1um --plot psf.png

    The same figures as in the paper's Fig. 5, from the autocorrelation and the spectrum.

    Parameters
    ----------
    psf
        Picture of a point source: camera raw, .tif, .png or .npy, or one of the PSFs in a
        folder of nolens calibrate.
    pixel
        Distance of the file's pixels, such as 3.1um. In a raw file behind a colour mosaic four of
        them make a cell: give the sensor's own pitch.  [default: what psfs.toml beside it says]
    camera
        Tells angles in the scene, the aperture of a lenslet and its depth of focus: paper,
        paper-film, small, live, a folder with camera.toml, or a .toml file.
        [default: camera.toml beside the PSF, if there is one]
    channels
        grey (mean of all), r, g or b.  [default: grey]
    black
        Count that stands for no light, or "auto": read off the darkest corner.
        [default: what the file says]
    noise
        Standard deviation of the noise of a cell, in counts; 0 for a PSF without noise.
        [default: the power at the frequencies where it is least]
    plot
        Picture to write (.png): PSF, autocorrelation, spectral magnitude. The record of the run
        goes beside it, as .json.
    json_
        Print one JSON object on standard output: all figures and curves.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = run_measure_psf(MeasurePsfOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    for line in _lines(summary):
        show(line)
    return 0


def _lines(found: dict[str, Any]) -> list[str]:
    rows, columns = found["cells"]
    pitch, row = found["pitch_um"], found["row_pitch_um"]
    lines = [
        f"{rows}×{columns} cells of {found['cell_um']:g} µm, {found['channel']}",
        f"autocorrelation: FWHM {found['fwhm_um']:.2f} µm, half way to its lowest value before the "
        f"second peak; {found['fwhm_over_mean_um']:.2f} µm half way to the mean",
        f"line width {found['line_width_um']:.2f} µm (FWHM/√2)",
        "pitch "
        + ("unknown" if pitch is None else f"{pitch:.2f} µm")
        + ("" if row is None else f"; {row:.2f} µm along the rows"),
        f"contrast {found['contrast']:.3g}, {100 * found['sparsity']:.1f} % of the area is dark, "
        f"{100 * found['background_share']:.1f} % of the light is background",
        f"spectral magnitude at least {found['lowest_magnitude']:.2g} up to the lines' "
        f"{found['line_per_mm']:.1f}/mm; noise {found['noise_magnitude']:.2g}, "
        + ("given" if found["noise_given"] else "estimated"),
        _clear(found["clear_bands_per_mm"]),
    ]
    if found["line_deg"] is not None:
        line = f"expected resolution: a line is {found['line_deg']:.2f}° wide"
        if found["usable_deg"] is not None:
            line += (
                f", and half a period of the frequency up to which the PSF is above the noise "
                f"{found['usable_deg']:.2f}°"
            )
        lines.append(line)
    if found.get("lenslet_aperture") is not None:
        lines.append(
            f"lenslets: NA {found['lenslet_aperture']:.4f}, depth of focus "
            f"{found['depth_of_focus_mm']:.2f} mm"
        )
    return [*lines, *found["outputs"]]


def _clear(bands: list[list[float]]) -> str:
    """Frequencies at which the PSF is above its noise."""
    if not bands:
        return "nowhere above the noise"
    parts = [
        f"up to {high:.1f}" if low == 0 else f"from {low:.1f} to {high:.1f}" for low, high in bands
    ]
    return f"above the noise {', and '.join(parts)} lines/mm"
