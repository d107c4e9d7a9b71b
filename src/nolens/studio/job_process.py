"""The process that works on jobs, one at a time; it checks others meanwhile."""

import math
import os
import queue
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import nolens.jobs
from nolens.design.preview import with_thickness
from nolens.errors import FileError, NolensError, OptionError
from nolens.files import CAMERA_FILE, atomic_write, read_camera, write_into
from nolens.files.cameras import camera_copies, write_description
from nolens.files.plots import dark_plots
from nolens.jobs.designing.look import Thicknesses
from nolens.jobs.options import JobOptions, Option, choices_of, default_text
from nolens.jobs.run import Job, Reporter
from nolens.progress import Pace
from nolens.solvers import Progress
from nolens.studio.job_kinds import KINDS, Place
from nolens.studio.pixel_values import pixel_values
from nolens.studio.schemas import JobKind
from nolens.studio.worker import Channel, Message

_EVERY_S = 0.1


class _CancelledError(BaseException):
    """A person cancelled work that does not go in steps: nothing of it is kept."""


def main(channel: Channel) -> None:
    """Do what the server sends, until it ends."""
    work: queue.SimpleQueue[Message] = queue.SimpleQueue()
    cancelled: set[str] = set()
    threading.Thread(target=_listen, args=(channel, work, cancelled), daemon=True).start()
    while True:
        _, identity, kind, options, folder = work.get()
        _work(channel, cancelled, Place(Path(folder), identity), kind, options)


def _listen(channel: Channel, work: "queue.SimpleQueue[Message]", cancelled: set[str]) -> None:
    for message in channel.messages():
        if message[0] == "run":
            work.put(message)
        elif message[0] == "cancel":
            cancelled.add(message[1])
        elif message[2] == "declarations":
            _answer(channel, message[1], declarations)
        elif message[2] == "pixels":
            _, number, _, path, camera = message
            _answer(channel, number, partial(pixel_values, Path(path), camera))
        else:
            _, number, _, identity, kind, options, folder = message
            place = Place(Path(folder), identity)
            _answer(channel, number, partial(_check, kind, options, place))
    # Work that is going on would hold the process for as long as it takes.
    os._exit(0)


def _check(kind: JobKind, options: Mapping[str, Any], place: Place) -> None:
    _prepare(kind, options, place)


def _answer(channel: Channel, number: int, work: Callable[[], Any]) -> None:
    """Answer with the result of some work, or with what is wrong."""
    try:
        answer = work()
    except NolensError as error:
        channel.answer(number, refused=str(error))
    except Exception as error:
        traceback.print_exc()
        channel.answer(number, refused=f"a bug in nolens: {type(error).__name__}: {error}")
    else:
        channel.answer(number, answer)


def _work(
    channel: Channel, cancelled: set[str], place: Place, kind: JobKind, options: dict[str, Any]
) -> None:
    reporter = ChannelReporter(channel, place.id, cancelled)
    try:
        job = _prepare(kind, options, place)
        try:
            job.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileError(f"cannot make {job.folder}: {error.strerror or error}") from None
        summary = _finite(job.run(reporter))
    except _CancelledError:
        channel.send("cancelled", place.id, None)
    except NolensError as error:
        channel.send("failed", place.id, str(error))
    except MemoryError:
        channel.send("failed", place.id, "there is not enough memory for this")
    except Exception as error:
        traceback.print_exc()
        where = traceback.extract_tb(error.__traceback__)[-1]
        channel.send(
            "failed",
            place.id,
            f"this is a bug in nolens: {type(error).__name__}: {error} "
            f"({Path(where.filename).name}, line {where.lineno})",
        )
    else:
        reporter.flush()
        ended = "cancelled" if reporter.stopped else "done"
        channel.send(ended, place.id, summary)


class _PreparedJob(NamedTuple):
    """A job whose options were read: the folder that must exist for it, and what does it."""

    folder: Path
    run: Callable[[Reporter], dict[str, Any]]


def _prepare(kind: JobKind, options: Mapping[str, Any], place: Place) -> _PreparedJob:
    """Read the options of a job, with real paths, as its command does.

    Raises
    ------
    NolensError
        If an option cannot be used.
    """
    about, job = KINDS[kind], _job(kind)
    values = {name: value for name, value in options.items() if name not in about.own}
    _check_names(kind, job.options, values)
    _check_texts(values)
    thickness = options.get("thickness") if "thickness" in about.own else None
    changed = None if thickness is None else Thicknesses.gather({"thickness": thickness})
    outputs = about.outputs(options, place)
    values |= outputs
    read = job.options.gather(values)
    first = next(iter(outputs.values()))

    def run(reporter: Reporter) -> dict[str, Any]:
        prepared = read
        if changed is not None:
            camera = _changed_camera(values["camera"], changed, place)
            prepared = job.options.gather({**values, "camera": camera})
        with dark_plots() as dark:
            summary = dict(job(prepared, reporter).summary)
        plot = outputs.get("plot")
        if dark and isinstance(plot, Path):
            path = plot.with_suffix(".dark.png")
            with atomic_write(path) as temporary:
                temporary.write_bytes(dark[-1])
            summary["outputs"] = [*summary.get("outputs", []), str(path)]
        return summary

    return _PreparedJob((first[0] if isinstance(first, tuple) else first).parent, run)


def declarations() -> dict[JobKind, dict[str, dict[str, Any]]]:
    """The options of every kind of job, as `JobOption` has them."""
    declared: dict[JobKind, dict[str, dict[str, Any]]] = {}
    for kind, about in KINDS.items():
        model = _job(kind).options
        declared[kind] = {
            name: _declaration(model, field, name) for name, field in model.spellings().items()
        } | {
            name: {"label": label, "help": "", "role": "value"} for name, label in about.own.items()
        }
    return declared


def _declaration(model: type[JobOptions], field: str, name: str) -> dict[str, Any]:
    option = Option.of(model, field)
    return {
        "label": "" if name == option.former else option.label,
        "help": option.help,
        "role": option.role,
        "group": option.group,
        "default": default_text(model, field),
        "choices": list(choices_of(model.model_fields[field].annotation)),
    }


def _job(kind: JobKind) -> Job[JobOptions, Any]:
    job: Job[JobOptions, Any] = getattr(nolens.jobs, KINDS[kind].job)
    return job


def _check_names(kind: JobKind, model: type[JobOptions], values: Mapping[str, Any]) -> None:
    for name in values:
        if name not in model.spellings():
            known = [each for each in model.model_fields if Option.of(model, each).role != "output"]
            raise OptionError(
                f"there is no option {name!r} of {kind}; known are {', '.join(known)}"
            )


def _check_texts(values: Mapping[str, Any]) -> None:
    """Refuse text that no option takes, and that the system would stumble over."""
    for name, value in values.items():
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, str) and "\0" in each:
                raise OptionError(f"{name} is {each!r}: no option has such a character")


def _changed_camera(name: str, changed: Thicknesses, place: Place) -> str:
    """Folder of a camera like another one, but for the thickness of layers."""
    loaded = read_camera(name)
    camera = with_thickness(loaded, changed.thickness).camera
    folder = place.folder / "camera"
    writers = camera_copies(name, loaded) | {CAMERA_FILE: partial(write_description, camera=camera)}
    write_into(folder, {folder / file: write for file, write in writers.items()})
    return str(folder)


class ChannelReporter(Reporter):
    """Reports to the server how far a job is; whoever waits there may cancel it.

    Parameters
    ----------
    channel
        To the server.
    identity
        Of the job.
    cancelled
        Jobs that were cancelled.
    """

    def __init__(self, channel: Channel, identity: str, cancelled: set[str]) -> None:
        self.stopped = False
        self._channel, self._identity, self._cancelled = channel, identity, cancelled
        self._rows: list[dict[str, float | None]] = []
        self._reported = 0.0
        self._work, self._pace = "", Pace()

    def note(self, text: str) -> None:
        """Say something a person should know before it happens."""
        self._channel.send("note", self._identity, text)
        self._check()

    def warn(self, text: str) -> None:
        """Say what may make the result worse than it could be."""
        self._channel.send("warning", self._identity, text)

    def advance(self, what: str, fraction: float) -> None:
        """Report how much of a piece of work is done; a cancelled one ends here."""
        self._check()
        self._progress(what, fraction, None, None)

    def step(self, what: str, done: int, limit: int, result: str, state: str = "") -> bool:
        """Report how many steps are done; True ends a cancelled job."""
        self._progress(what, done / limit, done, limit)
        self.stopped = self._identity in self._cancelled
        return self.stopped

    def progress(self, progress: Progress, limit: int) -> bool:
        """Report an iteration; True ends a cancelled job."""
        row = {
            "iteration": progress.iteration,
            "objective": progress.objective,
            "residual": progress.residual,
            "scene_step": progress.scene_change,
        }
        self._rows.append({name: _number(value) for name, value in row.items()})
        return self.step("iteration", progress.iteration, limit, "the picture")

    def flush(self) -> None:
        """Send what was held back."""
        if self._rows:
            self._channel.send("rows", self._identity, self._rows)
            self._rows = []

    def _check(self) -> None:
        if self._identity in self._cancelled:
            raise _CancelledError

    def _progress(self, what: str, fraction: float, done: int | None, limit: int | None) -> None:
        now, left = time.monotonic(), self._pace.seconds_left(what, fraction)
        if now - self._reported < _EVERY_S and fraction < 1 and what == self._work:
            return
        self._reported, self._work = now, what
        self.flush()
        progress = {
            "what": what,
            "fraction": fraction,
            "done": done,
            "limit": limit,
            "seconds_left": left,
        }
        self._channel.send("progress", self._identity, progress)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _finite(value: Any) -> Any:
    """A value as JSON has it: NaN and infinity are nothing, tuples are lists."""
    if isinstance(value, dict):
        return {str(key): _finite(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(each) for each in value]
    return _number(value) if isinstance(value, float) else value
