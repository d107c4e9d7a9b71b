"""`nolens reconstruct` and `nolens info`."""

import json
from pathlib import Path
from typing import Any

from nolens.cli.command import Json, command
from nolens.cli.messages import show
from nolens.files import describe, read_frame
from nolens.jobs import expand_home
from nolens.jobs import reconstruct as reconstruct_job


def _lines(summary: dict[str, Any]) -> list[str]:
    """What came of it."""
    if "frames" in summary:
        end = f"{summary['seconds']:.1f} s on {summary['device']}"
        dropped = f", {len(summary['dropped'])} dropped" if summary["dropped"] else ""
        psfs = summary["field_points"]
        used = f", {psfs} PSFs over the field" if psfs > 1 else ""
        return [f"{summary['frames']} frames{dropped}{used} ({summary['stop_reason']}), {end}"]
    if "depths_mm" in summary or "bands" in summary:
        end = f"{summary['iterations']} iterations ({summary['stop_reason']})"
        end = f"tau {summary['tau']:.3g}, {end}, {summary['seconds']:.1f} s on {summary['device']}"
        if "bands" in summary:
            return [f"{len(summary['bands'])} bands: {', '.join(summary['bands'])}", end]
        end = _with_psfs(end, summary)
        depths = [at if isinstance(at, str) else f"{at:g} mm" for at in summary["depths_mm"]]
        light = zip(depths, summary["light_of_depths"], strict=True)
        return [
            "light at " + ", ".join(f"{at} {100 * part:.0f} %" for at, part in light),
            end,
            summary["occlusion"],
        ]
    if "video" in summary:
        video, end = summary["video"], f"{summary['seconds']:.1f} s on {summary['device']}"
        return [
            f"{video['frames']} frames of {1e3 * video['frame_s']:.3g} ms each; lines were exposed "
            f"for {1e3 * video['exposure_s']:.3g} ms",
            f"{summary['iterations']} iterations ({summary['stop_reason']}), tau "
            f"{summary['tau']:.3g}, {_with_psfs(end, summary)}",
        ]
    report = summary["report"]["lines"]
    width = max(len(name) for name, _ in report)
    lines = [f"{name:{width}}  {text}" for name, text in report]
    shown = summary["report"]["limited"] and not summary["report"]["acceptance"]
    if summary["automatic_support"] and shown:
        lines[-2] += ": nowhere else does light show; --support full takes it from everywhere"
    if summary["automatic_tau"]:
        detail = summary["detail"]
        lines[-1] += f"; --detail {2 * detail:g} shows more detail, {detail / 2:g} less noise"
    return [*lines, *(_sweep_line(row) for row in summary.get("sweep", ()))]


def _with_psfs(text: str, summary: dict[str, Any]) -> str:
    """With how many PSFs over the field there were, where there were several."""
    psfs = summary["field_points"]
    return f"{text}, {psfs} PSFs over the field" if psfs > 1 else text


def _sweep_line(row: dict[str, Any]) -> str:
    """A picture of a sweep, and the option that gives it alone."""
    steps = f", {row['iterations']} iterations ({row['stop_reason']})"
    steps = "" if row["stop_reason"] == "one shot" else steps
    return f"{row['file']}: {row['text']}, tau {row['tau']:.3g}{steps}"


reconstruct = command(reconstruct_job, _lines, name="reconstruct")


def info(
    file: Path,
    /,
    *,
    mosaic: str | None = None,
    json_: Json = False,
) -> int:
    """Say what a file holds: size, channels, mosaic, levels, range.

    Parameters
    ----------
    file
        Camera raw, .png, .tif or .npy.
    mosaic
        Colour mosaic of a .tif, .png or .npy that holds raw counts.
    """
    facts = describe(read_frame(expand_home(file), mosaic=mosaic))
    if json_:
        show(json.dumps(facts))
    else:
        width = max(len(name) for name in facts)
        for name, value in facts.items():
            show(f"{name.replace('_', ' '):{width}}  {_readable(value)}")
    return 0


def _readable(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_readable(each)}" for key, each in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_readable(each) for each in value)
    if isinstance(value, float):
        return f"{value:.6g}"
    return "not stated" if value is None else str(value)
