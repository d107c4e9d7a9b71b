"""`nolens calibrate`, of frames of a point source."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import CalibratePointOptions, calibrate_point


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
    return [
        *(_exposure(each) for each in summary["exposures"]),
        f"{100 * summary['saturated_share']:.2g} % saturated in all of them",
        f"noise of a frame: {noise['read_counts']:.3g} counts in the dark, and "
        f"{noise['counts_per_electron']:.3g} counts to the electron (from {known[noise['from']]})",
        f"{rows}×{columns} pixels of {summary['cell']}; peak over noise {signal} dB",
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


point = command(CalibratePointOptions, calibrate_point, _lines, name="point")
