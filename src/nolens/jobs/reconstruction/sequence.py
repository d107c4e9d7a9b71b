"""A sequence of frames, each reconstructed from where the one before it ended."""

from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from nolens.camera import arrange_rgb, exposure_white
from nolens.errors import FileError, NolensError, OptionError
from nolens.files import open_sequence, readable, write_into, write_png
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reconstruction.setup import Setup, method_of, psf_row, read_development
from nolens.jobs.run import Product, Run
from nolens.solvers import Method, Stream
from nolens.solvers.stream import CHECK_WEIGHT_EVERY, weight_to_follow
from nolens.solvers.trained_stream import TrainedStream

_DROPS_REPORTED = 5
"""Frames that are dropped with a warning each; of more, the record has all."""


def reconstruct_sequence(run: Run[ReconstructOptions]) -> Product[Tensor]:
    """Reconstruct every frame of a folder or stack into a folder of pictures.

    The PSF, and all that follows from it, are prepared once, with the first frame that can be used;
    every later frame starts from the one before (`Reconstructor.stream`). A frame that cannot be
    used is dropped, with a warning. Pictures are written as they come, and share the white of the
    first.
    """
    options, reporter = run.options, run.reporter
    folder = _sequence_folder(options)
    frames = open_sequence(options.measurement, mosaic=options.mosaic, bgr=options.bgr)
    run.reads({f"frame {path.name}": path for path in frames.sources})
    development = read_development(run)
    run.begin()
    setup: Setup | None = None
    stream: Stream | TrainedStream | None = None
    picture: Tensor | None = None
    white: float | None = None
    rows: list[dict[str, float]] = []
    choices: list[dict[str, float]] = []
    dropped: list[tuple[str, str]] = []
    count, interrupted = len(frames.names), False
    for number, name in enumerate(frames.names):
        try:
            frame = frames.read(number)
            if setup is None or stream is None:
                setup = Setup.of(run, development, frame)
                stream = setup.reconstructor.stream(
                    setup.problem,
                    iterations=options.iterations,
                    latency_s=None if options.latency is None else options.latency.s,
                )
                measurement = setup.measurement
            else:
                measurement = setup.development.measurement(frame)
                weighed = setup.weight is not None and len(rows) % CHECK_WEIGHT_EVERY == 0
                if weighed and isinstance(stream, Stream):
                    chosen = setup.reconstructor.choose_weight(measurement).tau / options.detail
                    stream.weigh(weight_to_follow(stream.weight, chosen))
                    choices.append({"frame": number + 1, "chosen": chosen, "tau": stream.weight})
            solved = stream.solve(
                measurement.values.to(run.device), measurement.valid.to(run.device)
            )
            current = setup.picture(solved.scene)
            white = exposure_white(current) if white is None else white
        except (NolensError, ArithmeticError) as error:
            if stream is None and isinstance(error, OptionError):
                raise
            dropped.append((name, str(error)))
            run.warn(f"{name} is dropped: {error}", aloud=len(dropped) <= _DROPS_REPORTED)
        else:
            picture = current
            rgb = arrange_rgb(picture, measurement.channels)
            write_into(
                folder, {folder / f"{name}.png": partial(write_png, radiance=rgb, white=white)}
            )
            rows.append(
                {
                    "frame": number + 1,
                    "iterations": solved.iterations,
                    "seconds": solved.seconds,
                    "tau": stream.weight,
                }
            )
        if reporter.step("frame", number + 1, count, "the pictures"):
            interrupted = True
            break
    silent = len(dropped) - _DROPS_REPORTED
    if silent > 0 and picture is not None:
        reporter.warn(f"{silent} more frames are dropped: {readable(options.record)} says why")
    if setup is None or picture is None:
        raise FileError(
            f"none of the {count} frames of {options.measurement} can be used: {dropped[0][1]}"
        )
    figures = {
        "method": setup.reconstructor.method_name,
        **setup.reconstructor.prior_facts,
        "frames": len(rows),
        "field_points": setup.problem.forward.field_points,
        "dropped": [name for name, _ in dropped],
        "stop_reason": "interrupted" if interrupted else "end of the sequence",
    }
    parameters = {
        "bin": setup.options.bin_by,
        "black": setup.development.black,
        "psf": psf_row(setup.psf),
        "tau": setup.tau,
        "tau_checks": choices,
        "support": setup.support,
        "white_radiance": white,
        "names": [name for name in frames.names if (folder / f"{name}.png").exists()],
        "threads": torch.get_num_threads(),
    }
    return Product(picture, figures, parameters=parameters, history=rows, outputs=(folder,))


def _sequence_folder(options: ReconstructOptions) -> Path:
    """The folder to write into, once the options are known to suit a sequence."""
    if len(options.output) != 1 or options.output[0].suffix:
        outputs = " ".join(str(path) for path in options.output)
        raise OptionError(
            f"{options.measurement} is a sequence of frames, whose pictures go into a folder; "
            f"given is -o {outputs}: give the name of a folder, such as -o pictures"
        )
    if method_of(options) is not Method.ADMM or options.resume is not None:
        raise OptionError(
            "a sequence is solved by ADMM, each frame from the one before: leave out --method, "
            "--quality draft and --resume"
        )
    return options.output[0]
