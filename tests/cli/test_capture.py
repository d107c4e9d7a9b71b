"""`nolens capture`: the files hold what the camera gave, and nothing that was taken is lost."""

import errno
import json
import os
import pty
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from little_camera import little_twin
from PIL import Image
from running import Done, check_refused, listing, read_terminal, run, start

import nolens.jobs.capturing
from fake_picamera2 import Sensor, module
from nolens.camera import develop
from nolens.capture import FolderSource, Levels
from nolens.cli.capture import histogram_text
from nolens.files import read_frame, read_record, write_frame
from patience import PATIENCE_S, until


@pytest.fixture
def sensor(monkeypatch: pytest.MonkeyPatch) -> Sensor:
    made = Sensor()
    monkeypatch.setitem(sys.modules, "picamera2", module(made))
    return made


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A simulated camera of few pixels, made in a moment."""
    return f"twin:{little_twin(tmp_path_factory.mktemp('camera'))}"


def taken(*arguments: object) -> dict[str, Any]:
    done = run("capture", *arguments, "--json")
    assert done.code == 0, done.err
    told: dict[str, Any] = json.loads(done.out)
    return told


@pytest.mark.parametrize("suffix", [".dng", ".tif", ".npy"])
def test_a_file_reads_back_the_very_counts(sensor: Sensor, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"shot{suffix}"
    told = taken("-o", path, "--exposure", "20ms", "--gain", 2)
    frame = read_frame(path, mosaic="BGGR")
    assert torch.equal(frame.counts[0], torch.from_numpy(sensor.pixels.astype(np.float32)))
    if suffix != ".npy":
        assert (frame.black, frame.white, frame.mosaic) == ((256.0,), 4095.0, "BGGR")
        assert frame.exposure_s == pytest.approx(0.02, rel=2e-3)
    assert sensor.controls["ExposureTime"] == 20000 and sensor.controls["AnalogueGain"] == 2
    assert told["source"] == "Raspberry Pi imx477" and told["outputs"] == [str(path)]
    record = read_record(path.with_suffix(".json"))
    assert record.result["camera"] == "Raspberry Pi imx477"
    assert record.result["exposure_s"] == pytest.approx(0.02, rel=2e-3)
    assert record.result["mosaic"] == "BGGR" and record.result["black"] == [256.0]
    assert record.result["details"]["SensorTemperature"] == 31.0
    assert record.parameters["gain"] == 2
    assert sensor.log[-1] == "close"


def test_a_mean_keeps_fractions_and_what_was_saturated_once(sensor: Sensor, tmp_path: Path) -> None:
    sensor.delay = 0

    def light(number: int) -> Any:
        counts = np.full((40, 60), 1000, np.uint16)
        counts[5, 7] = 1000 + number
        counts[6, 8] = 4095 if number == 2 else 4000
        return counts

    sensor.light = light
    path = tmp_path / "mean.tif"
    told = taken("-o", path, "--frames", 4, "--average", "--exposure", "10ms")
    frame = read_frame(path)
    first = sensor.frames - 3
    assert first <= 2
    assert float(frame.counts[0, 5, 7]) == 1000 + first + 1.5
    assert float(frame.counts[0, 0, 0]) == 1000
    assert float(frame.counts[0, 6, 8]) == 4095
    assert (frame.mosaic, frame.black, frame.white) == ("BGGR", (256.0,), 4095.0)
    assert not bool(develop(frame).valid[:, 3, 4].all())
    assert read_record(tmp_path / "mean.json").result["frames"] == 4
    assert (told["frames"], told["files"]) == (4, 1)


def test_a_bracket_has_the_exposures_that_were_asked_for(sensor: Sensor, tmp_path: Path) -> None:
    taken("-o", tmp_path / "psf", "--psf", "--exposure", "2.5ms", "--bracket", 3, "--factor", 8)
    names = [f"psf-000{n}-{ms}ms.dng" for n, ms in ((1, "2.5"), (2, "20"), (3, "160"))]
    assert [each for each in sorted(listing(tmp_path / "psf")) if each.endswith(".dng")] == names
    for name, exposure_s in zip(names, (0.0025, 0.02, 0.16), strict=True):
        frame = read_frame(tmp_path / "psf" / name)
        # In whole lines of 23.5 us.
        assert frame.exposure_s == pytest.approx(exposure_s, abs=2 * 23.5e-6)


def test_automatic_exposure_fills_the_range(sensor: Sensor, tmp_path: Path) -> None:
    pattern = np.linspace(0.1, 1, 2400).reshape(40, 60)

    def light(number: int) -> Any:
        used_us = sensor.controls["ExposureTime"]
        return np.minimum(256 + pattern * used_us * 2, 4095).astype(np.uint16)

    sensor.light = light
    told = taken("-o", tmp_path / "x.dng")
    (levels,) = told["exposures"]
    assert levels["exposure_s"] == pytest.approx(0.8 * 3839 / 2 * 1e-6, rel=0.15)
    assert levels["clipped_fraction"] == 0


def test_numbers_go_on_where_they_ended(sensor: Sensor, tmp_path: Path) -> None:
    asked = ("-o", tmp_path / "day.dng", "--exposure", "10ms", "--frames", 2)
    taken(*asked)
    before = listing(tmp_path)
    told = taken(*asked)
    assert [Path(each).name for each in told["outputs"]] == ["day-0003.dng", "day-0004.dng"]
    assert before.items() <= listing(tmp_path).items()


def test_unplugged_in_the_middle_keeps_what_was_taken(sensor: Sensor, tmp_path: Path) -> None:
    sensor.delay = 0
    sensor.unplugged_after = 5
    path = tmp_path / "shots" / "a.dng"
    done = run("capture", "-o", path, "--exposure", "10ms", "--frames", 9)
    check_refused(done, "unplugged", "files written before are kept")
    kept = [each for each in listing(path.parent) if each.endswith(".dng")]
    assert len(kept) >= 2 and f"the {len(kept)} files" in done.err
    sensor.unplugged_after = sensor.frames + 5
    mean = tmp_path / "mean.tif"
    check_refused(
        run("capture", "-o", mean, "--exposure", "11ms", "--frames", 9, "--average"),
        "unplugged", "the 1 file written before is kept",
    )  # fmt: skip
    assert 2 <= read_record(tmp_path / "mean.json").result["frames"] < 9
    assert torch.equal(read_frame(mean).counts, read_frame(path.with_name(kept[0])).counts)


def test_a_full_disk_is_told_and_what_was_written_stays(
    sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[Path] = []

    def fills_up(path: Path, **frame: Any) -> None:
        if len(written) == 2:
            path.write_bytes(b"half of")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written.append(path)
        write_frame(path, **frame)

    monkeypatch.setattr(nolens.jobs.capturing, "write_frame", fills_up)
    done = run("capture", "-o", tmp_path / "a.dng", "--exposure", "10ms", "--frames", 5)
    check_refused(done, "No space left on device", "the 2 files written before are kept")
    found = listing(tmp_path)
    assert sorted(found) == ["a-0001.dng", "a-0001.json", "a-0002.dng", "a-0002.json"]


def test_dark_frames_of_a_camera_that_is_not_covered(sensor: Sensor, tmp_path: Path) -> None:
    told = taken("-o", tmp_path / "dark.dng", "--dark", "--exposure", "10ms")
    assert "light reaches the sensor" in told["warnings"][0]
    assert read_record(tmp_path / "dark.json").result["kind"] == "dark"
    sensor.pixels = np.full((40, 60), 256, np.uint16)
    sensor.pixels[::3] += 2
    assert taken("-o", tmp_path / "d.dng", "--dark", "--exposure", "10ms")["warnings"] == []


def test_a_killed_time_lapse_leaves_whole_files(twin: str, tmp_path: Path) -> None:
    folder = tmp_path / "night"
    asked = ("--every", "0.05s", "--exposure", "1ms", "--source", twin)
    with start("capture", "-o", folder, *asked) as process:
        until(lambda: len(list(folder.glob("frame-*.dng"))) >= 4, "four frames")
        process.kill()
    names = sorted(each.name for each in folder.iterdir() if not each.name.startswith("."))
    frames = [name for name in names if name.endswith(".dng")]
    assert frames[:4] == [f"frame-{n:04d}.dng" for n in range(1, 5)]
    for name in frames:
        assert read_frame(folder / name).counts.shape == (1, 96, 128)
    for name in (each for each in names if each.endswith(".json")):
        assert read_record(folder / name).result["kind"] == "frame"
    assert len(names) >= 2 * len(frames) - 1


def test_ctrl_c_ends_after_a_frame_and_shows_the_histogram(twin: str, tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    asked = ("--exposure", "20ms", "--every", "0.1s", "--source", twin, "--json")
    with start("capture", "-o", tmp_path / "x.dng", *asked, stderr=theirs) as process:
        os.close(theirs)
        shown = read_terminal(ours, r"frame ([2-9]|\d\d+)/")
        process.send_signal(signal.SIGINT)
        shown += read_terminal(ours, "")
        out = process.communicate(timeout=PATIENCE_S)[0]
    os.close(ours)
    assert process.returncode == 130
    assert "the frames so far will be written" in shown
    assert "█" in shown and "bright pixels at" in shown
    told = json.loads(out)
    written = sorted(each for each in listing(tmp_path) if each.endswith(".dng"))
    assert len(written) == told["frames"] == len(told["outputs"]) >= 2


def test_the_simulated_camera_sees_what_it_is_shown(twin: str, tmp_path: Path) -> None:
    red = np.zeros((30, 40, 3), np.uint8)
    red[..., 0] = 255
    Image.fromarray(red).save(tmp_path / "red.png")
    told = taken("-o", tmp_path / "shot.dng", "--source", twin, "--scene", tmp_path / "red.png")
    values = develop(read_frame(tmp_path / "shot.dng")).values.mean(dim=(1, 2))
    assert float(values[0]) > 3 * float(values[2])
    assert 0.6 < told["exposures"][0]["bright"] < 0.95
    record = read_record(tmp_path / "shot.json")
    assert record.inputs["scene"].path == str(tmp_path / "red.png")
    taken("-o", tmp_path / "dark.tif", "--dark", "--source", twin, "--exposure", "1s",
          "--frames", 2, "--average")  # fmt: skip
    assert float(read_frame(tmp_path / "dark.tif").counts.mean()) == pytest.approx(256, abs=0.2)


def test_each_frame_sees_the_next_picture_of_a_folder(twin: str, tmp_path: Path) -> None:
    film = tmp_path / "film"
    film.mkdir()
    for number, colour in enumerate(("red", "blue")):
        Image.new("RGB", (40, 30), colour).save(film / f"{number}.png")
    taken("-o", tmp_path / "x.dng", "--source", twin, "--scene", film, "--frames", 3,
          "--exposure", "500ms")  # fmt: skip
    colours = [develop(read_frame(tmp_path / f"x-000{n}.dng")).values.mean(dim=(1, 2))
               for n in (1, 2, 3)]  # fmt: skip
    assert [int(each.argmax()) for each in colours] == [0, 2, 0]
    record = read_record(tmp_path / "x-0001.json")
    assert {Path(each.path).name for each in record.inputs.values()} == {"0.png", "1.png"}


def test_frames_of_a_watched_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, output = tmp_path / "from", tmp_path / "to.tif"
    source.mkdir()
    counts = np.arange(600, dtype=np.uint16).reshape(20, 30)
    np.save(source / "there.npy", counts)
    told = taken("-o", output, "--source", f"folder:{source}", "--existing", "--mosaic", "GRBG")
    assert torch.equal(read_frame(output).counts[0], torch.from_numpy(counts.astype(np.float32)))
    assert read_frame(output).mosaic == "GRBG"
    assert told["exposures"][0]["exposure_s"] == 0

    begin = FolderSource.open

    def begin_and_write(watched: FolderSource) -> None:
        begin(watched)
        (source / "broken.npy").write_bytes(b"\x93NUMPY and no more")
        np.save(source / "new.npy", counts + 1)

    monkeypatch.setattr(FolderSource, "open", begin_and_write)
    done = run("capture", "-o", tmp_path / "new.npy", "--source", f"folder:{source}")
    assert done.code == 0 and "broken.npy" in done.err and "passed over" in done.err
    assert np.array_equal(np.load(tmp_path / "new.npy"), counts + 1)


BAD: list[tuple[list[object], list[str]]] = [
    ([], ["no output is given", "-o shot.dng"]),
    (["-o", "x.png"], ["x.png", "Accepted: .dng, .tif, .tiff, .npy"]),
    (["-o", "none/x.dng"], ["no folder none"]),
    (["-o", "x.dng", "--source", "webcam"], ["no source 'webcam'", "auto, raspberry"]),
    (["-o", "x.dng", "--exposure", "40"], ["exposure is '40'", "no unit", "40 ms"]),
    (["-o", "x.dng", "--exposure", "0s"], ["0.001 µs to 1000000 s"]),
    (["-o", "x.dng", "--exposure", "1us"], ["0.001 ms is beyond this camera", "give 0.114 ms"]),
    (["-o", "x.dng", "--exposure", "10ms", "--gain", "99"], ["gain of 99", "1 to 22.26"]),
    (["-o", "x", "--exposure", "90s", "--bracket", "9"], ["is beyond this camera", "694.423 s"]),
    (["-o", "x.dng", "--gain", "-1"], ["gain is -1", "0.001 to 10000"]),
    (["-o", "x.dng", "--frames", "0"], ["frames is 0", "1"]),
    (["-o", "x.dng", "--frames", "2.5"], ["2.5 is no whole number"]),
    (["-o", "x.dng", "--average"], ["only one frame", "--frames 16"]),
    (["-o", "x.dng", "--frames", "4", "--average"], ["fractions", "write x.tif"]),
    (["-o", "x.dng", "--dark"], ["needs the exposure time", "--exposure 40ms"]),
    (["-o", "x.dng", "--dark", "--psf"], ["--dark and --psf", "leave one out"]),
    (["-o", "x.dng", "--count", "3"], ["--every"]),
    (["-o", "x", "--every", "0s"], ["every is", "1 µs to 1000000 s"]),
    (["-o", "x.dng", "--factor", "2"], ["--bracket 3"]),
    (["-o", "x.dng", "--scene", "none.png"], ["none.png"]),
    (["-o", "x.dng", "--source", "raspberry", "--scene", "s.png"], ["--scene", "--source twin"]),
    (["-o", "x.dng", "--source", "folder:.", "--gain", "2"], ["set at their camera"]),
    (["-o", "x.dng", "--source", "folder:none"], ["cannot watch none", "Give a folder"]),
    (["-o", "x.dng", "--source", "twin:smal"], ["Did you mean the preset 'small'"]),
    (["-o", "x.dng", "--shutter", "2"], ["--shutter"]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "words"), BAD, ids=lambda each: " ".join(map(str, each))[:40]
)
def test_bad_input(
    sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    arguments: list[object], words: list[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    check_refused(run("capture", *arguments), *words)
    assert listing(tmp_path) == {}


def test_a_monochrome_camera_and_dng(sensor: Sensor, tmp_path: Path) -> None:
    sensor.native, sensor.given = "R12_CSI2P", "R12"
    done: Done = run("capture", "-o", tmp_path / "x.dng", "--exposure", "10ms")
    check_refused(done, "holds a colour mosaic", "write x.tif")
    told = taken("-o", tmp_path / "grey", "--exposure", "10ms")
    assert told["outputs"] == [str(tmp_path / "grey" / "frame-0001.tif")]
    assert read_frame(told["outputs"][0]).channels == ("grey",)


def test_histogram_in_the_terminal() -> None:
    levels = Levels({"R": (1000, *(0,) * 62, 3), "G": (0,) * 64}, 0.25, 1.0, 1.0, 0.1)
    lines = histogram_text(levels).splitlines()
    assert [line[0] for line in lines[:2]] == ["R", "G"]
    assert lines[0][2] == "█" and lines[0][-2] != " " and set(lines[0][3:-2]) == {" "}
    assert set(lines[1][2:-1]) == {" "}
    assert lines[2] == "bright pixels at 100 %, 25 % saturated"
