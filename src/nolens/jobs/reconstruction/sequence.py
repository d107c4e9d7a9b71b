"""Frame after frame through one camera: folders and stacks of measurements."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from nolens.camera import Frame, Measurement, arrange_rgb, exposure_white
from nolens.errors import FileError, NolensError, OptionError
from nolens.files import (
    FrameSequence,
    open_sequence,
    readable,
    write_into,
    write_png,
)
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reconstruction.read import developed, read_development
from nolens.jobs.reconstruction.solve import (
    method_of,
    reconstructor_of,
)
from nolens.jobs.reconstruction.window import asked_region, crop_window, oriented
from nolens.jobs.run import Product, Run, announce_memory
from nolens.solvers import Development, Method, Stream, admm_bytes

_DROPS_TOLD = 5
"""Frames that are dropped with a warning each; of more, the record has all."""


def reconstruct_sequence(run: Run[ReconstructOptions]) -> Product[Tensor]:
    """Reconstruct every frame of a folder or stack into a folder of pictures.

    The PSF, and all that follows from it, are prepared once, with the first frame that can be used;
    every later frame starts from the one before (`Stream`). A frame that cannot be used is
    dropped, with a warning. Pictures are written as they come, and share the white of the first.

    Parameters
    ----------
    run
        Its `measurement` is the sequence, its `output` the folder.

    Returns
    -------
    Product
        The last picture.

    Raises
    ------
    NolensError
        If an input or an option cannot be used, or no frame can.
    """
    options, reporter = run.options, run.reporter
    folder = _folder(options)
    frames = open_sequence(options.measurement, mosaic=options.mosaic, bgr=options.bgr)
    run.reads({f"frame {path.name}": path for path in frames.sources})
    run.begin()
    work = _Work(run, options, read_development(options))
    count, interrupted = len(frames.names), False
    for number in range(count):
        work.take(frames, number, folder)
        if reporter.step("frame", number + 1, count, "the pictures"):
            interrupted = True
            break
    silent = len(work.dropped) - _DROPS_TOLD
    if silent > 0 and work.picture is not None:
        reporter.warn(f"{silent} more frames are dropped: {readable(options.record)} says why")
    if work.picture is None:
        raise FileError(
            f"none of the {count} frames of {options.measurement} can be used: {work.dropped[0][1]}"
        )
    figures = {
        "method": Method.ADMM.value,
        "frames": len(work.rows),
        "dropped": [name for name, _ in work.dropped],
        "stop_reason": "interrupted" if interrupted else "end of the sequence",
    }
    parameters = {
        "bin": work.options.bin_by,
        "black": work.development.black,
        "tau": work.tau,
        "white_radiance": work.white,
        "names": [name for name in frames.names if (folder / f"{name}.png").exists()],
        "threads": torch.get_num_threads(),
    }
    return Product(
        work.picture, figures, parameters=parameters, history=work.rows, outputs=(folder,)
    )


def _folder(options: ReconstructOptions) -> Path:
    """The folder to write into, once the options are known to suit a sequence."""
    if len(options.output) != 1 or options.output[0].suffix:
        given = " ".join(str(path) for path in options.output)
        raise OptionError(
            f"{options.measurement} is a sequence of frames, whose pictures go into a folder; "
            f"given is -o {given}: give the name of a folder, such as -o pictures"
        )
    if method_of(options) is not Method.ADMM or options.resume is not None:
        raise OptionError(
            "a sequence is solved by ADMM, each frame from the one before: leave out --method, "
            "--quality draft and --resume"
        )
    return options.output[0]


@dataclass
class _Work:
    """What is carried from frame to frame."""

    run: Run[ReconstructOptions]
    options: ReconstructOptions
    development: Development
    rows: list[dict[str, float]] = field(default_factory=list)
    dropped: list[tuple[str, str]] = field(default_factory=list)
    picture: Tensor | None = None
    white: float | None = None
    tau: float | None = None
    _stream: Stream | None = None
    _window: tuple[int, int, int, int] = (0, 0, 0, 0)

    def take(self, frames: FrameSequence, number: int, folder: Path) -> None:
        """Solve for a frame and write its picture, or drop it."""
        name = frames.names[number]
        try:
            frame = frames.read(number)
            if self._stream is None:
                self._stream, measurement = self._begin(frame)
            else:
                measurement = self.development.measurement(frame)
            solved = self._stream.solve(
                measurement.values.to(self.run.device), measurement.valid.to(self.run.device)
            )
            top, left, height, width = self._window
            scene = solved.scene[:, top : top + height, left : left + width].cpu()
            picture = oriented(scene, self.options.flip)
            if self.white is None:
                self.white = exposure_white(picture)
        except (NolensError, ArithmeticError) as error:
            if self._stream is None and isinstance(error, OptionError):
                raise
            self.dropped.append((name, str(error)))
            self.run.warn(f"{name} is dropped: {error}", aloud=len(self.dropped) <= _DROPS_TOLD)
            return
        shown = arrange_rgb(picture, measurement.channels)
        write_into(folder, {folder / f"{name}.png": partial(_write, shown, self.white)})
        self.picture = picture
        row = {"frame": number + 1, "iterations": solved.iterations, "seconds": solved.seconds}
        self.rows.append(row)

    def _begin(self, frame: Frame) -> tuple[Stream, Measurement]:
        options, ready = developed(self.options, self.development, frame, self.run.reporter)
        self.options, self.development = options, ready.development
        measurement, prepared = ready.measurement, ready.prepared
        for text in prepared.notes:
            self.run.reporter.note(text)
        self.run.warn(*prepared.warnings)
        psf = prepared.values
        region = asked_region(options, measurement.size, psf)
        reconstructor = reconstructor_of(options, psf, region, self.run.device)
        problem = reconstructor.problem(measurement)
        self.tau = reconstructor.weight
        self._window = crop_window(options, problem)
        announce_memory(admm_bytes(problem.padded_pixels), self.run.reporter)
        latency = None if options.latency is None else options.latency.s
        each = {} if options.iterations is None else {"iterations": options.iterations}
        return reconstructor.stream(problem, latency_s=latency, **each), measurement


def _write(picture: Tensor, white: float, path: Path) -> None:
    write_png(path, picture, white)
