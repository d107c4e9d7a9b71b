"""The point spread function of a camera, in the colours of its sensor."""

import math
from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.kernels import fast_length, irfft2_window_, rfft2_window
from nolens.optics import (
    Grid,
    Margin,
    MaskSurface,
    PointSource,
    Relief,
    divergence,
    monochromatic_psf,
    monochromatic_psf_bytes,
)
from nolens.progress import ProgressCallback, part_of
from nolens.twin.light import Colour, Light
from nolens.twin.model import REFERENCE_NM, Twin

Frame = Literal["chief-ray", "sensor"]


def point_spread(
    twin: Twin,
    source: PointSource,
    shape: tuple[int, int],
    *,
    superpixel: int = 1,
    light: Light,
    wavelengths: int = 3,
    frame: Frame = "chief-ray",
    mosaic: str | None = None,
    progress: ProgressCallback | None = None,
) -> Tensor:
    """Irradiance of one point source, integrated over superpixels, channel by channel.

    Parameters
    ----------
    twin
        The camera.
    source
        Where the light comes from.
    shape
        (rows, columns) of the result; may be more or fewer than the sensor has.
    superpixel
        Sensor pixels along a superpixel.
    light
        Spectrum of the source.
    wavelengths
        How many stand for a channel.
    frame
        ``"chief-ray"``: the middle of the result follows the ray through the camera's middle;
        ``"sensor"``: it stays on the sensor's.
    mosaic
        Colours of a superpixel of 2×2, row by row: each channel is integrated over its own pixels,
        as a developed frame has it; None integrates over all.
    progress
        Called with the fraction that is done, 0 to 1.

    Returns
    -------
    Tensor
        float32, (channels, rows, columns), on the device of the twin's mask; 1 is what a flat
        mask gives straight ahead of a far source (see `monochromatic_psf`).

    Raises
    ------
    OptionError
        If the source is beyond the model, or the light passes beyond the relief.
    """
    twin.check_source(source)
    _check_size(source)
    per_pixel = samples_per_pixel(twin, at_least=2, distance_um=source.distance_um)
    edge = math.ceil(_image_um(twin, source) / (superpixel * twin.sensor_pitch_um))
    grid = Grid(
        shape[0] + 2 * edge,
        shape[1] + 2 * edge,
        twin.sensor_pitch_um * superpixel,
        twin.shift_um(source) if frame == "chief-ray" else (0.0, 0.0),
    )
    twin.check_extent(source, grid)
    colours = light.colours(twin.quantum_efficiency, twin.camera.sensor.channels, wavelengths)
    prepared = sampled(
        twin,
        twin.sensor_pitch_um / per_pixel,
        shortest_nm=shortest_nm(colours),
        distance_um=source.distance_um,
    )
    disc = _disc(twin, source, grid) if source.diameter_um > 0 else None
    planes = []
    for number, colour in enumerate(colours):
        plane = polychromatic_psf(
            prepared,
            source,
            grid.finer(per_pixel * superpixel),
            colour,
            part_of(progress, number, len(colours)),
            average=per_pixel * (superpixel if mosaic is None else 1),
        )
        if mosaic is not None:
            own = (divmod(at, 2) for at, each in enumerate(mosaic) if "RGB".index(each) == number)
            plane = torch.stack([plane[row::2, column::2] for row, column in own]).mean(dim=0)
        planes.append(plane if disc is None else _blurred(plane, disc, edge))
    return torch.stack(planes)


def polychromatic_psf(
    twin: Twin,
    source: PointSource,
    grid: Grid,
    wavelengths: Colour,
    progress: ProgressCallback | None = None,
    *,
    average: int = 1,
) -> Tensor:
    """Weighted sum of the PSFs at some wavelengths, over blocks of `average`² samples of a grid.

    The camera has its relief on a multiple of the grid's pitch (`sampled`).
    """
    total: Tensor | None = None
    for number, (wavelength_nm, weight) in enumerate(wavelengths):
        psf = monochromatic_psf(
            twin.illumination(source, wavelength_nm),
            twin.mask,
            twin.media(wavelength_nm),
            grid,
            response=twin.response(),
            progress=part_of(progress, number, len(wavelengths)),
            average=average,
        )
        total = psf.mul_(weight) if total is None else total.add_(psf, alpha=weight)
    assert total is not None
    return total


def polychromatic_psf_bytes(
    twin: Twin,
    source: PointSource,
    shape: tuple[int, int],
    superpixel: int,
    *,
    at_least: int,
    shortest: float,
) -> float:
    """Most memory that `polychromatic_psf` holds at once.

    Parameters
    ----------
    twin, source
        The camera, as `preview_model` gives it, and the point source.
    shape, superpixel
        (rows, columns) of the result, and sensor pixels along one of its pixels.
    at_least
        Samples along a sensor pixel.
    shortest
        Shortest wavelength, in nm.
    """
    per_pixel = samples_per_pixel(twin, at_least=at_least, distance_um=source.distance_um)
    grid = Grid(*shape, twin.sensor_pitch_um * superpixel).finer(per_pixel * superpixel)
    step = field_step(twin, grid.pitch_um, shortest_nm=shortest, distance_um=source.distance_um)
    light = twin.illumination(source, REFERENCE_NM)
    return monochromatic_psf_bytes(light, twin.mask, twin.media(REFERENCE_NM), grid, step)


def shortest_nm(colours: list[Colour]) -> float:
    """The shortest of all channels' wavelengths."""
    return min(wavelength_nm for colour in colours for wavelength_nm, _ in colour)


def samples_per_pixel(twin: Twin, *, at_least: int, distance_um: float = math.inf) -> int:
    """Samples along a pixel, so that the light of a source behind the relief is carried."""
    limit = twin.coarsest_pitch_um(divergence=_divergence(twin, twin.sensor_pitch_um, distance_um))
    return max(at_least, math.ceil(twin.sensor_pitch_um / limit))


def field_step(twin: Twin, pitch_um: float, *, shortest_nm: float, distance_um: float) -> int:
    """Samples of the intensity, 1, 2 or 4, for one of the field behind the relief."""
    limit = twin.coarsest_pitch_um(shortest_nm, _divergence(twin, pitch_um, distance_um))
    if twin.mask.opening is not None:
        limit = min(limit, twin.mask.relief.grid_um)
    return max(m for m in (1, 2, 4) if m == 1 or m * pitch_um <= limit * (1 + 1e-9))


def _divergence(twin: Twin, pitch_um: float, distance_um: float) -> float:
    """How far light spreads, in p, from the middle of a window to the end of its margin."""
    after = twin.illumination(PointSource(), REFERENCE_NM).after
    coupling = float(twin.media(REFERENCE_NM).coupling(torch.zeros((), dtype=torch.float64)).abs())
    turned = coupling * twin.mask.relief.steepest
    margin = Margin.needed(turned, after.reduced_um, REFERENCE_NM * 1e-3)
    return divergence(pitch_um, distance_um) + margin.total_um / distance_um


def sampled(twin: Twin, pitch_um: float, *, shortest_nm: float, distance_um: float) -> Twin:
    """The same camera with its relief on a grid of `field_step` times `pitch_um`.

    The field behind the relief is sampled there, its intensity on the sensor at `pitch_um`: the
    coarsest grid that carries the field takes the least time. Openings keep the relief's own
    grid or a finer one, for their edges.
    """
    relief, opening = twin.mask.relief, twin.mask.opening
    grid_um = pitch_um * field_step(
        twin, pitch_um, shortest_nm=shortest_nm, distance_um=distance_um
    )
    if math.isclose(relief.grid_um, grid_um, rel_tol=1e-9):
        return twin
    rows, columns = (max(2, math.floor(extent / grid_um) + 1) for extent in relief.extent_um)
    heights = relief.sample(Grid(rows, columns, grid_um))
    return replace(twin, mask=MaskSurface(Relief(heights, grid_um), opening))


def _check_size(source: PointSource) -> None:
    if source.diameter_um < 0:
        raise OptionError(
            f"a source of {source.diameter_um:g} µm: its diameter must be 0 µm (a point) or more"
        )
    if source.diameter_um > 0 and math.isinf(source.distance_um):
        raise OptionError("a source at infinity has no diameter: give a distance, or size 0 µm")


def _scales(twin: Twin, source: PointSource) -> tuple[float, float]:
    """Size of the source's image over its own: along the direction of the angle, and across.

    For a fixed place on the mask the light moves by ds/dt · dx / z, with s the displacement in
    the layers behind it and t the tangent of the angle.
    """
    after = twin.illumination(source, REFERENCE_NM).after
    p = torch.tensor(twin.p_of(source), dtype=torch.float64)
    outside = twin.camera.outside
    # dp/dt = n cos³θ, with t the tangent of the angle.
    radial = float(after.spread_um(p) * (1 - (p / outside) ** 2).pow(1.5)) * outside
    across = after.reduced_um * outside
    if source.p > 0:
        across = float(after.displacement_um(p)) / math.hypot(*source.tangent)
    return radial / source.distance_um, across / source.distance_um


def _image_um(twin: Twin, source: PointSource) -> float:
    return source.diameter_um * max(_scales(twin, source)) if source.diameter_um > 0 else 0.0


def _disc(twin: Twin, source: PointSource, grid: Grid) -> Tensor:
    r"""Spectrum :math:`2J_1(πaf)/(πaf)` of the image of a disc, on a grid or a larger one."""
    radial, across = _scales(twin, source)
    size = math.hypot(*source.tangent)
    unit = (source.tangent[0] / size, source.tangent[1] / size) if size > 0 else (1.0, 0.0)
    counts = fast_length(grid.rows, of_rows=False), fast_length(grid.columns, of_rows=True)
    rows = torch.fft.fftfreq(counts[0], grid.pitch_um, dtype=torch.float64)[:, None]
    columns = torch.fft.rfftfreq(counts[1], grid.pitch_um, dtype=torch.float64)
    along = (rows * unit[0] + columns * unit[1]) * radial
    beside = (columns * unit[0] - rows * unit[1]) * across
    argument = (math.pi * source.diameter_um) * torch.hypot(along, beside)
    disc = torch.where(
        argument > 1e-6, 2 * torch.special.bessel_j1(argument) / argument.clamp_min(1e-6), 1.0
    )
    return disc.float()


def _blurred(plane: Tensor, disc: Tensor, edge: int) -> Tensor:
    """A PSF convolved with a disc of that spectrum, without an edge of so many pixels."""
    rows, columns = plane.shape
    padded = disc.shape[0], 2 * (disc.shape[1] - 1)
    spectrum = rfft2_window(plane, (0, 0), padded).mul_(disc.to(plane.device))
    window = edge, edge, rows - 2 * edge, columns - 2 * edge
    return irfft2_window_(spectrum, window, padded).clamp_min(0)


def colours_of(twin: Twin, light: Light, wavelengths: int) -> list[Colour]:
    """Wavelengths and weights of all channels, of a light that the sensor sees.

    Raises
    ------
    OptionError
        If a channel sees nothing of a spectrum, none sees a single wavelength, or the index of a
        layer is not known there.
    """
    efficiency, channels = twin.quantum_efficiency, twin.camera.sensor.channels
    if not any(light.electrons(efficiency, channel, 1.0) > 0 for channel in channels):
        first, last = efficiency.wavelength_nm[0], efficiency.wavelength_nm[-1]
        raise OptionError(
            f"the sensor sees nothing of the light {light.name}: its quantum efficiency is given "
            f"from {first:g} to {last:g} nm, and zero elsewhere; choose another --light"
        )
    colours = light.colours(efficiency, channels, wavelengths)
    for colour in colours:
        for wavelength_nm, _ in colour:
            twin.media(wavelength_nm)
    return colours
