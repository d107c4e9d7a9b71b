"""The viewfinder and the calibration on the page, as a visitor without a camera meets them.

Every test also holds that no request leaves this machine, and that neither an error nor a breach
of the content security policy is told on the console.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
from browser import Visit, await_text, needs_chromium, picture_of, until
from PIL import Image
from playwright.sync_api import expect

from nolens.camera import srgb_from_linear
from nolens.capture import chart
from nolens.files import read_frame, read_psf_set

pytestmark = needs_chromium


def alike(one: Image.Image, other: Image.Image) -> float:
    """Correlation of two pictures' colours, the second brought to the size of the first."""
    pixels = [
        np.asarray(each.convert("RGB").resize(one.size), dtype=float).ravel()
        for each in (one, other)
    ]
    if not all(each.any() for each in pixels):  # Nothing has been drawn yet.
        return 0.0
    return float(np.corrcoef(*pixels)[0, 1])


def built_in() -> Image.Image:
    """The scene that the viewfinder begins with, as a picture."""
    values = (srgb_from_linear(chart()) * 255).round().byte()
    return Image.fromarray(values.permute(1, 2, 0).numpy())


def number_of(page: Any) -> int:
    """Of the frame that is shown."""
    return int(page.locator("#live-raw").get_attribute("data-number") or -1)


def await_frames(page: Any, count: int) -> None:
    """Wait for so many more frames."""
    first = number_of(page)
    page.wait_for_function(
        "([first, count]) => Number(document.querySelector('#live-raw').dataset.number)"
        " >= first + count",
        arg=[first, count],
    )  # fmt: skip


def await_likeness(page: Any, scene: Image.Image) -> None:
    """Wait until the viewfinder shows a scene."""
    until(lambda: alike(picture_of(page, "#live-picture"), scene) > 0.9, "the scene")


def middle_of(page: Any, canvas: str) -> tuple[float, float]:
    """Place on the screen of the middle of a picture."""
    box = page.locator(canvas).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def await_newest(visit: Visit) -> None:
    """Wait until a page of a frozen viewfinder shows what another one is shown at once."""
    other = visit.phone("viewfinder")
    until(lambda: number_of(other) > 0, "a frame")
    until(lambda: number_of(visit.page) == number_of(other), "the newest frame")
    other.close()


def test_viewfinder_shows_the_scene_live(visit: Visit) -> None:
    page = visit.show("viewfinder")
    await_likeness(page, built_in())
    shown = picture_of(page, "#live-picture")
    await_frames(page, 2)
    later = picture_of(page, "#live-picture")
    assert alike(picture_of(page, "#live-raw"), built_in()) < 0.8
    assert np.any(np.asarray(shown) != np.asarray(later))
    assert await_text(page, ".verdict", "Exposure right")
    page.mouse.move(*middle_of(page, "#live-raw"))
    counts = await_text(page, ".probe", r"x \d+, y \d+ · counts [RGB] \d+$")
    assert 0 < int(counts.split()[-1]) < 4096
    page.mouse.move(*middle_of(page, "#live-picture"))
    await_text(page, ".probe", r"radiance R [\d.]+")
    visit.keep("viewfinder")
    phone = visit.phone("viewfinder")
    await_frames(phone, 4)
    assert phone.evaluate("document.documentElement.scrollWidth") == 360
    visit.keep("viewfinder-phone", phone)


def test_settings_act_at_once_and_freezing_holds_the_frame(visit: Visit) -> None:
    page = visit.show("viewfinder")
    await_frames(page, 2)
    page.get_by_role("button", name="Wiener").click()
    await_text(page, ".view figcaption", "Wiener")
    trained = page.get_by_label("Trained network")
    expect(trained).to_be_disabled()
    detail = page.get_by_role("slider", name="Detail")
    assert detail.get_attribute("aria-valuetext") == "automatic"
    detail.evaluate("(each) => { each.value = each.max; each.dispatchEvent(new Event('input')); }")
    assert detail.get_attribute("aria-valuetext") == "8 × finer"
    page.get_by_role("button", name="ADMM").click()
    page.wait_for_function(
        "(each) => each.ariaValueText === 'automatic'", arg=detail.element_handle()
    )
    trained.click()
    expect(trained).not_to_be_checked()
    page.get_by_label("Exposure", exact=True).evaluate(
        "(each) => { each.value = 0.75 * each.max; each.dispatchEvent(new Event('input')); }"
    )
    assert await_text(page, ".verdict", "Clipped")
    expect(page.get_by_label("Automatic exposure")).not_to_be_checked()
    # A frame from before the click may still say the opposite.
    page.get_by_label("Automatic exposure").click()
    expect(page.get_by_label("Automatic exposure")).to_be_checked()
    await_text(page, ".verdict", "Exposure right")
    page.keyboard.press("Space")
    await_text(page, ".readout", "frozen")
    await_newest(visit)
    held = number_of(page)
    page.wait_for_timeout(700)
    assert number_of(page) == held
    page.keyboard.press("Space")
    await_frames(page, 1)
    expect(trained).not_to_be_checked()  # As the server's state says.


def test_saving_keeps_what_is_shown(visit: Visit, studio_folder: Path) -> None:
    page = visit.show("viewfinder")
    await_frames(page, 4)
    page.keyboard.press("Space")
    await_text(page, ".readout", "frozen")
    await_newest(visit)
    page.keyboard.press("s")
    await_text(page, "[role=status]", "Saved in /.*/nolens-studio/shots")
    names = page.locator(".files a").all_text_contents()
    assert {Path(name).suffix for name in names} == {".png", ".tif", ".dng", ".json"}
    shots = studio_folder / "nolens-studio" / "shots"
    assert all((shots / name).is_file() for name in names)
    (png,) = [shots / name for name in names if name.endswith(".png")]
    with Image.open(png) as saved:
        assert alike(picture_of(page, "#live-picture"), saved) > 0.97


def test_twin_looks_at_what_the_visitor_gives(visit: Visit) -> None:
    page = visit.show("viewfinder")
    await_frames(page, 1)
    halves = Image.new("RGB", (320, 240), (220, 30, 30))
    halves.paste((30, 60, 220), (160, 0, 320, 240))
    buffer = io.BytesIO()
    halves.save(buffer, "PNG")
    page.get_by_label("a picture or video").set_input_files(
        {"name": "halves.png", "mimeType": "image/png", "buffer": buffer.getvalue()}
    )
    await_text(page, "[role=status]", "looks at halves.png")
    await_likeness(page, halves)
    page.get_by_role("button", name="Use my webcam").click()
    await_text(page, "[role=status]", "Nothing leaves this machine")
    page.wait_for_function("() => document.querySelector('select').value === 'webcam'")
    # Chromium's own test picture is green.
    until(lambda: np.asarray(picture_of(page, "#live-picture")).mean((0, 1)).argmax() == 1, "green")
    page.get_by_role("button", name="Stop the webcam").click()
    page.get_by_label("Built-in picture").select_option("chart")
    await_likeness(page, built_in())


def test_picture_dropped_on_the_page_becomes_the_scene(visit: Visit) -> None:
    page = visit.show("viewfinder")
    await_frames(page, 1)
    halves = Image.new("RGB", (320, 240), (30, 200, 40))
    halves.paste((210, 40, 200), (160, 0, 320, 240))
    buffer = io.BytesIO()
    halves.save(buffer, "PNG")
    carried = page.evaluate_handle(
        "(bytes) => { const carried = new DataTransfer(); carried.items.add(new File("
        "[new Uint8Array(bytes)], 'dropped.png', { type: 'image/png' })); return carried; }",
        list(buffer.getvalue()),
    )
    for event in ("dragenter", "dragover", "drop"):
        page.dispatch_event("#live-picture", event, {"dataTransfer": carried})
    await_text(page, "[role=status]", "looks at dropped.png")
    await_likeness(page, halves)


# Half a second of a picture whose right half is yellow, as the browser itself records it.
RECORD = """async () => {
  const canvas = document.createElement("canvas");
  canvas.width = 320; canvas.height = 180;
  const context = canvas.getContext("2d");
  const recorder = new MediaRecorder(canvas.captureStream(20), { mimeType: "video/webm" });
  const parts = [];
  recorder.ondataavailable = (event) => parts.push(event.data);
  const ended = new Promise((done) => { recorder.onstop = done; });
  recorder.start();
  for (let number = 0; number < 12; number += 1) {
    context.fillStyle = "#000"; context.fillRect(0, 0, 160, 180);
    context.fillStyle = "#ee2"; context.fillRect(160, 0, 160, 180);
    await new Promise((done) => setTimeout(done, 50));
  }
  recorder.stop();
  await ended;
  const bytes = new Uint8Array(await new Blob(parts).arrayBuffer());
  return Array.from(bytes);
}"""


def test_twin_looks_at_a_video(visit: Visit) -> None:
    page = visit.show("viewfinder")
    await_frames(page, 1)
    video = bytes(page.evaluate(RECORD))
    field = page.get_by_label("a picture or video")
    field.set_input_files({"name": "halves.webm", "mimeType": "video/webm", "buffer": video})
    await_text(page, "[role=status]", "looks at halves.webm")
    seen = picture_of(page, "#live-picture")
    high = round(seen.width * 180 / 320)  # The camera's field is higher: black above and below.
    halves = Image.new("RGB", seen.size)
    top = (seen.height - high) // 2
    halves.paste((238, 238, 34), (seen.width // 2, top, seen.width, top + high))
    await_likeness(page, halves)
    page.get_by_label("Built-in picture").select_option("chart")
    await_likeness(page, built_in())
    field.set_input_files({"name": "none.webm", "mimeType": "video/webm", "buffer": b"no video"})
    page.get_by_text("none.webm cannot be played").wait_for()


def test_page_finds_the_studio_again_when_the_connection_breaks(visit: Visit) -> None:
    sockets: list[Any] = []

    def between(socket: Any) -> None:
        sockets.append(socket)
        socket.connect_to_server()

    visit.page.route_web_socket("**/api/live/frames", between)
    page = visit.show("viewfinder")
    await_frames(page, 2)
    page.evaluate(
        "() => new MutationObserver(() => { document.body.dataset.told +="
        " document.querySelector('#banner').textContent; }).observe("
        "document.querySelector('#banner'), { childList: true })"
    )
    sockets[-1].close(code=1012)
    page.wait_for_function("() => document.body.dataset.told?.includes('connection to the studio')")
    await_frames(page, 3)
    assert page.locator("#banner").is_hidden()
    assert len(sockets) == 2


def test_calibration_proposes_the_camera_that_runs_however_late_it_is_known(visit: Visit) -> None:
    held: list[Any] = []
    known = False

    def hold(route: Any) -> None:
        if known:
            route.continue_()
        else:
            held.append(route)

    visit.page.route("**/api/live", hold)
    page = visit.show("calibrate")
    description = page.get_by_label("Description")
    page.wait_for_function("() => document.querySelectorAll('.steps option').length > 3")
    assert description.input_value() == ""
    known = True
    for route in held:
        route.continue_()
    page.wait_for_function("() => document.querySelector('.steps select').value === 'live'")
    description.select_option("small")
    page.wait_for_timeout(2500)  # The state is asked for every 2 s.
    assert description.input_value() == "small"


def test_calibration_makes_the_psf_that_the_twin_has(visit: Visit, studio_folder: Path) -> None:
    page = visit.show("calibrate")
    await_text(page, ".view figcaption", "looks at no point source")
    page.get_by_role("button", name="Show the simulated camera a point source").click()
    await_text(page, ".view figcaption", "The PSF is in the middle")
    for number, name in enumerate(("Take frames", "Take dark frames")):
        page.get_by_label("How many").nth(number).fill("3")
        page.get_by_role("button", name=name, exact=True).click()
        page.locator(".steps [role=status]", has_text="3 taken").nth(number).wait_for()
    page.get_by_role("button", name="Make the PSF").click()
    figures = await_text(page, ".figures", "Line width")
    visit.keep("calibrate", scrolled=True)
    assert len([*(studio_folder / "nolens-studio" / "calibration").glob("*.dng")]) == 6
    made = studio_folder / "nolens-studio" / "cameras" / "my-camera"
    (entry,) = read_psf_set(made).psf
    assert entry.distance.mm == 300
    answer = visit.tell("live/save", {"as": ["raw"]})
    true = studio_folder / "nolens-studio" / answer.json()["psf_path"].removeprefix("work/")
    one, other = (
        read_frame(path).counts.mean(dim=0).double() for path in (made / entry.file, true)
    )
    assert one.shape == other.shape
    assert float(np.corrcoef(one.ravel(), other.ravel())[0, 1]) > 0.98
    assert "µm" in figures
    page.get_by_role("button", name="Add another distance").click()
    page.keyboard.type("500mm")
    page.get_by_role("button", name="Take frames", exact=True).click()
    page.locator(".steps [role=status]", has_text="3 taken").first.wait_for()
    page.get_by_role("button", name="Make the PSF").click()
    page.wait_for_function("() => !document.querySelector('.steps .job').hidden")
    page.get_by_role("link", name="psf-500mm.tif").wait_for()
    assert [each.distance.mm for each in read_psf_set(made).psf] == [300, 500]
