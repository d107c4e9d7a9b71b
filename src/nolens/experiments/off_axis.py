"""How PSFs change with the field angle."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from nolens.camera import develop
from nolens.errors import DataError
from nolens.evaluate import PeakCorrelation, peak_correlation
from nolens.experiments.virtual_experiment import Tick, VirtualExperiment
from nolens.optics import PointSource
from nolens.twin import Twin

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
    bench: VirtualExperiment,
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
        Fraction of a full pixel that the brightest one is exposed to.
    seed
        Of the noise; every frame has its own.
    tick
        Called with the fraction that is done.

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
        compared(central, pattern, source, twin.pixel_um, twin, top / brightest, light / power)
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
        (rows, columns), on the pixels of the sensor; None for the second one where no light of it
        reaches the sensor.
    source
        Of the second one.
    cell_um
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
        How far it moves; the fraction of the frame that is left, to the side and upwards; the
        light.
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
    height_um, width_um = (count * twin.pixel_um for count in twin.shape)
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
