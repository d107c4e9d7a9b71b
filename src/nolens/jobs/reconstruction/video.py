"""A video from one frame of a camera with a rolling shutter."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from nolens.camera import (
    Frame,
    LoadedCamera,
    Sensor,
    Shutter,
    arrange_rgb,
    exposure_white,
    flipped,
)
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE
from nolens.files.contact_sheet import SheetPicture, write_contact_sheet
from nolens.files.ome import write_ome_tiff
from nolens.files.psf_folder import pixel_of_camera
from nolens.files.video import check_video_support, write_mp4
from nolens.jobs.reconstruction.options import LESS_MEMORY, ReconstructOptions
from nolens.jobs.reconstruction.setup import Prepared, psf_row, read_development
from nolens.jobs.reconstruction.stack import fewer_slices, solve_stack
from nolens.jobs.run import Product, Run, Writer
from nolens.machine import BYTES_OF_PROGRAM
from nolens.solvers import stack_bytes
from nolens.solvers.video import ACROSS, VideoProblem

_ITERATIONS, _TOLERANCE = 60, 3e-3
_PER_SECOND = 12
"""Frames of the .mp4 in a second: two seconds for 24."""
_ON_SHEET = 24
_APART = 2.0
"""Frames within a line's exposure from which on neighbours are hardly told apart."""


def reconstruct_video(run: Run[ReconstructOptions]) -> Product[Tensor]:
    """Radiance of the frames, (frames, channels, height, width).

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, frames = run.options, run.options.frames
    assert frames is not None
    if any(path.suffix.lower() == ".mp4" for path in options.output):
        check_video_support()
    camera = run.camera_beside(None, options.psf.parent)
    sensor = _rolling_sensor(options, camera)
    frame = run.frame("measurement", mosaic=options.mosaic, bgr=options.bgr)
    assert camera is not None
    pixel_of_camera(frame, camera)
    prepared = Prepared.of(run, read_development(run), frame)
    options, measurement = prepared.options, prepared.measurement
    exposure_s = _exposure_s(options, frame)
    problem = VideoProblem.build(prepared.reconstructor, measurement, sensor, exposure_s, frames)
    shutter, single = problem.shutter, problem.single
    run.warn(*_blur_warnings(shutter, problem.frame_s))
    each = stack_bytes(1, single.channels, single.forward.geometry.padded)
    run.begin(
        BYTES_OF_PROGRAM + frames * each,
        fewer_slices("frames", frames, each, run.device, LESS_MEMORY),
    )
    solved = solve_stack(
        run,
        problem.stack,
        "the video",
        iterations=_ITERATIONS,
        tolerance=_TOLERANCE,
        by_noise=True,
    )
    video = flipped(problem.video(solved.scene), options.flip)
    figures = {
        **solved.figures,
        "field_points": single.forward.field_points,
        "video": {
            "frames": len(video),
            "frame_s": problem.frame_s,
            "exposure_s": shutter.exposure_s,
            "duration_s": shutter.duration_s,
        },
    }
    parameters = {
        **solved.parameters,
        "bin": options.bin_by,
        "black": prepared.development.black,
        "psf": psf_row(prepared.psf),
        "across": ACROSS,
        "channel_names": list(measurement.channels),
        "threads": torch.get_num_threads(),
    }
    writers = _writers(options.output, video, measurement.channels, problem.frame_s)
    return Product(video, figures, writers, parameters, solved.result.history)


def _rolling_sensor(options: ReconstructOptions, camera: LoadedCamera | None) -> Sensor:
    """The camera's sensor, whose lines are exposed one after another."""
    if camera is None:
        raise OptionError(
            f"--frames {options.frames} needs the line time of the sensor, and there is no "
            f"{CAMERA_FILE} beside {options.psf}: give the folder of a camera (--psf FOLDER)"
        )
    if camera.camera.sensor.line_time_us is None:
        raise OptionError(
            f"--frames {options.frames}: all lines of {camera.camera.name!r} are exposed at once, "
            "so that one frame shows one moment. For a rolling shutter give line_time_us and "
            f'rolling, such as "down", under [sensor] in {options.psf.parent / CAMERA_FILE}'
        )
    return camera.camera.sensor


def _blur_warnings(shutter: Shutter, frame_s: float) -> list[str]:
    """About an exposure that is long beside a frame, or beside all of the readout."""
    distinct = int(shutter.duration_s / shutter.exposure_s)
    readout_s = shutter.duration_s - shutter.exposure_s
    if distinct < 2:
        return [
            f"each line is exposed for {1e3 * shutter.exposure_s:.4g} ms, and the last begins "
            f"{1e3 * readout_s:.3g} ms after the first: all show nearly the same moments, and no "
            "video can be had of them, whatever --frames says. Expose for "
            f"{1e3 * readout_s:.3g} ms or less"
        ]
    if shutter.exposure_s <= _APART * frame_s:
        return []
    return [
        f"each line is exposed for {shutter.exposure_s / frame_s:.1f} frames, which blurs them "
        f"into one another: a shorter exposure, or --frames {distinct}"
    ]


def _exposure_s(options: ReconstructOptions, frame: Frame) -> float:
    if options.exposure is not None:
        return options.exposure.s
    if frame.exposure_s is None:
        raise OptionError(
            f"{frame.source} does not say how long its lines were exposed: give --exposure, such "
            "as --exposure 1ms"
        )
    return frame.exposure_s


def _writers(
    outputs: Sequence[Path], video: Tensor, channels: tuple[str, ...], frame_s: float
) -> dict[Path, Writer]:
    """What writes each file; all frames have one white."""
    pictures = torch.stack([arrange_rgb(each, channels) for each in video])
    white = exposure_white(pictures.movedim(0, 1).flatten(1, 2))
    every = -(-len(video) // _ON_SHEET)
    sheet = [
        SheetPicture(f"{1e3 * (number + 0.5) * frame_s:.3g} ms", pictures[number])
        for number in range(0, len(video), every)
    ]
    about = {"TimeIncrement": frame_s, "TimeIncrementUnit": "s"}
    kinds = {
        ".mp4": partial(write_mp4, pictures=pictures, white=white, per_second=_PER_SECOND),
        ".png": partial(write_contact_sheet, pictures=sheet, white=white),
    }
    stack = partial(write_ome_tiff, stack=video, axis="T", channels=channels, pixels=about)
    return {path: kinds.get(path.suffix.lower(), stack) for path in outputs}
