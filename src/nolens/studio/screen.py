"""A page that fills a screen and shows the pictures that a camera before it is to see."""

import asyncio
import io
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import uvicorn
from fastapi import FastAPI, Response
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from pydantic import BaseModel, Field
from torch import Tensor

from nolens.capture.screen import Screen
from nolens.errors import ScreenError
from nolens.files.pictures import screen_picture
from nolens.studio.security import Guard, Rules
from nolens.studio.serve import configuration, listen

_PAGE = Path(__file__).with_name("page")
_SETTLE_S = 0.2
"""After the page has drawn, until the screen shows it: two frames of it and of its electronics."""
_ANSWER_S, _OPEN_S, _POLL_S, _STEP_S = 30.0, 900.0, 15.0, 0.02


class Size(BaseModel):
    """Pixels of the screen, of its longer side at most those of 8K."""

    rows: Annotated[int, Field(ge=100, le=8000)]
    columns: Annotated[int, Field(ge=100, le=8000)]


class Shown(BaseModel):
    """Which picture is on the screen."""

    number: Annotated[int, Field(ge=1, le=10**9)]


class ScreenPage(Screen):
    """The page and its server, in a thread; it is served to this computer alone.

    Parameters
    ----------
    say
        Tells a person at the terminal.
    opened
        Called with the address of the page.
    settle_s
        From the page's drawing to the camera's frame.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        opened: Callable[[str], None],
        *,
        settle_s: float = _SETTLE_S,
    ) -> None:
        self._settle_s = settle_s
        self._changed = threading.Condition()
        self._size: tuple[int, int] | None = None
        self._picture, self._number, self._shown = b"", 0, 0
        listening = listen("127.0.0.1", None, say)
        self.address = f"http://127.0.0.1:{listening.getsockname()[1]}/"
        self._server = uvicorn.Server(configuration(self._application()))
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [listening]}, daemon=True
        )
        self._thread.start()
        opened(self.address)

    def _application(self) -> FastAPI:
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

        @app.get("/")
        async def page() -> FileResponse:
            return FileResponse(_PAGE / "screen.html")

        @app.get("/api/screen")
        async def newest(after: int = 0) -> Shown | None:
            end = time.monotonic() + _POLL_S
            while self._number <= after and time.monotonic() < end and not self._closing:
                await asyncio.sleep(_STEP_S)
            return Shown(number=self._number) if self._number > after else None

        @app.get("/api/screen/picture/{number}")
        async def picture(number: int) -> Response:
            return Response(self._picture, media_type="image/png")

        @app.post("/api/screen/size")
        async def size(size: Size) -> None:
            with self._changed:
                self._size = self._size or (size.rows, size.columns)
                self._changed.notify_all()

        @app.post("/api/screen/shown")
        async def shown(shown: Shown) -> None:
            with self._changed:
                self._shown = shown.number
                self._changed.notify_all()

        app.mount("/", StaticFiles(directory=_PAGE), name="page")
        app.add_middleware(Guard, rules=Rules())
        return app

    @property
    def _closing(self) -> bool:
        return self._server.should_exit

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns) of the screen, once the page is open on it.

        Raises
        ------
        ScreenError
            If nobody opens it in a quarter of an hour.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: self._size is not None, _OPEN_S):
                raise ScreenError(f"the page {self.address} was not opened on a screen")
            assert self._size is not None
            return self._size

    def show(self, picture: Tensor) -> None:
        """Show a picture, and wait until it is drawn and has settled.

        Raises
        ------
        ScreenError
            If the page does not draw it in half a minute.
        """
        buffer = io.BytesIO()
        screen_picture(picture, 1.0).save(buffer, "PNG", compress_level=1)
        with self._changed:
            self._picture = buffer.getvalue()
            self._number += 1
            if not self._changed.wait_for(lambda: self._shown >= self._number, _ANSWER_S):
                raise ScreenError(
                    f"the page {self.address} does not show pictures any more: give the same "
                    "command again, and open the page that it names"
                )
        time.sleep(self._settle_s)

    def close(self) -> None:
        """End the server."""
        self._server.should_exit = True
        self._thread.join()
