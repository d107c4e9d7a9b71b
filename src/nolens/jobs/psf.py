"""What a simulated camera shows of one point source."""

import math
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from nolens.camera import OpenCamera
from nolens.errors import DataError, OptionError
from nolens.files import write_png, write_tiff32
from nolens.jobs.raw import SimulatedCamera, write_raw
from nolens.jobs.run import BYTES_OF_PROGRAM, Product, Run, Writer, check_memory, job
from nolens.jobs.scene_options import PsfOptions
from nolens.optics import PointSource
from nolens.quantities import Share
from nolens.twin import Twin, mosaic, photocurrents, point_spread
from nolens.twin.expose import expose_safely
from nolens.twin.point import Frame, colour_pattern_bytes, colours_of, shortest_nm
from nolens.twin.preview import distance_um, relief_points, simulation_bytes

_FILL = Share("90", "%")
_REMEDY = "fewer --cells, a camera with fewer pixels or a coarser grid of its relief needs less"
_SIZE_UM = 50.0
"""The paper's light: a pinhole of 50 um."""
_LUX = 1.0
"""Illuminance at the camera by a source straight ahead, to which exposure times are stated."""


@dataclass(frozen=True)
class _Shape:
    """What is computed: cells of so many pixels, in one of the frames."""

    cells: tuple[int, int]
    pixels: int
    frame: Frame


@job
def simulate_psf(run: Run[PsfOptions]) -> Product[Tensor]:
    """Irradiance without noise, (channels, rows, columns), by a camera of a point source.

    Each channel is as bright as the sensor sees it beside the brightest one.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, reporter, device = run.options, run.reporter, run.device
    simulated = SimulatedCamera.of(run)
    opened, light, bare = simulated.opened, simulated.light, simulated.preview
    sensor = opened.camera.sensor
    captured = options.output.suffix.lower() == ".dng"
    shape = _shape(options, opened, captured)
    source = _source(options, opened)
    bare.check_source(source)
    colours = colours_of(bare, light, options.wavelengths)
    pattern_bytes = colour_pattern_bytes(
        bare,
        source,
        _with_edge(bare, source, shape),
        shape.pixels,
        at_least=2,
        shortest=shortest_nm(colours),
    )
    held = 8 * math.prod(shape.cells) * len(sensor.channels)
    needed = BYTES_OF_PROGRAM + simulation_bytes(relief_points(opened), pattern_bytes + held)
    check_memory(needed, device, _REMEDY)
    run.begin(needed)

    reporter.advance("mask", 0.0)
    twin = Twin.of(opened, device=device, fresnel=options.fresnel)
    pattern = point_spread(
        twin,
        source,
        shape.cells,
        pixels=shape.pixels,
        light=light,
        wavelengths=options.wavelengths,
        frame=shape.frame,
        tick=partial(reporter.advance, "point source"),
    ).cpu()
    # As a captured one has it, so that a scene in this light comes out in its own colours.
    seen = photocurrents(twin, light, 1.0)
    pattern *= (seen / seen.max())[:, None, None]
    if not float(pattern.max()) > 0:
        raise DataError(
            f"no light from {source.angle_deg:.4g} deg off the axis reaches these pixels: they do "
            "not accept it, or it falls beside them. Choose a smaller angle or more --cells"
        )
    shift = twin.shift_um(source)
    figures = {
        "camera": opened.camera.name,
        "angle_deg": round(source.angle_deg, 3),
        "shift_um": [round(shift[1], 3), round(0.0 - shift[0], 3)],
        "cells": list(shape.cells),
        "pixels_per_cell": shape.pixels,
        "frame": shape.frame,
        "mean": float(pattern.mean()),
        "peak_over_mean": float(pattern.max() / pattern.mean()),
    }
    if captured:
        image = mosaic(pattern, sensor.mosaic)
        fill = (options.fill or _FILL).value
        scale = fill * sensor.clip_electrons / float(image.max())
        electrons = image * scale
        exposure_s = scale / (_LUX * float(seen.max()))
        figures["exposure_s"] = exposure_s
        counts = expose_safely(electrons, sensor, seed=options.seed)
        figures["saturated_share"] = float((counts >= sensor.saturated_counts).double().mean())
        write: Writer = partial(write_raw, counts=counts, sensor=sensor, exposure_s=exposure_s)
    elif options.output.suffix.lower() == ".png":
        reporter.note(
            f"{options.output} is for looking at: reconstruct with the .tif or .dng of this PSF"
        )
        write = partial(write_png, radiance=pattern)
    else:
        write = partial(write_tiff32, radiance=pattern)
    return Product(pattern, figures, {options.output: write}, simulated.parameters)


def _source(options: PsfOptions, opened: OpenCamera) -> PointSource:
    depth = distance_um(options.distance, opened)
    size = 0.0 if math.isinf(depth) else _SIZE_UM
    if options.size is not None:
        size = options.size.um
    if size > 0 and math.isinf(depth):
        raise OptionError(
            f"--size {options.size} at infinity: a light there has no diameter. Leave --size out, "
            "or give a --distance"
        )
    right, up = (math.tan(angle.rad) for angle in options.angle)
    return PointSource((-up, right), depth, size)


def _with_edge(twin: Twin, source: PointSource, shape: _Shape) -> tuple[int, int]:
    """Cells with what is computed around them, as wide as the image of the light."""
    image = source.diameter_um * float(twin.stack().spread_um(torch.tensor(source.p)))
    edge = math.ceil(image / source.distance_um / (shape.pixels * twin.sensor_pitch_um))
    return shape.cells[0] + 2 * edge, shape.cells[1] + 2 * edge


def _shape(options: PsfOptions, opened: OpenCamera, captured: bool) -> _Shape:
    sensor = opened.camera.sensor
    if captured:
        if options.bin not in (None, 1):
            raise OptionError(
                f"--bin {options.bin}: {options.output.name} is a DNG, which holds every pixel; "
                f"leave --bin out, or write {options.output.with_suffix('.tif').name}"
            )
        cells = options.cells or (sensor.rows, sensor.columns)
        if cells[0] % 2 or cells[1] % 2:
            raise OptionError(
                f"--cells {cells[0]}x{cells[1]} do not make whole 2×2 cells of the mosaic "
                f"{sensor.mosaic}: for a DNG, give even numbers of pixels"
            )
        return _Shape(cells, 1, options.frame or "sensor")
    for name, given in (("--fill", options.fill), ("--seed", options.seed or None)):
        if given is not None:
            raise OptionError(
                f"{name} {given}: {options.output.name} holds the pattern without exposure and "
                f"noise; leave {name} out, or write "
                f"{options.output.with_suffix('.dng').name}"
            )
    pixels = options.bin or (1 if sensor.mosaic == "none" else 2)
    cells = options.cells or (sensor.rows // pixels, sensor.columns // pixels)
    if 0 in cells:
        raise OptionError(
            f"--bin {pixels} is more than the sensor's {sensor.rows}×{sensor.columns} pixels: "
            "give a smaller one"
        )
    return _Shape(cells, pixels, options.frame or "chief-ray")
