"""From pictures of a scene to what a simulated camera measures of them."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from nolens.camera import OpenCamera, Sensor
from nolens.errors import DataError
from nolens.files import read_picture, write_tiff32
from nolens.jobs.raw import SimulatedCamera, write_raw
from nolens.jobs.run import BYTES_OF_PROGRAM, Product, Run, Writer, check_memory, job
from nolens.jobs.scene_options import SimulateOptions
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.quantities import Share
from nolens.twin import (
    Irradiated,
    Plane,
    Twin,
    arrange,
    check_field_points,
    irradiate,
    irradiate_bytes,
    mosaic,
    photocurrents,
)
from nolens.twin.expose import expose_safely
from nolens.twin.point import colours_of
from nolens.twin.preview import distance_um, relief_points, simulation_bytes
from nolens.twin.scene import in_channels

_FILL = Share("90", "%")
_REMEDY = (
    "a camera with fewer or larger pixels, a coarser grid of its relief or a smaller --angle needs "
    "less"
)
_VISIBLE = 0.3
"""Share of the noise from which on the error of the field points is worth a warning."""


@job
def simulate(run: Run[SimulateOptions]) -> Product[Tensor]:
    """Radiance of the scene on the pixels of the reconstruction, (channels, height, width).

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, reporter, device = run.options, run.reporter, run.device
    simulated = SimulatedCamera.of(run)
    opened, light, bare = simulated.opened, simulated.light, simulated.preview
    sensor = opened.camera.sensor
    check_field_points(options.field_points)
    planes = _planes(options, opened)
    colours = colours_of(bare, light, options.wavelengths)
    working = irradiate_bytes(bare, planes, options.field_points, colours)
    needed = BYTES_OF_PROGRAM + simulation_bytes(relief_points(opened), working)
    check_memory(needed, device, _REMEDY)
    field, seen = arrange(bare, planes)
    truth = torch.stack([plane.radiance for plane in seen]).sum(dim=0)
    if options.exposure is None:
        _brightest(truth)
    run.begin(needed)

    reporter.advance("mask", 0.0)
    twin = Twin.of(opened, device=device, fresnel=options.fresnel)
    irradiated = irradiate(
        twin,
        replace(field, twin=twin),
        seen,
        field_points=options.field_points,
        light=light,
        wavelengths=options.wavelengths,
        tick=partial(reporter.advance, "scene"),
    )
    currents = photocurrents(twin, light, options.luminance.cd_m2)[:, None, None]
    rate = irradiated.light * mosaic(currents.expand(-1, *irradiated.light.shape), sensor.mosaic)
    if options.exposure is not None:
        exposure_s = options.exposure.s
    else:
        exposure_s = (options.fill or _FILL).value * sensor.clip_electrons / _brightest(rate)
    electrons = rate * exposure_s
    counts = expose_safely(electrons, sensor, seed=options.seed)
    error = _field_error(irradiated, rate, exposure_s, sensor)
    run.warn(*_warnings(error, options.field_points))

    response = field.solid_angle() * field.vignetting()
    largest_angle = max(PointSource(plane.tangents).angle_deg for plane in planes)
    figures = {
        "camera": opened.camera.name,
        "region": _region(field.region, twin.cells),
        "cells": list(twin.cells),
        "psf_cells": _psf_cells(field.region, twin),
        "exposure_s": exposure_s,
        "brightest_electrons": float(electrons.max()),
        "saturated_share": float((counts >= sensor.saturated_counts).double().mean()),
        "field_points": options.field_points,
        "field_error": error,
        "largest_angle_deg": round(largest_angle, 3),
    }
    writers: dict[Path, Writer] = {
        options.output: partial(write_raw, counts=counts, sensor=sensor, exposure_s=exposure_s)
    }
    if options.truth is not None:
        writers[options.truth] = partial(write_tiff32, radiance=truth)
    if options.response is not None:
        share = (response / response.max()).float()[None]
        writers[options.response] = partial(write_tiff32, radiance=share)
    return Product(truth, figures, writers, simulated.parameters)


def _psf_cells(region: Region, twin: Twin) -> str:
    """Cells of a PSF that a reconstruction needs, as `nolens psf --cells` takes them.

    Without an aperture light from the side passes mask that the sensor's own PSF does not show.
    """
    rows, columns = twin.cells
    if twin.mask.opening is None:
        rows, columns = rows + region.height, columns + region.width
    return f"{rows}x{columns}"


def _planes(options: SimulateOptions, opened: OpenCamera) -> tuple[Plane, ...]:
    """The pictures, in the sensor's channels, where they stand."""
    count = len(options.scenes)
    distances = [distance_um(each, opened) for each in options.distance or (None,)]
    angles = [angle.deg for angle in options.angle]
    planes = []
    for number, path in enumerate(options.scenes):
        picture = read_picture(path)
        radiance = in_channels(picture.radiance, len(opened.camera.sensor.channels))
        planes.append(
            Plane(
                radiance,
                angles[number if len(angles) == count else 0],
                distances[number if len(distances) == count else 0],
                picture.opacity,
            )
        )
    return tuple(planes)


def _brightest(light: Tensor) -> float:
    """What the exposure goes by."""
    brightest = float(light.max())
    if not brightest > 0:
        raise DataError(
            "no light reaches the sensor: the scene is black, or all of it is hidden. Give a "
            "brighter scene, or say how long to expose (--exposure 40ms)"
        )
    return brightest


def _field_error(
    irradiated: Irradiated, rate: Tensor, exposure_s: float, sensor: Sensor
) -> dict[str, float] | None:
    """Error of the field points beside the picture's contrast and the noise; None if unknown."""
    if irradiated.field_error is None:
        return None
    deviation = float(irradiated.light.double().std())
    electrons = rate.double() * exposure_s
    noise = math.sqrt(float(electrons.mean()) + sensor.read_noise_electrons**2)
    per_light = float(electrons.square().mean().sqrt()) / max(
        float(irradiated.light.double().square().mean().sqrt()), 1e-300
    )
    return {
        "of_contrast": irradiated.field_error / max(deviation, 1e-300),
        "of_noise": irradiated.field_error * per_light / max(noise, 1e-300),
    }


def _warnings(error: dict[str, float] | None, field_points: int) -> list[str]:
    if error is None or error["of_noise"] <= _VISIBLE:
        return []
    # Bilinear interpolation errs with the square of the distance of its points.
    steps = (field_points - 1) * math.sqrt(error["of_noise"] / _VISIBLE)
    better = 2 * math.ceil(steps / 2) + 1
    return [
        f"between the {field_points}×{field_points} field points the simulation is off by "
        f"{error['of_noise']:.2g} of the noise: try --field-points {better}"
    ]


def _region(region: Region, cells: tuple[int, int]) -> str:
    """As `nolens reconstruct --support` takes it."""
    text = f"{region.height}x{region.width}"
    if region == Region.centred(region.height, region.width, cells):
        return text
    return f"{text}{region.top:+d}{region.left:+d}"
