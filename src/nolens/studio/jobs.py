"""The queue of jobs: what was requested, how far it is, and its result; and their routes."""

import asyncio
import secrets
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from pydantic import ValidationError

from nolens.documents import parse_json
from nolens.errors import DataError, FileError, NolensError
from nolens.files.atomic import atomic_write
from nolens.files.input import read_text, readable
from nolens.studio.job_kinds import KINDS, title_of, with_paths
from nolens.studio.requests import JsonRoute
from nolens.studio.schemas import (
    ENDED,
    Job,
    JobDeclarations,
    JobId,
    JobOption,
    JobProgress,
    JobRequest,
    Jobs,
    JobShort,
    Status,
)
from nolens.studio.worker import Message, RefusedError, Worker
from nolens.studio.workspace import JOBS, WORK, Workspace, is_name

_TARGET = "nolens.studio.job_process:main"
_RECORD = "job.json"
_GRACE_S = 5.0
_CHECK_S = 60.0
_MOST_JOBS = 300
_MOST_BRIEF = 20
_MOST_QUEUED = 50
_MOST_ROWS = 5000
_MOST_TEXTS = 200
_Path = Annotated[str, Query(max_length=1000)]


class NoSuchJobError(NolensError):
    """A job that nobody knows."""


class TooManyJobsError(NolensError):
    """As many jobs are waiting as may."""


class JobQueue:
    """Jobs of one studio, one running at a time in a process of their own.

    Parameters
    ----------
    workspace
        Where they read and write.
    """

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._jobs: dict[str, Job] = {}
        self._resolved: dict[str, dict[str, Any]] = {}
        self._queue: list[str] = []
        self._checking: set[str] = set()
        self._running: str | None = None
        self._cancelling = False
        self._worker: Worker | None = None
        self._grace: asyncio.TimerHandle | None = None
        self._declarations: JobDeclarations | None = None
        # One thread, so that what is written first is first on the disk.
        self._disk = ThreadPoolExecutor(1, "jobs")
        self._load()

    def all(self) -> list[JobShort]:
        """Every job, the newest first."""
        return [JobShort.model_validate(dict(each)) for each in reversed(self._jobs.values())]

    def job(self, identity: str) -> Job:
        """One of them.

        Raises
        ------
        NoSuchJobError
            If there is none of this name.
        """
        if identity not in self._jobs:
            raise NoSuchJobError(f"there is no job {identity[:100]!r}")
        return self._jobs[identity]

    @property
    def pid(self) -> int | None:
        """Number of the process, while there is one."""
        return None if self._worker is None else self._worker.pid

    async def submit(self, request: JobRequest) -> Job:
        """Check the options as the command would, and put the job into the queue.

        Raises
        ------
        TooManyJobsError
            If as many are waiting as may.
        NolensError
            If an option cannot be used; the text is the command's.
        """
        # Its place and name are taken before anything is waited for: others ask meanwhile.
        if len(self._queue) + len(self._checking) >= _MOST_QUEUED:
            raise TooManyJobsError(
                f"{_MOST_QUEUED} jobs are waiting already: wait for one, or cancel one"
            )
        identity = self._new_id(request.kind)
        self._checking.add(identity)
        try:
            options = await self._checked(identity, request)
        finally:
            self._checking.discard(identity)
        job = Job(
            id=identity,
            kind=request.kind,
            title=title_of(request.kind, request.options),
            status="queued",
            options=dict(request.options),
        )
        self._jobs[identity], self._resolved[identity] = job, options
        place = len(self._queue)
        if _is_brief(job):  # Before the first that is not.
            waiting = [_is_brief(self._jobs[each]) for each in self._queue]
            place = waiting.index(False) if False in waiting else place
        self._queue.insert(place, identity)
        self._next()
        return job

    async def declarations(self) -> JobDeclarations:
        """The options of every kind of job; the process that works on jobs has them.

        Raises
        ------
        RefusedError
            If that process cannot be started.
        """
        if self._declarations is None:
            kinds = await self._working().request("declarations", seconds=_CHECK_S)
            self._declarations = JobDeclarations(kinds=kinds)
        return self._declarations

    async def pixels(self, path: str, camera: str | None) -> bytes:
        """Values of a file's pixels, as `pixel_values` packs them.

        Raises
        ------
        NolensError
            If the file cannot be read; the text is for a person.
        """
        loop = asyncio.get_running_loop()
        given = {"path": path, "camera": camera}
        declared = {
            "path": JobOption(label="", help="", role="input"),
            "camera": JobOption(label="", help="", role="camera"),
        }
        real = await loop.run_in_executor(self._disk, with_paths, declared, given, self._workspace)
        values: bytes = await self._working().request(
            "pixels", real["path"], real.get("camera"), seconds=_CHECK_S
        )
        return values

    async def _checked(self, identity: str, request: JobRequest) -> dict[str, Any]:
        """Options of a new job, with real paths."""
        loop = asyncio.get_running_loop()
        declared = (await self.declarations()).kinds[request.kind]
        options = await loop.run_in_executor(
            self._disk, with_paths, declared, request.options, self._workspace
        )
        work = str(self._workspace.work)
        await self._working().request(
            "check", identity, request.kind, options, work, seconds=_CHECK_S
        )
        return options

    def cancel(self, identity: str) -> Job:
        """End a job: one that runs may write what it has so far, and is killed if it does not end.

        Raises
        ------
        NoSuchJobError
            If there is none of this name.
        """
        job = self.job(identity)
        if job.status == "queued":
            self._queue.remove(identity)
            self._end(job, "cancelled")
        elif identity == self._running and not self._cancelling and self._worker is not None:
            self._cancelling = True
            with suppress(RefusedError):
                self._worker.send("cancel", identity)
            self._grace = asyncio.get_running_loop().call_later(_GRACE_S, self._worker.kill)
        return job

    def start(self) -> None:
        """Start the process before there is a job for it: it takes seconds."""
        self._working()

    async def close(self) -> None:
        """End the process; a job that runs is lost, and has failed."""
        worker, self._worker = self._worker, None
        if self._running is not None:
            self._end(self._jobs[self._running], "failed", "the studio was stopped while it ran")
        for identity in self._queue:
            self._end(self._jobs[identity], "cancelled")
        self._queue = []
        if worker is not None:
            await worker.stop(0.2)
        await asyncio.to_thread(self._disk.shutdown)

    def _working(self) -> Worker:
        if self._worker is None:
            loop = asyncio.get_running_loop()

            def on_message(message: Message) -> None:
                about, identity, *content = message
                # Paths are looked up here, in the worker's thread.
                named = self._workspace.named(content)
                with suppress(RuntimeError):  # The loop is closed.
                    loop.call_soon_threadsafe(self._received, about, identity, *named)

            folders = self._workspace.paths
            self._worker = Worker("nolens-jobs", _TARGET, folders, on_message, self._died)
        return self._worker

    def _next(self) -> None:
        if self._running is not None or not self._queue:
            return
        job = self._jobs[self._queue.pop(0)]
        options = self._resolved[job.id]
        job.status, job.started = "running", time.time()
        self._running, self._cancelling = job.id, False
        self._store(job)
        try:
            self._working().send("run", job.id, job.kind, options, str(self._workspace.work))
        except (RefusedError, OSError) as error:
            self._end(job, "failed", f"the process for jobs cannot be started: {error}")

    def _received(self, about: str, identity: str, *content: Any) -> None:
        """A message of the process; of a job that has ended meanwhile it means nothing."""
        if identity != self._running:
            return
        job = self._jobs[identity]
        handlers: dict[str, Callable[..., None]] = {
            "progress": self._progress,
            "rows": self._rows,
            "note": lambda job, text: _add_text(job.notes, text),
            "warning": lambda job, text: _add_text(job.warnings, text),
            "done": self._done,
            "cancelled": lambda job, summary: self._done(job, summary, "cancelled"),
            "failed": lambda job, text: self._end(job, "failed", text),
        }
        handlers[about](job, *content)

    def _progress(self, job: Job, progress: dict[str, Any]) -> None:
        job.progress = JobProgress(**progress)

    def _rows(self, job: Job, rows: list[dict[str, float | None]]) -> None:
        job.history.extend(rows[: _MOST_ROWS - len(job.history)])

    def _done(self, job: Job, summary: dict[str, Any] | None, status: Status = "done") -> None:
        if summary is not None:
            job.summary = summary
            # What lies in no named folder kept its whole path.
            outputs = summary.get("outputs", [])
            job.outputs = [each for each in outputs if not Path(each).is_absolute()]
        self._end(job, status)

    def _end(self, job: Job, status: Status, error: str | None = None) -> None:
        job.status, job.error, job.ended = status, error, time.time()
        self._resolved.pop(job.id, None)
        if self._grace is not None and job.id == self._running:
            self._grace.cancel()
            self._grace = None
        if job.id == self._running:
            self._running = None
        self._store(job)
        self._prune()
        self._next()

    def _died(self, reason: str) -> None:
        if self._worker is None:  # It was ended on purpose.
            return
        self._worker = None
        if self._running is None:
            return
        job = self._jobs[self._running]
        if self._cancelling:
            _add_text(job.notes, f"it did not end within {_GRACE_S:g} s, and was killed")
            self._end(job, "cancelled")
        else:
            self._end(job, "failed", f"the process that worked on it {reason}")

    def _new_id(self, kind: str) -> str:
        while True:
            now = datetime.now().astimezone()
            identity = f"{now:%Y%m%d-%H%M%S}-{kind}-{secrets.token_hex(2)}"
            if identity not in self._jobs and identity not in self._checking:
                return identity

    def _prune(self) -> None:
        """Forget the oldest jobs, and take away what looks and previews wrote long ago."""
        brief = [
            each.id for each in self._jobs.values() if each.status in ENDED and _is_brief(each)
        ]
        for identity in brief[:-_MOST_BRIEF]:
            del self._jobs[identity]
            self._disk.submit(self._workspace.remove_job, identity)
        ended = [each.id for each in self._jobs.values() if each.status in ENDED]
        for identity in ended[: max(0, len(self._jobs) - _MOST_JOBS)]:
            del self._jobs[identity]

    def _store(self, job: Job) -> None:
        """Write the state of a job, so that the studio finds it when it is started again."""
        loop, record = asyncio.get_running_loop(), job.model_dump_json(indent=1)

        def written(done: Future[None]) -> None:
            error = done.exception()
            if error is not None:
                text = f"this job is not kept beyond this run of the studio: {error}"
                with suppress(RuntimeError):  # The loop is closed.
                    loop.call_soon_threadsafe(_add_text, job.warnings, readable(text))

        self._disk.submit(self._write, job.id, record).add_done_callback(written)

    def _write(self, identity: str, text: str) -> None:
        folder = self._workspace.make(f"{JOBS}/{identity}")
        with atomic_write(folder / _RECORD) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def _load(self) -> None:
        folder = self._workspace.work / JOBS
        with suppress(OSError):  # There is none, or it may not be read.
            names = sorted(each.name for each in folder.iterdir() if is_name(each.name))
            for name in names[-_MOST_JOBS:]:
                try:
                    job = self._read(name)
                except NolensError as error:
                    job = Job(
                        id=name,
                        kind="",
                        title=f"{name}/{_RECORD}",
                        status="failed",
                        error=readable(str(error)),
                    )
                if job is not None:
                    self._jobs[name] = job
        self._prune()

    def _read(self, name: str) -> Job | None:
        """A job of an earlier run; None where it has no record.

        Raises
        ------
        NolensError
            If the record is no job, or cannot be read.
        """
        text = f"{WORK}/{JOBS}/{name}/{_RECORD}"
        try:
            path = self._workspace.resolve(text)
        except FileError:
            return None
        try:
            job = Job.model_validate(parse_json(read_text(path, "JSON"), text))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(map(str, first["loc"]))
            raise DataError(f"{text} is no job: {place}: {first['msg']}") from None
        if job.id != name:
            raise DataError(f"{text} is the job {job.id[:80]!r}, and not that of its folder")
        if job.kind not in KINDS:
            raise DataError(f"{text} is a job of the unknown kind {job.kind[:80]!r}")
        if job.status not in ENDED:
            job.status, job.error = "failed", "the studio was stopped while it ran"
        return job


def _is_brief(job: Job) -> bool:
    return any(kind.brief for name, kind in KINDS.items() if name == job.kind)


def _add_text(texts: list[str], text: str) -> None:
    if len(texts) < _MOST_TEXTS:
        texts.append(text)


def jobs_router(queue: JobQueue) -> APIRouter:
    """Routes of jobs, and of what their process reads for the page."""
    router = APIRouter(prefix="/api/jobs", route_class=JsonRoute)

    @router.get(
        "/pixels",
        response_class=Response,
        responses={200: {"content": {"application/octet-stream": {}}, "description": "Values"}},
    )
    async def pixels(path: _Path, camera: _Path | None = None) -> Response:
        return Response(await queue.pixels(path, camera), media_type="application/octet-stream")

    @router.get("")
    async def jobs() -> Jobs:
        return Jobs(jobs=queue.all())

    @router.post("", status_code=201)
    async def submit(request: JobRequest) -> JobId:
        return JobId(id=(await queue.submit(request)).id)

    @router.get("/options")
    async def options() -> JobDeclarations:
        return await queue.declarations()

    @router.get("/{identity}")
    async def job(identity: str) -> Job:
        return queue.job(identity)

    @router.post("/{identity}/cancel")
    async def cancel(identity: str) -> Job:
        return queue.cancel(identity)

    return router
