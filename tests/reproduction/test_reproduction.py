"""The whole report, very small: every row is there, and the same seed gives the same bytes."""

import json
import re
import shutil
from pathlib import Path

import pytest
from pypdf import PdfReader
from watching import Watcher

from nolens.camera import preset_text
from nolens.files import plots, read_camera
from nolens.reproduction import ReproduceOptions, depths, job, photographs, reproduce
from nolens.reproduction import setup as sizes
from nolens.reproduction.comparison import PAPER

TINY = sizes.Size(
    pixels=None, field_points=1, iterations=6, papers_iterations=2, films_mm=(1.25, 1.45),
    films_pixels=(200, 200), point_draws=1, point_iterations=8, angle_steps=10,
    dot_field_points=1, dot_extent_deg=5.0,
)  # fmt: skip

TAKEN = ("dots", "siemens", "magnification")
"""Most of the work; as when interrupted."""


@pytest.fixture(autouse=True)
def small_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes of a few degrees, which the camera `small` sees in a moment, and coarse plots."""
    monkeypatch.setattr(job, "FULL", TINY)
    scenes = tuple(
        photographs.Scene(each.name, each.picture, 8.0, each.distance_um)
        for each in photographs.SCENES
    )
    for module in (photographs, job):
        monkeypatch.setattr(module, "SCENES", scenes)
    monkeypatch.setattr(depths, "_ANGLE_DEG", 12.0)
    save = plots._save
    monkeypatch.setattr(plots, "_save", lambda figure, path, dpi: save(figure, path, dpi // 4))


@pytest.fixture
def camera(tmp_path: Path) -> str:
    """The camera `small` without colours, which is three times as fast."""
    text = preset_text("small")
    start, stop = (
        text.index("[sensor.quantum_efficiency.values]"),
        text.index("[sensor.acceptance]"),
    )
    green = re.search(r"G = (\[[^]]*\])", text)
    assert green is not None
    text = f"{text[:start]}[sensor.quantum_efficiency.values]\ngrey = {green[1]}\n{text[stop:]}"
    path = tmp_path / "grey.toml"
    path.write_text(text.replace('mosaic = "RGGB"', 'mosaic = "none"'))
    return str(path)


def made(folder: Path, watcher: Watcher, camera: str) -> dict[str, bytes]:
    options = ReproduceOptions(output=folder, camera=camera)
    reproduce(options, watcher)
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.relative_to(folder).parts[0] != "steps"
    }


def test_every_row_is_there_and_the_same_seed_gives_the_same_bytes(
    tmp_path: Path, camera: str
) -> None:
    watcher = Watcher()
    one = made(tmp_path / "one", watcher, camera)
    timing = json.loads(one["timing.json"])
    longer = tmp_path / "another, much longer name"
    for taken in TAKEN:
        shutil.copytree(tmp_path / "one/steps" / taken, longer / "steps" / taken)
    other = made(longer, Watcher(), camera)
    for taken in TAKEN:
        assert json.loads(other["timing.json"])["parts"][taken] == timing["parts"][taken]
    same = [name for name in one if name.endswith((".html", ".pdf", ".png"))]
    assert len(same) == 2 + 14
    for name in same:
        assert one[name] == other[name], name

    rows = json.loads(one["report.json"])["result"]["rows"]
    assert [row["key"] for row in rows] and {row["key"] for row in rows} == set(PAPER)
    assert len(rows) == len(PAPER)
    # Letters that encode a picture may spell any short word.
    html, pictures = re.subn(
        r'"data:image/png;base64,[A-Za-z0-9+/=]+"', '"picture"', one["report.html"].decode()
    )
    assert pictures == 14
    assert not re.search(r"(src|href)=\"(?!picture\"|#)", html) and "base64" not in html
    assert "url(" not in html and "http" not in html
    pdf = " ".join(
        " ".join(
            page.extract_text() for page in PdfReader(tmp_path / "one/report.pdf").pages
        ).split()
    )
    for row in rows:
        for text in (row["text"], row["paper"]):
            assert text in html.replace("&#x27;", "'")
        assert row["where"] in pdf
    # What differs from run to run stands elsewhere.
    for text in (html, pdf):
        assert not re.search(r"20\d\d-\d\d-\d\d", text)
        assert "/tmp" not in text and str(tmp_path) not in text
    assert "see timing.json" in html and "see timing.json" not in one["reproduction.md"].decode()
    assert timing["seconds"] > 0 and set(timing["photographs"]) == {
        "7a",
        "7b",
        "7c",
        "7d",
        "7e",
        "7f",
    }
    assert timing["machine"] in one["reproduction.md"].decode()
    for picture in re.findall(r"\]\((pictures/[^)]+)\)", one["reproduction.md"].decode()):
        assert picture in one
    assert watcher.fractions == sorted(watcher.fractions)


def test_steps_of_another_seed_are_not_taken(tmp_path: Path) -> None:
    opened = read_camera("small")
    keys = [
        [step.key for step in job.all_steps(sizes.ExperimentSetup(opened, TINY, seed), "small")]
        for seed in (0, 1)
    ]
    assert len(set(keys[0]) | set(keys[1])) == 2 * len(keys[0])
