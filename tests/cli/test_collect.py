"""`nolens collect`: a simulated camera before a simulated screen, and the page of a real one."""

import io
import json
import threading
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from little_camera import little_twin
from PIL import Image
from running import check_refused, listing, run
from skimage import data

import nolens.capture.twin
import nolens.studio.screen
from nolens.camera import develop, linear_from_srgb
from nolens.capture import Shot, TwinSource
from nolens.capture.screen import TwinScreen
from nolens.cli.collect import CollectTerminal
from nolens.errors import CameraError, ScreenError
from nolens.files import read_frame, read_picture
from nolens.jobs import CollectOptions, collect
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.studio.screen import ScreenPage

PICTURES = {"cat": data.chelsea, "cup": data.coffee, "man": data.astronaut, "page": data.page}
SCREEN = ("--distance", "300mm", "--screen-width", "18mm")


@pytest.fixture(scope="module")
def bright() -> Any:
    """A screen so bright that no frame takes its time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nolens.capture.twin, "_LUMINANCE_CD_M2", 4e5)
        yield


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory, bright: None) -> Path:
    """A folder with pictures, and with pairs that were ended after two, then gone on with."""
    made = tmp_path_factory.mktemp("collect")
    little_twin(made)
    (made / "shown").mkdir()
    for name, picture in PICTURES.items():
        Image.fromarray(picture()).convert("RGB").resize((160, 90)).save(
            made / "shown" / f"{name}.png"
        )

    class Impatient(CollectTerminal):
        def step(self, what: str, done: int, limit: int, result: str, state: str = "") -> bool:
            return done == 2

    options = CollectOptions.gather(
        {"pictures": made / "shown", "output": made / "pairs", "distance": "300mm",
         "screen_width": "18mm", "source": f"twin:{made / 'camera.toml'}"}
    )  # fmt: skip
    summary = collect(options, Impatient()).summary
    assert (summary["pictures"], summary["left"]) == (2, 2)
    before = listing(made / "pairs" / "measured")
    assert len(before) == 2
    done = again(made)
    assert done.code == 0 and "4 pairs by twin of small" in done.out, done
    (made / "told.txt").write_text(done.out)
    after = listing(made / "pairs" / "measured")
    assert len(after) == 4 and before.items() <= after.items()
    return made


def again(made: Path, *more: object, output: str = "pairs") -> Any:
    return run(
        "collect", made / "shown", *SCREEN, "--source", f"twin:{made / 'camera.toml'}",
        "-o", made / output, *more,
    )  # fmt: skip


def test_the_screen_is_found_where_it_stands(bench: Path) -> None:
    """To 0.2 pixels, but for the zero shift, which is where the middle dot is seen."""
    record = json.loads((bench / "pairs" / "collect.json").read_text())["result"]
    matrix = np.array(record["screen"]["matrix"])
    source = TwinSource.of(str(bench / "camera.toml"))
    source.open()
    screen = TwinScreen(source, 18, 300)
    support = source.support
    rows, columns = np.mgrid[: support.height, : support.width]
    place = matrix @ np.stack(
        [(rows + support.top).ravel(), (columns + support.left).ravel(), np.ones(rows.size)]
    )
    beside = (place[:2] / place[2]).reshape(2, *rows.shape) - screen.places
    size = np.array(screen.size)[:, None, None]
    on_it = ((screen.places >= 0) & (screen.places < size)).all(axis=0)
    beside = beside[:, on_it] - beside[:, on_it].mean(axis=1, keepdims=True)
    pixels = np.sqrt((beside**2).sum(axis=0).mean()) / np.sqrt(abs(np.linalg.det(matrix[:2, :2])))
    assert pixels < 0.2 and record["screen"]["error_px"] < 0.5


def test_pairs_fit_together(bench: Path) -> None:
    """The middle dot is a PSF, blurred: with it the pictures give what was measured."""
    pairs = bench / "pairs"
    read = {name: read_frame(pairs / "pattern" / f"{name}.dng") for name in ("black", "dot-5")}
    psf = develop(read["dot-5"]).values - develop(read["black"]).values
    text = json.loads((pairs / "collect.json").read_text())["result"]["screen"]["support"]
    height, width = map(int, text.split("+")[0].split("x"))
    support = PixelRectangle.centred(height, width, (48, 64))
    assert support.text == text
    dark = read_frame(pairs / "dark.tif")
    alike = {}
    for shown in PICTURES:
        picture = read_picture(pairs / "pictures" / f"{shown}.png").radiance
        assert picture.shape[-2:] == (height, width)
        light = CroppedConvolution(psf, (48, 64), support)(picture)[1]
        for name in PICTURES:
            frame = read_frame(pairs / "measured" / f"{name}.dng")
            measured = develop(frame, dark=dark).values[1]
            both = torch.corrcoef(torch.stack([light.flatten(), measured.flatten()]))
            alike[shown, name] = float(both[0, 1])
    for name in PICTURES:
        assert alike[name, name] > 0.99
        assert alike[name, name] == max(alike[name, other] for other in PICTURES)


def test_goes_straight_into_calibrate_and_compare(bench: Path) -> None:
    pairs = bench / "pairs"
    # The command that was printed.
    words = (bench / "told.txt").read_text().split("then: nolens ")[1].split(" (PITCH")[0].split()
    change = {"PITCH": "3.1um", "mycamera": bench / "mycamera"}
    done = run(*(change.get(word, word) for word in words))
    assert done.code == 0 and "solved-300mm.tif" in done.out, done.err
    told = json.loads(run("compare", pairs / "pictures", pairs, "--json").out)
    assert told["pictures"] == 4
    assert told["methods"]["pictures"]["psnr_db"]["mean"] == "infinity"


def test_a_camera_that_fails_at_times(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once: tried again. For good: the picture failed, the rest and the next run go on."""
    shot, calls = TwinSource.shot, [0]

    def failing(source: TwinSource) -> Shot:
        calls[0] += 1
        if calls[0] == 3 or first <= calls[0] < first + 3:
            raise CameraError("the cable is loose")
        return shot(source)

    monkeypatch.setattr(TwinSource, "shot", failing)
    first = 10_000
    assert again(bench, "--exposure", "1ms", output="other").code == 0
    total, calls[0] = calls[0], 0
    first = total - 3
    done = again(bench, "--exposure", "1ms", output="third")
    assert done.code == 3 and "was not taken" in done.err and "the cable is loose" in done.err, done
    assert "1 failed" in done.out
    first = 10_000
    done = again(bench, "--exposure", "1ms", output="third")
    assert done.code == 0 and "4 pairs" in done.out


def test_refused(bench: Path) -> None:
    large = ("--screen-width", "60mm")
    done = run(
        "collect", bench / "shown", "--distance", "300mm", *large, "--source",
        f"twin:{bench / 'camera.toml'}", "-o", bench / "large",
    )  # fmt: skip
    check_refused(done, "the screen is not found", "whole screen is before the camera", "pattern")
    assert len(list((bench / "large" / "pattern").iterdir())) == 10
    before = listing(bench / "pairs")
    check_refused(
        run("collect", bench / "shown", "--distance", "300mm", *large, "--source",
            f"twin:{bench / 'camera.toml'}", "-o", bench / "pairs"),
        "another width of the screen", "18 mm there, 60 mm now",
    )  # fmt: skip
    assert listing(bench / "pairs") == before
    check_refused(run("collect", bench / "shown", "-o", bench / "x"), "no distance is given")


def test_page_of_a_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the page is sent is the picture, and it is waited for."""
    addresses: list[str] = []
    page = ScreenPage(lambda text: None, addresses.append, settle_s=0)

    def ask(path: str, body: dict[str, int] | None = None) -> bytes:
        request = urllib.request.Request(
            addresses[0] + path, None if body is None else json.dumps(body).encode(),
            {"Content-Type": "application/json"},
        )  # fmt: skip
        with urllib.request.urlopen(request) as answer:
            content: bytes = answer.read()
            return content

    try:
        assert b"Fill this screen" in ask("") and b"requestFullscreen" in ask("js/screen.js")
        ask("api/screen/size", {"rows": 120, "columns": 200})
        assert page.size == (120, 200)
        picture = linear_from_srgb(torch.arange(3 * 120 * 200).reshape(3, 120, 200) % 256 / 255)
        showing = threading.Thread(target=page.show, args=(picture,))
        showing.start()
        number = json.loads(ask("api/screen?after=0"))["number"]
        assert showing.is_alive()
        with Image.open(io.BytesIO(ask(f"api/screen/picture/{number}"))) as sent:
            pixels = torch.from_numpy(np.array(sent)).permute(2, 0, 1)
        assert torch.equal(linear_from_srgb(pixels / 255), picture)
        ask("api/screen/shown", {"number": number})
        showing.join()
        monkeypatch.setattr(nolens.studio.screen, "_ANSWER_S", 0.01)
        with pytest.raises(ScreenError, match="does not show pictures"):
            page.show(picture)
    finally:
        page.close()
