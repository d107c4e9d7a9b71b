"""Running of a batch: what is missing goes through workers, and what comes back is written."""

import hashlib
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from nolens import __version__
from nolens.engine import Manifest, Work, run_items, worker_count
from nolens.errors import FileError
from nolens.files.formats import FrameSequence
from nolens.jobs.batch.options import BatchOptions
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run
from nolens.machine import gigabytes

_FAILURES_TOLD = 5
"""Items that fail with a warning each; of more, the record has all."""
DIGITS = 16
"""Of a hash that tells one file from another."""

Paths = Callable[[str, str], Path]
"""File of an item, by its key and the name of the result."""


@dataclass(frozen=True)
class Answer:
    """What a worker hands back of an item.

    Parameters
    ----------
    files
        Content of each file by the name of the result.
    row
        Figures, in values that JSON has.
    """

    files: Mapping[str, bytes]
    row: Mapping[str, Any]


def open_manifest(
    run: Run[Any], frames: FrameSequence, more: Mapping[str, str] | None = None
) -> Manifest:
    """The manifest of the output folder, for these frames and options, and what else matters.

    Raises
    ------
    NolensError
        As `Manifest.open`.
    """
    return Manifest.open(run.options.output, {**_about(run, frames), **(more or {})}, frames.names)


def run_batch(
    run: Run[Any],
    manifest: Manifest,
    frames: FrameSequence,
    load: Callable[[int], Any],
    work: Work,
    needed: float,
    paths: Paths,
) -> Product[None]:
    """Do the work with every item that is not done yet, and write what comes of each.

    Parameters
    ----------
    run
        Of the batch; it has begun.
    manifest
        Of its folder.
    frames
        All items.
    load
        Gives an item by its number.
    work
        For each; it gives an `Answer`.
    needed
        Bytes that a worker holds at once.
    paths
        Where results go.

    Raises
    ------
    NolensError
        If a result cannot be written, or there are no workers. What was written is kept.
    """
    options: BatchOptions = run.options
    numbers = {name: number for number, name in enumerate(frames.names)}
    missing = manifest.missing
    items = [(key, partial(load, numbers[key])) for key in missing]
    count, ended, failed = len(frames), "end of the set", 0
    done = count - len(missing)
    if 0 < done < count:
        run.reporter.note(f"{done} of {count} are done already, and stay as they are")
    workers = _workers(run, needed) if missing else 0
    outcomes = run_items(
        items,
        work,
        workers=min(workers, len(missing)),
        scheduler=options.scheduler,
        note=run.reporter.note,
    )
    with closing(outcomes):
        for outcome in outcomes:
            if outcome.error:
                manifest.fail(outcome.key, outcome.error, outcome.attempts)
                failed += 1
                text = f"{outcome.key} failed: {outcome.error}"
                run.warn(text, aloud=failed <= _FAILURES_TOLD)
            else:
                answer: Answer = outcome.value
                writers = {
                    paths(outcome.key, name): partial(Path.write_bytes, data=content)
                    for name, content in answer.files.items()
                }
                try:
                    manifest.keep(outcome.key, answer.row, writers)
                except FileError as error:
                    raise FileError(
                        f"{error}. The {done} that are done are kept; the same command goes on"
                    ) from error
                done += 1
            if run.reporter.step("item", done + failed, count, "what is done"):
                ended = "interrupted"
                break
    if failed > _FAILURES_TOLD:
        run.reporter.warn(f"{failed - _FAILURES_TOLD} more failed: {options.record} says why")
    made = done - count + len(missing)
    return batch_product(run, manifest, made=made, stop_reason=ended)


def batch_product(
    run: Run[Any], manifest: Manifest, *, made: int = 0, stop_reason: str = "interrupted"
) -> Product[None]:
    """The batch as it stands: counts, failures, and for the record a row for each item.

    Parameters
    ----------
    run
        Of the batch.
    manifest
        Of its folder.
    made
        Items that this run has done.
    stop_reason
        Why it ended.
    """
    done, failed = manifest.rows("done"), manifest.rows("failed")
    figures = {
        "items": sum(manifest.counts.values()),
        "done": len(done),
        "made": made,
        "failed": {key: row["error"] for key, row in failed.items()},
        "stop_reason": stop_reason,
    }
    table = [{"item": key, **row} for key, row in {**done, **failed}.items()]
    return Product(None, figures, parameters={"rows": table}, outputs=(run.options.output,))


def _workers(run: Run[Any], needed: float) -> int:
    """Worker processes, as stated or as many as there is room for, which is said."""
    options: BatchOptions = run.options
    if options.scheduler is not None:
        return 0
    if options.workers is not None:
        return options.workers
    count = 1 if run.device.type == "cuda" else worker_count(needed)
    run.reporter.note(
        f"{count} worker processes, by the cores and the free memory of this machine; each takes "
        f"about {gigabytes(needed)} (--workers says another number)"
    )
    return count


def _about(run: Run[Any], frames: FrameSequence) -> dict[str, str]:
    """What the results depend on, by name: versions, options, and the content of inputs."""
    options: BatchOptions = run.options
    model = type(options)
    about = {"version of nolens": __version__, "job": model.__name__}
    for name in model.model_fields:
        if name not in options.own and Option.of(model, name).role != "input":
            about[model.flag(name)] = str(getattr(options, name))
    about |= {f"file: {role}": file.sha256[:DIGITS] for role, file in run.inputs.items()}
    sizes = [_size(path) for path in frames.sources]
    listing = repr([*frames.names, *sizes]).encode()
    about["set of frames (names and sizes)"] = hashlib.sha256(listing).hexdigest()[:DIGITS]
    return about


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0
