"""JSON of requests and answers: read within limits, and both worked out beside the loop."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import Executor
from typing import Any

from fastapi import HTTPException, Request, Response
from fastapi.routing import APIRoute
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from nolens.documents import parse_json
from nolens.errors import DataError


class _JsonRequest(Request):
    async def json(self) -> Any:
        try:
            return await run_in_threadpool(parsed, await self.body())
        except DataError as error:
            # FastAPI has words of its own for other errors.
            raise HTTPException(422, str(error)) from None


class JsonRoute(APIRoute):
    """A route whose JSON is held to the limits of all documents."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """What answers a request."""
        handle = super().get_route_handler()

        async def handler(request: Request) -> Response:
            return await handle(_JsonRequest(request.scope, request.receive))

        return handler


def parsed(body: bytes) -> Any:
    """JSON of a body.

    Raises
    ------
    DataError
        If it is none, or beyond the limits of documents.
    """
    try:
        text = body.decode("utf-8")
    except UnicodeDecodeError as error:
        raise DataError(f"the request is no JSON: {error}") from None
    return parse_json(text, "the request")


async def answered(pool: Executor, work: Callable[[], BaseModel]) -> Response:
    """The JSON of what threads of a pool work out.

    FastAPI would check and serialize it once more, in the loop.
    """

    def content() -> str:
        return work().model_dump_json()

    text = await asyncio.get_running_loop().run_in_executor(pool, content)
    return Response(text, media_type="application/json")
