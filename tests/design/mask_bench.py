"""What the tests of masks share."""

import torch
from torch import Tensor

from nolens.camera import LoadedCamera, preset
from nolens.design.masks import Layout, Limits, Tile, spread_over
from nolens.optics import Grid, MaskSurface, PointSource, Relief, monochromatic_psf, smoothed
from nolens.twin import Light, Twin

GREEN_NM = 535.0
LIMITS = Limits(height_um=12.0, slope=0.095, feature_um=8.0)


def small() -> Twin:
    """Without reflections, which tiles leave out."""
    return Twin.of(LoadedCamera.of(preset("small")), fresnel=False)


def waves(side: int, height_um: float, seed: int, deviation: float = 8.0) -> Tensor:
    """A random smooth surface that repeats itself, with this standard deviation."""
    noise = torch.randn((side, side), generator=torch.Generator().manual_seed(seed))
    surface = smoothed(noise, deviation)
    return surface * (height_um / surface.std())


def tile_of(twin: Twin, side: int) -> tuple[Layout, Tile]:
    layout = Layout(side, twin.sensor_pitch_um, 2)
    return layout, layout.tile(twin, Light(f"{GREEN_NM:g}nm"))


def by_the_twin(
    twin: Twin, heights_um: Tensor, grid_um: float, tangent: tuple[float, float]
) -> Tensor:
    """One period of the pattern, computed by the twin behind 5 × 5 of them."""
    side = len(heights_um)
    relief = Relief(spread_over(heights_um, (5 * side + 1, 5 * side + 1)), grid_um)
    source = PointSource(tangent)
    light = twin.illumination(source, GREEN_NM)
    p = torch.tensor(source.p, dtype=torch.float64)
    reach = float(light.after.displacement_um(p)) / max(source.p, 1e-12)
    size = max((tangent[0] ** 2 + tangent[1] ** 2) ** 0.5, 1e-12)
    middle = tuple(reach * source.p * part / size for part in tangent)
    grid = Grid(side + 1, side + 1, grid_um, (middle[0], middle[1]))
    pattern = monochromatic_psf(light, MaskSurface(relief), twin.media(GREEN_NM), grid)
    # The middle sample of the surface is that of the tile; the light falls slantingly.
    return pattern[:side, :side] / float((1 - p * p) ** 1.5)
