"""Running of a job: its reporter, time, memory and device; what it writes, and the record."""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, update_wrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, get_args

import torch

from nolens.camera import Frame, Measurement
from nolens.files import (
    CAMERA_FILE,
    InputFile,
    RunRecord,
    check_folder,
    check_output,
    read_frame,
    readable,
    with_former_keys,
    write_into,
    write_record,
    write_together,
)
from nolens.files.atomic import Writer as Writer
from nolens.jobs.options import JobOptions, check_apart
from nolens.machine import (
    BYTES_OF_PROGRAM,
    check_memory,
    gigabytes,
    mapped_note,
    pick_device,
)
from nolens.progress import Clock
from nolens.solvers import Progress, Reconstructor

if TYPE_CHECKING:
    from nolens.camera import LoadedCamera
    from nolens.twin import Light, Twin

Options = TypeVar("Options", bound=JobOptions)
Value = TypeVar("Value")
_NOTABLE_BYTES = 1e9


class Reporter:
    """Whoever watches a job run; this one says nothing and lets it run to its end.

    Others derive from it and show what they want to.
    """

    def note(self, text: str) -> None:
        """Say something a person should know before it happens."""

    def warn(self, text: str) -> None:
        """Say what may make the result worse than it could be."""

    def advance(self, what: str, fraction: float) -> None:
        """See how much of a piece of work is done, from 0 to 1."""

    def step(self, what: str, done: int, limit: int, result: str, state: str = "") -> bool:
        """See how many steps are done, and what they came to so far.

        True ends the work, and `result` so far is written.
        """
        return False

    def progress(self, progress: Progress, limit: int) -> bool:
        """See an iteration; True stops the solver, and the picture so far is written."""
        return False


def check_solver_memory(solver: Reconstructor, data: Measurement, remedy: str) -> float:
    """Bytes that a reconstruction needs, if the machine has as many.

    Raises
    ------
    OptionError
        If it has less memory, before the PSF is transformed; `remedy` ends the message.
    """
    needed = BYTES_OF_PROGRAM + solver.working_bytes(len(data.channels), data.size)
    check_memory(needed, torch.device(solver.device), remedy)
    return needed


def mapped_where_needed(
    solver: Reconstructor, data: Measurement, remedy: str, note: Callable[[str], object]
) -> Reconstructor:
    """The same solver, with PSFs over the field in temporary files where memory would not do.

    Parameters
    ----------
    solver, data, remedy
        As `check_solver_memory` takes them.
    note
        Is told of the files.

    Raises
    ------
    OptionError
        If even so memory would not do, or no disk has room.
    """
    shape = len(data.channels), data.size
    needed, in_files = BYTES_OF_PROGRAM + solver.working_bytes(*shape), solver.mapped_bytes(*shape)
    mapped = check_memory(needed, torch.device(solver.device), remedy, in_files)
    if mapped:
        note(mapped_note(in_files))
    return replace(solver, mapped=mapped)


def announce_memory(needed: float, reporter: Reporter) -> None:
    """Say beforehand what takes gigabytes.

    Parameters
    ----------
    needed
        Bytes that the job holds at once.
    reporter
        Is told.
    """
    if needed > _NOTABLE_BYTES:
        reporter.note(f"this takes about {gigabytes(needed)} of memory")


@dataclass(frozen=True)
class Result(Generic[Value]):
    """What a job came to.

    Parameters
    ----------
    value
        What it is for: a picture, a camera, figures.
    summary
        Figures of the run, in values that JSON has.
    """

    value: Value
    summary: dict[str, Any]


@dataclass(frozen=True)
class Product(Generic[Value]):
    """What the work of a job hands over to be written.

    Parameters
    ----------
    value
        What it is for.
    figures
        Of the result, in values that JSON has.
    writers
        What writes each file.
    parameters
        Of the record, beside the options: what was chosen where they say nothing.
    history
        Of the record: an entry for each iteration.
    outputs
        Files or folders to list in place of those of the writers.
    commit
        Writes all files, all or none, by their names in the folder of the options. None writes
        them as they are, into that folder where there is one.
    spent
        Files of the job's own, such as a checkpoint, that nobody needs once all is written.
    """

    value: Value
    figures: Mapping[str, Any]
    writers: Mapping[Path, Writer] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    history: list[dict[str, float]] = field(default_factory=list)
    outputs: tuple[Path, ...] | None = None
    commit: Callable[[Mapping[str, Writer]], None] | None = None
    spent: tuple[Path, ...] = ()


class Run(Generic[Options]):
    """A job while it runs.

    Parameters
    ----------
    options
        What was asked for.
    reporter
        Is told of it.

    Attributes
    ----------
    warnings
        What was warned of.
    """

    def __init__(self, options: Options, reporter: Reporter) -> None:
        self.options, self.reporter = options, reporter
        self.clock = Clock()
        self.warnings: list[str] = []
        self._files: dict[str, Path] = {}
        self._inputs: dict[str, InputFile] | None = None
        for _, path, _, suffixes in options.written:
            if suffixes:
                check_output(path, suffixes)
        record, folder = options.record, options.output_folder
        if record is not None and record.parent != folder:
            check_output(record, (".json",))
        if options.output_folder is not None:
            check_folder(options.output_folder)
        self.reads(options.inputs)

    @cached_property
    def device(self) -> torch.device:
        """Where to compute.

        Raises
        ------
        OptionError
            If CUDA is asked for and there is none.
        """
        return pick_device(getattr(self.options, "device", "cpu"))

    def reads(self, files: Mapping[str, Path]) -> None:
        """Add files that are read, by role, to those of the options.

        Raises
        ------
        OptionError
            If one of them would be written over.
        """
        self._files |= files
        check_apart(self.options, self._files)

    def frame(self, option: str, *, mosaic: str | None = None, bgr: bool = False) -> Frame:
        """Read the frame that an option names (`read_frame`).

        Raises
        ------
        NolensError
            If it cannot be read.
        """
        return read_frame(getattr(self.options, option), mosaic=mosaic, bgr=bgr)

    def camera(self, name: str | Path) -> "LoadedCamera":
        """Read a camera, and add its files to those that are read.

        Raises
        ------
        NolensError
            If it cannot be used, or one of its files would be written over.
        """
        from nolens.files import camera_files, read_camera

        loaded = read_camera(name)
        self.reads(camera_files(name, loaded.camera))
        return loaded

    def light(self, name: str) -> "Light":
        """The light of a name, or of a file, which is added to those that are read.

        Raises
        ------
        NolensError
            As `camera`.
        """
        from nolens.files import read_light

        light = read_light(name)
        if light.spectrum is not None:
            self.reads({"spectrum of the light": Path(name)})
        return light

    def camera_beside(self, name: str | None, folder: Path | None) -> "LoadedCamera | None":
        """The camera of a name, or without one that of a folder; None where there is neither.

        Raises
        ------
        NolensError
            As `camera`.
        """
        beside = None if folder is None else folder / CAMERA_FILE
        if name is None and (beside is None or not beside.is_file()):
            return None
        return self.camera(name or beside or "")

    def twin(
        self, loaded: "LoadedCamera", working: float, remedy: str, *, fresnel: bool = True
    ) -> "Twin":
        """Begin work with a simulated camera by computing its relief.

        Parameters
        ----------
        loaded
            The camera.
        working
            Bytes that are held at once beside its relief.
        remedy
            What would need less, as the end of a sentence.
        fresnel
            Whether light is lost at surfaces.

        Raises
        ------
        OptionError
            If the machine has less memory than that.
        """
        from nolens.twin import Twin, check_simulation_memory

        self.begin(check_simulation_memory(loaded, working, self.device, remedy))
        self.reporter.advance("mask", 0.0)
        return Twin.of(loaded, device=self.device, fresnel=fresnel)

    def for_options(self, options: Any) -> "Run[Any]":
        """The same run, with the options of a job that is a part of it."""
        part = copy(self)
        part.options = options
        return part

    def begin(self, needed: float = 0.0, remedy: str = "") -> None:
        """Say that all is read and checked: from here on the work takes its time.

        The files are hashed while they are as they were read, and work that takes much memory is
        announced.

        Parameters
        ----------
        needed
            Bytes that the work holds at once.
        remedy
            What would need less, as the end of a sentence; nothing where that is known to be there.

        Raises
        ------
        OptionError
            If the machine has less memory than that.
        FileError
            If one of them cannot be read any more.
        """
        if remedy:
            check_memory(needed, self.device, remedy)
        self._inputs = {
            role: InputFile.of(path) for role, path in self._files.items() if not path.is_dir()
        }
        announce_memory(needed, self.reporter)

    @property
    def inputs(self) -> dict[str, InputFile]:
        """The files that are read, hashed, by role."""
        if self._inputs is None:
            self.begin()
        return self._inputs or {}

    def warn(self, *texts: str, aloud: bool = True) -> None:
        """Say what may make the result worse than it could be, and keep it for the record.

        Parameters
        ----------
        texts
            Warnings.
        aloud
            Whether they are more than a line of the record.
        """
        for text in texts:
            self.warnings.append(text)
            if aloud:
                self.reporter.warn(text)

    def finish(self, product: Product[Value]) -> Result[Value]:
        """Write what the work came to, and the record.

        Raises
        ------
        FileError
            If a file cannot be written; then none is.
        """
        options = self.options
        files = [*(product.writers if product.outputs is None else product.outputs)]
        if options.record is not None:
            files.append(options.record)
        summary = {
            **product.figures,
            "warnings": self.warnings,
            "outputs": [readable(path) for path in files],
        }
        if "device" in type(options).model_fields:
            summary["device"] = str(self.device)
        summary["seconds"] = self.clock.seconds
        writers = dict(product.writers)
        if options.record is not None:
            writers[options.record] = partial(self._write_record, product, summary)
        folder = options.output_folder
        if product.commit is not None and folder is not None:
            product.commit({str(each.relative_to(folder)): writers[each] for each in writers})
        elif folder is not None:
            write_into(folder, writers)
        else:
            write_together(writers)
        for path in product.spent:
            path.unlink(missing_ok=True)
        return Result(product.value, summary)

    def record(
        self,
        figures: Mapping[str, Any],
        parameters: dict[str, Any],
        history: list[dict[str, float]] | None = None,
    ) -> RunRecord:
        """What a record keeps of the run, with these figures and parameters."""
        return RunRecord(
            started=self.clock.started,
            inputs=self.inputs,
            parameters=parameters,
            result=with_former_keys(figures),
            history=history or [],
            warnings=list(self.warnings),
        )

    def _write_record(self, product: Product[Any], summary: dict[str, Any], path: Path) -> None:
        summary["seconds"] = self.clock.seconds  # With all that was written.
        parameters = {
            **self.options.model_dump(mode="json", by_alias=True),
            **with_former_keys(product.parameters),
            "options_set": sorted(self.options.model_fields_set),
        }
        write_record(path, self.record(summary, parameters, product.history))


class Job(Generic[Options, Value]):
    """A job that can be run: ``refocus(RefocusOptions(...), Reporter())``.

    Outputs are checked before the work begins, and nothing is written unless all of it went well.

    Attributes
    ----------
    options
        Model of its options, as the work declares it.
    """

    def __init__(self, work: Callable[[Run[Options]], Product[Value]]) -> None:
        self._work = work
        self.options: type[Options] = get_args(work.__annotations__["run"])[0]
        update_wrapper(self, work)

    def __call__(self, options: Options, reporter: Reporter) -> Result[Value]:
        """Run it.

        Raises
        ------
        NolensError
            If an option, an input or an output cannot be used.
        """
        run = Run(options, reporter)
        return run.finish(self._work(run))


def job(work: Callable[[Run[Options]], Product[Value]]) -> Job[Options, Value]:
    """Make a job of its work: ``@job`` before ``def refocus(run: Run[RefocusOptions]) -> ...``."""
    return Job(work)
