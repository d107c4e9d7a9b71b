"""The studio as a web application: its routes, its page, and what it answers when things fail."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from fastapi.staticfiles import StaticFiles

from nolens import __version__
from nolens.capture.sources import available_sources
from nolens.errors import FileError, NolensError
from nolens.studio.job_kinds import KINDS
from nolens.studio.jobs import JobQueue, NoSuchJobError
from nolens.studio.live import LiveHub
from nolens.studio.routes_files import files_router
from nolens.studio.routes_jobs import jobs_router
from nolens.studio.routes_live import SCENE_BYTES, SCENE_PATH, live_router
from nolens.studio.scene_names import SCENES
from nolens.studio.schemas import About, LiveStart, SceneInfo, SourceInfo, Trouble
from nolens.studio.security import Guard, Rules
from nolens.studio.worker import WorkerDiedError
from nolens.studio.workspace import Workspace

UPLOAD_BYTES = 1_000_000_000
_PAGE = Path(__file__).with_name("page")


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

    @asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        if studio.source is not None:
            hub.begin(LiveStart(source=studio.source))
        queue.start()
        try:
            yield
        finally:
            await asyncio.gather(hub.close(), queue.close())

    app = FastAPI(
        title="nolens studio", version=__version__, lifespan=life, docs_url=None, redoc_url=None,
        openapi_url="/api/openapi.json", responses={"4XX": {"model": Trouble}},
    )  # fmt: skip

    @app.get("/api/about")
    def about() -> About:
        found = [SourceInfo(**vars(each)) for each in available_sources()]
        return About(
            version=__version__,
            folders=workspace.folders,
            cameras=workspace.cameras(),
            sources=found,
            scenes=[SceneInfo(id=name, label=label) for name, label in SCENES.items()],
            upload_bytes=studio.upload_bytes,
            kinds=list(KINDS),
        )

    for router in (files_router(workspace), live_router(hub), jobs_router(queue)):
        app.include_router(router)
    app.mount("/", StaticFiles(directory=_PAGE, html=True), name="page")
    app.state.live, app.state.jobs = hub, queue
    _answer_errors(app)
    limits = {"/api/uploads": studio.upload_bytes, SCENE_PATH: SCENE_BYTES}
    app.add_middleware(Guard, rules=Rules(studio.host, studio.token, limits))
    return app


def _answer_errors(app: FastAPI) -> None:
    """Every error that is the user's to mend is told as text."""

    @app.exception_handler(NolensError)
    async def refused(request: Request, error: NolensError) -> JSONResponse:
        status = 422
        missing = isinstance(error, FileError) and request.method == "GET"
        if missing or isinstance(error, NoSuchJobError):
            status = 404
        elif isinstance(error, WorkerDiedError):
            status = 503
        return JSONResponse({"detail": str(error)}, status_code=status)

    @app.exception_handler(RequestValidationError)
    async def malformed(request: Request, error: RequestValidationError) -> JSONResponse:
        reasons = []
        for each in error.errors():
            place = ".".join(str(part) for part in each["loc"][1:]) or str(each["loc"][0])
            message = each["msg"][:1].lower() + each["msg"][1:]
            reasons.append(f"{place}: {message}")
        return JSONResponse({"detail": "; ".join(reasons)}, status_code=422)
