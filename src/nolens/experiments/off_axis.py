"""How PSFs change with the field angle: correlation with the central one, shift and light."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import PsfEntry, develop
from nolens.errors import DataError
from nolens.experiments.dot_grid import (
    DotGrid,
    dot_grid,
    dot_grid_bytes,
    field_points,
    grid_tangents,
)
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.kernels import fast_length, irfft2, rfft2
from nolens.optics import PointSource
from nolens.progress import ProgressCallback, within
from nolens.solvers import Prior
from nolens.twin import (
    Light,
    Twin,
    check_field_points,
    colours_of,
    polychromatic_psf_bytes,
    shortest_nm,
)

CORRELATIONS = (0.6, 0.3)
"""Down to the first a picture is good, below the second it is lost (`uvimprint`); the paper does
not say whether frames count by their own norms or, at one exposure, by the central one's."""
_DIAMETER_UM = 50.0
"""The paper's light: a pinhole of 50 um."""
_FILL = 0.9
"""Fraction of a full pixel that the brightest one is exposed to."""
_CURVE_STEPS = 60
_SEARCH_PIXELS = 12
"""Around the place that a PSF is known to have moved to."""


@dataclass(frozen=True)
class OffAxis:
    """A PSF from the side beside the one from straight ahead.

    Parameters
    ----------
    angle_deg
        Between the axis and the point source.
    correlation
        Peak of the cross-correlation of the two frames as the sensor has them, each by its own
        norm.
    correlation_one_exposure
        The same peak over that of the central frame with itself, for frames of one exposure time:
        light that is lost counts. None where exposures are not known.
    correlation_overlap
        Correlation of those parts alone that both frames have: what aberration does.
    overlap_width, overlap_height
        Fraction of the frame that both have by the chief ray, for a light beside the camera and one
        above it; None without a description of the camera.
    shift_um
        How far the PSF has moved.
    expected_shift_um
        How far the chief ray has, by Snell's law; None without a description of the camera.
    light
        On the sensor, in that of the central light; None where exposures are not known.
    expected_light
        What the angle and the pixels leave of it; None without a description of the camera.
    """

    angle_deg: float
    correlation: float
    correlation_one_exposure: float | None
    correlation_overlap: float
    overlap_width: float | None
    overlap_height: float | None
    shift_um: float
    expected_shift_um: float | None
    light: float | None
    expected_light: float | None


def off_axis(
    experiment: VirtualExperiment,
    angles_deg: Sequence[float],
    *,
    distance_um: float = math.inf,
    diameter_um: float = 0.0,
    seed: int = 0,
    progress: ProgressCallback | None = None,
) -> list[OffAxis]:
    """Capture point sources beside the camera, and compare each with the one straight ahead.

    Frames have the sensor's noise, and each its own exposure, as they are taken in the laboratory.

    Parameters
    ----------
    experiment
        The camera.
    angles_deg
        To the right; the central light need not be among them.
    distance_um, diameter_um
        Of the light; the distance from the sensor's plane.
    seed
        Of the noise; every frame has its own.
    progress
        Called with the fraction that is done.

    Raises
    ------
    OptionError
        If an angle is beyond the model.
    """
    twin = experiment.twin
    sources = [
        PointSource((0.0, math.tan(math.radians(angle))), distance_um, diameter_um)
        for angle in angles_deg
    ]
    for source in sources:
        twin.check_source(source)
    total = len(sources) + 1
    shots: list[tuple[Tensor | None, float, float]] = []
    for number, source in enumerate([PointSource((0.0, 0.0), distance_um, diameter_um), *sources]):
        image = experiment.light_of(source, within(progress, number / total, 1 / total))
        power = float(image.double().sum())
        if not power > 0:
            shots.append((None, 0.0, 0.0))
            continue
        measured = develop(experiment.exposed(image, _FILL, seed + number), channels="grey")
        shots.append((measured.values[0], power, float(image.max())))
    central, power, brightest = shots[0]
    if central is None:
        raise DataError(
            "no light from straight ahead reaches the sensor: there is nothing to compare with"
        )
    return [
        # Its brightest pixel was exposed to as much as the central one's.
        compare(central, psf, source, twin.pixel_um, twin, top / brightest, light / power)
        for source, (psf, light, top) in zip(sources, shots[1:], strict=True)
    ]


def _off_axis_bytes(twin: Twin, farthest: PointSource, count: int) -> float:
    """Bytes that PSFs of some point sources, with two samples to the pixel, hold at once."""
    sensor = twin.camera.sensor
    psf = polychromatic_psf_bytes(
        twin,
        farthest,
        (sensor.rows, sensor.columns),
        1,
        at_least=2,
        shortest=shortest_nm(colours_of(twin, Light("white-led"), 1)),
    )
    return psf + 8 * sensor.rows * sensor.columns * (count + 1)


def _angle_figures(psfs: Sequence[OffAxis]) -> dict[str, Any]:
    """Figures of PSFs by angle, and where their correlations fall to `CORRELATIONS`.

    A correlation that some PSF does not have is left out.
    """
    angles = [each.angle_deg for each in psfs]
    figures: dict[str, Any] = {"angles": [asdict(each) for each in psfs]}
    for name in ("correlation", "correlation_one_exposure", "correlation_overlap"):
        values = [getattr(each, name) for each in psfs]
        if None not in values:
            figures[f"{name}_falls_to_deg"] = {
                f"{level:g}": falls_to(level, angles, values) for level in CORRELATIONS
            }
    return figures


@dataclass(frozen=True)
class FieldOfView:
    """How far to the side a camera sees.

    Parameters
    ----------
    psfs
        PSFs from the side beside the central one, by angle; empty where dots were measured.
    grid
        A grid of dots in the camera's picture; None where PSFs were compared.
    rays
        Curves by ray optics, by name; None where the camera is not known.
    """

    psfs: tuple[OffAxis, ...]
    grid: DotGrid | None = None
    rays: Mapping[str, Sequence[float]] | None = None

    @classmethod
    def of_psfs(cls, psfs: Sequence[OffAxis], twin: Twin | None, distance_um: float) -> Self:
        """PSFs by angle, of light at a distance, with what rays say where the camera is known."""
        rays = None if twin is None else ray_curves(twin, psfs[-1].angle_deg, distance_um)
        return cls(tuple(psfs), None, rays)

    @property
    def figures(self) -> dict[str, Any]:
        """All figures by name, as ``nolens measure field --json`` prints them."""
        return _angle_figures(self.psfs) if self.grid is None else self.grid.figures


@dataclass(frozen=True)
class FieldTarget:
    """What a simulated camera is shown: a grid of dots, or without its pitch point sources.

    Parameters
    ----------
    distance_um
        From the camera.
    angles_deg
        Half angles of the point sources, rising.
    pitch_um
        Distance of neighbouring dots.
    extent_deg
        Half angle up to which there are dots.
    psf_points
        PSFs along each side of the field with which the dots are reconstructed; odd.
    prior
        With which they are.
    simulated_psfs
        PSFs along each side of the field between which those of the dots are blended, odd; None
        takes one every 12.5°.

    Raises
    ------
    OptionError
        If there are too few dots up to that angle, or too many.
    """

    distance_um: float
    angles_deg: Sequence[float]
    pitch_um: float | None
    extent_deg: float
    psf_points: int = 1
    prior: Prior = Prior.AUTO
    simulated_psfs: int | None = None

    def __post_init__(self) -> None:
        if self.pitch_um is not None:
            grid_tangents(self.pitch_um, self.distance_um, self.extent_deg)
        check_field_points(self.psf_points)
        check_field_points(self.field_points)

    def __str__(self) -> str:
        if self.pitch_um is None:
            return f"{len(self.angles_deg)} point sources"
        return f"{len(grid_tangents(self.pitch_um, self.distance_um, self.extent_deg))} dots"

    @property
    def field_points(self) -> int:
        """PSFs along each side of what is blended."""
        if self.pitch_um is None:
            return 1
        points = self.simulated_psfs
        return field_points(self.extent_deg) if points is None else points

    def working_bytes(self, twin: Twin) -> float:
        """Bytes that the experiment holds at once, beside the relief.

        Raises
        ------
        OptionError
            If the largest angle is beyond the model.
        """
        largest_deg = self.angles_deg[-1] if self.pitch_um is None else self.extent_deg
        farthest = PointSource((0.0, math.tan(math.radians(largest_deg))), self.distance_um)
        twin.check_source(farthest)
        if self.pitch_um is None:
            return _off_axis_bytes(twin, farthest, len(self.angles_deg))
        return dot_grid_bytes(
            twin,
            pitch_um=self.pitch_um,
            distance_um=self.distance_um,
            extent_deg=self.extent_deg,
            simulated_psfs=self.field_points,
            psf_points=self.psf_points,
        )

    def measure(
        self, experiment: VirtualExperiment, seed: int, progress: ProgressCallback
    ) -> FieldOfView:
        """Show it to a camera with as many `field_points`; the seed is that of the noise."""
        if self.pitch_um is None:
            psfs = off_axis(
                experiment,
                self.angles_deg,
                distance_um=self.distance_um,
                diameter_um=0.0 if math.isinf(self.distance_um) else _DIAMETER_UM,
                seed=seed,
                progress=progress,
            )
            return FieldOfView.of_psfs(psfs, experiment.twin, self.distance_um)
        grid = dot_grid(
            experiment,
            pitch_um=self.pitch_um,
            distance_um=self.distance_um,
            extent_deg=self.extent_deg,
            psf_points=self.psf_points,
            prior=self.prior,
            seed=seed,
            progress=progress,
        )
        return FieldOfView((), grid)


def source_of(entry: PsfEntry) -> PointSource:
    """Light of a PSF: to the right of the axis, and above it, where rows count downwards."""
    right, up = (math.tan(angle.rad) for angle in entry.angle)
    return PointSource((-up, right), entry.distance_um)


def captured_at_angles(
    folder: Path, entries: Sequence[PsfEntry]
) -> tuple[PsfEntry, list[PsfEntry]]:
    """The central PSF, and all of its distance by angle; those of the distance with the most.

    Raises
    ------
    DataError
        If the folder has none from straight ahead, or none from the side at its distance.
    """
    captured = [
        each
        for each in entries
        if each.kind == "captured" and (each.on_axis or each.frame == "sensor")
    ]
    groups: dict[float, list[PsfEntry]] = {}
    for entry in captured:
        groups.setdefault(entry.distance_um, []).append(entry)
    whole = [group for group in groups.values() if any(each.on_axis for each in group)]
    if not whole:
        raise DataError(
            f"{folder} has no captured PSF of a light straight ahead to compare others with: "
            "calibrate one (nolens calibrate), at the distance of those from the side"
        )
    group = max(whole, key=len)
    if len(group) == 1:
        raise DataError(
            f"{folder} has no captured PSF of a light from the side at the distance of "
            f"{group[0].file}: calibrate some at known angles (nolens calibrate)"
        )
    central = next(each for each in group if each.on_axis)
    return central, sorted(group, key=lambda each: source_of(each).angle_deg)


def compare(
    central: Tensor,
    psf: Tensor | None,
    source: PointSource,
    pixel_um: float,
    twin: Twin | None,
    one_exposure: float | None = None,
    light: float | None = None,
) -> OffAxis:
    """Compare one captured PSF with the central one.

    Parameters
    ----------
    central, psf
        (rows, columns), on the pixels of the sensor; None for the second one where no light of it
        reaches the sensor.
    source
        Of the second one.
    pixel_um
        Pitch of the pixels.
    twin
        The camera; None leaves out what follows from it.
    one_exposure
        What the second one's values are multiplied by to be of the central one's exposure time;
        None where that is not known.
    light
        Of the second one on the sensor, in that of the central one.
    """
    near = rays = None
    if twin is not None:
        twin.check_source(source)
        moved = twin.shift_um(source)
        near = moved[0] / pixel_um, moved[1] / pixel_um
        rays = _by_rays(twin, source, central.shape[0] * pixel_um, central.shape[1] * pixel_um)
    peak = _PeakCorrelation(0.0, 0.0, 0.0, (0.0, 0.0))
    if psf is not None:
        peak = peak_correlation(central, psf, near)
    return OffAxis(
        angle_deg=source.angle_deg,
        correlation=peak.frame,
        correlation_one_exposure=None if one_exposure is None else peak.projection * one_exposure,
        correlation_overlap=peak.overlap,
        overlap_width=None if rays is None else rays.overlap_width,
        overlap_height=None if rays is None else rays.overlap_height,
        shift_um=math.hypot(*peak.shift) * pixel_um,
        expected_shift_um=None if rays is None else rays.shift_um,
        light=light,
        expected_light=None if rays is None else rays.light,
    )


@dataclass(frozen=True)
class _ChiefRay:
    """What the chief ray of an angle says, in the fields of `OffAxis`."""

    angle_deg: float
    shift_um: float
    overlap_width: float
    overlap_height: float
    light: float


def ray_curves(
    twin: Twin, largest_deg: float, distance_um: float = math.inf
) -> dict[str, list[float]]:
    """Follow chief rays from straight ahead to an angle, in steps fine enough for a curve.

    Parameters
    ----------
    twin
        The camera.
    largest_deg
        The last angle.
    distance_um
        Of the light from the sensor's plane.

    Returns
    -------
    dict
        ``angle_deg``, ``shift_um``, ``overlap_width``, ``overlap_height`` and ``light``, one value
        for each angle.
    """
    height_um, width_um = (count * twin.pixel_um for count in twin.shape)
    angles = (largest_deg * step / _CURVE_STEPS for step in range(_CURVE_STEPS + 1))
    sources = (PointSource((0.0, math.tan(math.radians(deg))), distance_um) for deg in angles)
    rays = [asdict(_by_rays(twin, source, height_um, width_um)) for source in sources]
    return {name: [each[name] for each in rays] for name in rays[0]}


def _by_rays(twin: Twin, source: PointSource, height_um: float, width_um: float) -> _ChiefRay:
    shift = math.hypot(*twin.shift_um(source))
    return _ChiefRay(
        angle_deg=source.angle_deg,
        shift_um=shift,
        overlap_width=max(0.0, 1 - shift / width_um),
        overlap_height=max(0.0, 1 - shift / height_um),
        light=float(twin.vignetting(torch.tensor(twin.p_of(source), dtype=torch.float64))),
    )


@dataclass(frozen=True)
class _PeakCorrelation:
    """Where two PSFs are most alike, and how much.

    `frame` is the peak of the normalised cross-correlation of the whole frames, outside of which
    there is nothing: what leaves the frame is missed. Each frame counts by its own norm, so it does
    not matter how bright it is. `projection` is the same peak over the first frame's own,
    ⟨a, b⟩/⟨a, a⟩: by how much of the first PSF the second one holds, in the units of the frames. Of
    frames of one exposure time it counts vignetting too. `overlap` is the correlation over those
    pixels alone that lie over each other there, or near to where the PSF is known to have moved.
    Where the whole frames are most alike, the second one lies by `shift` pixels further down and to
    the right.
    """

    frame: float
    projection: float
    overlap: float
    shift: tuple[float, float]


def peak_correlation(
    one: Tensor, other: Tensor, near: tuple[float, float] | None = None
) -> _PeakCorrelation:
    r"""Compare two PSFs as they were captured (`uvimprint`, fig. 6c).

    .. math:: c(s) = \frac{\sum_x (a_x - \bar a)(b_{x+s} - \bar b)}{|a - \bar a|\,|b - \bar b|}

    with both zero outside of the frame; between the pixels the peak is a parabola's. Over the
    overlap mean and norm are those of its pixels.

    Parameters
    ----------
    one, other
        (rows, columns) alike, in any unit.
    near
        By how many pixels the second one is known to lie further down and to the right: the overlap
        is compared at the best place within 12 pixels of that, even where chance is more alike
        elsewhere. None: where the whole frames are most alike.

    Raises
    ------
    DataError
        If they differ in size, or one of them is even.
    """
    if one.shape != other.shape:
        raise DataError(
            f"PSFs of {one.shape[0]}×{one.shape[1]} and {other.shape[0]}×{other.shape[1]} pixels "
            "cannot be compared: give both from the same sensor"
        )
    frames = [each.double() - each.double().mean() for each in (one, other)]
    norms = [float(each.norm()) for each in frames]
    if not min(norms) > 0:
        raise DataError("one of the PSFs is even: it has no structure to compare")
    rows, columns = one.shape
    padded = (
        fast_length(2 * rows, of_rows=False),
        fast_length(2 * columns, of_rows=True),
    )
    margins = (0, padded[1] - columns, 0, padded[0] - rows)
    first, second = (rfft2(nnf.pad(each.float(), margins)) for each in frames)
    correlation = irfft2(first.conj() * second, padded)
    place = _signed(int(correlation.argmax()), padded, (rows, columns))
    steps = torch.arange(-1, 2)
    rows_near, columns_near = (place[0] + steps) % padded[0], (place[1] + steps) % padded[1]
    around = correlation[rows_near[:, None], columns_near].tolist()
    top, moved = _vertex(around)
    known = place if near is None else _best_near(correlation, near)
    over = [
        [_pearson(one, other, (known[0] + i, known[1] + j)) for j in (-1, 0, 1)] for i in (-1, 0, 1)
    ]
    return _PeakCorrelation(
        frame=min(1.0, top / (norms[0] * norms[1])),
        projection=top / norms[0] ** 2,
        overlap=min(1.0, _vertex(over)[0]),
        shift=(place[0] + moved[0], place[1] + moved[1]),
    )


def falls_to(level: float, angles_deg: Sequence[float], values: Sequence[float]) -> float | None:
    """Angle at which values that are given by angle first fall to a level, between them.

    Parameters
    ----------
    level
        The level.
    angles_deg
        Rising.
    values
        One for each.

    Returns
    -------
    float or None
        None where they stay above it.
    """
    for number, value in enumerate(values):
        if value <= level:
            if number == 0:
                return angles_deg[0]
            before, start = values[number - 1], angles_deg[number - 1]
            return start + (before - level) / (before - value) * (angles_deg[number] - start)
    return None


def _signed(index: int, padded: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    """Shift of a value of the cross-correlation, by its number."""
    row, column = divmod(index, padded[1])
    return (
        row - padded[0] if row >= size[0] else row,
        column - padded[1] if column >= size[1] else column,
    )


def _best_near(correlation: Tensor, near: tuple[float, float]) -> tuple[int, int]:
    """Shift of the highest value of the cross-correlation around a known one."""
    steps = torch.arange(-_SEARCH_PIXELS, _SEARCH_PIXELS + 1)
    at = [steps + round(middle) for middle in near]
    part = correlation[(at[0] % correlation.shape[0])[:, None], at[1] % correlation.shape[1]]
    row, column = divmod(int(part.argmax()), len(steps))
    return int(at[0][row]), int(at[1][column])


def _pearson(one: Tensor, other: Tensor, shift: tuple[int, int]) -> float:
    """Correlation of the pixels that lie over each other when the second is moved back."""
    parts = []
    for frame, sign in ((one, 1), (other, -1)):
        part = frame
        for axis, step in enumerate(shift):
            length = frame.shape[axis] - abs(step)
            if length < 2:
                return 0.0
            part = part.narrow(axis, max(0, -step * sign), length)
        parts.append(part.double() - part.double().mean())
    product = float(parts[0].norm() * parts[1].norm())
    return float((parts[0] * parts[1]).sum()) / product if product > 0 else 0.0


def _vertex(near: list[list[float]]) -> tuple[float, tuple[float, float]]:
    """Top of parabolas along both axes through 3×3 values, and its place from the middle."""
    middle = near[1][1]
    height, moved = middle, []
    for before, after in ((near[0][1], near[2][1]), (near[1][0], near[1][2])):
        bend = before - 2 * middle + after
        step = 0.5 * (before - after) / bend if bend < 0 else 0.0
        step = math.copysign(min(abs(step), 1.0), step)
        moved.append(step)
        height -= 0.25 * (before - after) * step
    return height, (moved[0], moved[1])
