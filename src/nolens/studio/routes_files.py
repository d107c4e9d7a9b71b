"""Files of the named folders: what there is, what is in them, and uploads."""

import errno
import mimetypes
import os
import secrets
from contextlib import suppress
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, HTTPException, Query, Request
from fastapi.responses import FileResponse
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from nolens.errors import FileError, OptionError
from nolens.studio.schemas import Entries, Uploaded
from nolens.studio.workspace import (
    PICTURE_SUFFIXES,
    RAW_SUFFIXES,
    UPLOADS,
    WORK,
    Workspace,
    unused,
)

_INLINE = {
    ".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".pdf": "application/pdf",
    ".json": "application/json",
}  # fmt: skip
"""What a browser may show by itself: nothing that runs scripts in the page's place."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_LONGEST = 150


def files_router(workspace: Workspace) -> APIRouter:
    """Routes of files."""
    router = APIRouter(prefix="/api")

    @router.get("/files")
    def files(path: Annotated[str, Query(max_length=1000)] = WORK) -> Entries:
        return Entries(entries=workspace.listing(path))

    @router.get(
        "/file",
        response_class=FileResponse,
        responses={200: {"content": {"application/octet-stream": {}}, "description": "The file"}},
    )
    def file(path: Annotated[str, Query(max_length=1000)]) -> FileResponse:
        found = workspace.resolve(path)
        if not found.is_file():
            raise FileError(f"{path} is no file")
        if not os.access(found, os.R_OK):
            raise FileError(f"{path} may not be read by this studio")
        kind = _INLINE.get(found.suffix.lower())
        place = "attachment" if kind is None else "inline"
        return FileResponse(
            found,
            media_type=kind or mimetypes.guess_type(found.name)[0] or "application/octet-stream",
            headers={"Content-Disposition": f"{place}; filename*=UTF-8''{quote(found.name)}"},
        )

    @router.post("/uploads", status_code=201, openapi_extra=_ANY_BYTES)
    async def upload(name: Annotated[str, Query(max_length=1000)], request: Request) -> Uploaded:
        checked = _checked_name(name)
        folder = workspace.make(UPLOADS)
        path = await _received(request, folder, checked)
        return Uploaded(path=f"{WORK}/{UPLOADS}/{path.name}")

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


async def _received(request: Request, folder: Path, name: str) -> Path:
    """Write the body of a request into a file, whole or not at all."""
    temporary = folder / f".{secrets.token_hex(6)}.part"
    written = 0
    try:
        with temporary.open("xb") as file:
            async for chunk in request.stream():
                written += len(chunk)
                await run_in_threadpool(file.write, chunk)
        if written == 0:
            raise OptionError(f"the upload {name} is empty")
        path = folder / f"{unused(folder, Path(name).stem)}{Path(name).suffix}"
        temporary.replace(path)
        return path
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
