"""docs/pi.md: its commands work, with the simulated camera, and end with a photograph."""

import json
import re
import shlex
from pathlib import Path

import pytest
from running import run

from nolens.capture import TwinSource, open_source
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_frame

PAGE = Path(__file__).parents[2] / "docs" / "pi.md"
SOURCE = Path(__file__).parents[2] / "src" / "nolens"


def commands() -> list[list[str]]:
    """Every line of the page's blocks that begins with nolens."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(), re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("nolens ")]


def as_tried(command: list[str]) -> list[str]:
    """The command as a shell passes it on, with the simulated camera, and without the waiting."""
    changed = {"paper": "live", "10s": "0.1s", "60": "3"}
    if command[0] == "reconstruct":
        changed["2"] = "4"  # Larger pixels.
    if "--dark" in command and command[0] == "capture":
        first = min(Path("point").glob("psf-0001-*.json"))
        record = json.loads(first.read_text())
        changed["16ms"] = f"{1e3 * record['result']['exposure_s']:g}ms"
    command = [changed.get(word, word) for word in command]
    words = [sorted(map(str, Path().glob(word))) if "*" in word else [word] for word in command]
    return [each for found in words for each in found]


def test_from_the_first_frame_to_the_photograph(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # Every command has a camera of its own, whose PSF is computed once.
    source = open_source("twin")
    assert isinstance(source, TwinSource)
    prepared = source._prepare()
    monkeypatch.setattr(TwinSource, "_prepare", lambda _: prepared)
    every = commands()
    assert len(every) >= 10
    for command in every:
        done = run(*as_tried(command))
        assert done.code == 0, (command, done.err)
    # The dark frames are those that the frames of the point ask for.
    record = json.loads(Path("mycamera/calibrate-300mm.json").read_text())
    assert record["warnings"] == []
    assert all(each["dark_frames"] == 8 for each in record["result"]["exposures"])

    support, truth = source.support, source.truth()
    done = run("reconstruct", "shot.dng", "--psf", "mycamera/psf-300mm.tif", "-o", "x.tif",
               "--tiff-bits", 32, "--iterations", 20, "--tau", 1e-4,
               "--support", support.text)  # fmt: skip
    assert done.code == 0
    assert psnr(scale_fit(read_frame("x.tif").counts, truth), truth, 1.0) > 20


SAID = (
    "no camera is connected",
    "Picamera2 does not load",
    "the camera is in use by another program",
    "gave no frame for",
    "gives its raw as",
    "light reaches the sensor",
    "of the pixels are saturated",
)


@pytest.mark.parametrize("said", SAID)
def test_the_page_explains_what_the_messages_say(said: str) -> None:
    assert said in PAGE.read_text()
    files = (*(SOURCE / "capture").glob("*.py"), SOURCE / "jobs" / "capturing.py")
    assert any(said in path.read_text() for path in files)
