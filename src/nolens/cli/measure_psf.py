"""`nolens measure psf`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import MeasurePsfOptions, measure_psf


def _lines(found: dict[str, Any]) -> list[str]:
    rows, columns = found["pixels"]
    pitch, row = found["pitch_um"], found["row_pitch_um"]
    lines = [
        f"{rows}×{columns} pixels of {found['pixel_um']:g} µm, {found['channel']}",
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
    return lines


def _clear(bands: list[list[float]]) -> str:
    """Frequencies at which the PSF is above its noise."""
    if not bands:
        return "nowhere above the noise"
    parts = [
        f"up to {high:.1f}" if low == 0 else f"from {low:.1f} to {high:.1f}" for low, high in bands
    ]
    return f"above the noise {', and '.join(parts)} lines/mm"


psf = command(MeasurePsfOptions, measure_psf, _lines, name="psf")
