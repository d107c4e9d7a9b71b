"""A grid of dots that is shown to a simulated camera."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from nolens.jobs.measuring.field_found import DotGrid, found_grid, grid_tangents
from nolens.jobs.measuring.field_rays import Places, Rays
from nolens.jobs.optical_bench import OpticalBench, solved
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.twin import LARGEST_ANGLE_DEG, FieldMap, Seen, Twin

Tick = Callable[[float], None]


def dot_grid(
    bench: OpticalBench,
    *,
    pitch_um: float,
    distance_um: float,
    reach_deg: float = LARGEST_ANGLE_DEG,
    iterations: int = 300,
    fill: float = 0.9,
    seed: int = 0,
    tick: Tick | None = None,
) -> DotGrid:
    """Show a camera a grid of dots, reconstruct what it measures, and find them in the picture.

    The PSF of the reconstruction is the central one, known as far as light from the grid passes;
    light can come from the grid's region alone. Each dot is smaller than a cell.

    Parameters
    ----------
    bench
        The camera; between its field points PSFs are blended.
    pitch_um, distance_um
        Of the grid.
    reach_deg
        Half angle up to which there are dots.
    iterations
        Of the reconstruction.
    fill, seed
        See `OpticalBench.photograph`.
    tick
        Called with the share that is done.

    Raises
    ------
    OptionError
        If there are too few dots up to that angle, or the angle is beyond the model.
    DataError
        If the picture shows no such grid.
    """
    twin = bench.twin
    at = grid_tangents(pitch_um, distance_um, reach_deg)
    twin.check_source(PointSource((0.0, math.tan(math.radians(reach_deg))), distance_um))
    field = _map_of(twin, reach_deg, pitch_um / distance_um)
    scene = _radiance(field, at)

    def first(share: float) -> None:
        if tick is not None:
            tick(0.6 * share)

    def second(share: float) -> None:
        if tick is not None:
            tick(0.6 + 0.4 * share)

    channels = len(bench.sensor.channels)
    seen = Seen(scene.expand(channels, -1, -1).contiguous(), distance_um)
    shot = bench.seen(field, (seen,), fill=fill, seed=seed, tick=first)
    rows, columns = twin.cells
    wide = rows + field.region.height, columns + field.region.width
    psf = bench.psf(PointSource((0.0, 0.0), distance_um), wide)
    picture = solved(shot.frame, psf, field.region, iterations=iterations, tick=second)
    return found_grid(
        picture.cpu().mean(dim=0), twin, pitch_um=pitch_um, distance_um=distance_um,
        reach_deg=reach_deg,
    )  # fmt: skip


def _map_of(twin: Twin, reach_deg: float, step: float) -> FieldMap:
    """Square of cells up to an angle along its sides, and half a pitch more."""
    limit = math.tan(math.radians(reach_deg))
    reach = twin.shift_um(PointSource((0.0, limit)))[1] + step / 2 * twin.stack().reduced_um
    side = 2 * math.ceil(reach / twin.cell_um + 1)
    return FieldMap(twin, Region.centred(side, side, twin.cells))


def _radiance(field: FieldMap, at: Places) -> Tensor:
    """Dots of one size on the cells, each shared by the four that it lies between."""
    region = field.region
    scene = torch.zeros(region.height, region.width, dtype=torch.float64)
    weight = field.solid_angle()
    rays = Rays.of(field.twin, (region.height, region.width))
    for tangent, place in zip(at, rays.cells(at), strict=True):
        row, column = (math.floor(each) for each in place)
        down, right = place[0] - row, place[1] - column
        power = math.cos(math.radians(PointSource(tangent).angle_deg))
        for i, share in ((0, 1 - down), (1, down)):
            for j, part in ((0, 1 - right), (1, right)):
                scene[row + i, column + j] += power * share * part
    scene = scene / weight
    return (scene / scene.max()).float()
