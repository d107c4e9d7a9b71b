"""`nolens measure`: each command is made when it is used, and loads no more than that."""

from collections.abc import Callable
from typing import Annotated, Any

from cyclopts import App, Parameter

from nolens.cli.command import command
from nolens.errors import OptionError

_HERE = "nolens.cli.measure"
_TARGET = "resolution-"
"""What the names of the commands of `nolens measure resolution` here begin with."""

measure = App(name="measure", help="Measure how good a camera is: PSF, resolution, field of view.")
for _name in ("field", "psf", "resolution", "target"):
    measure.command(f"{_HERE}:{_name}")


def __getattr__(name: str) -> App | Callable[..., int]:
    """Make the command of a name."""
    if name == "field":
        from nolens.jobs import measure_field

        return command(measure_field, _field_lines, name=name)
    if name == "psf":
        from nolens.jobs import measure_psf

        return command(measure_psf, _psf_lines, name=name)
    if name == "target":
        from nolens.jobs import TargetOptions, make_target

        return command(make_target, lambda _: (), name=name, options=TargetOptions)
    if name == "resolution":
        return _resolution()
    if name.startswith(_TARGET):
        return _by_target(name.removeprefix(_TARGET))
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _resolution() -> App:
    """`nolens measure resolution`: a command for each target that there is."""
    from nolens.jobs.measuring.resolution import TARGETS

    app = App(
        name="resolution", help="Measure how fine a camera resolves, by one of several targets."
    )
    for name in TARGETS.names:
        app.command(f"{_HERE}:{_TARGET}{name}", name=name)
    return app


def _by_target(name: str) -> Callable[..., int]:
    """The command of a target; of one that cannot be loaded, a command that says why."""
    from nolens.jobs.measuring.resolution import TARGETS

    try:
        target = TARGETS.load(name)
    except OptionError as error:
        reason = error

        def refuse(*_: Annotated[str, Parameter(allow_leading_hyphen=True, show=False)]) -> int:
            raise reason

        refuse.__doc__ = str(error)
        return refuse
    return command(target.job, target.lines, name=name)


def _field_lines(summary: dict[str, Any]) -> list[str]:
    return _dots_lines(summary) if "dots" in summary else _angle_lines(summary)


def _angle_lines(summary: dict[str, Any]) -> list[str]:
    lines = ["half angle  correlation  at one exposure  of the overlap  overlap  light"]
    for each in summary["angles"]:
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
        if f"{name}_falls_to_deg" not in summary:
            continue
        falls = [
            f"to {level} at {angle:.1f}°" if angle is not None else f"nowhere to {level}"
            for level, angle in summary[f"{name}_falls_to_deg"].items()
        ]
        lines.append(f"{what} falls {', '.join(falls)}")
    return lines


def _dots_lines(summary: dict[str, Any]) -> list[str]:
    counts = {
        name: sum(dot["grade"] == name for dot in summary["dots"])
        for name in ("good", "distorted", "lost")
    }
    good, lost = summary["good_deg"], summary["lost_deg"]
    return [
        f"{len(summary['dots'])} dots: " + ", ".join(f"{n} {name}" for name, n in counts.items()),
        f"{summary['measured_pitch_mm']:.3f} mm apart, turned by {summary['turned_deg']:.2f}°",
        "good: " + ("nowhere" if good is None else f"up to {good:.1f}°"),
        "lost: " + ("nowhere" if lost is None else f"from {lost:.1f}° on"),
        *_blend_lines(summary),
    ]


def _blend_lines(summary: dict[str, Any]) -> list[str]:
    """Of a simulated grid, how far off its PSFs are."""
    points, error = summary.get("simulated_psfs"), summary.get("field_error")
    if points is None or error is None:
        return []
    return [
        f"between {points}×{points} simulated PSFs the simulation is off by "
        f"{100 * error['of_contrast']:.2g} % of the picture's contrast"
    ]


def _psf_lines(summary: dict[str, Any]) -> list[str]:
    rows, columns = summary["pixels"]
    pitch, row = summary["pitch_um"], summary["row_pitch_um"]
    lines = [
        f"{rows}×{columns} pixels of {summary['pixel_um']:g} µm, {summary['channel']}",
        f"autocorrelation: FWHM {summary['fwhm_um']:.2f} µm, half way to its lowest value before "
        f"the second peak; {summary['fwhm_over_mean_um']:.2f} µm half way to the mean",
        f"line width {summary['line_width_um']:.2f} µm (FWHM/√2)",
        "pitch "
        + ("unknown" if pitch is None else f"{pitch:.2f} µm")
        + ("" if row is None else f"; {row:.2f} µm along the rows"),
        f"contrast {summary['contrast']:.3g}, {100 * summary['sparsity']:.1f} % of the area is "
        f"dark, {100 * summary['background_fraction']:.1f} % of the light is background",
        f"spectral magnitude at least {summary['lowest_magnitude']:.2g} up to the lines' "
        f"{summary['line_per_mm']:.1f}/mm; noise {summary['noise_magnitude']:.2g}, "
        + ("stated" if summary["noise_known"] else "estimated"),
        _clear(summary["clear_bands_per_mm"]),
    ]
    if summary["line_deg"] is not None:
        line = f"expected resolution: a line is {summary['line_deg']:.2f}° wide"
        if summary["usable_deg"] is not None:
            line += (
                f", and half a period of the frequency up to which the PSF is above the noise "
                f"{summary['usable_deg']:.2f}°"
            )
        lines.append(line)
    if summary.get("lenslet_aperture") is not None:
        lines.append(
            f"lenslets: NA {summary['lenslet_aperture']:.4f}, depth of focus "
            f"{summary['depth_of_focus_mm']:.2f} mm"
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
