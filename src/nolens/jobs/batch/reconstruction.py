"""`nolens batch reconstruct`: every frame of a set on its own, with one set-up for all."""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from nolens.camera import Frame, arrange_rgb, exposure_white
from nolens.engine import Manifest, check_scheduler
from nolens.errors import DataError, FileError, NolensError
from nolens.files import open_sequence
from nolens.files.formats import FrameSequence
from nolens.jobs.batch.options import BatchOptions, batch_of
from nolens.jobs.batch.run import Answer, batch_product, open_manifest, run_batch
from nolens.jobs.fields import PICTURE, FilePath
from nolens.jobs.options import Option
from nolens.jobs.reconstruction.job import write_picture
from nolens.jobs.reconstruction.options import LESS_MEMORY, ReconstructOptions
from nolens.jobs.reconstruction.setup import Setup, read_development
from nolens.jobs.run import Product, Run, check_solver_memory, job
from nolens.machine import pick_device
from nolens.progress import Clock
from nolens.solvers import Development

_SMALL = ("uint8", "uint16")
_STORED = "chunk"


class BatchReconstructBase(BatchOptions):
    """Each is solved on its own, on all cores or a cluster.

    nolens batch reconstruct frames/ --psf psf.dng -o pictures

    nolens batch reconstruct 'raw/*.png' --psf psf.png -o pictures --scheduler tcp://host:8786

    Binning, how the PSF is read, and tau are chosen once, by the first frame that can be used; so
    a picture depends on its frame alone, and not on order, workers or interruptions. The same
    command again does what is missing. Frames that fail are tried again, then named; the exit
    code is 3 where some did.
    """

    formats: Annotated[
        tuple[Literal["png", "tif"], ...],
        Field(min_length=1, max_length=2),
        Option(
            "Kinds of picture to write for each frame: png (8-bit sRGB, each with its own white) "
            "or tif (linear); may be given twice.",
            PICTURE,
            label="Kinds of picture",
        ),
    ] = ("png",)
    store: Annotated[
        FilePath | None,
        Option(
            "Also writes linear pictures of all frames, as floats, into one Zarr store with the "
            "axes of OME-Zarr, such as out/pictures.zarr.",
            PICTURE,
            role="output",
            label="Zarr store",
        ),
    ] = None


if TYPE_CHECKING:
    BatchReconstructOptions = BatchReconstructBase
else:
    BatchReconstructOptions = batch_of(
        ReconstructOptions,
        without=(
            *("measurement", "output", "sweep", "resume", "latency", "frames", "exposure"),
            *("depths", "noise", "depth_smoothness"),
            *("bands", "spectral_smoothness", "spectrum_at"),
        ),
        base=BatchReconstructBase,
        usage="batch reconstruct FRAMES --psf PSF -o FOLDER",
    )


@dataclass(frozen=True)
class PackedFrame:
    """A frame as it is sent to workers: whole counts in as few bytes as the file has.

    Parameters
    ----------
    counts
        Of the frame.
    others
        Its other fields. A frame with an empty tensor would take longer to pickle than all else.
    """

    counts: NDArray[Any]
    others: Mapping[str, Any]

    @classmethod
    def of(cls, frame: Frame) -> "PackedFrame":
        """Pack it, without loss."""
        counts = frame.counts.numpy()
        small = counts.astype(frame.stored_as) if frame.stored_as in _SMALL else counts
        exact = np.array_equal(small, counts)
        others = {name: value for name, value in vars(frame).items() if name != "counts"}
        return cls(small if exact else counts, others)

    @property
    def unpacked(self) -> Frame:
        """The frame."""
        return Frame(torch.from_numpy(self.counts.astype(np.float32)), **self.others)


@dataclass(frozen=True)
class FrameWork:
    """The reconstruction of frames in a worker.

    Parameters
    ----------
    setup
        For all of them, with the transformed PSF.
    formats
        Kinds of picture.
    stored
        Whether the Zarr store gets them, too.
    """

    setup: Setup
    formats: tuple[str, ...]
    stored: bool

    def prepare(self) -> Callable[[PackedFrame], Answer]:
        """Transform the PSF on a device of the worker's, if it is to use one."""
        device, setup = pick_device(self.setup.options.device), self.setup
        if device != setup.problem.data.device:
            reconstructor = replace(setup.reconstructor, device=device)
            problem = reconstructor.problem(setup.measurement)
            setup = replace(setup, reconstructor=reconstructor, problem=problem)
        return partial(self._reconstruct, setup)

    def _reconstruct(self, setup: Setup, packed: PackedFrame) -> Answer:
        clock = Clock()
        measurement = setup.development.measurement(packed.unpacked)
        problem = setup.problem.measuring(measurement.values, measurement.valid)
        result = setup.reconstructor.solve(problem)
        picture = arrange_rgb(setup.picture(result.scene), measurement.channels)
        white = exposure_white(picture)
        files: dict[str, bytes] = {}
        with TemporaryDirectory(prefix="nolens-") as folder:
            for suffix in self.formats:
                path = Path(folder) / f"picture.{suffix}"
                write_picture(path, picture, white, setup.options)
                files[suffix] = path.read_bytes()
        if self.stored:
            from nolens.files.picture_store import encoded_picture

            files[_STORED] = encoded_picture(picture.numpy())
        row = {
            "iterations": result.iterations,
            "stop_reason": result.stop_reason,
            "objective": result.objective,
            "white": white,
            "seconds": clock.seconds,
        }
        return Answer(files, row)


@job
def batch_reconstruct(run: Run[BatchReconstructOptions]) -> Product[None]:
    """Reconstruct every frame of a set.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used, or no frame can. Frames that fail are
        in the result.
    """
    options = run.options
    one = options.one(
        ReconstructOptions, measurement=options.items, output=(options.output / "picture.png",)
    )
    frames = open_sequence(options.items, mosaic=one.mosaic, bgr=one.bgr)
    development = read_development(run.for_options(one))
    run.begin()
    check_scheduler(options.scheduler)
    with closing(open_manifest(run, frames)) as manifest:
        setup = _set_up(run.for_options(one), manifest, frames, development)
        if setup is None:
            return batch_product(run, manifest)
        work = FrameWork(setup, options.formats, options.store is not None)
        if options.store is not None:
            _make_store(options.store, setup, frames)
        product = run_batch(
            run,
            manifest,
            frames,
            partial(_load, frames),
            work,
            # Each worker has the PSFs in memory of its own.
            check_solver_memory(
                replace(setup.reconstructor, mapped=False), setup.measurement, LESS_MEMORY
            ),
            partial(_path, options, {name: at for at, name in enumerate(frames.names)}),
        )
    parameters = {**product.parameters, **setup.choices}
    if options.store is not None:
        from nolens.files.picture_store import write_attributes

        write_attributes(options.store, frames.names, parameters["rows"])
    return replace(product, parameters=parameters)


def _set_up(
    run: Run[ReconstructOptions],
    manifest: Manifest,
    frames: FrameSequence,
    development: Development,
) -> Setup | None:
    """What all frames have in common, by the first that can be used; or as it was chosen before.

    None where it was interrupted.
    """
    chosen = manifest.notes
    first = chosen.get("first")
    reason: NolensError | None = None
    for number in range(len(frames)) if first is None else [first]:
        try:
            setup = Setup.of(
                run, development, frames.read(number), chosen["choices"] if chosen else None
            )
        except (DataError, FileError) as error:
            reason = reason or error
            continue
        if not chosen:
            # Ctrl-C ends a choice before its time.
            if run.reporter.step("set-up", 1, 1, "nothing"):
                return None
            # From here to the first picture, such as while no worker joins, it ends all at once.
            run.reporter.advance("set-up", 1.0)
            manifest.note(first=number, choices=setup.choices)
        return setup
    assert reason is not None
    if len(frames) == 1 or first is not None:
        raise reason
    raise DataError(f"none of the {len(frames)} frames can be used; the first: {reason}")


def _make_store(store: Path, setup: Setup, frames: FrameSequence) -> None:
    from nolens.files.picture_store import create_store

    picture = arrange_rgb(
        setup.picture(setup.problem.data[..., :1, :1]), setup.measurement.channels
    )
    create_store(store, frames.names, tuple(picture.shape))


def _load(frames: FrameSequence, number: int) -> PackedFrame:
    return PackedFrame.of(frames.read(number))


def _path(
    options: BatchReconstructOptions, numbers: Mapping[str, int], key: str, result: str
) -> Path:
    """File of a frame's result."""
    if result == _STORED and options.store is not None:
        from nolens.files.picture_store import chunk_path

        return chunk_path(options.store, numbers[key])
    return options.output / f"{key}.{result}"
