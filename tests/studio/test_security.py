"""Who may talk to the studio: its own page on this computer, and who has the token."""

import asyncio
from collections.abc import Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import httpx
import pytest
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from nolens.studio.security import COOKIE, Guard, Rules, is_loopback

T = TypeVar("T")
TOKEN = "a-token-of-this-test"
OURS = "http://127.0.0.1:8350"


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """An application that has read every byte of the body."""
    body = await Request(scope, receive).body()
    await PlainTextResponse(f"{len(body)} bytes")(scope, receive, send)


def run(work: Coroutine[Any, Any, T]) -> T:
    """In a thread of its own: the browser's tests leave a running loop in this one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, work).result()


def ask(rules: Rules, method: str = "GET", path: str = "/api/x", **how: Any) -> httpx.Response:
    async def asked() -> httpx.Response:
        transport = httpx.ASGITransport(Guard(echo, rules))
        url = how.pop("url", OURS)
        async with httpx.AsyncClient(transport=transport, base_url=url) as client:
            return await client.request(method, path, **how)

    return run(asked())


@pytest.mark.parametrize("host", ["127.0.0.1:8350", "localhost:9", "[::1]:8350", "LOCALHOST"])
def test_own_names_are_served(host: str) -> None:
    assert ask(Rules(), headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example:8350", "192.168.1.7:8350", "", "localhost:x"]
)
def test_a_name_bound_to_this_computer_by_others_is_not_served(host: str) -> None:
    answer = ask(Rules(), headers={"Host": host})
    assert answer.status_code == 403
    assert "the address that the terminal shows" in answer.json()["detail"]


def test_beyond_loopback_addresses_are_served_but_not_names_of_others() -> None:
    rules = Rules("0.0.0.0", TOKEN)
    query = {"token": TOKEN}
    served = {
        host: ask(rules, headers={"Host": host}, params=query).status_code
        for host in ("192.168.1.7:8350", "localhost:8350", "evil.example:8350")
    }
    assert served == {"192.168.1.7:8350": 200, "localhost:8350": 200, "evil.example:8350": 403}


@pytest.mark.parametrize("method", ["GET", "POST", "DELETE"])
@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:3000", "file://127.0.0.1:8350"]
)
def test_other_pages_are_refused(method: str, origin: str) -> None:
    assert ask(Rules(), method, headers={"Origin": origin}).status_code == 403


def test_own_page_is_let_through() -> None:
    headers = {"Origin": OURS, "Sec-Fetch-Site": "same-origin"}
    assert ask(Rules(), "POST", headers=headers).status_code == 200


def test_other_pages_cannot_load_from_here_without_an_origin_either() -> None:
    """As an image or a script does."""
    headers = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}
    assert ask(Rules(), headers=headers).status_code == 403
    followed = {**headers, "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert ask(Rules(), headers=followed).status_code == 200
    framed = {**headers, "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "iframe"}
    assert ask(Rules(), headers=framed).status_code == 403


def test_token_is_needed_and_goes_on_as_a_cookie() -> None:
    rules = Rules("0.0.0.0", TOKEN)
    for given in ({}, {"token": "wrong"}, {"token": TOKEN[:-1]}, {"token": "ä"}):
        answer = ask(rules, params=given)
        assert answer.status_code == 401
        assert TOKEN not in answer.text
    first = ask(rules, path="/", params={"token": TOKEN, "x": "1"})
    assert first.status_code == 303
    assert first.headers["location"] == "/?x=1"
    cookie = first.headers["set-cookie"]
    assert "HttpOnly" in cookie and "SameSite=strict" in cookie
    assert ask(rules, headers={"Cookie": f"{COOKIE}={TOKEN}"}).status_code == 200
    assert ask(rules, headers={"Cookie": f"{COOKIE}=wrong"}).status_code == 401


def test_body_is_limited_whether_its_length_is_told_or_not() -> None:
    rules = Rules(body_bytes={"/api/large": 2_000_000})

    async def unknown_length() -> Any:
        for _ in range(30):
            yield b"x" * 50_000

    assert ask(rules, "POST", content=b"x" * 1_000_000).text == "1000000 bytes"
    told = ask(rules, "POST", content=b"x" * 1_000_001)
    assert told.status_code == 413
    assert "1 MB" in told.json()["detail"]
    with pytest.raises(Exception, match="1 MB"):
        ask(rules, "POST", content=unknown_length())
    assert ask(rules, "POST", "/api/large", content=unknown_length()).text == "1500000 bytes"


def test_every_answer_has_the_headers() -> None:
    for answer in (ask(Rules()), ask(Rules(), headers={"Host": "evil.example"})):
        assert answer.headers["x-content-type-options"] == "nosniff"
        policy = answer.headers["content-security-policy"]
        assert "default-src 'self'" in policy and "unsafe" not in policy


@pytest.fixture
def socket_scope() -> Iterator[Scope]:
    yield {
        "type": "websocket", "path": "/api/live/frames", "query_string": b"",
        "headers": [(b"host", b"127.0.0.1:8350")],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("header", "rules"),
    [
        ((b"origin", b"http://evil.example"), Rules()),
        ((b"host", b"evil.example"), Rules()),
        ((b"cookie", b"other=1"), Rules("0.0.0.0", TOKEN)),
    ],
)
def test_sockets_are_held_to_the_same(
    socket_scope: Scope, header: tuple[bytes, bytes], rules: Rules
) -> None:
    sent: list[Any] = []

    async def collect(message: Any) -> None:
        sent.append(message)

    async def nothing() -> Any:
        raise AssertionError("nothing is read of it")

    socket_scope["headers"].append(header)
    run(Guard(echo, rules)(socket_scope, nothing, collect))
    assert [each["type"] for each in sent] == ["websocket.close"]


def test_what_is_loopback() -> None:
    assert all(map(is_loopback, ("127.0.0.1", "::1", "localhost", "127.1.2.3")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.1.7", "example.org")))
