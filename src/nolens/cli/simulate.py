"""`nolens simulate` and `nolens psf`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import simulate as simulate_job
from nolens.jobs import simulate_psf


def _scene_lines(summary: dict[str, Any]) -> list[str]:
    return [
        f"exposed {1e3 * summary['exposure_s']:.4g} ms: the brightest pixel has "
        f"{summary['brightest_electrons']:.0f} electrons, "
        f"{100 * summary['saturated_fraction']:.2g} % of the pixels are saturated",
        _field_text(summary),
        f"the scene's corners are {summary['largest_angle_deg']:.1f}° off the axis",
        _next_text(summary),
        f"{summary['seconds']:.1f} s on {summary['device']}",
    ]


def _psf_lines(summary: dict[str, Any]) -> list[str]:
    if "psfs" in summary:
        rows, columns = summary["pixels"]
        return [
            f"{len(summary['psfs'])} PSFs of {rows}×{columns} pixels, to "
            f"{summary['largest_angle_deg']:.1f}° off the axis, {summary['seconds']:.1f} s on "
            f"{summary['device']}",
            f"reconstruct with --support {summary['support']} and this folder (--psf FOLDER)",
        ]
    right, up = summary["shift_um"]
    return [
        f"{summary['angle_deg']:.4g}° off the axis: the pattern moves {right:z.1f} µm to the right "
        f"and {up:z.1f} µm up",
        f"mean {summary['mean']:.4g}, peak {summary['peak_over_mean']:.1f} times that; "
        f"{summary['seconds']:.1f} s on {summary['device']}",
    ]


def _next_text(summary: dict[str, Any]) -> str:
    rows, columns = summary["pixels"]
    psf, extent = "nolens psf", ""
    if summary["psf_pixels"] != f"{rows}x{columns}":
        psf, extent = f"nolens psf --pixels {summary['psf_pixels']}", " --psf-extent wide"
    return f"reconstruct with{extent} --support {summary['support']} and the PSF of {psf}"


def _field_text(summary: dict[str, Any]) -> str:
    points, error = summary["field_points"], summary["field_error"]
    if error is None and points > 1:
        return f"{points}×{points} field points"
    if error is None:
        return "one PSF for the whole scene; how far off that is, is not known"
    return (
        f"{points}×{points} field points: off by {100 * error['of_contrast']:.2g} % of the "
        f"picture's contrast, {error['of_noise']:.2g} of the noise"
    )


simulate = command(simulate_job, _scene_lines, name="simulate")
psf = command(simulate_psf, _psf_lines, name="psf")
