"""The studio as a web application: its routes, its page, and what it answers when things fail."""

import asyncio
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from fastapi.staticfiles import StaticFiles

from nolens import __version__
from nolens.capture import available_sources
from nolens.errors import FileError, NolensError
from nolens.files.input import readable
from nolens.studio.files import files_router
from nolens.studio.job_kinds import KINDS
from nolens.studio.jobs import JobQueue, NoSuchJobError, TooManyJobsError, jobs_router
from nolens.studio.live import SCENE_BYTES, SCENE_PATH, LiveHub, live_router
from nolens.studio.requests import answered
from nolens.studio.schemas import SCENES, About, LiveStart, SceneInfo, SourceInfo, Trouble
from nolens.studio.security import Guard, Rules
from nolens.studio.worker import WorkerDiedError
from nolens.studio.workspace import Workspace

UPLOAD_BYTES = 1_000_000_000
_PAGE = Path(__file__).with_name("page")
_MOST_REASONS = 3
_LONGEST_DETAIL = 1000


@dataclass(frozen=True)
class Studio:
    """What a studio is started with.

    Parameters
    ----------
    workspace
        Its folders.
    host
        Address that it is served on.
    token
        That every request must have; None on loopback.
    source
        Of the live view, started at once; None for none.
    upload_bytes
        The most that one upload may have.
    say
        Tells a person at the terminal.
    """

    workspace: Workspace
    host: str = "127.0.0.1"
    token: str | None = None
    source: str | None = "auto"
    upload_bytes: int = UPLOAD_BYTES
    say: Callable[[str], None] = print


def create_app(studio: Studio) -> FastAPI:
    """The application; its processes live as long as it runs.

    Parameters
    ----------
    studio
        What it is started with.
    """
    workspace = studio.workspace
    hub, queue = LiveHub(workspace, studio.say), JobQueue(workspace)
    # Threads that read folders: few, since they take turns with the loop; one for what the page
    # cannot do without, so that it need not wait for the others.
    reading, looking = ThreadPoolExecutor(2, "files"), ThreadPoolExecutor(1, "about")

    @asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        if studio.source is not None:
            hub.begin(LiveStart(source=studio.source))
        queue.start()
        try:
            yield
        finally:
            await asyncio.gather(hub.close(), queue.close())
            for pool in (reading, looking):
                pool.shutdown(wait=False, cancel_futures=True)

    app = FastAPI(
        title="nolens studio",
        version=__version__,
        lifespan=life,
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/openapi.json",
        responses={"4XX": {"model": Trouble}},
    )

    @app.get("/api/about", response_model=About)
    async def about() -> Response:
        return await answered(looking, lambda: _about(studio))

    for router in (files_router(workspace, reading), live_router(hub), jobs_router(queue)):
        app.include_router(router)
    app.mount("/", StaticFiles(directory=_PAGE, html=True), name="page")
    app.state.live, app.state.jobs = hub, queue
    _answer_errors(app)
    limits = {"/api/uploads": studio.upload_bytes, SCENE_PATH: SCENE_BYTES}
    app.add_middleware(Guard, rules=Rules(studio.host, studio.token, limits))
    return app


def _about(studio: Studio) -> About:
    workspace = studio.workspace
    return About(
        version=__version__,
        folders=workspace.folders,
        cameras=workspace.cameras(),
        sources=[SourceInfo(**vars(each)) for each in available_sources()],
        scenes=[SceneInfo(id=name, label=label) for name, label in SCENES.items()],
        upload_bytes=studio.upload_bytes,
        kinds=list(KINDS),
    )


def _answer_errors(app: FastAPI) -> None:
    """Every error that the user can correct, as text."""

    @app.exception_handler(NolensError)
    async def refused(request: Request, error: NolensError) -> JSONResponse:
        status = 422
        missing = isinstance(error, FileError) and request.method == "GET"
        if missing or isinstance(error, NoSuchJobError):
            status = 404
        elif isinstance(error, TooManyJobsError):
            status = 429
        elif isinstance(error, WorkerDiedError):
            status = 503
        return _trouble(status, str(error))

    @app.exception_handler(RequestValidationError)
    async def malformed(request: Request, error: RequestValidationError) -> JSONResponse:
        errors = error.errors()
        reasons = []
        for each in errors[:_MOST_REASONS]:
            place = ".".join(str(part) for part in each["loc"][1:]) or str(each["loc"][0])
            message = each["msg"][:1].lower() + each["msg"][1:]
            reasons.append(f"{place}: {message}")
        if len(errors) > _MOST_REASONS:
            reasons.append(f"and {len(errors) - _MOST_REASONS} more")
        return _trouble(422, "; ".join(reasons))


def _trouble(status: int, text: str) -> JSONResponse:
    text = readable(text)
    if len(text) > _LONGEST_DETAIL:
        text = f"{text[:_LONGEST_DETAIL]}..."
    return JSONResponse({"detail": text}, status_code=status)
