"""A studio from its default start, and a browser that looks at its page."""

import io
import os
import re
import shutil
import signal
import subprocess
import sys
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest
from PIL import Image
from serving import with_the_tests

from patience import PATIENCE_S
from patience import until as patiently

SHOTS = Path(__file__).parents[2] / "docs" / "studio"
SHOWN = bool(os.environ.get("NOLENS_SCREENSHOTS"))
"""Whether screenshots are written."""
_ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+\S*")
_DESK, _PHONE = {"width": 1280, "height": 860}, {"width": 360, "height": 740}
_AT_FIRST = {"method": "admm", "exposure_s": None, "frozen": False}
# The tests' own folder says nothing to who looks at a picture.
_SHORTER = r"""() => {
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const text = texts.currentNode;
    text.data = text.data.replace(/\/\S*\/nolens-studio/g, "~/nolens-studio");
  }
}"""
_LARGEST_BYTES = 300_000
_WAIT_S = 60.0
"""For what the page is to show: the longest of its jobs lasts seconds."""
until = partial(patiently, seconds=_WAIT_S)

needs_chromium = pytest.mark.skipif(
    shutil.which("chromium") is None, reason="there is no chromium to look at the page with"
)


@contextmanager
def running_studio(folder: Path) -> Iterator[str]:
    """`nolens studio` in an empty folder; gives the address that it prints."""
    process = subprocess.Popen(
        [sys.executable, "-m", "nolens", "studio", "--no-browser", "--port", "0"],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True, preexec_fn=with_the_tests,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    try:
        assert process.stdout is not None
        said = ""
        for line in process.stdout:
            said += line
            if address := _ADDRESS.search(line):
                yield address[0].rstrip("/.")
                break
        else:
            raise AssertionError(f"the studio did not start:\n{said}")
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_WAIT_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise
        finally:
            if process.stdout is not None:
                process.stdout.close()


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser without a screen, with a webcam that shows a test picture."""
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=1e3 * _WAIT_S)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox", "--use-fake-ui-for-media-stream",
                  "--use-fake-device-for-media-stream"],
        )  # fmt: skip
        yield browser
        browser.close()


@dataclass
class Visit:
    """One visitor of the page, and all that a page must not do."""

    browser: Any
    address: str
    wrong: list[str] = field(default_factory=list)
    allowed: str | None = None

    def __enter__(self) -> Self:
        self._contexts: list[Any] = []
        self.page = self._open()
        return self

    def _open(self, **more: Any) -> Any:
        settings = {"viewport": _DESK, "color_scheme": "dark", **more}
        context = self.browser.new_context(**settings)
        self._contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(1e3 * _WAIT_S)
        page.add_init_script(
            "addEventListener('securitypolicyviolation', (e) => console.error('CSP ' + e.blockedURI"
            " + ' ' + e.violatedDirective));"
        )
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.wrong.append(f"page error: {error}"))
        page.on("request", lambda request: self._on_address(request.url))
        page.on("websocket", lambda socket: self._on_address(socket.url))
        return page

    def _on_console(self, message: Any) -> None:
        if message.type not in ("error", "warning"):
            return
        if self.allowed is None or not re.search(self.allowed, message.text):
            self.wrong.append(f"console: {message.text} {message.location}")

    def _on_address(self, url: str) -> None:
        home = self.address.split("/")[2]
        if not re.match(rf"(https?|ws)://{re.escape(home)}/|blob:|data:", url):
            self.wrong.append(f"request: {url}")

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for context in self._contexts:
            context.close()
        if error is None:
            assert self.wrong == []

    def begin(self) -> None:
        """Put the viewfinder back as it is at the start, whatever the test before did."""
        for what, given in (("scene", {"builtin": "chart"}), ("settings", _AT_FIRST)):
            self.tell(f"live/{what}", given)

    def tell(self, what: str, given: dict[str, Any]) -> Any:
        """Ask something of the server, as the page would."""
        return self.page.request.post(
            f"{self.address}/api/{what}",
            data=given,
            headers={"Origin": self.address},
            timeout=1e3 * PATIENCE_S,  # The studio ends it.
        )

    def jobs(self) -> list[dict[str, Any]]:
        """The studio's jobs, the newest first."""
        found: list[dict[str, Any]] = self._asked("jobs")["jobs"]
        return found

    def job(self, identity: str) -> dict[str, Any]:
        """All that is known of a job."""
        return self._asked(f"jobs/{identity}")

    def _asked(self, what: str) -> dict[str, Any]:
        found: dict[str, Any] = self.page.request.get(f"{self.address}/api/{what}").json()
        return found

    def show(self, panel: str) -> Any:
        """The page with a panel open."""
        self.page.goto(f"{self.address}/#{panel}")
        return self.page

    def phone(self, panel: str) -> Any:
        """Another page, as wide as a phone."""
        page = self._open(viewport=_PHONE, has_touch=True)
        page.goto(f"{self.address}/#{panel}")
        return page

    def keep(self, name: str, page: Any = None, *, scrolled: bool = False) -> None:
        """Keep how the page looks, dark and light, where screenshots are asked for."""
        if not SHOWN:
            return
        page = page or self.page
        page.evaluate(_SHORTER)
        if not scrolled:
            page.evaluate("scrollTo(0, 0)")
        for theme in ("light", "dark"):
            page.emulate_media(color_scheme=theme)
            self._keep(f"{name}-{theme}", page)

    def _keep(self, name: str, page: Any) -> None:
        page.wait_for_timeout(300)
        SHOTS.mkdir(parents=True, exist_ok=True)
        with Image.open(io.BytesIO(page.screenshot())) as shot:
            colours = shot.convert("RGB")
        path = SHOTS / f"{name}.png"
        colours.save(path, optimize=True)
        palette = colours.quantize(256)
        for dither in (Image.Dither.FLOYDSTEINBERG, Image.Dither.NONE):
            if path.stat().st_size > _LARGEST_BYTES:
                colours.quantize(palette=palette, dither=dither).save(path, optimize=True)


def picture_of(page: Any, canvas: str) -> Image.Image:
    """What a canvas of the page shows."""
    data = page.locator(canvas).evaluate("(each) => each.toDataURL('image/png')")
    with Image.open(io.BytesIO(b64decode(data.partition(",")[2]))) as image:
        return image.convert("RGB")


def await_text(page: Any, selector: str, pattern: str) -> str:
    """The text of an element once it fits a pattern."""
    from playwright.sync_api import TimeoutError as WaitedTooLong

    try:
        page.wait_for_function(
            "([selector, pattern]) => [...document.querySelectorAll(selector)]"
            ".some((each) => new RegExp(pattern).test(each.textContent))",
            arg=[selector, pattern],
        )
    except WaitedTooLong:
        said = page.locator(f"{selector}, #banner, #notices, .trouble").all_text_contents()
        raise AssertionError(f"nothing fits {pattern!r}; the page says {said}") from None
    texts: list[str] = page.locator(selector).all_text_contents()
    return next(text for text in texts if re.search(pattern, text))
