"""`nolens reconstruct --frames`: a video from one frame of a rolling shutter."""

from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest
import tifffile
import torch
from little_camera import BLACK, SCENE, SENSOR, SUPPORT, WHITE, expose_dng, little_twin, spots
from PIL import Image
from running import check_refused, listing, run
from torch import Tensor

import nolens as nl
from nolens.camera import preset
from nolens.evaluate import psnr, scale_fit
from nolens.files import write_dng
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.twin import expose, mosaic

FRAMES, LINES, EXPOSED = 6, 96, 8
"""Of the video, of the sensor, and line times for which a line is exposed."""
MASKED = ("--support", SUPPORT, "--frames", FRAMES)


def scenes() -> Tensor:
    """A bright square that falls and a bar that moves to the left, on grey."""
    frames = torch.full((FRAMES, 3, *SCENE), 0.1)
    for number, frame in enumerate(frames):
        frame[:, 2 + 3 * number : 6 + 3 * number, 6:10] = torch.tensor([1.0, 0.8, 0.6])[
            :, None, None
        ]
        frame[:, 4:20, 27 - 2 * number : 29 - 2 * number] = 0.7
    return frames


def take(folder: Path, rolling: str, exposure_s: float | None) -> Path:
    """What lines see that begin one line time after another, counted in fortieths of it."""
    sensor = preset("small").sensor
    support = PixelRectangle.centred(*SCENE, SENSOR)
    light = CroppedConvolution(spots(), SENSOR, support)(scenes()).clamp_min(0)
    pixels = light.repeat_interleave(2, dim=-2).repeat_interleave(2, dim=-1)
    planes = torch.stack([mosaic(each, sensor.mosaic) for each in pixels])
    last = LINES - 1 if rolling in ("down", "up") else LINES // 2 - 1
    moments = (np.arange(40 * (last + EXPOSED)) + 0.5) / 40
    shown = (moments * FRAMES / (last + EXPOSED)).astype(int)
    image = torch.zeros(LINES, 2 * SENSOR[1])
    for line in range(LINES):
        begun = {"down": line, "in": min(line, LINES - 1 - line)}[rolling]
        exposed = shown[(moments >= begun) & (moments < begun + EXPOSED)]
        image[line] = planes[exposed, line].mean(dim=0)
    counts = expose(image * (0.9 * sensor.full_well_electrons / image.max()), sensor, seed=1)
    path = folder / "raw.dng"
    write_dng(path, counts, pattern=sensor.mosaic, black=BLACK, white=WHITE, exposure_s=exposure_s)
    expose_dng(folder / "psf.dng", spots(), seed=2)
    description = little_twin(folder)
    description.write_text(description.read_text().replace('"down"', f'"{rolling}"'))
    return path


def test_what_moves_is_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = take(tmp_path, "in", EXPOSED * 28.571e-6)
    outputs = [f"-o{tmp_path / 'out'}{suffix}" for suffix in (".tif", ".mp4", ".png")]
    asked = ("--psf", tmp_path / "psf.dng", *MASKED, "--tau", 1e-3, "--iterations", 24)
    done = run("reconstruct", raw, *asked, *outputs)
    assert done.code == 0, done.err
    with tifffile.TiffFile(tmp_path / "out.tif") as file:
        video = torch.from_numpy(file.asarray())
        step = (LINES // 2 - 1 + EXPOSED) * 28.571e-6 / FRAMES
        assert file.series[0].axes == "TCYX" and 'TimeIncrementUnit="s"' in file.ome_metadata
        assert f'TimeIncrement="{step:.6f}'[:20] in file.ome_metadata
    truth = scenes()
    still = truth.mean(0).expand_as(truth)  # The best that one picture can be.
    quality = psnr(scale_fit(video, truth), truth, 1.0)
    assert quality > psnr(still, truth, 1.0) + 3
    rows = torch.arange(SCENE[0], dtype=torch.float32)
    for number, frame in enumerate(video):
        column = (frame.mean(0)[:, 6:10].mean(1) - frame.median()).clamp_min(0)
        assert float((column * rows).sum() / column.sum()) == pytest.approx(3.5 + 3 * number, abs=1)
    with av.open(str(tmp_path / "out.mp4")) as file:
        shown = [each.to_ndarray(format="gray") for each in file.decode(video=0)]
    assert len(shown) == FRAMES and shown[0].shape[0] >= 400
    middle = shown[-1].shape[0] * 18 // 24  # The square is there at the end alone.
    assert shown[-1][middle].max() > 2 * shown[0][middle, : shown[0].shape[1] // 2].max()
    with Image.open(tmp_path / "out.png") as sheet:
        assert sheet.size[0] > 1000

    camera, point = nl.Camera(tmp_path), nl.load(tmp_path / "psf.dng")
    description = tmp_path / "camera.toml"
    text = description.read_text()
    description.unlink()
    mine = nl.reconstruct_video(
        nl.load(raw), point, FRAMES, camera=camera, support=SCENE, tau=1e-3, iterations=24
    )
    assert torch.equal(mine.values, video) and mine.times_s[1] == pytest.approx(1.5 * step)
    assert mine.save(tmp_path / "mine.mp4").read_bytes() == (tmp_path / "out.mp4").read_bytes()

    description.write_text(text)
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(total=5.001e8))
    asked = ("--psf", tmp_path / "psf.dng", "--support", SUPPORT, "--frames", 2, "--exposure")
    done = run("reconstruct", raw, *asked, "1602ms", "-o", tmp_path / "still.tif")
    assert done.code == 2 and "not even 2 frames would fit" in done.err
    assert "no video can be had" in done.err and "Expose for 1.34 ms or less" in done.err


@pytest.mark.parametrize(
    ("old", "new", "options", "words"),
    [
        ('rolling = "down"\n', "", MASKED, ["rolling is missing", 'rolling = "down"']),
        ("line_time_us = 28.571\n", "", MASKED, ["line_time_us is missing"]),
        ('line_time_us = 28.571\nrolling = "down"\n', "", MASKED, ["at once", "line_time_us"]),
        ("", "", MASKED, ["does not say how long its lines were exposed", "--exposure 1ms"]),
        ("", "", ("--frames", 5), ["--frames 5", "does not show where", "--support"]),
        ("", "", (*MASKED, "--quality", "draft"), ["--frames 6", "leave out --quality"]),
        ("", "", ("--exposure", "1ms"), ["--exposure 1 ms", "give --frames"]),
    ],
)
def test_what_makes_no_video_is_refused(
    old: str, new: str, options: tuple[object, ...], words: list[str], tmp_path: Path
) -> None:
    raw = take(tmp_path, "down", None)
    description = tmp_path / "camera.toml"
    description.write_text(description.read_text().replace(old, new))
    before = listing(tmp_path)
    psf = tmp_path / "psf.dng"
    check_refused(run("reconstruct", raw, "--psf", psf, "-o", tmp_path / "v.tif", *options), *words)
    assert listing(tmp_path) == before
