"""The server as a whole: its command, its files, and whatever a stranger sends it."""

import asyncio
import errno
import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
)
from serving import NOLENS, Running, command, serving, stop

from nolens.engine import Manifest
from nolens.studio import files, serve
from nolens.studio.schemas import ENDED
from patience import PATIENCE_S, until

UPLOAD_BYTES = 3_000_000
JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    work, other = tmp_path_factory.mktemp("studio"), tmp_path_factory.mktemp("data")
    (other / "sheet.html").write_text("<script>1</script>")
    (other / "raw.npy").write_bytes(b"raw")
    with serving(work, other, upload_bytes=UPLOAD_BYTES) as running:
        yield running


def listed(folder: Path) -> list[str]:
    return sorted(each.name for each in folder.iterdir())


def test_upload_is_kept_under_a_name_of_its_own(studio: Running) -> None:
    first, data = os.urandom(2_500_000), os.urandom(2_500_000)
    names = [
        studio.post("uploads", None, 201, params={"name": "a b.dng"}, content=content)["path"]
        for content in (first, data, first, data)  # The same content again is the same file.
    ]
    assert names == 2 * ["work/uploads/a b.dng", "work/uploads/a b-2.dng"]
    answer = httpx.get(f"{studio.url}/api/file", params={"path": names[1]})
    assert answer.content == data
    assert answer.headers["content-disposition"].startswith("attachment")
    entries = {each["path"]: each for each in studio.get("files?path=work/uploads")["entries"]}
    assert set(names) <= set(entries)
    assert entries[names[0]]["kind"] == "raw" and entries[names[0]]["bytes"] == len(data)


def test_progress_of_a_batch(studio: Running) -> None:
    """While its command writes; what is no manifest is refused."""
    with closing(Manifest.open(studio.work / "pictures", {}, "abc")) as manifest:
        manifest.keep("a", {}, {})
        manifest.fail("c", "no light", 3)
        found = studio.get("batch?path=work/pictures")
    assert found["counts"] == {"waiting": 1, "writing": 0, "done": 1, "failed": 1}
    assert found["failed"] == {"c": "no light"}
    (studio.work / "other").mkdir()
    (studio.work / "other" / "manifest.sqlite").write_bytes(b"SQLite format 3\0" * 99)
    for folder in ("other", "none"):
        assert httpx.get(f"{studio.url}/api/batch?path=work/{folder}").status_code == 404


@pytest.mark.parametrize(
    "name", ["../x.dng", "/x.dng", ".x.dng", "x.exe", "x.html", "", "a/b.dng", "a\\b.dng",
             "x.dng\0", "x" * 500 + ".dng"]
)  # fmt: skip
def test_upload_of_another_name_is_refused(studio: Running, name: str) -> None:
    assert studio.post("uploads", None, 422, params={"name": name}, content=b"x")["detail"]


def test_upload_that_is_too_large_is_refused_and_leaves_nothing(studio: Running) -> None:
    folder = studio.work / "uploads"
    folder.mkdir(exist_ok=True)
    before = listed(folder)

    def pieces() -> Iterator[bytes]:
        for _ in range(100):
            yield b"x" * 100_000

    for content in (b"x" * (UPLOAD_BYTES + 1), pieces()):
        answer = httpx.post(f"{studio.url}/api/uploads", params={"name": "x.dng"}, content=content)
        assert answer.status_code == 413
        assert "3 MB" in answer.json()["detail"]
    assert listed(folder) == before


def test_upload_that_breaks_off_leaves_nothing(studio: Running) -> None:
    folder = studio.work / "uploads"
    folder.mkdir(exist_ok=True)
    before = listed(folder)
    host, port = studio.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as line:
        line.sendall(
            f"POST /api/uploads?name=half.dng HTTP/1.1\r\nHost: {host}:{port}\r\n"
            "Content-Length: 1000000\r\n\r\n".encode()
            + 5000 * b"x"
        )
        until(lambda: len(listed(folder)) == len(before) + 1, "a file that grows")
    until(lambda: listed(folder) == before, "it is gone")


def test_full_disk_is_told(studio: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    async def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files, "run_in_threadpool", full)
    # Told after a part of it, to a client that sends all before it reads, and closes.
    answer = studio.post(
        "uploads", None, 507, params={"name": "x.dng"}, content=bytes(UPLOAD_BYTES),
        headers={"Connection": "close"},
    )  # fmt: skip
    assert "the disk is full" in answer["detail"]
    assert not [name for name in listed(studio.work / "uploads") if name.startswith(".")]


def test_pages_of_files_never_run_here(studio: Running) -> None:
    data = studio.get("about")["folders"][1]["id"]
    answer = httpx.get(f"{studio.url}/api/file", params={"path": f"{data}/sheet.html"})
    assert answer.headers["content-disposition"].startswith("attachment")
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("path", ["work/../../etc/passwd", "/etc/passwd", "work/none.png", "work"])
def test_other_files_are_not_handed_out(studio: Running, path: str) -> None:
    answer = httpx.get(f"{studio.url}/api/file", params={"path": path})
    assert answer.status_code in (404, 422)
    assert answer.json()["detail"]
    for raw in ("/../../../etc/passwd", "/%2e%2e/%2e%2e/app.py", "/js/..%2f..%2fapp.py"):
        assert b"nolens" not in httpx.get(studio.url + raw).content


def test_the_page_is_served_with_its_headers(studio: Running) -> None:
    answer = httpx.get(studio.url + "/")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert httpx.get(studio.url + "/docs").status_code == 404


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (rb'{"kind": "psf", "options": {"camera": "small", "light": "\ud800"}}', "surrogate"),
        (rb'{"kind": "psf", "options": {"\udfff": 1}}', "surrogate"),
        (b'{"kind": "psf", "options": {"a": ' + b"[" * 900 + b"]" * 900 + b"}}", "deep"),
        (b'{"kind": "psf", "options": {"a": ' + b"9" * 5000 + b"}}", "5000 characters"),
        (b'{"kind": "psf", "options": {"a": NaN}}', "NaN is no number"),
        (b'{"kind": "psf", "options": {"a": 1e999}}', "the largest number"),
        (b'{"kind": "psf", "options": {"' + b"a" * 900_000 + b'": 1}}', "there is no option"),
        (b'{"kind": "preview", "options": {"path": "work/\\u0000"}}', "is no path here"),
        (
            b'{"kind": "preview", "options": {"path": [' + b'"work",' * 3000 + b'"work"]}}',
            "at most",
        ),
        (b"\xff\xfe", "no JSON"),
    ],
)
def test_what_no_job_can_be_asked_with_is_refused_in_one_line(
    studio: Running, body: bytes, words: str
) -> None:
    """And becomes no job."""
    before = [each["id"] for each in studio.get("jobs")["jobs"]]
    answer = studio.post("jobs", None, 422, content=body, headers=JSON)
    assert words in answer["detail"]
    assert "\n" not in answer["detail"] and len(answer["detail"]) < 1100
    assert [each["id"] for each in studio.get("jobs")["jobs"]] == before


def test_strangers_input_is_answered(studio: Running) -> None:
    """Whatever the OpenAPI document lets one think of: never an error of the server's."""
    schema = schemathesis.openapi.from_url(f"{studio.url}/api/openapi.json")
    for operation in schema.get_all_operations():
        check_operation(operation.ok(), studio)
    assert studio.get("about")["version"]
    jobs = [job["id"] for job in studio.get("jobs")["jobs"]]  # Some of them can be done.
    for identity in jobs:
        studio.post(f"jobs/{identity}/cancel")
    for identity in jobs:
        assert studio.ended(identity)["status"] in ENDED


def check_operation(operation: Any, studio: Running) -> None:
    @given(case=operation.as_strategy())
    @settings(
        max_examples=6, deadline=None, phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    def check(case: Any) -> None:
        answer = case.call(base_url=studio.url, timeout=PATIENCE_S)
        case.validate_response(
            answer,
            checks=[
                not_a_server_error,
                response_schema_conformance,
                content_type_conformance,
            ],
        )
        if answer.status_code >= 400:
            assert isinstance(answer.json()["detail"], str)

    check()


def test_server_never_loads_the_numerics() -> None:
    code = (
        "import sys, nolens.cli.studio, nolens.studio.serve, nolens.studio.app\n"
        "print(sorted({'torch', 'numba', 'scipy', 'PIL'} & {*sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_command_says_its_address_and_ends_with_all_it_started(tmp_path: Path) -> None:
    with command("--port", 0, "--camera", "twin:small", tmp_path / "new") as process:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        running = Running(url.rstrip("/"), tmp_path / "new")
        assert running.get("about")["folders"][0]["path"] == str(tmp_path / "new")
        running.until("live", lambda live: live["running"])
        started = psutil.Process(process.pid).children(recursive=True)
        assert len(started) >= 2
        code, said = stop(process)
    assert code == 130
    assert "the studio has ended" in said and "Traceback" not in said
    _, alive = psutil.wait_procs(started, timeout=PATIENCE_S)
    assert not alive
    assert not (tmp_path / "new").exists()  # Nothing was written.


@pytest.mark.parametrize(
    ("message", "error", "shown"),
    [
        ("Exception in ASGI application\n", ValueError("a bug"), True),
        ("Exception in ASGI application\n", asyncio.CancelledError("at the end"), False),
        ("Cancel 2 running task(s), timeout graceful shutdown exceeded", None, False),
        (
            "Invalid UTF-8 sequence received from client.",
            UnicodeDecodeError("", b"", 0, 1, ""),
            False,
        ),
    ],
)
def test_only_errors_of_its_own_are_logged(
    message: str, error: BaseException | None, shown: bool
) -> None:
    said = {"msg": message, "exc_info": None if error is None else (type(error), error, None)}
    assert serve.is_ours(logging.makeLogRecord(said)) is shown


def test_killed_server_leaves_no_process_behind(tmp_path: Path) -> None:
    with command("--port", 0, "--camera", "twin:small", tmp_path) as process:
        assert process.stdout is not None
        process.stdout.readline()
        started = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGKILL)
        _, alive = psutil.wait_procs(started, timeout=PATIENCE_S)
        assert not alive


def test_port_in_use(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with command("--port", port, tmp_path) as process:
            _, said = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 2
        assert f"port {port} is in use" in said and "give --port" in said


def test_next_free_port_is_taken_where_none_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        monkeypatch.setattr(serve, "PORT", port)
        with serve.listen("127.0.0.1", None, said.append) as found:
            other = found.getsockname()[1]
    assert other > port
    assert said == [f"port {port} is in use, perhaps by another studio: this one takes {other}"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--camera", "webcam"], "is no source of frames"),
        (["--camera", "folder:nowhere"], "there is no folder"),
        (["--port", "70000"], "0 (any) to 65535"),
        (["--host", "203.0.113.1"], "cannot serve on 203.0.113.1"),
        (["missing-first", "missing-second"], "there is no folder missing-second"),
    ],
)
def test_bad_options_of_the_command(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = subprocess.run(
        [NOLENS, "studio", "--no-browser", *arguments], capture_output=True, text=True,
        check=False, cwd=tmp_path, timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stdout == ""
    assert words in done.stderr and done.stderr.count("\n") == 1


def test_beyond_this_computer_it_has_a_token(tmp_path: Path) -> None:
    with command("--port", 0, "--host", "0.0.0.0", tmp_path) as process:
        assert process.stdout is not None
        url = httpx.URL(process.stdout.readline().strip())
        token = url.params["token"]
        assert len(token) >= 24
        local = f"http://127.0.0.1:{url.port}"
        assert httpx.get(f"{local}/api/about").status_code == 401
        with httpx.Client(follow_redirects=True) as client:
            assert client.get(f"{local}/?token={token}").url.query == b""
            assert client.get(f"{local}/api/about").status_code == 200
        code, said = stop(process)
    assert code == 130 and token not in said


def test_connections_of_a_burst_are_read_in_turns() -> None:
    class Connection:
        is_paused = False

        def pause_reading(self) -> None:
            self.is_paused = True

        def resume_reading(self) -> None:
            self.is_paused = False

        def is_closing(self) -> bool:
            return False

    burst = [Connection() for _ in range(10)]

    async def come() -> list[list[bool]]:
        turns, seen = serve._Turns(), []
        for each in burst:
            turns.add(each)  # type: ignore[arg-type]
        for _ in range(3):
            seen.append([each.is_paused for each in burst])
            turns._next()
        return [*seen, [each.is_paused for each in burst]]

    with ThreadPoolExecutor(1) as pool:  # The browser's tests leave a running loop in this thread.
        waiting = pool.submit(asyncio.run, come()).result()
    read = (4, 8, 10, 10)
    assert waiting == [[False] * each + [True] * (10 - each) for each in read]
