"""How PSFs change with the angle: on a simulated camera, and from a camera's folder."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from nolens.camera import PsfEntry, develop
from nolens.errors import DataError
from nolens.evaluate import PeakCorrelation, clipped_cells, peak_correlation
from nolens.files import read_psf, read_psf_set
from nolens.jobs.optical_bench import OpticalBench
from nolens.optics import PointSource
from nolens.twin import Twin

Tick = Callable[[float], None]

_CURVE_STEPS = 60


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
        Share of the frame that both have by the chief ray, for a light beside the camera and one
        above it; None without a description of the camera.
    shift_um
        How far the pattern has moved.
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
    bench: OpticalBench,
    angles_deg: Sequence[float],
    *,
    distance_um: float = math.inf,
    diameter_um: float = 0.0,
    fill: float = 0.9,
    seed: int = 0,
    tick: Tick | None = None,
) -> list[OffAxis]:
    """Capture point sources beside the camera, and compare each with the one straight ahead.

    Frames have the sensor's noise, and each its own exposure, as they are taken in the laboratory.

    Parameters
    ----------
    bench
        The camera.
    angles_deg
        To the right; the central light need not be among them.
    distance_um, diameter_um
        Of the light; the distance from the sensor's plane.
    fill
        Share of a full pixel that the brightest one is exposed to.
    seed
        Of the noise; every frame has its own.
    tick
        Called with the share that is done.

    Raises
    ------
    OptionError
        If an angle is beyond the model.
    """
    twin = bench.twin
    sources = [
        PointSource((0.0, math.tan(math.radians(angle))), distance_um, diameter_um)
        for angle in angles_deg
    ]
    for source in sources:
        twin.check_source(source)
    total = len(sources) + 1
    patterns: list[tuple[Tensor | None, float, float]] = []
    for number, source in enumerate([PointSource((0.0, 0.0), distance_um, diameter_um), *sources]):

        def part(share: float, before: int = number) -> None:
            if tick is not None:
                tick((before + share) / total)

        image = bench.light_of(source, part)
        power = float(image.double().sum())
        if not power > 0:
            patterns.append((None, 0.0, 0.0))
            continue
        seen = develop(bench.exposed(image, fill, seed + number), channels="grey")
        patterns.append((seen.values[0], power, float(image.max())))
    central, power, brightest = patterns[0]
    if central is None:
        raise DataError(
            "no light from straight ahead reaches the sensor: there is nothing to compare with"
        )
    return [
        # Its brightest pixel was exposed to as much as the central one's.
        compared(central, pattern, source, twin.cell_um, twin, top / brightest, light / power)
        for source, (pattern, light, top) in zip(sources, patterns[1:], strict=True)
    ]


def compared(
    central: Tensor,
    pattern: Tensor | None,
    source: PointSource,
    cell_um: float,
    twin: Twin | None,
    one_exposure: float | None = None,
    light: float | None = None,
) -> OffAxis:
    """Compare one captured PSF with the central one.

    Parameters
    ----------
    central, pattern
        (rows, columns), on the cells of the sensor; None for the second one where no light of it
        reaches the sensor.
    source
        Of the second one.
    cell_um
        Distance of the cells.
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
        near = moved[0] / cell_um, moved[1] / cell_um
        rays = _by_rays(twin, source, central.shape[0] * cell_um, central.shape[1] * cell_um)
    found = PeakCorrelation(0.0, 0.0, 0.0, (0.0, 0.0))
    if pattern is not None:
        found = peak_correlation(central, pattern, near)
    return OffAxis(
        angle_deg=source.angle_deg,
        correlation=found.frame,
        correlation_one_exposure=None if one_exposure is None else found.projection * one_exposure,
        correlation_overlap=found.overlap,
        overlap_width=None if rays is None else rays.overlap_width,
        overlap_height=None if rays is None else rays.overlap_height,
        shift_um=math.hypot(*found.shift) * cell_um,
        expected_shift_um=None if rays is None else rays.shift_um,
        light=light,
        expected_light=None if rays is None else rays.light,
    )


@dataclass(frozen=True)
class Rays:
    """What the chief ray of an angle says, as `OffAxis` has it.

    Parameters
    ----------
    angle_deg
        Between the axis and the point source.
    shift_um, overlap_width, overlap_height, light
        How far it moves; the share of the frame that is left, to the side and upwards; the light.
    """

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
        The fields of `Rays` by name, one value for each angle.
    """
    height_um, width_um = (count * twin.cell_um for count in twin.cells)
    angles = (largest_deg * step / _CURVE_STEPS for step in range(_CURVE_STEPS + 1))
    sources = (PointSource((0.0, math.tan(math.radians(deg))), distance_um) for deg in angles)
    rays = [asdict(_by_rays(twin, source, height_um, width_um)) for source in sources]
    return {name: [each[name] for each in rays] for name in rays[0]}


def _by_rays(twin: Twin, source: PointSource, height_um: float, width_um: float) -> Rays:
    shift = math.hypot(*twin.shift_um(source))
    return Rays(
        angle_deg=source.angle_deg,
        shift_um=shift,
        overlap_width=max(0.0, 1 - shift / width_um),
        overlap_height=max(0.0, 1 - shift / height_um),
        light=float(twin.vignetting(torch.tensor(source.p, dtype=torch.float64))),
    )


def captured_off_axis(
    folder: Path, twin: Twin | None, tick: Tick
) -> tuple[list[OffAxis], float, list[str]]:
    """Compare the PSFs of a camera's folder that were captured at angles with the central one.

    Parameters
    ----------
    folder
        With its list of PSFs.
    twin
        The camera; None leaves out what follows from it.
    tick
        Called with the share that is done.

    Returns
    -------
    tuple
        One for each PSF, by angle, the central one first; the distance of the light in um; and
        sentences to show, one for each doubt.

    Raises
    ------
    DataError
        If there is no central PSF or none from the side, or they do not fit the camera.
    FileError
        If a file cannot be read.
    """
    central, others = _chosen(folder, read_psf_set(folder).psf)
    doubts = []
    first = read_psf(folder, central).mean(dim=0)
    if twin is not None and not math.isclose(central.cell.um, twin.cell_um, rel_tol=0.01):
        raise DataError(
            f"{central.file} has cells of {central.cell}, but a reconstruction with the camera "
            f"{twin.camera.name!r} has cells of {twin.cell_um:g} µm: give the camera that the PSFs "
            "are from (--camera)"
        )
    found = []
    for number, entry in enumerate(others):
        tick(number / len(others))
        pattern = first if entry is central else read_psf(folder, entry).mean(dim=0)
        clipped = clipped_cells(pattern)
        if clipped:
            doubts.append(
                f"{clipped} cells of {folder / entry.file}, many side by side, have its very "
                "largest value: it seems to be clipped. Take a shorter exposure"
            )
        found.append(compared(first, pattern, source_of(entry), central.cell.um, twin))
    return found, central.distance_um, doubts


def source_of(entry: PsfEntry) -> PointSource:
    """Light of a PSF: to the right of the axis, and above it, where rows count downwards."""
    right, up = (math.tan(angle.rad) for angle in entry.angle)
    return PointSource((-up, right), entry.distance_um)


def _chosen(folder: Path, entries: Sequence[PsfEntry]) -> tuple[PsfEntry, list[PsfEntry]]:
    """The central PSF, and all of its distance by angle; those of the distance with the most."""
    captured = [
        each for each in entries
        if each.kind == "captured" and (each.on_axis or each.frame == "sensor")
    ]  # fmt: skip
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
