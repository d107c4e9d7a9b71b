"""Plots of measurements: a PSF (the paper's Fig. 5), the field of view (Fig. 6), resolution."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from nolens.files.plots import ACCENT, GUIDE, WORST, plot_figure, show_picture, white_level

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from nolens.evaluate import Dot, EdgeResolution, PsfFigures, StarResolution, TwoPoints
    from nolens.experiments.off_axis import FieldOfView, OffAxis

_MARK = "#c23b2e"
_COLOURS = {0: "#3557c9", 90: "#2f9140", 180: "#e08a1e", 270: "#8a4fb0"}
_MOST_PIXELS = 1200
_ZOOM_PITCHES = 7.0
_DISPLAYED_PITCHES = 2.6
_BRIGHTEST_PSF = 99.7
_DECADES = 1e-4

_GRADES = {"good": "#2a7f62", "distorted": "#e08a1e", "lost": "#a01c3a"}
_FRAME, _EXPOSED, _OVERLAP, _OTHER = "#3557c9", "#a01c3a", "#2f9140", "0.45"
_BRIGHTEST_PICTURE = 99.8
_GAMMA = 2.2

_LEVELS = (0.5, 0.1)
"""Contrasts that are marked."""
_MOST_PANELS = 6
_PANEL_PIXELS = 24
"""Pictures of two points, and pixels along the side of each."""
_ARC_STEP = 1.15
_ARC_PERIODS = 4
_ARC_RADII = (1.0, 1.2, 1.5)
"""Distance of the traces, pairs of spokes in each, radii in those of the resolved ones."""


def write_psf_plot(path: str | Path, figures: "PsfFigures", psf: Tensor, pixel_um: float) -> None:
    """Draw a PSF with a part of it enlarged, its autocorrelation, and its spectral magnitude.

    The PSF is (rows, columns); the figures are those of `nolens.evaluate.psf_figures`.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    values = psf.detach().cpu().double().numpy()
    with plot_figure(path, (18, 4.4), title_size="large") as figure:
        left, part, middle, right = figure.subplots(1, 4, width_ratios=(1.15, 0.8, 1, 1))
        _draw_psf(left, part, values, figures, pixel_um)
        _draw_autocorrelation(middle, figures)
        _draw_psf_magnitude(right, values, figures)


def _draw_psf(
    axes: "Axes",
    part: "Axes",
    values: NDArray[np.float64],
    figures: "PsfFigures",
    pixel_um: float,
) -> None:
    """All of it, and a few pitches of its middle enlarged beside it."""
    from matplotlib.patches import Rectangle

    rows, columns = values.shape
    low, high = np.percentile(values, [1, _BRIGHTEST_PSF])
    shades = {"cmap": "gray", "vmin": low, "vmax": high}
    step = max(1, -(-max(rows, columns) // _MOST_PIXELS))
    height, width = rows * pixel_um * 1e-3, columns * pixel_um * 1e-3
    coarse = values[: rows // step * step, : columns // step * step]
    coarse = coarse.reshape(rows // step, step, columns // step, step).mean(axis=(1, 3))
    axes.imshow(coarse, extent=(0, width, height, 0), **shades)
    axes.set_xlabel("mm")
    axes.set_ylabel("mm")
    axes.set_title(f"(a) PSF, {rows}×{columns} pixels of {pixel_um:.4g} µm")
    pitch_um = figures.pitch_um or 5 * figures.fwhm_um
    half = min(round(_ZOOM_PITCHES / 2 * pitch_um / pixel_um), rows // 4, columns // 4)
    if half < 4:
        part.set_axis_off()
        return
    top, left = rows // 2 - half, columns // 2 - half
    mm = pixel_um * 1e-3
    part.imshow(
        values[top : top + 2 * half, left : left + 2 * half],
        extent=(left * mm, (left + 2 * half) * mm, (top + 2 * half) * mm, top * mm),
        interpolation="nearest",
        **shades,
    )
    part.set_xticks([])
    part.set_yticks([])
    for spine in part.spines.values():
        spine.set(visible=True, edgecolor=_MARK, linewidth=1.4)
    axes.add_patch(
        Rectangle(
            (left * mm, top * mm), 2 * half * mm, 2 * half * mm, fill=False, edgecolor=_MARK, lw=1.4
        )
    )
    part.set_title(f"its middle, {2 * half * pixel_um:.0f} µm wide")


def _draw_autocorrelation(axes: "Axes", figures: "PsfFigures") -> None:
    """Over all directions and along the rows, with width and pitch."""
    lag = np.array(figures.lag_um)
    pitch = figures.pitch_um
    extent = min(lag[-1], _DISPLAYED_PITCHES * pitch if pitch else 8 * figures.fwhm_um)
    for values, colour, style, label in (
        (figures.row_autocorrelation, "0.65", "-", "along the rows"),
        (figures.autocorrelation, "black", "-", "all directions"),
    ):
        axes.plot(
            np.concatenate([-lag[::-1], lag]),
            np.concatenate([values[::-1], values]),
            color=colour,
            linestyle=style,
            linewidth=1.3,
            label=label,
        )
    axes.set_xlim(-extent, extent)
    axes.axhline(0, color="0.85", linewidth=0.8, zorder=0)
    half = (1 + figures.level) / 2
    width = figures.fwhm_um
    axes.annotate(
        "",
        (-width / 2, half),
        (width / 2, half),
        arrowprops={"arrowstyle": "<->", "color": _MARK, "shrinkA": 0, "shrinkB": 0},
    )
    axes.annotate(
        f"FWHM {width:.2f} µm\nline {figures.line_width_um:.2f} µm\n"
        f"half way to 0: {figures.fwhm_over_mean_um:.2f} µm",
        (width / 2, half),
        (10, 0),
        textcoords="offset points",
        color=_MARK,
        va="center",
    )
    axes.axhline(figures.level, color=_MARK, linewidth=0.7, linestyle=":", zorder=0)
    if pitch is not None:
        top = float(np.interp(pitch, lag, figures.autocorrelation))
        axes.plot([pitch, pitch], [figures.level, top], color=_MARK, linewidth=0.9)
        axes.annotate(
            f"pitch {pitch:.2f} µm",
            (pitch, top),
            (0, 14),
            textcoords="offset points",
            color=_MARK,
            ha="center",
        )
    axes.set_xlabel("distance, µm")
    axes.set_ylabel("autocorrelation, mean taken off")
    axes.set_title("(b) autocorrelation")
    axes.legend(fontsize=8, loc="upper right", frameon=False)


def _draw_psf_magnitude(axes: "Axes", values: NDArray[np.float64], figures: "PsfFigures") -> None:
    """In four directions, over all of them, and the noise; the spectrum in the corner."""
    lowest = max(_DECADES * max(figures.magnitude), figures.noise_magnitude / 2)
    for angle, (at, magnitude) in figures.direction_magnitude.items():
        axes.plot(
            at,
            np.maximum(magnitude, lowest / 10),
            color=_COLOURS[angle],
            linewidth=0.8,
            linestyle="-" if angle < 180 else (0, (3, 3)),
            label=f"{angle}°",
        )
    axes.plot(figures.per_mm, figures.magnitude, color="black", linewidth=1.4, label="mean")
    if figures.noise_magnitude > lowest:
        axes.axhline(figures.noise_magnitude, color="0.5", linestyle="--", linewidth=0.9)
        axes.annotate(
            "noise",
            (0, figures.noise_magnitude),
            (4, 3),
            textcoords="offset points",
            color="0.4",
            fontsize=8,
        )
    axes.axvline(figures.line_per_mm, color=_MARK, linewidth=0.8)
    axes.annotate(
        f" line {figures.line_per_mm:.3g}/mm",
        (figures.line_per_mm, 0.02),
        xycoords=("data", "axes fraction"),
        color=_MARK,
        fontsize=8,
    )
    axes.set_yscale("log")
    axes.set_ylim(lowest, 1.3)
    axes.set_xlim(0, 500 / figures.pixel_um)
    axes.set_xlabel("spatial frequency on the sensor, lines/mm")
    axes.set_ylabel("spectral magnitude, of the light")
    axes.set_title("(c) spectral magnitude")
    axes.legend(fontsize=8, loc="upper center", frameon=False, ncols=1)
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(values - values.mean())))
    spectrum = _in_blocks(spectrum, 240)
    inset = axes.inset_axes((0.62, 0.58, 0.38, 0.42))
    decades = np.log10(np.maximum(spectrum, spectrum.max() * _DECADES))
    inset.imshow(decades, cmap="inferno", aspect="auto")
    inset.set_box_aspect(1)
    inset.set_xticks([])
    inset.set_yticks([])
    inset.set_xlabel("spectrum", fontsize=8, labelpad=2)


def _in_blocks(values: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """Root of the mean square over blocks, so that at most so many rows and columns are left."""
    steps = [max(1, -(-count // most)) for count in values.shape]
    rows, columns = (count // step for count, step in zip(values.shape, steps, strict=True))
    cut = values[: rows * steps[0], : columns * steps[1]]
    squares = (cut**2).reshape(rows, steps[0], columns, steps[1]).mean(axis=(1, 3))
    root: NDArray[np.float64] = np.sqrt(squares)
    return root


def write_field_plot(path: str | Path, field: "FieldOfView", levels: Sequence[float]) -> None:
    """Draw the dots of a grid, or PSFs from the side with correlations to mark.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    if field.grid is None:
        write_angles_plot(path, field.psfs, field.rays, levels)
    else:
        grid, angles = field.grid, field.grid.angles
        write_dots_plot(path, grid.dots, grid.picture, angles.good_deg, angles.lost_deg)


def write_angles_plot(
    path: str | Path,
    psfs: Sequence["OffAxis"],
    rays: Mapping[str, Sequence[float]] | None = None,
    levels: Sequence[float] = (),
) -> None:
    """Draw how PSFs from the side resemble the central one, and what light is left of them.

    Parameters
    ----------
    psfs
        What was measured, by angle; curves that hold None are left out.
    rays
        What rays say, at angles of its own: ``angle_deg``, ``overlap_width``, ``overlap_height``
        and ``light``; None draws none.
    levels
        Correlations to mark.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    columns = [asdict(each) for each in psfs]
    curves = {name: [each[name] for each in columns] for name in columns[0]}
    with plot_figure(path, (10.5, 4.2), title_size="large") as figure:
        left, right = figure.subplots(1, 2)
        _draw_curve(left, curves, "correlation", _FRAME, "o-", "frames, each by its own norm")
        _draw_curve(
            left, curves, "correlation_one_exposure", _EXPOSED, "D-", "frames of one exposure"
        )
        _draw_curve(left, curves, "correlation_overlap", _OVERLAP, "s-", "their overlap alone")
        if rays is not None:
            _draw_curve(
                left, rays, "overlap_width", _OTHER, "--", "overlap by rays, light at the side"
            )
            _draw_curve(left, rays, "overlap_height", _OTHER, ":", "overlap by rays, light above")
        for level in levels:
            left.axhline(level, color=_OTHER, linewidth=0.7, linestyle=(0, (6, 4)))
            left.annotate(
                f"{level:g}",
                (1, level),
                (-2, 2),
                xycoords=("axes fraction", "data"),
                textcoords="offset points",
                ha="right",
                color=_OTHER,
                fontsize=8,
            )
        left.set_ylabel("correlation with the central PSF; overlap")
        left.set_title("likeness to the central PSF")
        left.legend(fontsize=8, frameon=False, loc="best")
        _draw_curve(right, curves, "light", "black", "o-", "on the sensor")
        if rays is not None:
            _draw_curve(right, rays, "light", _OTHER, "--", "by cos³, reflection and acceptance")
        right.set_ylabel("light, of the central PSF's")
        right.set_title("vignetting")
        if right.lines:
            right.legend(fontsize=8, frameon=False, loc="best")
        for axes in (left, right):
            axes.set_xlabel("half angle, °")
            axes.set_ylim(min(0.0, axes.get_ylim()[0]), 1.05)
            axes.set_xlim(left=0)


def write_dots_plot(
    path: str | Path,
    dots: Sequence["Dot"],
    picture: Tensor,
    good_deg: float | None,
    lost_deg: float | None,
) -> None:
    """Draw the picture of a grid of dots with each one judged, and their figures by angle.

    Parameters
    ----------
    dots
        All that should be there.
    picture
        (rows, columns).
    good_deg, lost_deg
        Angles to mark.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with plot_figure(path, (15, 5.4), title_size="large") as figure:
        left, right = figure.subfigures(1, 2, width_ratios=(1, 1.5), squeeze=False)[0]
        axes = left.subplots()
        _draw_picture(axes, dots, picture)
        places = right.subplots(1, 3)
        named = ("error_deg", "width", "light")
        labels = ("off its place, °", "width, of the middle dots'", "light, of the middle dots'")
        for each, name, label in zip(places, named, labels, strict=True):
            _draw_figures(each, dots, name, label)
            for angle, colour in ((good_deg, _GRADES["good"]), (lost_deg, _GRADES["lost"])):
                if angle is not None:
                    each.axvline(angle, color=colour, linewidth=0.9)


def _draw_curve(
    axes: "Axes",
    curves: Mapping[str, Sequence[float | None]],
    name: str,
    colour: str,
    style: str,
    label: str,
) -> None:
    at = [each for each in curves["angle_deg"] if each is not None]
    values = [each for each in curves[name] if each is not None]
    if len(values) == len(at):
        axes.plot(
            at,
            values,
            style,
            color=colour,
            label=label,
            markersize=4,
            linewidth=1.2,
        )


def _draw_picture(axes: "Axes", dots: Sequence["Dot"], picture: Tensor) -> None:
    """Each dot in a ring of its grade's colour."""
    values = picture.detach().cpu().double().numpy().clip(min=0)
    white = float(np.percentile(values, _BRIGHTEST_PICTURE)) or 1.0
    axes.imshow((values / white).clip(max=1) ** (1 / _GAMMA), cmap="gray", vmin=0, vmax=1)
    side = min(values.shape)
    around = np.sqrt(values.size / max(1, len(dots)))
    size = (0.45 * around / side * 330) ** 2 / 4
    for name, colour in _GRADES.items():
        at = [dot.expected for dot in dots if dot.grade == name]
        if at:
            rows, columns = zip(*at, strict=True)
            axes.scatter(
                columns,
                rows,
                s=size,
                facecolors="none",
                edgecolors=colour,
                linewidths=0.8,
                label=f"{name}: {len(at)}",
            )
    axes.set_xlim(-0.5, values.shape[1] - 0.5)
    axes.set_ylim(values.shape[0] - 0.5, -0.5)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=3, frameon=False)
    axes.set_title(f"{len(dots)} dots")


def _draw_figures(axes: "Axes", dots: Sequence["Dot"], name: str, label: str) -> None:
    """One figure of every dot over its angle; of the light also what is expected."""
    for grade, colour in _GRADES.items():
        points = [
            (dot.angle_deg, value)
            for dot in dots
            if dot.grade == grade and (value := getattr(dot, name)) is not None
        ]
        if points:
            axes.plot(*zip(*points, strict=True), ".", color=colour, markersize=4)
    if name == "light":
        curve = sorted({(dot.angle_deg, dot.expected_light) for dot in dots})
        axes.plot(*zip(*curve, strict=True), "--", color=_OTHER, linewidth=1.1, label="expected")
        axes.legend(fontsize=8, frameon=False)
    axes.set_xlabel("half angle, °")
    axes.set_title(label, fontsize=9)
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))


def draw_two_points(points: "TwoPoints", path: Path) -> None:
    """Draw the points with the light through them, and the dips by separation."""
    order = sorted(range(len(points.pairs)), key=lambda n: abs(points.dips[n] - points.threshold))
    panels = sorted(order[:_MOST_PANELS])
    with plot_figure(path, (max(2.0 * len(panels), 6.0), 7.0)) as figure:
        grid = figure.add_gridspec(3, len(panels), height_ratios=[3, 2, 4])
        for place, number in enumerate(panels):
            above, below = (figure.add_subplot(grid[row, place]) for row in (0, 1))
            each = points.pairs[number]
            picture = each.picture.numpy()
            light = np.clip(picture, 0, None)
            middle = [round(at) for at in ndimage.center_of_mass(light**2)]
            top, left = (max(0, at - _PANEL_PIXELS // 2) for at in middle)
            picture = picture[top : top + _PANEL_PIXELS, left : left + _PANEL_PIXELS]
            show_picture(above, picture, white=float(picture.max()))
            above.set_title(f"{each.separation_deg:.3g}°, dip {100 * points.dips[number]:.0f} %")
            below.plot(each.pair.at.numpy(), each.pair.trace.numpy(), color=ACCENT)
            below.axhline(1 - points.threshold, color=GUIDE, linewidth=0.8, linestyle=":")
            below.set_xlabel("pixels")
            below.set_ylim(-0.05, 1.1)
            below.set_ylabel("light" if place == 0 else "")
        axes = figure.add_subplot(grid[2, :])
        axes.axhline(100 * points.threshold, color=GUIDE, linewidth=0.8, linestyle=":")
        title = "dip between the points"
        angle, off = points.resolved.value, points.resolved.plus_minus
        if angle is not None and off is not None:
            axes.axvspan(angle - off, angle + off, color=ACCENT, alpha=0.15, linewidth=0)
            axes.axvline(angle, color=ACCENT, linewidth=0.9)
            title = f"resolved from {angle:.3f}° ± {off:.3f}° on"
        axes.errorbar(
            points.separations_deg,
            [100 * dip for dip in points.dips],
            [100 * each for each in points.noise],
            color="black",
            marker="o",
            markersize=4,
            linewidth=1,
            capsize=2,
        )
        axes.set_xlabel("separation, degrees")
        axes.set_ylabel("dip, %")
        axes.set_ylim(-4, 104)
        axes.set_title(f"{title}; dotted: a dip of {100 * points.threshold:.1f} %")


def draw_star(resolution: "StarResolution", path: Path) -> None:
    """Draw the star, its contrast by frequency and direction, and the light along arcs."""
    star, worst = resolution.star, resolution.worst
    with plot_figure(path, (10.5, 8.4)) as figure:
        from matplotlib.patches import Circle

        places = figure.subplot_mosaic(
            [["picture", "contrast"], ["arc", "round"]], per_subplot_kw={"round": {"polar": True}}
        )
        show_picture(places["picture"], resolution.picture.values.numpy())
        row, column = star.place.centre
        radius = _resolved_radius(resolution)
        places["picture"].add_patch(
            Circle((column, row), radius, fill=False, color=WORST, linewidth=1.2)
        )
        places["picture"].set_title(
            f"circle: spokes of {resolution.resolved_everywhere_deg:.3f}° a pair, resolved from "
            "there on"
        )
        axes = places["contrast"]
        directions = star.directions_deg.tolist()
        for number, direction in enumerate(directions):
            is_worst = number == worst
            axes.plot(
                (1 / resolution.pairs_deg[number]).numpy(),
                star.contrast[number].numpy(),
                color=WORST if is_worst else ACCENT,
                linewidth=1.6 if is_worst else 0.8,
                alpha=1.0 if is_worst else 0.5,
                zorder=3 if is_worst else 2,
                label=f"spokes at {direction:g}° (worst)"
                if is_worst
                else "other directions"
                if number == (worst + 1) % len(directions)
                else None,
            )
        needed = resolution.threshold * star.wide
        axes.axhline(needed, color=GUIDE, linewidth=0.8, linestyle=":")
        axes.set_xlabel("cycles to the degree")
        axes.set_ylabel("contrast")
        axes.set_ylim(bottom=0)
        axes.set_title(f"dotted: {needed:.3g}, that counts as resolved")
        axes.legend(frameon=False)
        _arcs(places["arc"], resolution)
        _round(places["round"], resolution)


def _resolved_radius(resolution: "StarResolution") -> float:
    """In pixels, from which on all is resolved."""
    pairs = resolution.pairs_deg[resolution.worst].numpy()
    radii = resolution.star.radii.numpy()
    return float(np.interp(resolution.resolved_everywhere_deg, pairs, radii))


def _arcs(axes: "Axes", resolution: "StarResolution") -> None:
    """Light along arcs of the worst direction, one below the other."""
    star, picture = resolution.star, resolution.picture.values.numpy()
    direction_deg = float(star.directions_deg[resolution.worst])
    pairs, radii = resolution.pairs_deg[resolution.worst].numpy(), star.radii.numpy()
    periods = np.linspace(-_ARC_PERIODS / 2, _ARC_PERIODS / 2, 241)
    turns = math.radians(direction_deg) + periods * (2 * math.pi / star.place.periods)
    white = white_level(picture)
    labels: dict[float, str] = {}
    for number, times in enumerate(_ARC_RADII):
        radius = times * _resolved_radius(resolution)
        if radius > float(radii[-1]):
            continue
        row, column = star.place.centre
        places = [row - radius * np.sin(turns), column + radius * np.cos(turns)]
        light = ndimage.map_coordinates(picture, places, order=3)
        level = -_ARC_STEP * number
        labels[level] = f"{float(np.interp(radius, radii, pairs)):.3f}°"
        axes.axhline(level, color=GUIDE, linewidth=0.5)
        axes.plot(periods, light / white + level, color=WORST if number == 0 else ACCENT)
    axes.set_xlabel("pairs of spokes")
    axes.set_yticks(list(labels), list(labels.values()))
    axes.set_ylabel("light, by the angle of a pair")
    axes.set_title(f"light along arcs about {direction_deg:g}°, each above its line")


def _round(axes: "Axes", resolution: "StarResolution") -> None:
    """The smallest resolved pair of spokes around the circle."""
    from matplotlib.projections.polar import PolarAxes
    from matplotlib.ticker import MaxNLocator

    directions, worst = resolution.star.directions_deg.numpy(), resolution.worst
    turns = np.radians(np.append(directions, directions[0]))
    angles = np.append(resolution.resolved_deg, resolution.resolved_deg[0])
    axes.plot(turns, angles, color=ACCENT, marker="o", markersize=4)
    axes.plot(turns[worst], angles[worst], "o", color=WORST, markersize=7)
    axes.set_ylim(0, 1.2 * float(angles.max()))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    assert isinstance(axes, PolarAxes)
    axes.set_rlabel_position(22.5)
    axes.set_title("smallest resolved pair by direction of the spokes, degrees")


def draw_edge(edge: "EdgeResolution", path: Path) -> None:
    """Draw the edge, the light across it and the contrast by frequency, as the PNG of a path."""
    response = edge.response
    with plot_figure(path, (12.0, 3.8)) as figure:
        picture, spread, contrast = figure.subplots(1, 3)
        show_picture(picture, edge.picture.values.numpy())
        picture.set_title("picture")
        spread.plot(response.at.numpy() * edge.pixel_deg, response.spread.numpy(), color=ACCENT)
        spread.set_xlabel("degrees from the edge")
        spread.set_ylabel("light")
        spread.set_title("across the edge")
        frequencies = response.frequencies.numpy() / edge.pixel_deg
        contrast.plot(frequencies, response.transfer.numpy(), color=ACCENT)
        for level in _LEVELS:
            contrast.axhline(level, color=GUIDE, linewidth=0.8, linestyle=":")
            frequency = edge.per_deg(level)
            if frequency is not None:
                contrast.plot([frequency], [level], "o", color=WORST, markersize=5)
                contrast.annotate(
                    f"{frequency:.2f}/deg",
                    (frequency, level),
                    xytext=(6, 5),
                    textcoords="offset points",
                )
        contrast.set_xlabel("cycles to the degree")
        contrast.set_ylabel("contrast")
        contrast.set_ylim(bottom=0)
        contrast.set_title("modulation transfer")
