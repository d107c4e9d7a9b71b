"""Measurements on the page, and jobs that are cancelled or die.

Every test also holds that no request leaves this machine, and that neither an error nor a breach
of the content security policy is told on the console.
"""

import math
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from browser import Visit, await_text, needs_chromium

from nolens.files import read_camera
from nolens.optics import PointSource
from nolens.twin import preview_model
from patience import until

pytestmark = needs_chromium


CORNER = """async (image) => {
  await image.decode();
  const paint = new OffscreenCanvas(1, 1).getContext("2d");
  paint.drawImage(image, 0, 0, 1, 1, 0, 0, 1, 1);
  return [...paint.getImageData(0, 0, 1, 1).data].slice(0, 3);
}"""


def measured(page: Any, name: str) -> list[str]:
    """Rows of figures of a measurement, once its plot is there."""
    card = page.locator(f"[data-measure={name}]")
    card.get_by_role("button", name="Measure").click()
    plot = card.locator("img.wide:visible")
    plot.wait_for()
    assert plot.evaluate("async (e) => { await e.decode(); return e.naturalWidth; }") > 300
    rows: list[str] = card.locator("tr").all_inner_texts()
    return rows


def pictures_of(studio_folder: Path) -> Path:
    """The workspace's folder of pictures."""
    pictures = studio_folder / "nolens-studio" / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    return pictures


def figure(rows: list[str], name: str) -> float:
    """The number in a row."""
    (text,) = [row.split("\t")[1] for row in rows if row.startswith(name)]
    return float(text.split("°")[0].split(" ")[0])


def test_measurements_show_plots_and_figures(visit: Visit, shot: str) -> None:
    page = visit.show("measure")
    page.wait_for_function("() => document.querySelector('[data-panel=measure] select')?.value")
    page.get_by_label("Half angles").fill("0deg,10deg")
    psf, field = (measured(page, name) for name in ("psf", "field"))
    correlations = [float(row.split("\t")[1]) for row in field[1:]]
    assert correlations[0] > 0.99 > correlations[1]
    assert any(row.startswith("Line width") for row in psf)
    page.locator("#jobs-button").click()
    await_text(page, ".drawer .state", "done")
    visit.keep("jobs")
    page.keyboard.press("Escape")
    for theme, source in (("dark", ".dark.png"), ("light", ".png")):
        page.emulate_media(color_scheme=theme)
        for plot in page.locator("img.wide:visible").all():
            address = plot.get_attribute("src") or ""
            assert address.endswith(source) and (theme == "dark") == address.endswith(".dark.png")
            corner = plot.evaluate(CORNER)
            assert (max(corner) < 60) if theme == "dark" else (min(corner) > 250)
    page.emulate_media(color_scheme="dark")
    visit.keep("measure")
    assert page.locator("#jobs").is_hidden()


def test_targets_are_measured_in_simulations(visit: Visit, studio_folder: Path) -> None:
    """With options of "More", and dots in a picture: a simulation of those takes half a minute."""
    twin, pitch = preview_model(read_camera("small")), 24 / 300
    at, dots = np.arange(240.0), np.zeros((240, 240), np.float32)
    for i, j in product(range(-2, 3), repeat=2):
        shift = twin.shift_um(PointSource((i * pitch, j * pitch)))
        row, column = (120 + each / twin.pixel_um for each in shift)
        dots += np.exp(-((at[:, None] - row) ** 2 + (at - column) ** 2) / 4)
    np.save(pictures_of(studio_folder) / "dots.npy", dots)
    page = visit.show("measure")
    page.wait_for_function("() => document.querySelector('[data-measure=siemens] select')?.value")
    card = page.locator("[data-measure=dots]")
    card.get_by_role("button", name="A picture").click()
    card.get_by_label("Picture", exact=True).select_option("work/pictures/dots.npy")
    for label, text in (("dots", "24mm"), ("grid", "300mm")):
        card.get_by_label(f"Distance of the {label}").fill(text)
    rows = measured(page, "dots")
    cell_deg = figure(rows, "Field angle of a pixel in the middle")
    assert figure(rows, "Measured") == pytest.approx(24, rel=2e-3)
    for name in ("two-points", "siemens"):
        card = page.locator(f"[data-measure={name}]")
        assert not card.get_by_label("Iterations").is_visible()
        card.get_by_text("More", exact=True).click()
        card.get_by_label("Iterations").fill("60")
        # A pair of a bright and a dark line has at least two pixels.
        resolved = figure(measured(page, name), "Resolved")
        assert (1 if name == "two-points" else 2) * cell_deg * 0.9 < resolved < 20 * cell_deg
    visit.keep("measure-targets", scrolled=True)


def test_an_edge_in_a_picture_is_measured(visit: Visit, studio_folder: Path) -> None:
    rows, columns = np.mgrid[:121, :161] - np.array([60, 80])[:, None, None]
    away = columns * np.cos(0.09) + rows * np.sin(0.09)
    deviation = 2.0
    edge = [0.5 * (1 + math.erf(each / (deviation * math.sqrt(2)))) for each in away.ravel()]
    np.save(
        pictures_of(studio_folder) / "edge.npy", np.reshape(edge, away.shape).astype(np.float32)
    )
    page = visit.show("measure")
    card = page.locator("[data-measure=edge]")
    card.get_by_role("button", name="A picture").click()
    card.get_by_label("Picture", exact=True).select_option("work/pictures/edge.npy")
    rows = measured(page, "edge")
    # Of a Gaussian, exp(-2 (pi deviation frequency)²), where it is a half and a tenth.
    half, resolved = figure(rows, "Half of the contrast"), figure(rows, "Resolved from")
    assert half * resolved == pytest.approx(math.sqrt(math.log(2) / math.log(10)), rel=0.03)


def test_a_job_whose_process_dies_says_so_and_the_page_goes_on(visit: Visit) -> None:
    page = visit.show("measure")
    assert visit.tell("live/stop", {}).ok
    rest(workers_of(visit.address))  # From now on the job's process works alone.
    card = page.locator("[data-measure=two-points]")
    card.get_by_label("Camera").select_option("paper")
    card.get_by_text("More", exact=True).click()
    card.get_by_label("Repeats").fill("20")
    card.get_by_role("button", name="Measure").click()
    await_text(page, "[data-measure=two-points] .job-text", "point|Simulat|Working| of ")
    busiest(workers_of(visit.address)).kill()
    assert "SIGKILL" in await_text(page, "[data-measure=two-points] .trouble", ".")
    await_enabled(card)
    assert measured(page, "psf")
    assert visit.tell("live/start", {"source": "twin:live"}).ok


def await_enabled(card: Any) -> None:
    """Wait until a card can measure again: it asks for its job's state a few times a second."""
    from playwright.sync_api import expect

    expect(card.get_by_role("button", name="Measure")).to_be_enabled()


def worked_s(processes: list[psutil.Process]) -> list[float]:
    """Seconds that they have computed for."""
    return [sum(each.cpu_times()[:2]) for each in processes]


def rest(processes: list[psutil.Process]) -> None:
    """Wait until none has worked for a second: what was stopped may be at its last frame."""

    def rested() -> bool:
        before = sum(worked_s(processes))
        time.sleep(1.0)
        return sum(worked_s(processes)) < before + 0.1

    until(rested, "processes of the studio that rest")


def busiest(processes: list[psutil.Process]) -> psutil.Process:
    """The one that works, for half a second."""
    before = worked_s(processes)

    def working() -> list[psutil.Process]:
        grown = zip(processes, worked_s(processes), before, strict=True)
        return [each for each, now, was in grown if now - was >= 0.5]

    return until(working, "a process of the studio that works")[0]


def workers_of(address: str) -> list[psutil.Process]:
    """The processes in which a studio works."""
    port = int(address.split(":")[2].split("/")[0])
    (server,) = {
        each.pid for each in psutil.net_connections("tcp")
        if each.status == psutil.CONN_LISTEN and each.laddr.port == port
    }  # fmt: skip
    children = psutil.Process(server).children(recursive=True)
    return [each for each in children if "resource_tracker" not in " ".join(each.cmdline())]


def test_a_job_is_cancelled_in_the_drawer(visit: Visit) -> None:
    page = visit.show("measure")
    card = page.locator("[data-measure=two-points]")
    card.get_by_label("Camera").select_option("paper")
    card.get_by_text("More", exact=True).click()
    card.get_by_label("Repeats").fill("20")
    card.get_by_role("button", name="Measure").click()
    page.locator("#jobs-button").click()
    job = page.locator(".drawer .job").first
    await_text(page, ".drawer .job .state", "running")
    job.get_by_role("button", name="Cancel").click()
    await_text(page, ".drawer .job .state", "cancelled")
    await_enabled(card)
    assert card.locator("img.wide").count() == 0
