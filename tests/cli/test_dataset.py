"""`nolens dataset make`: the same bytes by any number of processes, and read back by others."""

import json
from collections.abc import Generator, Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from running import check_refused, listing, run

import nolens as nl
from nolens.camera import linear_from_srgb, preset
from nolens.camera.toml import to_toml
from nolens.engine import Outcome, run_items
from nolens.errors import DataError, FileError
from nolens.files.dataset import decode_picture
from nolens.files.picture_sets import open_pictures
from nolens.jobs.dataset import job

COUNT = 12
RECIPE = (
    "--count", COUNT, "--shard", 4, "--angle", "5deg", "--wavelengths", 1, "--seed", 9,
    "--distance", "300mm", "--distance", "infinity", "--fill", "30%,90%", "--mirror",
    "--psf-scale", "0.99,1.01", "--psf-rotation", "-1deg,1deg", "--psf-blur", "0,1",
    "--black-error=-8,8", "--validation", "20%", "--test", "20%", "--licence", "cc0-1.0",
)  # fmt: skip


def in_this_process(items: Iterable[tuple[str, Any]], work: Any, **_: object) -> Generator[Outcome]:
    """As `run_items`, without processes: starting one takes seconds."""
    call = work.prepare()
    for key, load in items:
        yield Outcome(key, call(load()), "", 1)


def made(monkeypatch: pytest.MonkeyPatch, *arguments: object, how: Any = in_this_process) -> str:
    monkeypatch.setattr(job, "run_items", how)
    done = run("dataset", "make", *arguments)
    assert done.code == 0, done
    return done.out


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A camera of 48×64 pixels and a folder of five pictures, two of which are the same."""
    folder = tmp_path_factory.mktemp("dataset")
    camera = preset("small")
    sensor = camera.sensor.model_copy(update={"rows": 48, "columns": 64})
    (folder / "camera").mkdir()
    text = to_toml(camera.model_copy(update={"sensor": sensor}))
    (folder / "camera" / "camera.toml").write_text(text)
    (folder / "photos" / "more").mkdir(parents=True)
    random = np.random.default_rng(1)
    for number in range(4):
        pixels = random.integers(0, 255, (8, 10, 3), np.uint8).repeat(8, 0).repeat(8, 1)
        Image.fromarray(pixels).save(folder / "photos" / f"{number}.png")
    Image.fromarray(pixels).save(folder / "photos" / "more" / "again.png")
    return folder


@pytest.fixture(scope="module")
def whole(here: Path) -> Path:
    """The data set, made in one go."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        recipe = ("--scenes", here / "photos", "--camera", here / "camera", *RECIPE)
        made(monkeypatch, *recipe, "-o", here / "whole")
    return here / "whole"


def contents(folder: Path) -> dict[str, str]:
    return {name: each for name, each in listing(folder).items() if "manifest" not in name}


def test_stopped_and_gone_on_by_two_processes_it_has_the_same_bytes(
    here: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = (whole / "recipe.toml", "-o", here / "stopped")

    def stopped(items: Any, work: Any, **about: Any) -> Generator[Outcome]:
        with closing(run_items(items, work, **about)) as outcomes:
            for number, outcome in enumerate(outcomes):
                if number == 8:
                    raise KeyboardInterrupt
                yield outcome

    monkeypatch.setattr(job, "run_items", stopped)
    assert run("dataset", "make", *recipe, "--workers", 2).code == 130
    before = contents(here / "stopped")
    assert "dataset.json" not in before
    made(monkeypatch, *recipe)
    assert contents(here / "stopped") == contents(whole)
    assert before.items() <= contents(whole).items()
    assert "12 items" in made(monkeypatch, *recipe)
    assert contents(here / "stopped") == contents(whole)
    check_refused(run("dataset", "make", *recipe, "--seed", 10), "another seed: 9 there, 10 now")


def test_where_an_item_fails_the_other_shards_are_there(
    here: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = (whole / "recipe.toml", "-o", here / "failed")

    def failing(items: Any, work: Any, **about: Any) -> Generator[Outcome]:
        for outcome in in_this_process(items, work):
            yield Outcome("4", None, "the lamp went out", 3) if outcome.key == "4" else outcome

    monkeypatch.setattr(job, "run_items", failing)
    done = run("dataset", "make", *recipe)
    assert done.code == 3
    assert "item 4: the lamp went out" in done.err and "1 of 5 shards are missing" in done.out
    assert sum(name.startswith("data/") for name in contents(here / "failed")) == 4
    made(monkeypatch, *recipe)
    assert contents(here / "failed") == contents(whole)


def test_an_item_can_be_made_again_alone(
    here: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = here / "alone"
    made(monkeypatch, whole / "recipe.toml", "--items", "7,2:4", "-o", alone)
    assert sorted(path.name for path in alone.glob("*.json")) == [
        "00000002.json", "00000003.json", "00000007.json",
    ]  # fmt: skip
    rows = {}
    for split in nl.LenslessDataset(whole).description.splits:
        dataset = nl.LenslessDataset(whole, split)
        rows |= {row["index"]: row for row in (dataset._row(i) for i in range(len(dataset)))}
    assert sorted(rows) == list(range(COUNT))
    for index in (2, 3, 7):
        stem = alone / f"{index:08d}"
        for name in ("measurement", "truth"):
            assert stem.with_suffix(f".{name}.png").read_bytes() == rows[index].pop(name)
        assert json.loads(stem.with_suffix(".json").read_text()) == rows[index]


def test_a_scene_is_in_one_split_and_the_truth_is_its_light(here: Path, whole: Path) -> None:
    scenes = {}
    for split in ("train", "validation", "test"):
        dataset = nl.LenslessDataset(whole, split)
        rows = [dataset[number] for number in range(len(dataset))]
        for row in rows:
            assert scenes.setdefault(row["scene"], split) == split
            pixels = np.array(Image.open(here / "photos" / row["scene"]))
            picture = linear_from_srgb(torch.from_numpy(pixels).permute(2, 0, 1) / 255)
            picture = picture.flip(-1) if row["mirrored"] else picture
            # All of the picture, but for what the sensor's shape cuts off above and below.
            truth = row["truth"]
            assert float((truth.mean((1, 2)) - picture.mean((1, 2))).abs().max()) < 0.05
            third = truth.shape[-1] // 3
            ends = [part.mean() for part in (truth[..., :third], truth[..., -third:])]
            third = picture.shape[-1] // 3
            expected = [part.mean() for part in (picture[..., :third], picture[..., -third:])]
            assert float(ends[0] - ends[1]) == pytest.approx(
                float(expected[0] - expected[1]), abs=0.05
            )
    assert scenes["3.png"] == scenes["more/again.png"]
    assert len(scenes) == 5


def test_pytorch_and_hugging_face_read_the_same_values(
    here: Path, whole: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    datasets = pytest.importorskip("datasets")
    datasets.disable_progress_bars()
    table = here / "table"
    made(monkeypatch, whole / "recipe.toml", "--layout", "parquet", "-o", table)
    dataset = nl.LenslessDataset(whole)
    again = nl.LenslessDataset(table)
    loaded = datasets.load_dataset(str(table), cache_dir=str(tmp_path / "cache"))
    assert {split: len(each) for split, each in loaded.items()} == {
        split: each.items for split, each in dataset.description.splits.items()
    }
    batches = torch.utils.data.DataLoader(dataset, batch_size=len(dataset), num_workers=1)
    batch = next(iter(batches))
    assert len(dataset) >= 5
    for number, row in enumerate(loaded["train"]):
        truth = decode_picture(row["truth"]["bytes"], Path("truth")) * row["truth_scale"]
        counts = np.asarray(row["measurement"])
        assert counts.dtype == np.uint16
        assert row["index"] == batch["index"][number] and row["psf"] == batch["psf"][number]
        for each in (again[number], {name: batch[name][number] for name in batch}):
            assert np.array_equal(each["truth"].numpy(), truth.astype(np.float32))
            assert np.array_equal(each["measurement"][0].numpy(), counts)
    row, frame = dataset[0], dataset.frame(0)
    psf, support = dataset.psf(row["psf"]), dataset.support(row["psf"])
    assert row["truth"].shape[-2:] == (support.height, support.width)
    assert frame.size == (48, 64)
    # The aperture is wider than the sensor: light of the whole support falls beside it.
    assert psf.size == (24 + support.height, 32 + support.width)


def test_developed_measurements_are_those_of_the_frames(
    here: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    developed = here / "developed"
    made(monkeypatch, whole / "recipe.toml", "--measurement", "developed", "-o", developed)
    dataset, raw = nl.LenslessDataset(developed), nl.LenslessDataset(whole)
    assert torch.equal(dataset[1]["measurement"], nl.develop(raw.frame(1)).values)
    with pytest.raises(DataError, match="--measurement raw"):
        dataset.frame(0)


def test_what_cannot_be_made_is_refused(here: Path, whole: Path, tmp_path: Path) -> None:
    def refused(*arguments: object, words: tuple[str, ...]) -> None:
        done = run("dataset", "make", "--camera", here / "camera", "--angle", "5deg", *arguments)
        check_refused(done, *words)

    empty, small, out = tmp_path / "empty", tmp_path / "small", tmp_path / "out"
    empty.mkdir()
    small.mkdir()
    Image.new("RGB", (9, 6)).save(small / "tiny.png")
    whole_file = (here / "photos" / "0.png").read_bytes()
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "0.png").write_bytes(whole_file[:-20])
    refused("--scenes", tmp_path / "cut", "-o", out, words=("0.png", "its end is missing"))
    refused("--scenes", empty, "-o", out, words=("holds no picture", ".png"))
    refused("--scenes", small, "-o", out, words=("1 of 1 pictures", "tiny.png", "6×9"))
    refused("--scenes", small, "-o", small / "set", words=("lies in the folder of the pictures",))
    refused("--distance", "0.3mm", "-o", out, words=("0.3 mm", "1 mm or more"))
    refused("--camera", tmp_path, "-o", out, words=("camera.toml",))
    refused("--fill", "90%,20%", "-o", out, words=("--fill", "smaller value first"))
    refused("-o", small, words=("has files", "empty folder"))
    refused("--items", "3", "-o", whole, words=("is a data set", "another folder"))
    refused("--items", "5:7", "--count", 6, "-o", out, words=("0 to 5",))
    assert not out.exists()
    with pytest.raises(FileError, match="finished"):
        nl.LenslessDataset(small)


def test_truths_are_what_compare_takes(whole: Path) -> None:
    """By split and number, times the light of each pixel that reaches the sensor."""
    found = open_pictures(whole)
    dataset = nl.LenslessDataset(whole, "train")
    assert sum(name.startswith("train-") for name in found.names) == len(dataset)
    assert len(found.names) == COUNT
    for number in (0, len(dataset) - 1):
        item = dataset[number]
        expected = item["truth"] * dataset.response(item["psf"])
        assert torch.allclose(found.read(f"train-{number:05}"), expected.expand(3, -1, -1))
