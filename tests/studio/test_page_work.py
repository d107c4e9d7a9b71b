"""Design, photographs and the page itself, from the studio's default start.

Every test also holds that no request leaves this machine, and that neither an error nor a breach
of the content security policy is told on the console.
"""

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from browser import Visit, await_text, needs_chromium, picture_of, until
from PIL import Image
from serving import write_own_weights

import nolens as nl
from nolens.camera import PsfEntry
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import read_psf_set, write_camera, write_psfs
from nolens.optics import PointSource
from nolens.twin import Light

pytestmark = needs_chromium
_PANELS = ("viewfinder", "design", "calibrate", "photograph", "measure")


def set_slider(page: Any, label: str, share: float) -> None:
    """Drag a slider to a share of its way."""
    page.get_by_role("slider", name=label, exact=True).evaluate(
        "(each, share) => { each.value = Number(each.min) + share * (each.max - each.min);"
        " each.dispatchEvent(new Event('input')); each.dispatchEvent(new Event('change')); }",
        share,
    )


def line_width_um(page: Any) -> float:
    """Line width that the design panel tells."""
    text = page.get_by_role("row", name="Line width (FWHM)").inner_text()
    return float(text.split()[-2])


def await_look(page: Any) -> None:
    """Wait until the design has been computed."""
    await_text(page, ".job-text", "Computing the PSF")
    page.wait_for_function(
        "() => ![...document.querySelectorAll('.job-text')]"
        ".some((each) => each.textContent.startsWith('Computing the PSF'))"
    )


def test_pattern_widens_out_of_focus_and_narrows_in_the_best(visit: Visit) -> None:
    page = visit.show("design")
    await_text(page, ".figures", "Line width")
    visit.keep("design")
    described = line_width_um(page)
    before = page.get_by_alt_text("Point spread function").get_attribute("src")
    set_slider(page, "resin · pua311", 0.05)
    await_look(page)
    thin = line_width_um(page)
    assert page.get_by_alt_text("Point spread function").get_attribute("src") != before
    page.get_by_role("button", name="Set to the best focus").click()
    await_look(page)
    best = line_width_um(page)
    assert thin > 1.15 * best
    assert best <= described
    row = page.get_by_role("row", name="It is off by").inner_text()
    assert float(row.split()[-2]) == 0


def test_files_for_the_workshop_can_be_downloaded(visit: Visit) -> None:
    page = visit.show("design")
    page.get_by_label("Description").select_option("small")
    await_text(page, ".figures", "Line width")
    page.locator("[data-panel=design]").get_by_text("More", exact=True).click()
    page.get_by_label("Thickness of the wall").fill("2mm")
    page.get_by_label("Triangles, at most").fill("20000")
    page.get_by_role("button", name="Make the files").click()
    page.get_by_role("link", name="frame.stl").wait_for()
    options = visit.job(visit.jobs()[0]["id"])["options"]
    assert options == {"camera": "small", "wall": "2mm", "triangles": 20000}
    with page.expect_download() as download:
        page.get_by_role("link", name="sheet.pdf").click()
    assert Path(download.value.path()).read_bytes().startswith(b"%PDF")


def test_photograph_forms_and_is_found_again(visit: Visit, studio_folder: Path, shot: str) -> None:
    page = visit.show("photograph")
    await_text(page, "figcaption [role=status]", r"\d+ × \d+ pixels")
    chooser = page.get_by_label("Raw file", exact=True)
    folder = next(studio_folder.rglob(shot)).parent
    newest = max(folder.glob("[0-9]*[0-9].dng"), key=lambda each: each.stat().st_mtime_ns)
    # Another test may have saved one since.
    assert chooser.evaluate("(each) => each.selectedOptions[0].label") == newest.name
    if newest.name != shot:
        chooser.select_option(label=shot)
        await_text(page, "figcaption [role=status]", r"\d+ × \d+ pixels")
    page.get_by_role("button", name="Draft").click()
    page.get_by_role("button", name="Reconstruct").click()
    await_text(page, "#main .stage b", r"\.png$")
    draft = page.locator("#photograph").evaluate("(each) => each.toDataURL()")
    page.get_by_role("button", name="Photo", exact=True).click()
    page.get_by_role("button", name="Reconstruct").click()
    page.wait_for_selector(".objective polyline.curve")
    page.wait_for_function(
        "(before) => document.querySelector('#photograph').toDataURL() !== before", arg=draft
    )
    name = page.locator("#main .stage b").first.inner_text()
    page.reload()
    await_text(page, "#main .stage b", f"^{name}$")
    shown = picture_of(page, "#photograph")
    kept = studio_folder / "nolens-studio" / "pictures" / name
    with Image.open(kept) as file:
        assert np.array_equal(np.asarray(shown), np.asarray(file.convert("RGB")))
    set_slider(page, "Gamma", 0.55)
    before = np.asarray(shown).mean()
    until(lambda: np.asarray(picture_of(page, "#photograph")).mean() > before, "it is brighter")
    page.get_by_role("button", name="Crop", exact=True).click()
    box = page.locator("#photograph").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.8 * box["height"])
    page.mouse.up()
    visit.keep("photograph")
    with page.expect_download() as download:
        page.get_by_role("button", name="Save as PNG").click()
    with Image.open(download.value.path()) as saved:
        share = (saved.width / shown.width, saved.height / shown.height)
    assert share == pytest.approx((0.2, 0.3), abs=0.03)
    undone(page, shown)
    read_out(page, kept.with_suffix(".tif"))
    refused(page, studio_folder)
    compared(page)
    visit.keep("compare")
    page.get_by_role("button", name="Results").click()
    await_text(page, ".card", f"{name}.*ADMM")
    visit.keep("results")


def test_one_of_several_settings_is_chosen_by_its_picture(visit: Visit, shot: str) -> None:
    page = visit.show("photograph")
    page.get_by_label("Raw file", exact=True).select_option(label=shot)
    await_text(page, "figcaption [role=status]", r"\d+ × \d+ pixels")
    page.get_by_role("button", name="Draft").click()
    page.get_by_label("Compare", exact=True).select_option("tau")
    page.get_by_role("button", name="Reconstruct").click()
    strip = page.get_by_role("group", name="Pictures with other settings")
    strip.get_by_role("button", name="Detail 1", exact=True).wait_for()
    assert strip.get_by_role("button").count() == 5
    pressed = strip.locator("[aria-pressed=true]")
    assert pressed.inner_text().strip() == "Detail 1"
    usual = page.locator("#photograph").evaluate("(each) => each.toDataURL()")
    strip.get_by_role("button", name="Detail 0.25").click()
    page.wait_for_function(
        "(before) => document.querySelector('#photograph').toDataURL() !== before", arg=usual
    )
    visit.keep("sweep")
    page.get_by_role("button", name="Use this setting").click()
    detail = page.get_by_role("slider", name="Detail")
    assert detail.get_attribute("aria-valuetext") == "4 × smoother"
    assert page.get_by_label("Compare", exact=True).input_value() == ""


def undone(page: Any, shown: Image.Image) -> None:
    """Crop and tone go back step by step, and forth again."""
    size = page.locator("[data-panel=photograph] .stage figcaption .named").first
    cropped, toned = size.inner_text(), np.asarray(picture_of(page, "#photograph"))
    page.get_by_role("button", name="Undo").click()
    assert f"{shown.width} × {shown.height} pixels" in size.inner_text() != cropped
    page.locator("body").press("Control+z")
    assert np.array_equal(np.asarray(picture_of(page, "#photograph")), np.asarray(shown))
    assert page.get_by_role("button", name="Undo").is_disabled()
    page.locator("body").press("Control+Shift+z")
    page.get_by_role("button", name="Redo").click()
    assert size.inner_text() == cropped
    assert np.array_equal(np.asarray(picture_of(page, "#photograph")), toned)
    page.get_by_role("button", name="Crop", exact=True).click()


def read_out(page: Any, linear: Path) -> None:
    """A place of the picture stays under the pointer while it is enlarged, and gives the values
    of the file, with its angle; the picture fills the screen and comes back.
    """
    stage = page.locator("[data-panel=photograph] .stage")
    box = page.locator("#photograph").bounding_box()
    place = box["x"] + 0.3 * box["width"], box["y"] + 0.4 * box["height"]
    page.mouse.move(*place)
    probe = "[data-panel=photograph] .stage .probe"
    text = await_text(page, probe, "radiance")
    x, y, *rgb = (float(each) for each in re.findall(r"[xyRGB] (?:≥ )?([\d.]+)", text))
    with tifffile.TiffFile(linear) as tiff:
        values = tiff.asarray()[int(y), int(x)] * json.loads(tiff.pages[0].description)["per_count"]
    assert rgb == pytest.approx(list(values), rel=0.01, abs=1e-5)
    assert re.search(r"[\d.]+° left, [\d.]+° up", text)
    page.mouse.dblclick(*place)
    larger = page.locator("#photograph").bounding_box()
    assert larger["width"] > 1.9 * box["width"]
    assert page.locator(probe).first.inner_text() == text
    page.mouse.down()
    page.mouse.move(place[0] + 60, place[1] + 40)
    page.mouse.up()
    moved = page.locator("#photograph").bounding_box()
    assert moved["x"] - larger["x"] == pytest.approx(60, abs=1)
    page.get_by_role("button", name="Pixel for pixel: Picture").click()
    width = page.locator("#photograph").bounding_box()["width"]
    assert width == page.locator("#photograph").evaluate("(each) => each.width")
    page.get_by_role("button", name="Full screen: Picture").click()
    page.wait_for_function("() => document.fullscreenElement")
    stage.locator(".frame").first.press("f")
    page.wait_for_function("() => !document.fullscreenElement")
    stage.locator(".frame").first.press("0")
    assert page.locator("#photograph").bounding_box()["width"] == pytest.approx(box["width"], abs=2)


def compared(page: Any) -> None:
    """The measurement lies beside the picture, up to a handle that pointer and keys move."""
    page.get_by_role("button", name="Compare").click()
    page.wait_for_function(
        "() => [...document.querySelectorAll('.plane > img')].filter((e) => e.checkVisibility()"
        " && e.naturalWidth).length >= 3"
    )
    assert page.get_by_label("Left", exact=True).input_value().endswith(".dng")
    assert page.get_by_label("Right", exact=True).input_value().endswith(".png")
    handle = page.get_by_role("slider", name="Left picture up to")
    frame = page.locator(".frame:has(.divide)")
    box, place = frame.bounding_box(), handle.bounding_box()
    page.mouse.move(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 20)
    page.mouse.up()
    assert handle.get_attribute("aria-valuenow") == "25"
    handle.press("ArrowRight")
    assert handle.get_attribute("aria-valuenow") == "27"


def dropped(page: Any, files: dict[str, bytes]) -> None:
    """Drop files on the panel."""
    carried = page.evaluate_handle(
        "(files) => { const carried = new DataTransfer(); for (const [name, bytes] of files)"
        " carried.items.add(new File([new Uint8Array(bytes)], name)); return carried; }",
        [[name, list(content)] for name, content in files.items()],
    )
    page.dispatch_event("[data-panel=photograph]", "drop", {"dataTransfer": carried})


def test_two_files_are_dropped_and_the_options_reach_the_job(
    visit: Visit, studio_folder: Path, shot: str
) -> None:
    work = studio_folder / "nolens-studio"
    frame = (work / "shots" / shot).read_bytes()
    psf = next((work / "cameras").glob("twin-*/psf*.tif")).read_bytes()
    page = visit.show("photograph")
    await_text(page, "figcaption [role=status]", r"\d+ × \d+ pixels")
    dropped(page, {"door.dng": frame, "door-psf.tif": psf})
    page.wait_for_function("() => /door.dng$/.test(document.querySelector('select').value)")
    assert page.get_by_label("PSF", exact=True).input_value() == "work/uploads/door-psf.tif"
    assert page.get_by_label("Turn the picture").is_visible()
    form = reconstruction(page)
    assert not form.get_by_label("Prior", exact=True).is_visible()
    form.get_by_text("More", exact=True).click()
    solver = form.get_by_role("region", name="Model and solver")
    assert solver.get_by_label("Prior", exact=True).is_visible()
    page.get_by_label("Flat field of yours").set_input_files(
        {"name": "flat.dng", "mimeType": "", "buffer": frame}
    )
    page.wait_for_function(
        "() => [...document.querySelectorAll('select')].some((e) => /flat.dng$/.test(e.value))"
    )
    page.get_by_label("Turn the picture").select_option("Mirrored")
    own_weights(page, studio_folder)
    form.get_by_label("Prior", exact=True).select_option("Few bright points (l1)")
    page.get_by_label("Fit low frequencies").select_option("Off")
    form.get_by_label("Iterations, at most").fill("3")
    page.get_by_label("Binning").fill("2")
    page.get_by_role("button", name="Reconstruct").click()
    await_text(page, "#main .stage b", r"^door.*\.png$")
    (job,) = [each for each in visit.jobs() if each["title"] == "Reconstruct door.dng"]
    assert job["status"] == "done"
    options = visit.job(job["id"])["options"]
    assert options == {
        "measurement": "work/uploads/door.dng",
        "psf": "work/uploads/door-psf.tif",
        "flat": "work/uploads/flat.dng",
        "flip": "horizontal",
        "prior": "l1",
        "low_frequency": False,
        "iterations": 3,
        "bin": 2,
    }
    used_again(visit)


def own_weights(page: Any, folder: Path) -> None:
    """A prior of one's own is brought, and stays chosen while files are listed anew; what is no
    file of weights is refused, and leaves the choice.
    """
    prior = reconstruction(page).get_by_label("Prior", exact=True)
    bring = page.get_by_label("Prior of yours")
    assert prior.input_value() == "auto"
    bring.set_input_files(write_own_weights(folder / "mine.npz"))
    page.wait_for_function(
        "() => [...document.querySelectorAll('select')].some((e) => /mine.npz$/.test(e.value))"
    )
    assert prior.input_value() == "work/uploads/mine.npz"
    assert prior.locator("optgroup option").all_inner_texts() == ["mine.npz"]
    bring.set_input_files({"name": "note.toml", "mimeType": "", "buffer": b"[note]\n"})
    await_text(page, "#notices", "note.toml cannot be used here: bring an .npz of weights")
    assert prior.input_value() == "work/uploads/mine.npz"


def used_again(visit: Visit) -> None:
    """The gallery has the result with its main figures; its settings are taken again."""
    page = visit.page
    page.get_by_role("button", name="Draft").click()
    for label, other in (("Turn the picture", "As it is"), ("Prior", "Total variation")):
        reconstruction(page).get_by_label(label, exact=True).select_option(other)
    page.get_by_label("Binning").fill("")
    page.get_by_role("button", name="Results").click()
    card = page.locator(".card", has_text="door.png")
    assert "ADMM · 3 iterations" in await_text(page, ".card", r"door.png.*ADMM")
    thumbnail = card.locator("img")
    assert thumbnail.evaluate("async (e) => { await e.decode(); return e.naturalWidth; }") > 50
    card.click()
    rows = await_text(page, ".record .figures", "door-psf.tif")
    assert "Turn the picture: horizontal" in rows and "Prior: l1" in rows
    report = await_text(page, ".report .figures", "Noise")
    names = page.locator(".report th").all_inner_texts()
    assert names == ["Noise", "Unexplained", "Resolution", "Support", "Run"]
    assert "noise alone would be" in report and "admm, 3 iterations" in report
    page.get_by_role("button", name="Use these settings again").click()
    page.wait_for_function(
        "() => [...document.querySelectorAll('select')].some((e) => e.value === 'l1')"
    )
    assert page.get_by_label("Turn the picture").input_value() == "horizontal"
    assert page.get_by_label("Binning").input_value() == "2"
    assert page.get_by_label("PSF", exact=True).input_value() == "work/uploads/door-psf.tif"
    assert (
        page.get_by_role("button", name="Photo", exact=True).get_attribute("aria-pressed") == "true"
    )


def reconstruction(page: Any) -> Any:
    """The form of a reconstruction."""
    return page.get_by_role("region", name="Reconstruction", exact=True)


def refused(page: Any, studio_folder: Path) -> None:
    """A PSF that does not fit is told by the names of the page's fields, beside no picture."""
    more = reconstruction(page).get_by_text("More", exact=True)
    more.click()
    page.get_by_label("PSF pixels finer by").fill("3")
    more.click()
    page.get_by_role("button", name="Reconstruct").click()
    said = await_text(page, "[data-panel=photograph] .trouble", "PSF pixels finer by")
    assert "--" not in said and str(studio_folder) in said
    assert page.get_by_label("PSF pixels finer by").is_visible()
    assert page.locator("#main .stage b").first.inner_text().startswith("Previous picture: ")
    page.get_by_label("PSF pixels finer by").fill("")


def test_click_focuses_on_a_point(visit: Visit, studio_folder: Path, shot: str) -> None:
    write_bands(studio_folder / "nolens-studio")
    page = visit.show("photograph")
    await_text(page, "figcaption [role=status]", r"\d+ × \d+ pixels")
    form = page.get_by_role("region", name="Refocus", exact=True)
    form.get_by_label("Depths").fill("2")
    page.get_by_label("Nearest").fill("15cm")
    form.get_by_text("More", exact=True).click()
    form.get_by_label("τ, weight of the prior").fill("1e-4")
    form.get_by_label("Iterations, at most").fill("30")
    page.get_by_role("button", name="Make the focal stack").click()
    page.wait_for_selector("#depth-picture")
    await_text(page, "[role=status]", "Sharp everywhere")
    page.locator("#depth-picture").click()
    assert await_text(page, "[role=status]", r"Sharp at \d")
    first = page.locator("#depth-picture").get_attribute("src")
    set_slider(page, "Depth", 0.0)
    near = page.locator("#depth-picture").get_attribute("src")
    set_slider(page, "Depth", 1.0)
    far = page.locator("#depth-picture").get_attribute("src")
    assert near != far and first in (near, far)
    visit.keep("refocus")
    depths_together(page)
    video_plays(page)
    spectrum_of_a_click(page, studio_folder / "nolens-studio" / "pictures" / "leaf")
    opened_again(page)
    # The version before had another name for the grid.
    former = 'const told = {"depths": ["1 m"], "sharpest": [[0]]};'
    stack = page.evaluate(
        "text => import('/js/depths.js').then(({ stackOf }) => stackOf(text))", f"\n{former}\n"
    )
    assert stack == {"depths": ["1 m"], "best_page": [[0]]}


def depths_together(page: Any) -> None:
    """Planes that are solved together are turned by the slider of the focal stack."""
    page.get_by_role("button", name="Picture", exact=True).click()
    form = page.get_by_role("region", name="Reconstruction", exact=True)
    form.get_by_text("More", exact=True).first.click()
    form.get_by_label("Depths").fill("15cm,infinity")
    form.get_by_role("textbox", name="Channels").fill("grey")
    form.get_by_label("Support of the scene").fill("40x40")
    form.get_by_label("τ, weight of the prior").fill("1e-3")
    form.get_by_label("Iterations, at most").fill("8")
    form.get_by_label("Noise").select_option("Poisson's law")
    form.get_by_label("Depth smoothness").fill("0.1")
    page.get_by_role("button", name="Reconstruct").click()
    await_text(page, "#main .stage b", "all-in-focus")
    page.get_by_role("button", name="Depths", exact=True).click()
    set_slider(page, "Depth", 1.0)
    await_text(page, "[role=status]", "Sharp at infinity")
    for label in ("Depths", "Depth smoothness"):
        form.get_by_label(label).fill("")
    form.get_by_label("Noise").select_option("auto")


def video_plays(page: Any) -> None:
    """A video of one still is played where pictures are; the method has the PSFs beside it."""
    form = reconstruction(page)
    labels = form.get_by_role("region", name="Model and solver").locator("label").all_inner_texts()
    assert labels[labels.index("Method") + 1] == "PSFs over the field"
    form.get_by_label("Frames of a video").fill("3")
    form.get_by_label("Exposure time of a line").fill("1ms")
    page.get_by_role("button", name="Reconstruct").click()
    await_text(page, "#main .stage .named", r"\.mp4 .*3 frames")
    video = page.locator("video")
    playing = "(video) => video.play().then(() => [video.duration, video.videoWidth])"
    assert video.evaluate(playing) == pytest.approx([3 / 12, 480], abs=0.1)
    page.wait_for_function("() => document.querySelector('video').currentTime > 0")
    assert not page.locator("#photograph").is_visible()
    # What the browser cannot play gives way to the sheet.
    video.evaluate("(video) => { video.src = video.src.replace(/mp4$/, 'png'); }")
    page.locator("#photograph").wait_for(state="visible")
    for label in ("Frames of a video", "Exposure time of a line", "Channels"):
        form.get_by_role("textbox", name=label, exact=True).fill("")


def opened_again(page: Any) -> None:
    """The gallery's video plays, and its volume's settings are taken."""
    for text in (r"3 frames", r"^[\d-]+\D{3} .*ADMM · 8"):
        page.get_by_role("button", name="Results").click()
        page.locator(".card").filter(has_text=re.compile(text)).first.click()
        if "frames" in text:
            page.locator("video").wait_for(state="visible")
            assert not page.locator(".spectrum").is_visible()
    await_text(page, ".record .figures", "Depths: 15 cm,infinity")
    page.get_by_role("button", name="Use these settings again").click()
    page.wait_for_function(
        "() => [...document.querySelectorAll('input')].some((e) => e.value === '15 cm,infinity')"
    )
    assert re.search(r"/psf\S*\.tif$", page.get_by_label("PSF", exact=True).input_value())
    form = reconstruction(page)
    assert form.get_by_label("Noise").input_value() == "poisson"
    assert form.get_by_label("Depth smoothness").input_value() == "0.1"


def write_bands(work: Path) -> None:
    """A camera, its PSF on all pixels, and a raw frame of a scene in three bands."""
    camera = nl.Camera("small")
    places = ["450nm", "540nm", "620nm"]
    scene = np.full((3, 24, 32), 0.1)
    scene[0, 4:12, 4:12] = scene[1, 12:20, 12:24] = scene[2, 6:20, 24:28] = 1
    shot = nl.simulate(scene, camera, bands=places, angle="4deg", field_points=1)
    (work / "uploads").mkdir(exist_ok=True)
    nl.save_frame(shot.frame, work / "uploads" / "leaf.dng")
    sensor = camera.loaded.camera.sensor
    source = PointSource((0.0, 0.0), 3e5)
    size = (sensor.rows, sensor.columns)
    psf = VirtualExperiment(camera.twin, Light("540nm")).psf(source, size, pixels=1)
    entry = {"file": "psf.tif", "pixel": str(sensor.pitch), "channels": ("grey",)}
    folder = work / "cameras" / "leaf"
    write_camera(folder, camera.loaded.camera)
    entry |= {"distance": "300 mm"}
    write_psfs(folder, {PsfEntry.model_validate(entry): psf.amax(0, keepdim=True)})


def spectrum_of_a_click(page: Any, folder: Path) -> None:
    """False colours are shown where pictures are, and a click has the spectrum of its place."""
    page.get_by_label("Raw file", exact=True).select_option(label="leaf.dng")
    await_text(page, "figcaption [role=status]", r"\d+ × \d+ pixels")
    page.get_by_label("PSF", exact=True).select_option(label="leaf: 300 mm")
    form = reconstruction(page)
    form.get_by_label("Bands").fill("3")
    form.get_by_label("Support of the scene").fill("48x64")
    page.get_by_role("button", name="Reconstruct").click()
    await_text(page, "#main .stage b", "false-colour.png")
    box = page.locator("#photograph").bounding_box()
    page.mouse.click(box["x"] + 0.55 * box["width"], box["y"] + 0.65 * box["height"])
    page.locator(".spectrum polyline").wait_for()
    row, column = map(int, re.findall(r"\d+", await_text(page, "[role=status]", "^Row")))
    points = page.locator(".spectrum polyline").get_attribute("points").split()
    heights = [-float(point.split(",")[1]) for point in points]
    cube = tifffile.imread(folder / "cube.ome.tif").squeeze()[:, row, column]
    slope = (max(heights) - min(heights)) / (cube.max() - cube.min())
    assert heights == pytest.approx(list(slope * (cube - cube.min()) + min(heights)), abs=0.5)


def test_psf_from_elsewhere(visit: Visit, studio_folder: Path) -> None:
    """Another group's file becomes the PSF of a folder, and the page says what was done to it."""
    rows, columns = np.mgrid[-60:60, -50:50]
    counts = 200 + 60000 * np.exp(-(rows**2 + columns**2) / 60)
    stored = io.BytesIO()
    tifffile.imwrite(stored, counts.clip(0, 40000).astype(np.uint16), photometric="minisblack")
    page = visit.show("calibrate")
    page.get_by_label("Description").select_option("")
    page.get_by_label("Folder of its PSFs").fill("theirs")
    page.get_by_text("Or import PSFs from elsewhere").click()
    page.get_by_label("PSF files").set_input_files(
        {"name": "lab.tif", "mimeType": "", "buffer": stored.getvalue()}
    )
    page.get_by_label("Distances of the PSFs").fill("20cm")
    page.get_by_label("Pitch of the pixels").fill("3.1um")
    page.get_by_label("Size of the sensor").fill("120x160")
    page.get_by_role("button", name="Import", exact=True).click()
    assert "from its dark area" in await_text(page, ".steps .figures", "120 × 160 pixels of 3.1 um")
    assert page.get_by_text("60 dark columns are added around its middle").is_visible()
    wide = "() => document.documentElement.scrollWidth - innerWidth"
    assert page.evaluate(wide) <= 0
    (entry,) = read_psf_set(studio_folder / "nolens-studio" / "cameras" / "theirs").psf
    assert entry.distance.mm == 200 and entry.file == "psf-200mm.tif"


def test_what_cannot_be_done_is_said_in_words(visit: Visit) -> None:
    page = visit.show("calibrate")
    page.get_by_role("button", name="Make the PSF").click()
    await_text(page, "#notices", "no frames of the point source")
    page.keyboard.press("Escape")
    assert page.locator("#notices").inner_text() == ""
    visit.allowed = "status of 422"
    page.keyboard.press("5")
    page.get_by_label("Half angles").fill("sideways")
    page.locator("[data-measure=field]").get_by_role("button", name="Measure").click()
    await_text(page, "#notices", "sideways")


def test_chosen_theme_is_kept(visit: Visit) -> None:
    page = visit.show("measure")
    paper = "getComputedStyle(document.body).backgroundColor"
    dark = page.evaluate(paper)
    page.get_by_role("button", name="Switch to the light theme").click()
    light = page.evaluate(paper)
    assert light != dark
    page.reload()
    assert page.evaluate(paper) == light
    page.get_by_role("button", name="Switch to the dark theme").click()
    assert page.evaluate(paper) == dark


# Colours that are still on their way are neither the one nor the other.
STILL = "() => !document.getAnimations().some((each) => each instanceof CSSTransition)"
# Text and its background as they are painted; pictures and controls that are off are left out.
CONTRAST = """() => {
  const paint = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
  const seen = (colours) => {
    paint.clearRect(0, 0, 1, 1);
    for (const colour of colours) { paint.fillStyle = colour; paint.fillRect(0, 0, 1, 1); }
    return [...paint.getImageData(0, 0, 1, 1).data].slice(0, 3);
  };
  const light = (rgb) => rgb.map((each) => each / 255)
    .map((each) => each <= 0.04045 ? each / 12.92 : ((each + 0.055) / 1.055) ** 2.4)
    .reduce((sum, each, at) => sum + [0.2126, 0.7152, 0.0722][at] * each, 0);
  const found = [];
  for (const element of document.querySelectorAll("body *")) {
    const own = [...element.childNodes].some((e) => e.nodeType === 3 && e.data.trim());
    if (!own || !element.checkVisibility({ opacityProperty: true, visibilityProperty: true })
      || element.closest(".unseen, :disabled, .frame, svg, option")) continue;
    const behind = [];
    for (let each = element; each; each = each.parentElement) {
      behind.unshift(getComputedStyle(each).backgroundColor);
    }
    const style = getComputedStyle(element);
    const both = [seen(behind), seen([...behind, style.color])].map(light).sort((a, b) => b - a);
    const ratio = (both[0] + 0.05) / (both[1] + 0.05);
    const large = parseFloat(style.fontSize) >= 24;
    if (ratio < (large ? 3 : 4.5)) found.push([element.textContent.trim().slice(0, 40), ratio]);
  }
  return found;
}"""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_stands_out_from_what_is_behind_it(visit: Visit, theme: str) -> None:
    """At least 4.5 to 1, as WCAG 2.2 AA asks (3 to 1 for large text)."""
    page = visit.show("viewfinder")
    page.emulate_media(color_scheme=theme)
    await_text(page, ".verdict", "Exposure right")
    for key in range(1, len(_PANELS) + 1):
        page.keyboard.press(str(key))
        page.wait_for_timeout(300)
        page.wait_for_function(STILL)
        assert page.evaluate(CONTRAST) == []


def test_scene_camera_and_reconstruct_are_above_the_fold(visit: Visit) -> None:
    page = visit.show("viewfinder")
    page.set_viewport_size({"width": 1280, "height": 800})
    await_text(page, ".view figcaption", "twin of")
    for title in ("Scene", "Camera", "Save", "Light", "Reconstruction"):
        box = page.get_by_role("region", name=title, exact=True).bounding_box()
        assert box["y"] + box["height"] <= 800, title
    page.keyboard.press("4")
    await_text(page, ".named", "pixels|Measurement")
    for name in ("Reconstruct", "Save as PNG", "Crop"):
        box = page.get_by_role("button", name=name, exact=True).bounding_box()
        assert box["y"] + box["height"] <= 800, name
    phone = visit.phone("photograph")
    order = [phone.get_by_label("Raw file", exact=True), phone.locator("#photograph"),
             phone.get_by_role("button", name="Save as PNG")]  # fmt: skip
    places = [each.bounding_box()["y"] for each in order]
    assert places == sorted(places) and places[0] < 400


def test_keys_and_widths(visit: Visit) -> None:
    page = visit.show("viewfinder")
    for key, panel in enumerate(_PANELS, start=1):
        page.keyboard.press(str(key))
        page.wait_for_selector(f"[data-panel={panel}]:not([hidden])")
        assert page.locator("[aria-current]").inner_text().endswith(panel.capitalize())
        page.set_viewport_size({"width": 360, "height": 740})
        assert page.evaluate("document.documentElement.scrollWidth") == 360
        page.set_viewport_size({"width": 1280, "height": 860})
        unnamed = page.evaluate(
            "[...document.querySelectorAll('main :is(input, select, button)')].filter((e) =>"
            " e.checkVisibility() && !e.labels?.length && !e.textContent.trim()"
            " && !e.getAttribute('aria-label')).length"
        )
        assert unnamed == 0
