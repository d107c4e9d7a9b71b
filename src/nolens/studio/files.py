"""Files of the named folders: what there is, what is in them, and uploads."""

import asyncio
import errno
import filecmp
import mimetypes
import os
import re
import secrets
import threading
from collections.abc import AsyncIterator
from concurrent.futures import Executor
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, HTTPException, Query, Request, Response
from fastapi.responses import FileResponse
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from nolens.documents import parse_json
from nolens.engine.manifest import MANIFEST_FILE, progress
from nolens.errors import DataError, FileError, OptionError
from nolens.files.input import read_text, readable
from nolens.studio.requests import answered
from nolens.studio.schemas import BatchProgress, Entries, Record, Uploaded
from nolens.studio.workspace import (
    PICTURE_SUFFIXES,
    RAW_SUFFIXES,
    UPLOADS,
    WORK,
    Workspace,
    unused,
)

_INLINE = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".pdf": "application/pdf",
    ".json": "application/json",
}
"""What a browser may show by itself: nothing that runs scripts in the page's place."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_LONGEST = 150
_FAILED_NAMED = 100


def files_router(workspace: Workspace, reading: Executor) -> APIRouter:
    """Routes of files, and the threads that read folders."""
    router = APIRouter(prefix="/api")
    placing = threading.Lock()

    @router.get("/files", response_model=Entries)
    async def files(path: Annotated[str, Query(max_length=1000)] = WORK) -> Response:
        return await answered(reading, lambda: Entries(entries=workspace.listing(path)))

    @router.get(
        "/file",
        response_class=FileResponse,
        responses={200: {"content": {"application/octet-stream": {}}, "description": "The file"}},
    )
    def file(path: Annotated[str, Query(max_length=1000)]) -> FileResponse:
        file_path = workspace.resolve(path)
        if not file_path.is_file():
            raise FileError(f"{path} is no file")
        if not os.access(file_path, os.R_OK):
            raise FileError(f"{path} may not be read by this studio")
        kind = _INLINE.get(file_path.suffix.lower())
        place = "attachment" if kind is None else "inline"
        return FileResponse(
            file_path,
            media_type=kind
            or mimetypes.guess_type(file_path.name)[0]
            or "application/octet-stream",
            headers={"Content-Disposition": f"{place}; filename*=UTF-8''{quote(file_path.name)}"},
        )

    @router.get("/record", response_model=Record)
    async def record(path: Annotated[str, Query(max_length=1000)]) -> Response:
        def read() -> Record:
            values = parse_json(read_text(workspace.resolve(path), "JSON"), path)
            if not isinstance(values, dict):
                raise DataError(f"{path} is no record")
            return Record(record=workspace.named(values))

        return await answered(reading, read)

    @router.get("/batch", response_model=BatchProgress)
    async def batch(path: Annotated[str, Query(max_length=1000)]) -> Response:
        def read() -> BatchProgress:
            counts, failed = progress(workspace.resolve(f"{path}/{MANIFEST_FILE}"), _FAILED_NAMED)
            told = {readable(key): readable(reason) for key, reason in failed.items()}
            return BatchProgress(counts=counts, failed=told)

        return await answered(reading, read)

    @router.post("/uploads", status_code=201, openapi_extra=_ANY_BYTES)
    async def upload(name: Annotated[str, Query(max_length=1000)], request: Request) -> Uploaded:
        checked = _checked_name(name)
        loop = asyncio.get_running_loop()
        folder = await loop.run_in_executor(reading, workspace.make, UPLOADS)
        async with _received(request, folder, checked) as temporary:
            placed = await loop.run_in_executor(reading, _placed, placing, temporary, checked)
        return Uploaded(path=f"{WORK}/{UPLOADS}/{placed.name}")

    return router


_ANY_BYTES = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


def _checked_name(name: str) -> str:
    """A name for an upload that is one, of a kind of file that can be read.

    Raises
    ------
    OptionError
        If it is none.
    """
    plain = bool(name) and not name.startswith(".") and name.isprintable()
    if not plain or any(each in name for each in '/\\:*?"<>|') or len(name) > _LONGEST:
        raise OptionError(
            f"{name[:80]!r} cannot be the name of an upload: give a file name such as raw.dng"
        )
    suffixes = (*RAW_SUFFIXES, *PICTURE_SUFFIXES, ".toml")
    if Path(name).suffix.lower() not in suffixes:
        raise OptionError(
            f"{name!r} is no file that can be read here: {', '.join(suffixes)} are accepted"
        )
    return name


def _placed(placing: threading.Lock, temporary: Path, name: str) -> Path:
    """Give a file its name, or one like it that no other has; one that is there already, with the
    same content, stays the only one.
    """
    folder, path = temporary.parent, Path(name)
    with placing:
        if (stored := _same(temporary, folder, name)) is not None:
            return stored
        placed = folder / f"{unused(folder, path.stem)}{path.suffix}"
        return temporary.replace(placed)


@asynccontextmanager
async def _received(request: Request, folder: Path, name: str) -> AsyncIterator[Path]:
    """The body of a request in a file for the block alone, with errors as answers."""
    temporary = folder / f".{secrets.token_hex(6)}.part"
    written = 0
    try:
        with await run_in_threadpool(temporary.open, "xb") as file:
            async for chunk in request.stream():
                written += len(chunk)
                await run_in_threadpool(file.write, chunk)
        if written == 0:
            raise OptionError(f"the upload {name} is empty")
        yield temporary
    except ClientDisconnect:
        raise HTTPException(400, f"the upload {name} was broken off") from None
    except OSError as error:
        if error.errno in _FULL:
            raise HTTPException(
                507, f"the disk is full: {name} was not kept. Make room and upload it again"
            ) from None
        raise FileError(f"cannot write {name}: {error.strerror or error}") from None
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _same(upload: Path, folder: Path, name: str) -> Path | None:
    """The file of an earlier upload with this name, or its name and a number, and this content."""
    known = re.compile(re.escape(Path(name).stem) + r"(-\d+)?" + re.escape(Path(name).suffix))
    for path in folder.iterdir():
        if known.fullmatch(path.name) and filecmp.cmp(path, upload, shallow=False):
            return path
    return None
