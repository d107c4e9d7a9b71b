"""What runs a job: checks, hashes, reports, writes all or nothing, and keeps the record."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial, wraps
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch

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
from nolens.jobs.clock import Clock
from nolens.jobs.cost import announce
from nolens.jobs.device import pick_device
from nolens.jobs.options import JobOptions, check_apart
from nolens.jobs.reporter import Reporter

Writer = Callable[[Path], None]
"""Writes one file when it is given a path."""
Options = TypeVar("Options", bound=JobOptions)
Value = TypeVar("Value")


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
        announce(needed, self.reporter)

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
            result=summary,
            history=product.history,
            warnings=self.warnings,
        )
        write_record(path, record)


def job(
    work: Callable[[Run[Options]], Product[Value]],
) -> Callable[[Options, Reporter], Result[Value]]:
    """Make a job of its work: ``@job`` before ``def refocus(run: Run[RefocusOptions]) -> ...``.

    Outputs are checked before the work begins, and nothing is written unless all of it went well.
    """

    @wraps(work)
    def run_job(options: Options, reporter: Reporter) -> Result[Value]:
        run = Run(options, reporter)
        return run.finish(work(run))

    return run_job
