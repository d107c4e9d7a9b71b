"""The camera with a mask of the kind that is asked for."""

import math
from dataclasses import dataclass, replace

import torch

from nolens.camera import OpenCamera, RandomLenslets, ReliefFile
from nolens.design.masks import (
    Layout,
    contour_relief,
    default_period_um,
    focusing_radius_um,
    gaussian_diffuser,
    lenslet_array,
    lenslet_start,
    line_target,
    optimised_relief,
    random_contours,
    smoothing_margin,
    spread_over,
)
from nolens.errors import OptionError
from nolens.jobs.cost import announce, check_memory, surface_cost
from nolens.jobs.designing.mask_options import RELIEF_FILE, MaskOptions
from nolens.jobs.reporter import Reporter
from nolens.quantities import Length
from nolens.twin import REFERENCE_NM, Light, Twin
from nolens.twin.preview import preview_model

_OVERHANG = Length("1.5", "mm")
_PER_PIXEL = (1, 2, 4)
_CPU = torch.device("cpu")
_BYTES_PER_SAMPLE = 150
_BYTES_OF_PROGRAM = 8e8


@dataclass(frozen=True)
class MadeMask:
    """A camera with a new mask.

    Parameters
    ----------
    opened
        The camera.
    layout
        Samples of the tile that a designed mask repeats.
    target
        On a contour mask the PSF that was wanted, on the cells of the tile.
    stopped
        Whether a person ended the descent early.
    """

    opened: OpenCamera
    layout: Layout | None = None
    target: torch.Tensor | None = None
    stopped: bool = False


def made_mask(
    options: MaskOptions,
    opened: OpenCamera,
    light: Light,
    device: torch.device,
    reporter: Reporter,
) -> MadeMask:
    """Make the mask that is asked for.

    Parameters
    ----------
    options
        Which mask.
    opened
        The camera it is for.
    light
        That a designed mask is to be good in.
    device
        Where to compute.
    reporter
        Sees how far the work is.

    Raises
    ------
    OptionError
        If there is no such mask, or it is too steep for any grid.
    """
    bare = preview_model(opened)
    radius_um = focusing_radius_um(bare) if options.radius is None else options.radius.um
    if options.kind in ("contour", "optimised"):
        return _designed(options, opened, bare, light, device, reporter, radius_um)
    pitch = opened.camera.sensor.pitch
    for per_pixel in _PER_PIXEL:
        grid = pitch if per_pixel == 1 else Length.of(pitch.um / per_pixel, "um")
        made = _described(options, opened, bare, radius_um, grid)
        try:
            preview_model(made)
            break
        except OptionError as error:
            if per_pixel == _PER_PIXEL[-1]:
                raise OptionError(
                    f"{error}, and {grid} is the finest that is tried: give a larger --radius, or "
                    "a smaller --pitch or --angle"
                ) from None
    return MadeMask(made)


def _described(
    options: MaskOptions, opened: OpenCamera, bare: Twin, radius_um: float, grid: Length
) -> OpenCamera:
    """A camera with lenslets or a diffuser."""
    named = _named(options, opened)
    if options.kind == "random-lenslets":
        assert options.pitch is not None and options.smoothing is not None
        relief = RandomLenslets(
            kind="random-lenslets",
            radius=options.radius or Length.of(round(radius_um, 2), "um"),
            pitch=options.pitch,
            smoothing=options.smoothing,
            seed=options.seed,
            grid=grid,
            overhang=_overhang(options, opened),
        )
        return with_relief(named, relief)
    size = _size(options, opened, grid.um)
    beyond = 0 if options.smoothing is None else smoothing_margin(options.smoothing.um, grid.um)
    cost = surface_cost(math.prod(count + 2 * beyond for count in size))
    check_memory(cost, _CPU, "a smaller --smoothing or --overhang needs less")
    media = bare.media(REFERENCE_NM)
    if options.kind == "lenslet-array":
        assert options.pitch is not None and options.smoothing is not None
        assert options.arrangement is not None
        surface = lenslet_array(
            radius_um=math.copysign(radius_um, media.below - media.above),
            pitch_um=options.pitch.um,
            arrangement=options.arrangement,
            smoothing_um=options.smoothing.um,
            size=size,
            grid_um=grid.um,
        )
    else:
        assert options.angle is not None and options.feature is not None
        surface = gaussian_diffuser(
            angle_rad=options.angle.rad,
            feature_um=options.feature.um,
            index_step=media.below - media.above,
            size=size,
            grid_um=grid.um,
            seed=options.seed,
        )
    return _with_heights(named, surface.height_um, grid)


def _designed(
    options: MaskOptions,
    opened: OpenCamera,
    bare: Twin,
    light: Light,
    device: torch.device,
    reporter: Reporter,
    radius_um: float,
) -> MadeMask:
    """A camera whose mask repeats a tile that is designed for its PSF."""
    limits, iterations = options.limits, options.iterations
    assert iterations is not None
    period_um = default_period_um(bare) if options.period is None else options.period.um
    layout = Layout.fit(bare, limits, period_um)
    full = math.prod(_size(options, opened, layout.grid_um))
    needed = _BYTES_OF_PROGRAM + _BYTES_PER_SAMPLE * layout.side**2 + 12 * full
    check_memory(needed, device, "a smaller --period or --overhang needs less")
    announce(needed, reporter)
    tile = layout.tile(bare, light, device)
    stopped = False

    def stop(done: int) -> bool:
        nonlocal stopped
        stopped = reporter.step("step", done, iterations, "the mask")
        return stopped

    target = None
    if options.kind == "contour":
        assert options.line is not None and options.spacing is not None
        lines = random_contours(layout.side, layout.grid_um, options.spacing.um, options.seed)
        target = line_target(lines, options.line.um, layout.samples_per_cell)
        heights = contour_relief(
            tile,
            lines.to(device),
            target,
            limits,
            radius_um=radius_um,
            iterations=iterations,
            stop=stop,
        )
    else:
        pitch_um = 2 * limits.slope * radius_um if options.pitch is None else options.pitch.um
        start = lenslet_start(tile, radius_um, pitch_um, options.seed).to(device)
        heights = optimised_relief(
            tile, options.goals, limits, start, iterations=iterations, stop=stop
        )
    grid = Length.of(layout.grid_um, "um")
    relief = spread_over(heights.cpu(), _size(options, opened, layout.grid_um))
    return MadeMask(_with_heights(_named(options, opened), relief, grid), layout, target, stopped)


def _overhang(options: MaskOptions, opened: OpenCamera) -> Length:
    relief = opened.camera.mask.relief
    own = relief.overhang if isinstance(relief, RandomLenslets) else _OVERHANG
    return options.overhang or own


def _size(options: MaskOptions, opened: OpenCamera, grid_um: float) -> tuple[int, int]:
    """Samples of a relief over sensor and overhang; even, so that cells lie as on the sensor."""
    sensor, beyond = opened.camera.sensor, 2 * _overhang(options, opened).um
    rows, columns = (
        2 * math.ceil((count * sensor.pitch.um + beyond) / grid_um / 2)
        for count in (sensor.rows, sensor.columns)
    )
    return rows, columns


def _named(options: MaskOptions, opened: OpenCamera) -> OpenCamera:
    name = f"{opened.camera.name}, {options.kind} mask"
    return replace(opened, camera=opened.camera.model_copy(update={"name": name}))


def with_relief(opened: OpenCamera, relief: RandomLenslets | ReliefFile) -> OpenCamera:
    """The camera with another relief, not yet read."""
    mask = opened.camera.mask.model_copy(update={"relief": relief})
    camera = opened.camera.model_copy(update={"mask": mask})
    return replace(opened, camera=camera, relief_um=None)


def _with_heights(opened: OpenCamera, heights_um: torch.Tensor, grid: Length) -> OpenCamera:
    relief = ReliefFile(kind="file", file=RELIEF_FILE, grid=grid)
    return replace(with_relief(opened, relief), relief_um=heights_um)
