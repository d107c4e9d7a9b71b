"""Who may talk to the studio, and how much they may send: rules that hold for every request."""

import asyncio
import hmac
import ipaddress
import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlencode

from fastapi import HTTPException
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; "
    "media-src 'self' blob:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; "
    "form-action 'none'; object-src 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-cache",
}
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
COOKIE = "nolens-studio"
_REST_BYTES, _REST_S = 100_000_000, 10.0


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches a server on that address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True)
class Rules:
    """What a server asks of those who talk to it.

    Parameters
    ----------
    host
        Address that it is served on.
    token
        That every request must have; None on loopback.
    body_bytes
        The most that the body of a request may have, by the path of the route; 1 MB for others.
    """

    host: str = "127.0.0.1"
    token: str | None = None
    body_bytes: Mapping[str, int] = field(default_factory=dict)

    def serves(self, host: str) -> bool:
        """Whether a Host header is one of ours: a name that someone else chose is not.

        Beyond loopback any bare address is: no name can be bound anew to lead there.
        """
        name = _name(host)
        if name is None:
            return False
        if name in _LOOPBACK or name == self.host.lower():
            return True
        if is_loopback(self.host):
            return False
        own = socket.gethostname().lower()
        return _is_address(name) or name in (own, f"{own}.local")

    def limit(self, path: str) -> int:
        """Bytes that a request to a path may send."""
        return self.body_bytes.get(path, 1_000_000)


class Guard:
    """Lets through what the rules allow, and gives every answer its headers.

    Parameters
    ----------
    app
        What is guarded.
    rules
        They.
    """

    def __init__(self, app: ASGIApp, rules: Rules) -> None:
        self._app, self._rules = app, rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on a request, or answer it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        refused = self._refused(scope)
        if refused is not None:
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
            else:
                body = _Body(scope, receive, self._rules.limit(scope["path"]))
                await refused(scope, body, _answering(send, body))
            return
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
            return
        body = _Body(scope, receive, self._rules.limit(scope["path"]))
        await self._app(scope, body, _answering(send, body))

    def _refused(self, scope: Scope) -> Response | None:
        """The answer to a request that is not let through."""
        headers = Headers(scope=scope)
        if len(headers.getlist("host")) != 1 or not self._rules.serves(headers["host"]):
            return _trouble(
                scope,
                403,
                f"this studio is not served as {headers.get('host', '')[:100]!r}: open "
                "the address that the terminal shows",
            )
        origin = headers.get("origin")
        if origin is not None and not _same_origin(origin, headers["host"]):
            return _trouble(scope, 403, "requests from other pages are not answered")
        if headers.get("sec-fetch-site") in ("cross-site", "same-site") and not _navigates(headers):
            return _trouble(scope, 403, "requests from other pages are not answered")
        if self._rules.token is not None:
            refused = self._without_token(scope, headers, self._rules.token)
            if refused is not None:
                return refused
        length = headers.get("content-length")
        limit = self._rules.limit(scope["path"])
        # As many digits as the server lets through are no number that Python converts.
        if length is not None and length.isdecimal() and int(length[:20]) > limit:
            return _trouble(scope, 413, too_large(limit))
        return None

    def _without_token(self, scope: Scope, headers: Headers, token: str) -> Response | None:
        tokens = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])
        by_query = any(_equal(each, token) for each in tokens)
        if not by_query and not any(_equal(each, token) for each in _cookies(headers)):
            return _trouble(
                scope,
                401,
                "this studio needs its token: open the address that the terminal "
                "shows, with ?token=... at its end",
            )
        if by_query and scope["type"] == "http" and scope["path"] == "/":
            # The token goes on as a cookie, and out of the address and the browser's history.
            rest = parse_qs(scope["query_string"].decode("latin-1"), keep_blank_values=True)
            rest.pop("token", None)
            answer = RedirectResponse(
                "/" + (f"?{urlencode(rest, doseq=True)}" if rest else ""), status_code=303
            )
            answer.set_cookie(COOKIE, token, httponly=True, samesite="strict", path="/")
            return answer
        return None


def too_large(limit: int) -> str:
    """What is said of a body beyond a limit."""
    size = f"{limit / 1e6:g} MB" if limit >= 1e6 else f"{limit} bytes"
    return f"that is more than the {size} that are accepted here"


class _Body:
    """Receives the body of a request: an error once it is larger than was allowed.

    Parameters
    ----------
    scope, receive
        Of the request.
    limit
        Bytes that are allowed.
    """

    def __init__(self, scope: Scope, receive: Receive, limit: int) -> None:
        headers = Headers(scope=scope)
        self._receive, self._limit = receive, limit
        self._size = 0
        self._ended = "content-length" not in headers and "transfer-encoding" not in headers
        # Who asks whether to send sends nothing before it is read.
        self._asks = headers.get("expect", "").lower() == "100-continue"

    async def __call__(self) -> Message:
        """The next message of the request."""
        message = await self._next()
        if self._size > self._limit:
            raise HTTPException(413, too_large(self._limit))
        return message

    async def rest(self) -> None:
        """Read what was not read, and throw it away.

        A connection that is closed before is reset, and its answer lost on the way.
        """
        most = self._size + max(self._limit, _REST_BYTES)
        with suppress(TimeoutError):
            async with asyncio.timeout(_REST_S):
                while not (self._ended or self._asks) and self._size < most:
                    await self._next()

    async def _next(self) -> Message:
        message = await self._receive()
        self._asks = False
        if message["type"] == "http.request":
            self._size += len(message.get("body", b""))
            self._ended = not message.get("more_body", False)
        else:
            self._ended = True
        return message


def _answering(send: Send, body: _Body) -> Send:
    """Send that gives every answer its headers, and ends it when its request has ended."""

    async def wrapped(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        elif message["type"] == "http.response.body" and not message.get("more_body", False):
            await send({**message, "more_body": True})
            await body.rest()
            message = {"type": "http.response.body"}
        await send(message)

    return wrapped


def _trouble(scope: Scope, status: int, text: str) -> Response:
    if scope["path"].startswith("/api/"):
        return JSONResponse({"detail": text}, status_code=status)
    return PlainTextResponse(f"nolens: {text}\n", status_code=status)


def _same_origin(origin: str, host: str) -> bool:
    scheme, _, rest = origin.partition("://")
    return scheme in ("http", "https") and rest.lower() == host.lower()


def _navigates(headers: Headers) -> bool:
    """Whether a person follows a link: that shows the page, and tells the other one nothing."""
    return headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") in (
        "document",
        None,
    )


def _name(host: str) -> str | None:
    """Name or address in a Host header, without its port; None where it is none."""
    host = host.strip().lower()
    if host.startswith("["):
        name, closed, port = host[1:].partition("]")
        if not closed:
            return None
        port = port.removeprefix(":") if port else ""
    else:
        name, _, port = host.partition(":")
    if not name or (port and not port.isdecimal()):
        return None
    return name


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _cookies(headers: Headers) -> list[str]:
    tokens = []
    for header in headers.getlist("cookie"):
        try:
            cookie = SimpleCookie(header).get(COOKIE)
        except CookieError:
            continue
        if cookie is not None:
            tokens.append(cookie.value)
    return tokens


def _equal(text: str, token: str) -> bool:
    return hmac.compare_digest(text.encode("utf-8", "replace"), token.encode())
