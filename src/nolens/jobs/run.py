"""Running of a job: its reporter, time, memory and device; what it writes, and the record."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property, partial, update_wrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, get_args

import psutil
import torch

from nolens.camera import Measurement
from nolens.errors import OptionError
from nolens.files import (
    InputFile,
    RunRecord,
    check_folder,
    check_output,
    readable,
    write_into,
    write_record,
    write_together,
)
from nolens.jobs.fields import DeviceName
from nolens.jobs.options import JobOptions, check_apart
from nolens.solvers import Progress, Reconstructor

if TYPE_CHECKING:
    from nolens.camera import LoadedCamera

Writer = Callable[[Path], None]
"""Writes one file when it is given a path."""
Options = TypeVar("Options", bound=JobOptions)
Value = TypeVar("Value")
BYTES_OF_PROGRAM = 5e8
_NOTABLE_BYTES = 1e9
_ABSURD_BYTES = 1e15
_RELIABLE_AFTER_S = 5.0


class Reporter:
    """Whoever watches a job run; this one says nothing and lets it run to its end.

    Others derive from it and show what they want to.
    """

    def note(self, text: str) -> None:
        """Say something a person should know before it happens."""

    def warn(self, text: str) -> None:
        """Say what may make the result worse than it could be."""

    def advance(self, what: str, share: float) -> None:
        """See how much of a piece of work is done, from 0 to 1."""

    def step(self, what: str, done: int, limit: int, kept: str) -> bool:
        """See how many steps of some work are done; True ends it, and what it kept is written."""
        return False

    def progress(self, progress: Progress, limit: int) -> bool:
        """See an iteration; True stops the solver, and the picture so far is written."""
        return False


def _now() -> str:
    return datetime.now(UTC).astimezone().isoformat(timespec="seconds")


@dataclass(frozen=True)
class Clock:
    """Starts when it is made.

    Attributes
    ----------
    started
        ISO 8601, with the offset from UTC.
    """

    started: str = field(default_factory=_now)
    _from: float = field(default_factory=time.perf_counter)

    @property
    def seconds(self) -> float:
        """Since then."""
        return round(time.perf_counter() - self._from, 3)


class Pace:
    """Time that a piece of work still takes, by the pace that it has had so far."""

    def __init__(self) -> None:
        self._work, self._begun, self._from = "", 0.0, 0.0

    def seconds_left(self, what: str, fraction: float) -> float | None:
        """By what is done of a piece of work, from 0 to 1; None where nothing tells yet.

        Other work than before, or less of it, begins anew.
        """
        now = time.perf_counter()
        if what != self._work or fraction < self._from:
            self._work, self._begun, self._from = what, now, fraction
        gone = fraction - self._from
        return (now - self._begun) * (1 - fraction) / gone if gone > 0 else None

    @property
    def sure(self) -> bool:
        """Whether the work has gone on for long enough that its pace is believed."""
        return time.perf_counter() - self._begun > _RELIABLE_AFTER_S


def duration_text(seconds: float) -> str:
    """Say how long, in the unit that suits."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def check_memory(needed: float, device: torch.device, remedy: str) -> None:
    """Refuse what the machine has no memory for.

    Parameters
    ----------
    needed
        Bytes that the job holds at once.
    device
        Where the job computes.
    remedy
        What would need less, as the end of a sentence.

    Raises
    ------
    OptionError
        If the machine has less memory than that.
    """
    where, there = "machine", float(psutil.virtual_memory().total)
    if device.type == "cuda":
        where, there = "CUDA device", float(torch.cuda.mem_get_info(device)[1])
    if needed > there:
        raise OptionError(
            f"this needs about {_gigabytes(needed)} GB of memory, and the {where} has "
            f"{_gigabytes(there)} GB: {remedy}"
        )


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


def check_simulation_memory(
    loaded: "LoadedCamera", working: float, device: torch.device, remedy: str
) -> float:
    """Bytes that a simulation needs, `working` beside the camera's relief, if there are as many.

    Raises
    ------
    OptionError
        If the machine has less memory, before the relief is computed; `remedy` ends the message.
    """
    from nolens.twin import relief_points, simulation_bytes

    needed = BYTES_OF_PROGRAM + simulation_bytes(relief_points(loaded), working)
    check_memory(needed, device, remedy)
    return needed


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
        reporter.note(f"this takes about {_gigabytes(needed)} GB of memory")


def _gigabytes(number: float) -> str:
    return f"{number / 1e9:.1f}" if number < _ABSURD_BYTES else f"{number / 1e9:.0e}"


def pick_device(name: DeviceName) -> torch.device:
    """Find the device of a name; auto takes CUDA where there is one.

    Raises
    ------
    OptionError
        If CUDA is asked for and there is none.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise OptionError(
            "--device cuda was asked for, but torch finds no CUDA device here; use "
            "--device cpu or auto, or install a CUDA build of torch"
        )
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)


_FORMER_KEYS = {
    "clipped_fraction": "clipped_share",
    "dark_fraction": "dark_share",
    "error_pixels": "error_cells",
    "extent_deg": "reach_deg",
    "extrapolated_by": "surround",
    "finest_of_the_pixels": "finest_of_the_cells",
    "known_fraction": "known_share",
    "leave_one_out": "left_out",
    "pixel": "cell",
    "pixel_deg": "cell_deg",
    "pixel_um": "cell_um",
    "pixels": "cells",
    "psf_pixels": "psf_cells",
    "residual": "misfit",
    "residual_pixels": "misfit_cells",
    "residual_varying": "misfit_varying",
    "saturated_fraction": "saturated_share",
    "sensor_pixels": "sensor_cells",
    "sensor_pixels_per_pixel": "pixels_per_cell",
    "support": "region",
    "support_fraction": "support_share",
    "unknown_fraction": "unknown_share",
    "width_pixels": "width_cells",
}
"""Keys of summaries by what the version before called them."""


def with_former_keys(summary: Mapping[str, Any]) -> dict[str, Any]:
    """A summary with its figures under the keys of the version before, too.

    Scripts that read `--json` or a record go on for one version. ``former_keys`` says which keys
    are going, and what each is called now.
    """
    former: dict[str, str] = {}

    def widened(value: Any) -> Any:
        if isinstance(value, Mapping):
            items = {key: widened(each) for key, each in value.items()}
            renamed = {_FORMER_KEYS[key]: key for key in items if key in _FORMER_KEYS}
            former.update(renamed)
            return items | {old: items[new] for old, new in renamed.items()}
        return [widened(each) for each in value] if isinstance(value, list | tuple) else value

    result: dict[str, Any] = widened(summary)
    return result | ({"former_keys": dict(sorted(former.items()))} if former else {})


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
        Writes all files, all or none. None writes them as they are, into the folder of the
        options where they have one.
    """

    value: Value
    figures: Mapping[str, Any]
    writers: Mapping[Path, Writer] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    history: list[dict[str, float]] = field(default_factory=list)
    outputs: tuple[Path, ...] | None = None
    commit: Callable[[Mapping[Path, Writer]], None] | None = None


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

    def begin_simulation(self, loaded: "LoadedCamera", working: float, remedy: str) -> None:
        """Begin work with a simulated camera, whose relief is computed first.

        Parameters
        ----------
        loaded
            The camera.
        working
            Bytes that are held at once beside its relief.
        remedy
            What would need less, as the end of a sentence.

        Raises
        ------
        OptionError
            If the machine has less memory than that.
        """
        self.begin(check_simulation_memory(loaded, working, self.device, remedy))
        self.reporter.advance("mask", 0.0)

    def begin(self, needed: float = 0.0) -> None:
        """Say that all is read and checked: from here on the work takes its time.

        The files are hashed while they are as they were read, and work that takes much memory is
        announced.

        Parameters
        ----------
        needed
            Bytes that the work holds at once.

        Raises
        ------
        FileError
            If one of them cannot be read any more.
        """
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
        if product.commit is not None:
            product.commit(writers)
        elif options.output_folder is not None:
            write_into(options.output_folder, writers)
        else:
            write_together(writers)
        return Result(product.value, summary)

    def _write_record(self, product: Product[Any], summary: dict[str, Any], path: Path) -> None:
        summary["seconds"] = self.clock.seconds  # With all that was written.
        record = RunRecord(
            started=self.clock.started,
            inputs=self.inputs,
            parameters={
                **self.options.model_dump(mode="json", by_alias=True),
                **product.parameters,
            },
            result=with_former_keys(summary),
            history=product.history,
            warnings=self.warnings,
        )
        write_record(path, record)


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
