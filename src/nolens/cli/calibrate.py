"""`nolens calibrate` and its parts."""

from functools import wraps
from typing import Any

from cyclopts import App

from nolens.cli.command import command
from nolens.cli.messages import say
from nolens.jobs import (
    calibrate_distances,
    calibrate_extrapolate,
    calibrate_import,
    calibrate_pairs,
    calibrate_plan,
    calibrate_point,
    calibrate_stitch,
)


def _distances(summary: dict[str, Any]) -> list[str]:
    return [
        f"the layers are as thick to rays as {summary['reduced_thickness_mm']:.3f} mm of air",
        *(
            f"{each['file']}: {each['magnification']:.5f} times as large as {each['from']}"
            + (
                f", {100 * each['unknown_fraction']:.2g} % unknown"
                if each["unknown_fraction"]
                else ""
            )
            for each in summary["psfs"]
        ),
    ]


def _extrapolate(summary: dict[str, Any]) -> list[str]:
    rows, columns = summary["pixels"]
    lines = [
        f"{summary['from']} extended to {rows}×{columns} pixels by {summary['extrapolated_by']}"
    ]
    if summary["residual"]:
        first, last = summary["residual"][0], summary["residual"][-1]
        lines.append(
            f"the reconstructions leave {100 * last:.2f} % of the measurements over, and left "
            f"{100 * first:.2f} % with the mean light; {summary['rounds']} rounds"
        )
    return lines


def _import(summary: dict[str, Any]) -> list[str]:
    lines = []
    for each in summary["psfs"]:
        rows, columns = each["pixels"]
        text = f"{each['source']}: {rows}×{columns} pixels of {each['pixel']}"
        if any(each["background_counts"]):
            counts = ", ".join(f"{level:g}" for level in each["background_counts"])
            text += f"; black level {counts}, read off the dark area"
        elif not each["black_stated"]:
            text += "; black level taken as 0"
        if each["saturated_fraction"]:
            text += (
                f"; {100 * each['saturated_fraction']:.2g} % saturated, continued from around to "
                f"{each['saturated_raised']:.2f} times the count that clips"
            )
        lines += [text, *(f"  {note}" for note in each["notes"])]
        if "centred_by" in each:
            lines.append(f"  {_centre(each)}")
    return lines


def _pairs(summary: dict[str, Any]) -> list[str]:
    rows, columns = summary["pixels"]
    lines = [
        f"{rows}×{columns} pixels of {summary['pixel']}, light in "
        f"{100 * summary['support_fraction']:.1f} % of them",
        "of each measurement, not explained by the PSF: with one PSF for the whole picture, and "
        "with one that may change over it (a large difference: the PSF varies over the field)",
    ]
    wide = max(len(row["name"]) for row in summary["pairs"])
    for row in summary["pairs"]:
        left, varying, gain = (
            sum(row[key]) / len(row[key]) for key in ("residual", "residual_varying", "gain")
        )
        lines.append(
            f"  {row['name']:<{wide}}  {100 * left:.1f} %  {100 * varying:.1f} %  "
            f"brightness {gain:.3f}"
        )
    if summary["leave_one_out"]:
        lines.append("with the PSF of the other pairs: left, and the reconstruction")
    for row in summary["leave_one_out"]:
        left = sum(row["residual"]) / len(row["residual"])
        alike = "" if row["ssim"] is None else f", SSIM {row['ssim']:.3f}"
        lines.append(
            f"  {row['name']:<{wide}}  {100 * left:.1f} %  PSNR {row['psnr_db']:.2f} dB{alike}"
        )
    return [*lines, f"{summary['seconds']:.1f} s"]


def _plan(summary: dict[str, Any]) -> list[str]:
    (rows, columns), (height, width) = summary["pixels"], summary["support"]
    return [
        f"capture a point source at {len(summary['angles_deg'])} angles, to the right and up:",
        *(f"  --angle {right:g}deg,{up:g}deg" for right, up in summary["angles_deg"]),
        *(
            f"with {count}, PSFs in between are off by up to {100 * error:.2g} % of their contrast"
            for count, error in summary["errors"].items()
        ),
        f"a scene of that angle covers --support {height}x{width}, and the stitched PSF "
        f"will have about {rows}×{columns} pixels",
    ]


def _stitch(summary: dict[str, Any]) -> list[str]:
    (rows, columns), sensor = summary["pixels"], summary["sensor_pixels"]
    height, width = summary["support"]
    return [
        *(
            f"{row['file']}: {row['shift_um'][0]:z.1f} µm to the right and "
            f"{row['shift_um'][1]:z.1f} µm up, {row['off_um']:.1f} µm beside its angle "
            f"({row['off_deg']:.2f}°); brightness {row['gain'][0]:.3f}, correlation "
            f"{row['correlation']:.3f}"
            for row in summary["captures"]
        ),
        f"overlaps agree to {summary['residual_pixels']:.2f} pixels",
        f"{rows}×{columns} pixels, the sensor has {sensor[0]}×{sensor[1]}; "
        f"{100 * summary['known_fraction']:.1f} % of them were captured",
        f"the captures suffice for scenes of up to --support {height}x{width}, "
        "with --psf-extent wide; give the scene's own support (nolens calibrate plan) where that "
        "is smaller",
        f"{summary['field_points']} PSFs over the field, {summary['megabytes']:g} MB: reconstruct "
        "with this folder (--psf FOLDER)"
        if summary["field_points"]
        else "the folder has no camera.toml: with it there would be a PSF of each angle",
    ]


def _point(summary: dict[str, Any]) -> list[str]:
    noise = summary["frame_noise"]
    known = {"frames": "the frames", "camera": "the camera's description", "picture": "one frame"}
    signal = ", ".join("-" if each is None else f"{each:.1f}" for each in summary["snr_db"])
    energy = ", ".join(
        f"{name} {each:.3f}"
        for name, each in zip(summary["channels"], summary["energy"], strict=True)
    )
    usable = summary["usable_per_mm"]
    rows, columns = summary["pixels"]
    return [
        *(_exposure(each) for each in summary["exposures"]),
        f"{100 * summary['saturated_fraction']:.2g} % saturated in all of them",
        f"noise of a frame: {noise['read_counts']:.3g} counts in the dark, and "
        f"{noise['counts_per_electron']:.3g} counts to the electron (from {known[noise['from']]})",
        f"{rows}×{columns} pixels of {summary['pixel']}; peak over noise {signal} dB",
        f"energy: {energy}",
        _background(summary),
        _centre(summary),
        "no spatial frequency stands out of the noise"
        if usable is None
        else f"stands out of the noise up to {usable:.1f} lines to the mm",
    ]


def _exposure(figures: dict[str, Any]) -> str:
    time = "unknown exposure time" if figures["ms"] is None else f"{figures['ms']:g} ms"
    text = f"{figures['frames']} frame{'' if figures['frames'] == 1 else 's'} of {time}"
    if figures["dark_frames"]:
        text += f" less {figures['dark_frames']} dark"
    if figures["clipped_fraction"] > 0:
        text += f", {100 * figures['clipped_fraction']:.2g} % clipped"
    return text


def _background(summary: dict[str, Any]) -> str:
    stray = ", ".join(f"{100 * each:.3g}" for each in summary["stray_over_peak"])
    floor = ", ".join(f"{100 * each:.3g}" for each in summary["floor_over_peak"])
    if summary["dark_fraction"] > 0:
        area = f"{100 * summary['dark_fraction']:.0f} % of the sensor is dark"
    else:
        area = "the PSF fills the sensor"
    return f"{area}; stray light subtracted {stray} %, darkest light left {floor} % of the peak"


def _centre(summary: dict[str, Any]) -> str:
    by = summary["centred_by"]
    if summary["frame"] == "sensor":
        text = "as the sensor captured it"
        if "expected_shift_um" in summary:
            text += _place(", its light expected", summary["expected_shift_um"])
        if "shift_um" in summary:
            text += _place(", measured", summary["shift_um"])
        return text
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


calibrate = App(name="calibrate")
calibrate.default(command(calibrate_point, _point, name="point"))
extrapolate = command(calibrate_extrapolate, _extrapolate, name="extrapolate")


@wraps(extrapolate)
def surround(*places: Any, **names: Any) -> int:
    """`extrapolate` by its name of the version before, which the help does not show."""
    say("surround is called extrapolate now; the former name goes with the next version")
    return extrapolate(*places, **names)


for each in (
    command(calibrate_distances, _distances, name="distances"),
    extrapolate,
    command(calibrate_import, _import, name="import"),
    command(calibrate_pairs, _pairs, name="pairs"),
    command(calibrate_plan, _plan, name="plan"),
    command(calibrate_stitch, _stitch, name="stitch"),
):
    calibrate.command(each)
calibrate.command(surround, name="surround", show=False)
