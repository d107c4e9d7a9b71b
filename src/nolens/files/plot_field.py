"""Plots of a camera's field of view, as the paper's Fig. 6c and d."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

from nolens.evaluate import Dot
from nolens.files.atomic import atomic_write
from nolens.files.save_plot import save_plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GRADES = {"good": "#2a7f62", "distorted": "#e08a1e", "lost": "#a01c3a"}
_FRAME, _EXPOSED, _OVERLAP, _OTHER = "#3557c9", "#a01c3a", "#2f9140", "0.45"
_BRIGHTEST = 99.8
_GAMMA = 2.2


def write_angles_plot(
    path: str | Path,
    curves: Mapping[str, Sequence[float | None]],
    rays: Mapping[str, Sequence[float]] | None = None,
    levels: Sequence[float] = (),
) -> None:
    """Draw how PSFs from the side resemble the central one, and what light is left of them.

    Parameters
    ----------
    path
        PNG to be written.
    curves
        What was measured: by name, one value for each ``angle_deg``: ``correlation``,
        ``correlation_one_exposure``, ``correlation_overlap`` and ``light``; those that hold None
        are left out.
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
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(10.5, 4.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        _draw(left, curves, "correlation", _FRAME, "o-", "frames, each by its own norm")
        _draw(left, curves, "correlation_one_exposure", _EXPOSED, "D-", "frames of one exposure")
        _draw(left, curves, "correlation_overlap", _OVERLAP, "s-", "their overlap alone")
        if rays is not None:
            _draw(left, rays, "overlap_width", _OTHER, "--", "overlap by rays, light at the side")
            _draw(left, rays, "overlap_height", _OTHER, ":", "overlap by rays, light above")
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
        _draw(right, curves, "light", "black", "o-", "on the sensor")
        if rays is not None:
            _draw(right, rays, "light", _OTHER, "--", "by cos³, reflection and acceptance")
        right.set_ylabel("light, of the central PSF's")
        right.set_title("vignetting")
        if right.lines:
            right.legend(fontsize=8, frameon=False, loc="best")
        for axes in (left, right):
            axes.set_xlabel("half angle, °")
            axes.set_ylim(min(0.0, axes.get_ylim()[0]), 1.05)
            axes.set_xlim(left=0)
        with atomic_write(path) as temporary:
            save_plot(figure, temporary)


def write_dots_plot(
    path: str | Path,
    dots: Sequence[Dot],
    picture: Tensor,
    good_deg: float | None,
    lost_deg: float | None,
) -> None:
    """Draw the picture of a grid of dots with each one judged, and their figures by angle.

    Parameters
    ----------
    path
        PNG to be written.
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
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(15, 5.4), layout="constrained")
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
        with atomic_write(path) as temporary:
            save_plot(figure, temporary)


def _draw(
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


def _draw_picture(axes: "Axes", dots: Sequence[Dot], picture: Tensor) -> None:
    """Each dot in a ring of its grade's colour."""
    values = picture.detach().cpu().double().numpy().clip(min=0)
    white = float(np.percentile(values, _BRIGHTEST)) or 1.0
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


def _draw_figures(axes: "Axes", dots: Sequence[Dot], name: str, label: str) -> None:
    """One figure of every dot over its angle; of the light also what is expected."""
    for grade, colour in _GRADES.items():
        found = [
            (dot.angle_deg, value)
            for dot in dots
            if dot.grade == grade and (value := getattr(dot, name)) is not None
        ]
        if found:
            axes.plot(*zip(*found, strict=True), ".", color=colour, markersize=4)
    if name == "light":
        curve = sorted({(dot.angle_deg, dot.expected_light) for dot in dots})
        axes.plot(*zip(*curve, strict=True), "--", color=_OTHER, linewidth=1.1, label="expected")
        axes.legend(fontsize=8, frameon=False)
    axes.set_xlabel("half angle, °")
    axes.set_title(label, fontsize=9)
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
