"""The live view through a real server: pictures of the scene, for many pages at once."""

import asyncio
import itertools
import json
import logging
import math
import os
import signal
import struct
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile
from serving import Running, serving
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from nolens.capture import chart
from nolens.files import read_frame, read_psf_set, read_record, write_psfs
from nolens.quantities import Angle
from nolens.studio import live
from nolens.studio.live import _Client
from patience import PATIENCE_S

Header = dict[str, Any]

_SCANS = Path(__file__).parents[1] / "corpus" / "simulate-jpeg-300-scans.jpg"

AT_FIRST = {
    "method": "admm", "detail": 1.0, "iterations": 2, "exposure_s": None, "gain": 1.0,
    "frozen": False, "over_field": False, "trained": True,
}  # fmt: skip


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with serving(tmp_path_factory.mktemp("studio"), source="twin:small") as running:
        running.until("live", lambda live: live["running"])
        yield running


@pytest.fixture
def studio(started: Running) -> Running:
    """As it was at its start, whatever the test before did."""
    state = started.get("live")
    if not state["running"] or state["source"] != "twin:small":
        started.post("live/start", {"source": "twin:small"})
    started.post("live/scene", {"builtin": "chart"})
    started.post("live/settings", AT_FIRST)
    return started


def frame(socket: ClientConnection) -> tuple[Header, dict[str, Image.Image]]:
    """The next message; the one after it is asked for."""
    message = socket.recv(timeout=PATIENCE_S)
    socket.send("ok")
    assert isinstance(message, bytes)
    (length,) = struct.unpack("<I", message[:4])
    header, rest = json.loads(message[4 : 4 + length]), message[4 + length :]
    parts = {}
    for part in header["parts"]:
        parts[part["name"]] = Image.open(BytesIO(rest[: part["bytes"]]))
        rest = rest[part["bytes"] :]
    assert rest == b""
    return header, parts


def frame_until(socket: ClientConnection, true: Any) -> tuple[Header, dict[str, Image.Image]]:
    end = time.monotonic() + PATIENCE_S
    while True:
        header, parts = frame(socket)
        if true(header, parts):
            return header, parts
        assert time.monotonic() < end, header


def likeness(picture: Image.Image, radiance: torch.Tensor) -> float:
    """Correlation of a picture with a scene, of the size of the picture."""
    scene = torch.nn.functional.interpolate(
        radiance[None], size=(picture.height, picture.width), mode="area"
    )[0]
    seen = (np.asarray(picture.convert("RGB"), float) / 255) ** 2.2
    return float(np.corrcoef(seen.ravel(), scene.permute(1, 2, 0).numpy().ravel())[0, 1])


def shows_chart(header: Header, parts: dict[str, Image.Image]) -> bool:
    """The exposure is the chart's, and so is the picture."""
    return header["number"] > 5 and likeness(parts["picture"], chart()) > 0.75


def test_shows_the_scene(studio: Running) -> None:
    with connect(studio.frames, max_size=None) as socket:
        header, parts = frame_until(socket, shows_chart)
        assert parts["raw"].size == (160, 128)
        histogram = np.array([header["histogram"][name] for name in "RGB"])
        assert histogram.shape == (3, 64)
        assert histogram.sum(axis=1).tolist() == [128 * 160, 2 * 128 * 160, 128 * 160]
        assert header["clipped_fraction"] < 0.01
        assert header["latency_ms"] > 0 and header["iterations"] >= 1
        assert studio.get("live")["scene"] == "chart"


def test_exposes_by_itself_and_as_it_is_told(studio: Running) -> None:
    with connect(studio.frames, max_size=None) as socket:
        told = studio.post("live/settings", {"exposure_s": 0.002, "gain": 2.0})
        assert (told["exposure_s"], told["gain"]) == (0.002, 2.0)
        frame_until(socket, lambda header, _: header["exposure_s"] == 0.002)
        studio.post("live/settings", {"exposure_s": 0.2, "gain": 8.0})
        clipped, _ = frame_until(socket, lambda header, _: header["exposure_s"] == 0.2)
        assert clipped["clipped_fraction"] > 0.1
        studio.post("live/settings", {"exposure_s": None, "gain": 1.0})
        frames = []

        def settled(header: Header, _: Any) -> bool:
            frames.append((header["number"], header["exposure_s"]))
            return len(frames) > 4 and frames[-3][1] == frames[-1][1]

        header, _ = frame_until(socket, settled)
        # The last filled bins of 64: 80 % of the range above black.
        pixels = np.sum([header["histogram"][name] for name in "RGB"], axis=0)
        bright = np.searchsorted(np.cumsum(pixels), 0.999 * pixels.sum())
        assert 0.65 * 64 < bright < 0.95 * 64
        for (before, one_s), (after, other_s) in itertools.pairwise(frames):
            assert abs(math.log2(other_s / one_s)) < 1.01 * (after - before)


def test_methods_remember_their_settings(studio: Running) -> None:
    with connect(studio.frames, max_size=None) as socket:
        admm = studio.post("live/settings", {"detail": 0.5, "iterations": 3})
        wiener = studio.post("live/settings", {"method": "wiener"})
        assert (admm["detail"], wiener["detail"]) == (0.5, 1)
        _, parts = frame_until(socket, lambda header, _: header["iterations"] == 1)
        assert likeness(parts["picture"], chart()) > 0.7
        back = studio.post("live/settings", {"method": "admm"})
        assert (back["detail"], back["iterations"]) == (0.5, 3)
        frame_until(socket, lambda header, _: header["iterations"] == 3)


def test_shows_what_is_dropped_on_the_page_and_the_webcam(studio: Running) -> None:
    bars = np.zeros((90, 120, 3), np.uint8)
    bars[:, 20:50] = (255, 40, 0)
    bars[30:60, 70:100] = (0, 120, 255)
    light = torch.from_numpy((bars / 255) ** 2.2).permute(2, 0, 1).float()
    with connect(studio.frames, max_size=None) as socket:
        told = studio.post("live/scene", None, content=encoded(bars, "PNG"),
                           headers={"Content-Type": "image/png"})  # fmt: skip
        assert told == {"scene": "picture"}
        frame_until(socket, lambda _, parts: likeness(parts["picture"], light) > 0.85)
        socket.send(encoded(bars[:, ::-1], "JPEG"))
        mirrored = light.flip(-1)
        frame_until(socket, lambda _, parts: likeness(parts["picture"], mirrored) > 0.85)
        assert studio.get("live")["scene"] == "webcam"
        studio.post("live/scene", {"builtin": "chart"})
        frame_until(socket, lambda _, parts: likeness(parts["picture"], chart()) > 0.75)
    for body in (b"no picture", encoded(bars, "PNG")[:200]):
        answer = studio.post("live/scene", None, 422, content=body,
                             headers={"Content-Type": "image/png"})  # fmt: skip
        assert "cannot be read" in answer["detail"]
    assert "there is no scene" in studio.post("live/scene", {"builtin": "x"}, 422)["detail"]


def encoded(pixels: NDArray[np.uint8], kind: str) -> bytes:
    buffer = BytesIO()
    Image.fromarray(pixels).save(buffer, kind, **({"quality": 95} if kind == "JPEG" else {}))
    return buffer.getvalue()


def test_frozen_frame_stays_and_is_what_is_saved(studio: Running) -> None:
    with connect(studio.frames, max_size=None) as socket:
        frame_until(socket, shows_chart)
        seen = socket.recv(timeout=PATIENCE_S)
        socket.send("ok")
        assert studio.post("live/settings", {"frozen": True})["frozen"]
        with connect(studio.frames, max_size=None) as late:
            message = late.recv(timeout=PATIENCE_S)
        while seen != message:  # It may be the newest already, or others are on their way.
            seen = socket.recv(timeout=PATIENCE_S)
            socket.send("ok")
        with pytest.raises(TimeoutError):
            socket.recv(timeout=1)
        saved = studio.post("live/save", {})
        again = studio.post("live/save", {"as": ["raw"]})
        assert not set(saved["files"]) & set(again["files"])
        studio.post("live/settings", {"frozen": False})
        frame(socket)
    files = {Path(each).suffix: studio.work / each.removeprefix("work/") for each in saved["files"]}
    assert sorted(files) == [".dng", ".json", ".png", ".tif"]
    raw = read_frame(files[".dng"])
    assert (raw.mosaic, raw.counts.shape, set(raw.black)) == ("RGGB", (1, 256, 320), {256.0})
    length = int.from_bytes(message[:4], "little")
    header = json.loads(message[4 : 4 + length])
    assert raw.exposure_s == pytest.approx(header["exposure_s"], rel=1e-6)
    shown = Image.open(BytesIO(message[4 + length + header["parts"][0]["bytes"] :]))
    assert isinstance(shown, JpegImageFile)
    kept = BytesIO()  # As a JPEG, which loses much of a dark frame's noise.
    Image.open(files[".png"]).save(kept, "JPEG", qtables=shown.quantization)
    pictures = [np.asarray(each, float).ravel() for each in (shown, Image.open(kept))]
    assert np.corrcoef(*pictures)[0, 1] > 0.998
    assert read_record(files[".json"]).parameters["method"] == "admm"
    psf = studio.work / saved["psf_path"].removeprefix("work/")
    assert read_frame(psf).counts.shape == (3, 128, 160)
    studio.post("live/stop")  # It would keep a core from the job.
    options = {
        "measurement": saved["files"][0],
        "psf": saved["psf_path"],
        "support": "64x80",
        "iterations": 60,
    }
    job = studio.ended(studio.job("reconstruct", options))
    assert job["status"] == "done", job
    picture = Image.open(studio.work / job["outputs"][0].removeprefix("work/"))
    assert likeness(picture, chart()) > 0.75


def test_psf_is_calibrated_of_a_point_of_light(studio: Running) -> None:
    """As on the page: dark frame, point, `calibrate`; it is the PSF that the twin has."""
    saved = {}
    with connect(studio.frames, max_size=None) as socket:
        studio.post("live/settings", {"exposure_s": 0.01, "gain": 1})
        for scene in ("dark", "point"):
            studio.post("live/scene", {"builtin": scene})
            for _ in range(6):
                frame(socket)
            saved[scene] = studio.post("live/save", {"as": ["raw"], "folder": "calibration"})
        studio.post("live/scene", {"builtin": "chart"})
        studio.post("live/settings", {"exposure_s": None})
    frames = {name: [each["files"][0]] for name, each in saved.items()}
    options = {
        "name": "bench", "camera": "small", "distance": "300mm",
        "frames": frames["point"], "dark": frames["dark"],
    }  # fmt: skip
    job = studio.ended(studio.job("calibrate", options))
    assert job["status"] == "done", job
    assert "work/cameras/bench" in [each["id"] for each in studio.get("about")["cameras"]]
    path = next(each for each in job["outputs"] if each.endswith(".tif"))
    found, own = (
        read_frame(studio.work / each.removeprefix("work/")).counts
        for each in (path, saved["point"]["psf_path"])
    )
    assert float(np.corrcoef(found.ravel(), own.ravel())[0, 1]) > 0.97


def test_eight_pages_one_of_which_stops_reading(studio: Running) -> None:
    """The others keep their picture, and memory does not grow."""
    server = psutil.Process()
    studio.post("live/settings", {"exposure_s": 0.01, "gain": 8})
    with ExitStack() as stack:
        pages = [stack.enter_context(connect(studio.frames, max_size=None)) for _ in range(7)]
        stopped = stack.enter_context(closing(silent(studio)))
        counts, seen = [0] * len(pages), [0] * len(pages)
        sizes = []
        ends = threading.Event()

        def look(place: int) -> None:
            while not ends.is_set():
                seen[place] = frame(pages[place])[0]["number"]
                counts[place] += 1

        threads = [threading.Thread(target=look, args=(place,)) for place in range(len(pages))]
        for thread in threads:
            thread.start()
        last = time.monotonic() + PATIENCE_S
        while min(counts) < 200 and time.monotonic() < last:
            sizes.append(server.memory_info().rss)
            time.sleep(0.1)
        # All see the newest, however many each has seen on the way.
        studio.post("live/settings", {"frozen": True})
        with connect(studio.frames, max_size=None) as late:
            newest = frame(late)[0]["number"]
        while set(seen) != {newest} and time.monotonic() < last:
            time.sleep(0.1)
        last_seen = set(seen)
        ends.set()
        studio.post("live/settings", {"frozen": False})
        for thread in threads:
            thread.join(PATIENCE_S)
        assert stopped is not None
    assert min(counts) >= 200 and last_seen == {newest}
    half = len(sizes) // 2
    assert max(sizes[half:]) - max(sizes[:half]) < 8e6, sizes


def silent(studio: Running) -> Any:
    """A page that asks for frames, and never reads one: a bare socket."""
    import socket

    host, port = studio.url.removeprefix("http://").split(":")
    found = socket.create_connection((host, int(port)))
    found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    found.sendall(
        f"GET /api/live/frames HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    ok = bytes((0x81, 0x82, 0, 0, 0, 0)) + b"ok"
    found.sendall(200 * ok)
    return found


@pytest.mark.parametrize(
    "message",
    ["", "okay", "{}", b"", b"\xff\xd8", b"GIF89a" + 100 * b"x", b"\x89PNG" + 9**6 * b"x"],
)
def test_what_is_malformed_closes_its_own_socket(studio: Running, message: str | bytes) -> None:
    with connect(studio.frames, max_size=None) as other:
        with (
            connect(studio.frames, max_size=None) as socket,
            pytest.raises(ConnectionClosed) as end,
        ):
            socket.send(message)
            while True:
                socket.recv(timeout=PATIENCE_S)
        assert end.value.rcvd is not None and end.value.rcvd.code == 1008
        frame(other)


def test_pictures_of_a_webcam_that_are_none_change_nothing(studio: Running) -> None:
    """But the page is told; one that is too large is not decoded."""
    large = BytesIO()
    Image.new("1", (7000, 7000)).save(large, "PNG")
    with connect(studio.frames, max_size=None) as socket:
        for data, words in (
            (b"\xff\xd8\xff" + 1000 * b"x", "cannot be read: give"),
            (large.getvalue(), "7000×7000 pixels: give one of at most 4 megapixels"),
            (_SCANS.read_bytes(), "a JPEG of 301 scans"),
        ):
            socket.send(data)
            studio.until("live", lambda live, words=words: words in (live["error"] or ""))
            for _ in range(3):
                frame(socket)
            assert studio.get("live")["scene"] == "chart"
        studio.post("live/scene", {"builtin": "chart"})
        assert studio.get("live")["error"] is None


def test_text_that_is_no_text_closes_its_own_socket_and_is_not_logged(studio: Running) -> None:
    logged: list[logging.LogRecord] = []
    handler = logging.Handler()
    handler.emit = logged.append  # type: ignore[method-assign]
    logging.getLogger("uvicorn.error").addHandler(handler)
    try:
        with (
            connect(studio.frames, max_size=None) as socket,
            pytest.raises(ConnectionClosed) as end,
        ):
            socket.send(b"\xff\xfe", text=True)
            while True:
                socket.recv(timeout=10)
    finally:
        logging.getLogger("uvicorn.error").removeHandler(handler)
    assert end.value.rcvd is not None and end.value.rcvd.code == 1007
    assert not [each for each in logged if each.levelno >= logging.ERROR]


def test_who_sends_more_than_frames_need_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page answers some ten frames a second, and sends as many of a webcam."""
    waited: list[float] = []

    class Page:
        count = 0

        async def receive(self) -> dict[str, str]:
            self.count += 1
            disconnects = self.count > 300
            return {"type": "websocket.disconnect"} if disconnects else {"type": "x", "text": "ok"}

    others, own = asyncio.sleep, []

    async def sleep(seconds: float) -> None:
        if threading.get_ident() in own:
            waited.append(seconds)
        else:  # A studio that the tests share.
            await others(seconds)

    monkeypatch.setattr(live.asyncio, "sleep", sleep)
    page: Any = Page()

    async def receive() -> None:
        own.append(threading.get_ident())
        await live._receive(page, _Client(), Any)  # type: ignore[arg-type]

    with ThreadPoolExecutor(1) as pool:  # The browser's tests leave a running loop in this thread.
        pool.submit(asyncio.run, receive()).result()
    assert 200 < len(waited) <= 251
    assert waited[-1] > 1


def test_killed_process_is_started_again_and_says_why(studio: Running) -> None:
    assert studio.app is not None
    with connect(studio.frames, max_size=None) as socket:
        frame(socket)
        os.kill(studio.app.state.live.pid, signal.SIGKILL)
        studio.until("live", lambda live: "SIGKILL" in (live["error"] or ""))
        assert any("SIGKILL" in text for text in studio.said)
        studio.until("live", lambda live: live["running"])
        frame_until(socket, lambda header, _: header["number"] >= 1)


def test_source_that_fails_is_told_and_another_can_be_started(studio: Running) -> None:
    answer = studio.post("live/start", {"source": "raspberry"}, 422)
    assert "Raspberry Pi" in answer["detail"]
    state = studio.get("live")
    assert not state["running"] and "Raspberry Pi" in state["error"]
    assert answer["detail"] in studio.said  # In the terminal too.
    for source in ("nothing", "folder:", "folder:../x", "twin:../../x", "twin:nothing"):
        assert studio.post("live/start", {"source": source}, 422)["detail"]
    assert "no frame to save" in studio.post("live/save", {}, 422)["detail"]
    state = studio.post("live/start", {"source": "twin:small"})
    assert state["running"] and state["error"] is None
    assert studio.post("live/save", {"as": ["raw"]})["files"]  # Its first frame is waited for.
    assert not studio.post("live/stop")["running"]
    assert httpx.get(f"{studio.url}/api/live").json()["fps"] == 0


def test_watches_a_folder_that_another_camera_writes_into(studio: Running) -> None:
    """First without a PSF, then with one: the picture is of the sensor's frame."""
    with connect(studio.frames, max_size=None) as socket:
        for _ in range(4):
            frame(socket)
        saved = studio.post("live/save", {"as": ["raw"]})
    raw = studio.work / saved["files"][0].removeprefix("work/")
    watched = studio.work / "uploads"
    watched.mkdir(exist_ok=True)
    asked = {"source": "folder:work/uploads"}
    state = studio.post("live/start", asked)
    assert state["running"] and state["source"] == "folder:work/uploads"
    assert state["limits"] is None and state["scene"] is None
    assert "none has come" in studio.post("live/save", {}, 422)["detail"]
    with connect(studio.frames, max_size=None) as socket:
        (watched / "new.dng").write_bytes(raw.read_bytes())
        header, parts = frame(socket)
        assert "no PSF is chosen" in header["trouble"]
        assert set(parts) == {"raw"}
    state = studio.post("live/start", {**asked, "psf": saved["psf_path"]})
    assert state["psf_path"] == saved["psf_path"]
    with connect(studio.frames, max_size=None) as socket:
        (watched / "newer.dng").write_bytes(raw.read_bytes())
        header, parts = frame(socket)
        assert header["trouble"] is None
        assert parts["picture"].size == parts["raw"].size == (160, 128)
        seen = parts["picture"].crop((40, 32, 40 + 80, 32 + 64))
        assert likeness(seen, chart()) > 0.6
    folder = studio.work / saved["psf_path"].removeprefix("work/")
    listed = folder.with_name("psfs.toml")
    (entry,) = read_psf_set(folder.parent).psf
    aside = entry.model_copy(
        update={"file": "aside.tif", "angle": (Angle.of(5, "deg"), entry.angle[1])}
    )
    write_psfs(folder.parent, {aside: read_frame(folder).counts})
    asked["psf"] = f"work/{listed.relative_to(studio.work)}"
    settings = {"over_field": True}
    state = studio.post("live/start", {**asked, "settings": settings})
    assert state["field_points"] == 2 and state["settings"]["iterations"] == 1
    with connect(studio.frames, max_size=None) as socket:
        (watched / "newest.dng").write_bytes(raw.read_bytes())
        header, parts = frame(socket)
        assert header["trouble"] is None and "picture" in parts
        saved = studio.post("live/save", {"as": ["png"]})
    record = studio.work / saved["files"][-1].removeprefix("work/")
    assert json.loads(record.read_text())["parameters"]["field_points"] == 2
    studio.post("live/settings", {"over_field": False})
    studio.post("live/stop")
