"""`nolens reconstruct --depths`: planes of a scene that are solved together."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from nolens.camera import (
    Camera,
    Frame,
    Measurement,
    PsfEntry,
    arrange_rgb,
    black_level,
    develop,
    exposure_white,
    flipped,
)
from nolens.camera.psf_set import Depth, depth_um
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE, read_psf_set
from nolens.files.stacks import volume_writers
from nolens.jobs.reconstruction.options import ReconstructOptions, parse_support
from nolens.jobs.reconstruction.setup import stated_options
from nolens.jobs.reconstruction.stack import fewer_slices, solve_stack
from nolens.jobs.refocusing import field_warnings, read_depth_psfs
from nolens.jobs.run import Product, Run
from nolens.machine import BYTES_OF_PROGRAM, check_memory, mapped_note
from nolens.operators import (
    TRANSFER_BYTES,
    CroppedConvolution,
    FieldConvolution,
    Geometry,
    PixelRectangle,
    StackConvolution,
)
from nolens.quantities import Length
from nolens.refocusing import (
    DepthPsfs,
    DepthReconstructor,
    FocalStack,
    depth_mm,
    photon_variance,
    spacing_warnings,
    transparent,
)
from nolens.solvers import StackPrior, StackProblem, stack_bytes

_PRIORS = {
    "auto": StackPrior(),
    "tv": StackPrior(),
    "isotropic-tv": StackPrior(isotropic=True),
    "l1": StackPrior(sparse=True),
}
_ITERATIONS, _TOLERANCE = 200, 1e-2
OCCLUSION = (
    "the light of all planes adds up; that near objects hide far ones is not modelled, so what "
    "lies behind an opaque object comes out too dark"
)


def reconstruct_volume(
    run: Run[ReconstructOptions], psfs: Mapping[Depth, Frame] | None = None
) -> Product[Tensor]:
    """Radiance of every plane, (depths, channels, height, width).

    Parameters
    ----------
    run
        Of the job.
    psfs
        By the distance of their point sources, in place of those that the options name.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options = run.options
    if options.prior not in _PRIORS:
        raise OptionError(
            f"--prior {options.prior} is for pictures of one depth: with --depths choose "
            f"{', '.join(_PRIORS)}"
        )
    depths = sorted(depth_um(each) for each in options.depths or ())
    measurement, known, camera = _read(run, psfs)
    known.check_depths(depths, "--depths")
    run.warn(*known.warnings, *known.depth_warnings(depths, None))
    run.warn(*spacing_warnings(depths, known.depth_of_focus_per_m))
    farthest = known.at(depths[-1])
    support = _support(run, measurement, known)
    stated = stated_options(support=options.support, field_points=options.field_points)
    run.warn(*field_warnings(known, depths, measurement.size, support, stated))
    mapped = _check_memory(run, measurement, farthest, support, len(depths))
    operators = _operators(run, depths, measurement, known, support, mapped=mapped)
    run.begin()
    problem = StackProblem.build(
        StackConvolution(operators),
        measurement.values.to(run.device),
        valid=measurement.valid.to(run.device),
        variance=_variance(run, measurement, camera),
        prior=replace(_PRIORS[options.prior], across=options.depth_smoothness),
    )
    if options.noise == "poisson":
        sensor = None if camera is None else camera.sensor
        problem = problem.counting(*((1.0, 0.0) if sensor is None else sensor.electrons))

    solved = solve_stack(run, problem, "the volume", iterations=_ITERATIONS, tolerance=_TOLERANCE)
    pages = solved.scene.movedim(1, 0)
    pages = torch.stack(
        [flipped(arrange_rgb(page, measurement.channels), options.flip) for page in pages]
    )
    stack = FocalStack(tuple(depths), pages, (solved.result.objective,) * len(depths))
    together = transparent(stack)
    exposure_white(together.picture)  # An empty volume is an error before anything is written.
    figures: dict[str, Any] = {
        **known.figures(),
        "depths_mm": [depth_mm(each) for each in depths],
        "field_points": max(each.field_points for each in operators),
        "light_of_depths": (pages.sum((1, 2, 3)) / pages.sum()).tolist(),
        **solved.figures,
        "prior": options.prior,
        "occlusion": OCCLUSION,
    }
    parameters = {
        **solved.parameters,
        "bin": known.bin_by,
        "channel_names": list(measurement.channels),
    }
    title = f"{options.measurement.name}: {len(depths)} depths"
    writers = volume_writers(options.output[0], stack, together, title, _names(measurement))
    return Product(pages, figures, writers, parameters, solved.result.history)


def _names(measurement: Measurement) -> tuple[str, ...]:
    return ("R", "G", "B") if len(measurement.channels) == 3 else measurement.channels


def _read(
    run: Run[ReconstructOptions], given: Mapping[Depth, Frame] | None
) -> tuple[Measurement, DepthPsfs, Camera | None]:
    """The measurement, PSFs for its depths, and the camera where it is known."""
    options = run.options
    frames = {
        name: run.frame(name, mosaic=options.mosaic, bgr=options.bgr)
        for name in ("measurement", "dark", "flat")
        if getattr(options, name) is not None
    }
    folder = options.psf_folder if given is None else None
    loaded = run.camera_beside(options.camera, folder)
    if given is None and folder is None and loaded is not None and options.distance is not None:
        given = {options.distance: run.frame("psf")}
    black = options.black
    if given is not None or black != "auto":
        black = black_level(black, next(iter((given or {}).values()), frames["measurement"]))

    def developed(bin_by: int) -> tuple[Measurement, DepthPsfs]:
        measurement = develop(
            frames["measurement"],
            dark=frames.get("dark"),
            flat=frames.get("flat"),
            black=None if black == "auto" else black,
            white=options.white,
            bin_by=bin_by,
            channels=options.channels,
        )
        if folder is not None:
            return measurement, read_depth_psfs(
                run,
                folder,
                measurement,
                bin_by=bin_by,
                channels=options.channels,
                field_points=options.field_points,
            )
        if given is None or (loaded is None and len(given) == 1):
            raise OptionError(
                f"--depths needs to know how the PSF {options.psf} changes with the distance: say "
                "how far away its point source was (--distance 30cm) and the camera (--camera), "
                f"or give a camera's folder with several PSFs, or one and a {CAMERA_FILE}"
            )
        pixel_um = 1.0  # Without a camera nothing is compared with it.
        if loaded is not None:
            sensor = loaded.camera.sensor
            pixel_um = max(1, sensor.rows // (bin_by * measurement.size[0])) * sensor.pitch.um
        entries = {
            PsfEntry(
                file=f"PSF of {each}.tif",
                pixel=Length.of(pixel_um, "um"),
                channels=psf.channels if psf.mosaic is None else ("R", "G", "B"),
                distance=each,
                kind="extended",
            ): psf
            for each, psf in sorted(given.items(), key=lambda item: depth_um(item[0]))
        }
        psfs = DepthPsfs.of_set(
            entries,
            measurement,
            None if loaded is None else loaded.camera,
            where=str(options.psf),
            bin_by=bin_by,
            channels=options.channels,
        )
        return measurement, psfs

    measurement, psfs = developed(options.bin_by)
    if options.bin is None and options.support in ("auto", "full"):
        # Two pixels are still less than a line.
        by = max(1, int(psfs.line / 2))
        if by > 1:
            measurement, psfs = developed(by)
            run.reporter.note(f"{by}×{by} pixels are one, as the PSF's lines are wider (--bin)")
    return measurement, psfs, None if loaded is None else loaded.camera


def _operators(
    run: Run[ReconstructOptions],
    depths: Sequence[float],
    measurement: Measurement,
    psfs: DepthPsfs,
    support: PixelRectangle | None,
    *,
    mapped: bool,
) -> list[CroppedConvolution]:
    """The forward model of each depth: by its PSF, or those over the field that the folder has."""
    size, middle = measurement.size, torch.tensor([side // 2 for side in measurement.size])

    def operator(depth: float) -> CroppedConvolution:
        field = psfs.field_at(depth)
        if field is None:
            return CroppedConvolution(psfs.at(depth).to(run.device), size, support)
        values = field.values.to(run.device)
        return FieldConvolution(values, field.places + middle, size, support, mapped=mapped)

    return [operator(depth) for depth in depths]


def _support(
    run: Run[ReconstructOptions], measurement: Measurement, psfs: DepthPsfs
) -> PixelRectangle | None:
    """Pixels that light can come from; chosen as if all of it came from the middle depth."""
    options = run.options
    middle = psfs.at(psfs.middle_um)
    if options.support == "full":
        return None
    if options.support != "auto":
        return parse_support(options.support, measurement.size, middle)
    reconstructor = DepthReconstructor(measurement, tau=1e-4, device=run.device).at(middle)

    def watch(fraction: float) -> bool:
        return run.reporter.step(
            "% of the choice of the support", round(100 * fraction), 100, "the volume"
        )

    return reconstructor.choose_support(measurement, progress=watch).support


def _check_memory(
    run: Run[ReconstructOptions],
    measurement: Measurement,
    psf: Tensor,
    support: PixelRectangle | None,
    depths: int,
) -> bool:
    """Refuse more depths than there is memory for; whether PSFs must be in temporary files."""
    height, width = psf.shape[-2:]
    padded = Geometry.build(measurement.size, (height, width), support).padded
    pixels = len(measurement.channels) * math.prod(padded)
    points = _most_field_points(run.options)
    each = stack_bytes(1, len(measurement.channels), padded)
    of_psfs = TRANSFER_BYTES * points * pixels if points > 1 else 0
    remedy = "--channels grey, a smaller --support or larger pixels (--bin) need less"
    mapped = check_memory(
        BYTES_OF_PROGRAM + depths * (each + of_psfs),
        run.device,
        fewer_slices("depths", depths, each, run.device, remedy),
        depths * of_psfs,
    )
    if mapped:
        run.reporter.note(mapped_note(depths * of_psfs))
    return mapped


def _most_field_points(options: ReconstructOptions) -> int:
    """PSFs over the field of one distance, at most."""
    if options.psf_folder is None or options.field_points == 1:
        return 1
    listed = Counter(each.distance for each in read_psf_set(options.psf_folder).psf)
    there = max(listed.values())
    return there if options.field_points == "auto" else min(there, options.field_points)


def _variance(
    run: Run[ReconstructOptions], measurement: Measurement, camera: Camera | None
) -> Tensor | None:
    """Of the noise of each pixel, where it is known."""
    if run.options.noise == "even" or (run.options.noise == "auto" and camera is None):
        return None
    return photon_variance(measurement, None if camera is None else camera.sensor).to(run.device)
