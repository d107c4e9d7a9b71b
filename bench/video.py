"""What a video from one still shows of moving scenes, beside one picture of all lines at once.

`python bench/video.py` (part of `make bench-model`) takes moving scenes with a simulated camera
with a rolling shutter, with noise and a colour mosaic, reconstructs 24 frames, and compares them
with the truth. The control is the same camera with all lines exposed at once: over the whole time
by as much light, or for one line's time in the middle; its picture stands for every frame. It
writes the table in `docs/video.md`; rows that were measured are in `--folder`.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as nnf
from PIL import Image
from torch import Tensor

import nolens as nl
from machine import describe
from nolens.camera import Shutter, develop, exposure_white, linear_from_srgb
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files.contact_sheet import SheetPicture, write_contact_sheet
from nolens.operators import PixelRectangle
from nolens.solvers import Reconstructor
from nolens.solvers.video import VideoProblem
from nolens.twin import FieldMap, FieldModel, Light

PIXELS, SCENE, FRAMES, STEP = (360, 480), (48, 64), 24, 1.5
FILL = 0.9
ITERATIONS, TOLERANCE = 60, 3e-3
"""As the command has them."""
LENSLETS = "lenslets of 100 µm"
CASES = {
    "hopper": ("hopper", "down", 1.0, LENSLETS),
    "spots": ("spots", "down", 1.0, LENSLETS),
    "astronaut": ("astronaut", "down", 1.0, LENSLETS),
    "astronaut, out": ("astronaut", "out", 1.0, LENSLETS),
    "cat": ("chelsea", "down", 1.0, LENSLETS),
    "astronaut, half": ("astronaut", "down", 0.5, LENSLETS),
    "astronaut, four": ("astronaut", "down", 4.0, LENSLETS),
    "spots, Gaussian surface": ("spots", "down", 1.0, "Gaussian surface of 1°"),
    "astronaut, Gaussian surface": ("astronaut", "down", 1.0, "Gaussian surface of 1°"),
    "spots, preset": ("spots", "down", 1.0, "the paper's"),
    "astronaut, preset": ("astronaut", "down", 1.0, "the paper's"),
}
"""Scene, direction, exposure of a line in frames, and mask; all was tuned on hopper."""
BEGIN, END = "<!-- bench/video.py -->", "<!-- end -->"


def camera(rolling: str, mask: str) -> nl.Camera:
    """The middle of the paper's camera; its lenslets make points, the other masks lines."""
    made = nl.Camera("paper", pixels=PIXELS)
    if mask == LENSLETS:
        made = nl.design_mask("random-lenslets", made, pitch="100um")
    elif mask.startswith("Gaussian"):
        made = nl.design_mask("diffuser", made)
    description = made.loaded.camera
    sensor = description.sensor.model_copy(update={"rolling": rolling})
    loaded = replace(made.loaded, camera=description.model_copy(update={"sensor": sensor}))
    return nl.Camera(loaded, pixels=PIXELS)


def photograph(name: str) -> Tensor:
    """A photograph, linear, (3, height, width)."""
    if name == "hopper":
        from matplotlib.cbook import get_sample_data

        picture = np.asarray(Image.open(get_sample_data("grace_hopper.jpg", asfileobj=False)))
    else:
        from skimage import data

        picture = getattr(data, name)()
    linear = linear_from_srgb(torch.from_numpy(picture[..., :3].copy()).float() / 255)
    height = 1.3 * SCENE[0]
    scale = max(height / linear.shape[0], (SCENE[1] + STEP * FRAMES + 4) / linear.shape[1])
    return nnf.interpolate(
        linear.movedim(-1, 0)[None], scale_factor=scale, mode="bilinear", antialias=True
    )[0]


def moving(name: str) -> Tensor:
    """Frames of a scene, (frames, 3, height, width); photographs pass by, spots have paths."""
    if name == "spots":
        places = spots()
        rows, columns = (torch.arange(n, dtype=torch.float32) for n in SCENE)
        squares = (rows[:, None] - places[..., :1, None]).square() + (
            columns - places[..., 1:, None]
        ).square()
        colours = torch.tensor([[1.0, 0.9, 0.7], [0.6, 1.0, 0.6], [0.7, 0.8, 1.0]])
        return torch.einsum("fshw,sc->fchw", torch.exp(-squares / (2 * 1.2**2)), colours)
    large = photograph(name)
    top = (large.shape[1] - SCENE[0]) // 2
    left = (large.shape[2] - SCENE[1] - STEP * (FRAMES - 1)) / 2
    frames = []
    for number in range(FRAMES):
        whole, part = divmod(left + STEP * number, 1)
        first = large[:, top : top + SCENE[0], int(whole) : int(whole) + SCENE[1]]
        second = large[:, top : top + SCENE[0], int(whole) + 1 : int(whole) + 1 + SCENE[1]]
        frames.append(torch.lerp(first, second, part))
    return torch.stack(frames)


def spots() -> Tensor:
    """Row and column of three spots in every frame, (frames, 3, 2); of a scene of 3:4."""
    t = torch.linspace(0, 1, FRAMES)
    across = torch.stack([12 + 6 * t, 8 + 62 * t], dim=-1)
    falling = torch.stack([10 + 40 * t, 60 - 14 * t], dim=-1)
    circle = torch.stack(
        [40 + 9 * torch.sin(2 * math.pi * t), 26 + 9 * torch.cos(2 * math.pi * t)], dim=-1
    )
    return torch.stack([across, falling, circle], dim=1) * SCENE[0] / 60


def centroids(video: Tensor, places: Tensor) -> Tensor:
    """Of each spot in every frame, (frames, 3, 2): what is above half its peak.

    A spot is looked for within five pixels of where it is.
    """
    rows, columns = (torch.arange(n, dtype=torch.float32) for n in SCENE)
    near = ((rows[:, None] - places[..., :1, None]).abs() <= 5) & (
        (columns - places[..., 1:, None]).abs() <= 5
    )
    light = video.mean(1)[:, None] * near
    weights = (light - 0.5 * light.amax((-2, -1), keepdim=True)).clamp_min(0)
    total = weights.sum((-2, -1)).clamp_min(1e-30)
    return torch.stack(
        [(weights.sum(-1) * rows).sum(-1) / total, (weights.sum(-2) * columns).sum(-1) / total], -1
    )


def psnr(video: Tensor, truth: Tensor) -> float:
    """Over all frames, with the best factor for each channel; 1 is white."""
    factor = (video * truth).sum((0, 2, 3)) / video.square().sum((0, 2, 3))
    return 10 * math.log10(1 / float((factor[:, None, None] * video - truth).square().mean()))


def measured(case: str, folder: Path) -> dict[str, float]:
    """Figures of one case."""
    scene, rolling, in_frames, mask = CASES[case]
    experiment, psf, model = prepared(rolling, mask)
    sensor = experiment.sensor
    readout = Shutter.of(sensor, 1.0).duration_s - 1.0
    # T = readout + e is 24 frames, and e so many of them.
    exposure_s = readout * in_frames / (FRAMES - in_frames)
    scenes = moving(scene)
    shot = experiment.measure_motion(model, scenes, exposure_s=exposure_s, fill=FILL, seed=1)
    luminance = shot.luminance_cd_m2
    truth = scenes * shot.response
    reconstructor = Reconstructor(psf, shot.support)
    begun = time.process_time()
    problem = VideoProblem.build(reconstructor, develop(shot.frame), sensor, exposure_s, FRAMES)
    tau = problem.stack.weight_by_noise
    result = problem.stack.solve(tau, iterations=ITERATIONS, tolerance=TOLERANCE)
    video = problem.video(result.scene)
    row: dict[str, float] = {
        "exposure_ms": 1e3 * exposure_s,
        "video_db": psnr(video, truth),
        "mean_db": psnr(truth.mean(0).expand_as(truth), truth),
        "iterations": result.iterations,
        "tau": tau,
        "cpu_s": time.process_time() - begun,
    }
    without = sensor.model_copy(update={"rolling": None, "line_time_us": None})
    description = experiment.twin.camera.model_copy(update={"sensor": without})
    control = replace(experiment, twin=replace(experiment.twin, camera=description))
    ways = {
        "long_db": (scenes, problem.shutter.duration_s),
        "short_db": (scenes[FRAMES // 2 :][:1], exposure_s),
    }
    for name, (part, seconds) in ways.items():
        still = control.measure_motion(
            model,
            part,
            exposure_s=seconds,
            luminance_cd_m2=luminance * exposure_s / seconds,
            seed=1,
        )
        picture = reconstructor.solve(develop(still.frame)).scene
        row[name] = psnr(picture.expand_as(truth), truth)
    if scene == "spots":
        places = spots()
        off = (centroids(video, places) - centroids(truth, places)).norm(dim=-1)
        row |= {"off_px": float(off.mean()), "farthest_px": float(off.max())}
    sheet(folder / f"video-{case.replace(', ', '-')}.png", truth, video)
    return row


def sheet(path: Path, truth: Tensor, video: Tensor) -> None:
    """Six frames of truth and video."""
    factor = (video * truth).sum((0, 2, 3)) / video.square().sum((0, 2, 3))
    pictures = []
    for first in (0, 12):
        numbers = (first + 1, first + 5, first + 10)
        pictures += [SheetPicture(f"truth, frame {n + 1}", truth[n]) for n in numbers]
        pictures += [
            SheetPicture(f"video, frame {n + 1}", (factor[:, None, None] * video[n]).clamp_min(0))
            for n in numbers
        ]
    white = exposure_white(truth.movedim(0, 1).flatten(1, 2))
    write_contact_sheet(path, pictures=pictures, white=white)


@cache
def prepared(rolling: str, mask: str) -> tuple[VirtualExperiment, Tensor, FieldModel]:
    """Camera, PSF and the model that scenes are measured with."""
    made = camera(rolling, mask)
    support = PixelRectangle.centred(*SCENE, made.size)
    psf = nl.psf(made, "300mm", support=support, wavelengths=1).values
    experiment = VirtualExperiment(made.twin, Light("white-led"), 1, 3)
    return experiment, psf, experiment.field_model(FieldMap(made.twin, support), 3e5)


def table(rows: dict[str, dict[str, float]]) -> list[str]:
    """Markdown."""
    machine = describe()
    lines = [
        BEGIN,
        f"{machine['cpu']}, {machine['cores']} cores. {PIXELS[0]}×{PIXELS[1]} pixels with a mosaic "
        f"({PIXELS[0] // 2}×{PIXELS[1] // 2} developed), scene of {SCENE[0]}×{SCENE[1]}, "
        f"{FRAMES} frames; photographs pass by {STEP:g} pixels a frame. PSNR of all frames in dB; "
        "τ by the sensor's noise.",
        "",
        "| scene | mask | lines | exposure of a line (in frames) | video | all at once, long | "
        "all at once, short | mean of the true frames | "
        "video over the better control | iterations, CPU |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for case, row in rows.items():
        scene, rolling, frames, mask = CASES[case]
        better = row["video_db"] - max(row["long_db"], row["short_db"])
        lines.append(
            f"| {scene} | {mask} | {rolling} | {row['exposure_ms']:.2g} ms ({frames:g}) | "
            f"**{row['video_db']:.1f}** | {row['long_db']:.1f} | {row['short_db']:.1f} | "
            f"{row['mean_db']:.1f} | {better:+.1f} dB | {row['iterations']:.0f}, "
            f"{row['cpu_s']:.0f} s |"
        )
    lines += [
        line
        for case, row in rows.items()
        if "off_px" in row
        for line in (
            "",
            f"Spots, {CASES[case][3]}: centroids off by {row['off_px']:.2f} pixels on average, "
            f"{row['farthest_px']:.2f} at most, over all frames and spots.",
        )
    ]
    return [*lines, END]


def main() -> None:
    """Measure what is not there yet, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/video"))
    parser.add_argument("--only", nargs="*", default=list(CASES))
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    stored = arguments.folder / "rows.json"
    rows = json.loads(stored.read_text()) if stored.is_file() else {}
    for case in arguments.only:
        if case not in rows:
            rows[case] = measured(case, arguments.folder)
            print(case, rows[case], flush=True)
            stored.write_text(json.dumps(rows, indent=1))
    page = Path("docs/video.md")
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    ordered = {case: rows[case] for case in CASES if case in rows}
    page.write_text(before + "\n".join(table(ordered)) + after, encoding="utf-8")


if __name__ == "__main__":
    main()
