"""Batches of any job that has one file as its subject: the job itself runs in a worker.

All that it reads is sent to the worker, and all that it writes is sent back.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Annotated, Any

from pydantic import Field

import nolens.jobs
from nolens.engine import check_scheduler
from nolens.errors import NolensError, OptionError
from nolens.files import CAMERA_FILE, PSFS_FILE, open_sequence, read_frame, write_frame
from nolens.files.formats import FrameSequence
from nolens.files.input import system_errors
from nolens.files.pictures import picture_files
from nolens.jobs.batch.options import BatchOptions, batch_of
from nolens.jobs.batch.run import DIGITS, Answer, open_manifest, run_batch
from nolens.jobs.fields import RESULT, Word
from nolens.jobs.options import JobOptions, Option, expand_home
from nolens.jobs.run import Job, Product, Reporter, Run, job
from nolens.machine import BYTES_OF_PROGRAM

_WORKING = 1.5e9
"""Bytes that a job is taken to hold beside the program, where its frames do not say."""


@dataclass(frozen=True)
class Kind:
    """A job that can be done for each item of a set.

    Parameters
    ----------
    job
        Its name in `nolens.jobs`.
    subject
        The field that the item is.
    results
        What its fields for files become, by field: what follows the item's name in the name of the
        file, or the end of a folder's.
    pictures
        Whether items are pictures of scenes rather than frames.
    varied
        A field that is a number, to which that of the item is added: of random numbers.
    """

    job: str
    subject: str
    results: Mapping[str, str]
    pictures: bool = False
    varied: str = ""

    @property
    def run(self) -> Job[Any, Any]:
        """The job."""
        found: Job[Any, Any] = getattr(nolens.jobs, self.job)
        return found


_OF_A_RUN = ("outputs", "device")
_PLOT = {"plot": ".png"}
KINDS = {
    "refocus": Kind("refocus", "measurement", {"output": "/"}),
    "simulate": Kind(
        "simulate",
        "scenes",
        {"output": ".dng", "truth": "-truth.tif", "response": "-response.tif"},
        pictures=True,
        varied="seed",
    ),
    "psf": Kind("measure_psf", "psf", _PLOT),
    "siemens": Kind("measure_siemens", "frames", _PLOT),
    "edge": Kind("measure_edge", "frames", _PLOT),
    "two-points": Kind("measure_two_points", "frames", _PLOT),
}
"""By the last word of the command."""


class BatchEachOptions(BatchOptions):
    """Each is done on its own, on all cores or a cluster.

    The same command again does what is missing. Items that fail are tried again, then named; the
    exit code is 3 where some did. The record, batch.json, has the figures of each.
    """

    also: Annotated[
        tuple[Word, ...],
        Field(max_length=10),
        Option(
            "Further files to write for each item, by the names of the job's options for them, "
            "such as plot, truth or response; may be given several times.",
            RESULT,
        ),
    ] = ()
    suffix: Annotated[
        Word | None,
        Option(
            "Kind of the file that is written for each item, where the job has several, such as "
            ".tif.",
            RESULT,
            default="the job's first",
        ),
    ] = None


def batch_options(name: str) -> type[BatchOptions]:
    """Options of a batch of the job of a name in `KINDS`."""
    kind = KINDS[name]
    left_out = (kind.subject, *kind.results, "simulate")
    made = batch_of(
        kind.run.options,
        without=left_out,
        base=BatchEachOptions,
        usage=f"batch {'measure ' if kind.results is _PLOT else ''}{name} FILES -o FOLDER",
    )
    made.kind = name
    return made


Tree = Mapping[str, bytes]
"""Files by their paths in a folder."""


@dataclass(frozen=True)
class Shipped:
    """A file or folder that an option names, as it is sent to workers.

    Parameters
    ----------
    name
        Of the file in the tree; empty for a folder.
    tree
        What goes along.
    """

    name: str
    tree: Tree

    @classmethod
    def of(cls, path: Path) -> "Shipped":
        """Read it, and what says more of a file where it lies beside it."""
        with system_errors(path):
            if path.is_dir():
                files = [each for each in sorted(path.rglob("*")) if each.is_file()]
                return cls("", {str(each.relative_to(path)): each.read_bytes() for each in files})
            beside = (path.parent / name for name in (CAMERA_FILE, PSFS_FILE))
            files = [path, *(each for each in beside if each.is_file() and each != path)]
            return cls(path.name, {each.name: each.read_bytes() for each in files})

    def unpack(self, folder: Path) -> Path:
        """Write it into a folder; where it is then."""
        for name, content in self.tree.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return folder / self.name

    @property
    def digest(self) -> str:
        """Tells it from others."""
        parts = [(name, hashlib.sha256(data).digest()) for name, data in sorted(self.tree.items())]
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:DIGITS]


@dataclass(frozen=True)
class Item:
    """What is worked on: the content of its file, and its number in the set."""

    file: Shipped
    number: int


@dataclass(frozen=True)
class JobWork:
    """A job in a worker.

    Parameters
    ----------
    kind
        The job.
    values
        Options that were given, but for files.
    files
        Those that name files, by option.
    results
        Options for files to write, and what they end with.
    """

    kind: Kind
    values: Mapping[str, Any]
    files: Mapping[str, Shipped]
    results: Mapping[str, str]

    def prepare(self) -> Callable[[Item], Answer]:
        """Write the files that all items need into a folder of the worker's."""
        folder = Path(mkdtemp(prefix="nolens-"))
        there = {name: each.unpack(folder / name) for name, each in self.files.items()}
        return partial(self._do, {**self.values, **there})

    def _do(self, values: Mapping[str, Any], item: Item) -> Answer:
        with TemporaryDirectory(prefix="nolens-") as name:
            folder = Path(name)
            out = folder / "out"
            out.mkdir()
            given = {**values, self.kind.subject: item.file.unpack(folder / "in")}
            for field, end in self.results.items():
                given[field] = out / f"item{end}"
            if self.kind.varied:
                first = self.kind.run.options.model_fields[self.kind.varied].default
                given[self.kind.varied] = values.get(self.kind.varied, first) + item.number
            options: JobOptions = self.kind.run.options.gather(given)
            try:
                summary = self.kind.run(options, Reporter()).summary
            except NolensError as error:
                raise type(error)(str(error).replace(f"{folder}/in/", "")) from None
            files = {
                str(path.relative_to(out)).removeprefix("item"): path.read_bytes()
                for path in sorted(out.rglob("*"))
                if path.is_file() and path != options.record
            }
            # What is said of the worker's own folder would tell nobody anything.
            row = json.loads(json.dumps(summary).replace(f"{folder}/in/", ""))
        return Answer(files, {key: row[key] for key in row if key not in _OF_A_RUN})


@job
def batch_each(run: Run[BatchEachOptions]) -> Product[None]:
    """Do a job for every item of a set.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used. Items that fail are in the result.
    """
    options = run.options
    kind: Kind = KINDS[options.kind]
    model = kind.run.options
    items = _pictures(options.items) if kind.pictures else open_sequence(options.items)
    values: dict[str, Any] = {}
    files: dict[str, Shipped] = {}
    for name in options.model_fields_set & set(model.model_fields) - {*kind.results}:
        value, role = getattr(options, name), Option.of(model, name).role
        path = expand_home(Path(value)) if isinstance(value, str | Path) else None
        if role in ("input", "camera") and path is not None and path.exists():
            files[name] = Shipped.of(path)
        else:
            values[name] = value
    run.begin()
    check_scheduler(options.scheduler)
    about = {f"file: --{name}": each.digest for name, each in files.items()}
    with closing(open_manifest(run, items, about)) as manifest:
        return run_batch(
            run,
            manifest,
            items,
            partial(_load, items),
            JobWork(kind, values, files, _results(kind, options)),
            BYTES_OF_PROGRAM + _WORKING,
            lambda key, name: options.output / f"{key}{name}",
        )


def _results(kind: Kind, options: BatchEachOptions) -> dict[str, str]:
    """Options for files to write, and what these end with."""
    results = {name: end for name, end in kind.results.items() if name == "output"}
    for name in options.also:
        if name not in kind.results or name == "output":
            known = ", ".join(each for each in kind.results if each != "output") or "none"
            raise OptionError(f"--also {name}: the job has no such file; it has {known}")
        results[name] = kind.results[name]
    if options.suffix is not None:
        suffixes = Option.of(kind.run.options, "output").suffixes if "output" in results else ()
        if options.suffix not in suffixes:
            raise OptionError(
                f"--suffix {options.suffix} is none of {', '.join(suffixes) or 'this job'}"
            )
        results["output"] = options.suffix
    return results


def _pictures(path: Path) -> FrameSequence:
    """Pictures of scenes as items."""
    files = picture_files(path)
    names = tuple(each.stem for each in files)
    return FrameSequence(names, tuple(files), lambda number: read_frame(files[number]))


def _load(items: FrameSequence, number: int) -> Item:
    """The content of an item's file; a frame of many is written into one of its own."""
    if len(items.sources) == len(items):
        path = items.sources[number]
        with system_errors(path):
            return Item(Shipped(path.name, {path.name: path.read_bytes()}), number)
    frame = items.read(number)
    with TemporaryDirectory(prefix="nolens-") as folder:
        path = Path(folder) / f"frame{'.tif' if len(frame.counts) == 1 else '.npy'}"
        write_frame(path, frame)
        return Item(Shipped(path.name, {path.name: path.read_bytes()}), number)
