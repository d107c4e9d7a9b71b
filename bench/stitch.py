"""What a PSF wider than the sensor is worth to a camera without an aperture.

`make bench-stitch` runs the paper's camera at its full size in the twin, takes frames of a point
of light at nine angles that are half a degree off what is written down, stitches them as a person
would (`nolens calibrate stitch`), and reconstructs a photograph that fills 56 degrees; it writes
docs/results/stitch.json and stitch.png.
"""

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from machine import describe
from nolens.calibrate.extrapolate import filled
from nolens.camera import PsfEntry, develop
from nolens.evaluate import psnr, scale_fit
from nolens.experiments.virtual_experiment import SimulatedMeasurement, VirtualExperiment, solved
from nolens.files import read_camera, write_camera, write_png, write_psfs
from nolens.files.sample_pictures import sample_picture
from nolens.jobs import CalibrateStitchOptions, Reporter, calibrate_stitch
from nolens.operators import Geometry, PixelRectangle
from nolens.optics import PointSource
from nolens.reproduction.photographs import PAPERS_PENALTIES, PAPERS_TAU
from nolens.solvers import Problem, admm
from nolens.twin import Plane

OUT = Path(__file__).parents[1] / "docs" / "results"
SCENE_DEG, MORE_DEG, OFF_DEG = 56.0, 1.0, 0.5
DISTANCE_UM = 300e3
FRAMES, ITERATIONS, TAU = 4, 200, 5e-6
PAPERS_ITERATIONS = 300


class Quiet(Reporter):
    """Passes warnings on, and nothing else."""

    def warn(self, text: str) -> None:
        """Show it."""
        print(f"warning: {text}", file=sys.stderr)


def captures(
    bench: VirtualExperiment, scene_deg: tuple[float, float] = (SCENE_DEG, SCENE_DEG)
) -> dict[PsfEntry, Tensor]:
    """PSFs of nine lights for a scene of an angle across and down, each the mean of some frames.

    All angles but one are off.
    """
    generator = torch.Generator().manual_seed(1)
    across, down = (each / 2 + MORE_DEG for each in scene_deg)
    found = {}
    for up in (down, 0.0, -down):
        for right in (-across, 0.0, across):
            off = OFF_DEG * torch.randn(2, generator=generator) * (1.0 if up or right else 0.0)
            tangents = [
                math.tan(math.radians(stated + float(error)))
                for stated, error in zip((right, up), off, strict=True)
            ]
            source = PointSource((-tangents[1], tangents[0]), DISTANCE_UM, 50.0)
            image = bench.light_of(source)
            frames = [develop(bench.exposed(image, 0.9, seed)) for seed in range(FRAMES)]
            psf = torch.stack([frame.values for frame in frames]).mean(dim=0)
            entry = PsfEntry.model_validate({
                "file": f"psf-300mm-{right:g}deg-{up:g}deg.tif",
                "cell": f"{bench.twin.pixel_um:g} um",
                "channels": bench.sensor.channels,
                "distance": "300 mm",
                "angle": (f"{right:g} deg", f"{up:g} deg"),
                "frame": "sensor" if up or right else "chief-ray",
            })  # fmt: skip
            found[entry] = psf
    return found


def scene_of(
    shot: SimulatedMeasurement, psf: Tensor, support: PixelRectangle | None
) -> tuple[Tensor, float]:
    """The reconstruction on the scene's cells, and the seconds it took."""
    start = time.perf_counter()
    seen = solved(shot.frame, psf, support, iterations=ITERATIONS, tau=TAU)
    seconds = time.perf_counter() - start
    return (shown(seen, shot, psf) if support is None else seen), seconds


def as_the_paper(shot: SimulatedMeasurement, psf: Tensor) -> tuple[Tensor, float]:
    """The same with fixed penalties, as published codes for such cameras have them."""
    start = time.perf_counter()
    seen = develop(shot.frame)
    problem = Problem.build(psf, seen.values, valid=seen.valid, tau=PAPERS_TAU)
    scene = admm(
        problem, iterations=PAPERS_ITERATIONS, tolerance=0.0, penalties=PAPERS_PENALTIES,
        balance=None,
    ).scene  # fmt: skip
    return shown(scene, shot, psf), time.perf_counter() - start


def shown(scene: Tensor, shot: SimulatedMeasurement, psf: Tensor) -> Tensor:
    """The scene's cells of a reconstruction that was not confined to them."""
    sensor = develop(shot.frame).values.shape[-2:]
    size = (psf.shape[-2], psf.shape[-1])
    origin = Geometry.build((sensor[0], sensor[1]), size, None).origin
    top, left = shot.support.top - origin[0], shot.support.left - origin[1]
    return scene[:, top : top + shot.support.height, left : left + shot.support.width]


def main() -> None:
    """Measure, write and show."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--camera", default="paper")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    opened = read_camera(arguments.camera)
    bench = VirtualExperiment.of(opened)
    picture = sample_picture("astronaut", "the benchmark")
    shot = bench.measure((Plane(picture, SCENE_DEG, DISTANCE_UM),), seed=1)
    psfs = captures(bench)
    ahead = next(psf for entry, psf in psfs.items() if entry.on_axis)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "camera"
        write_camera(folder, opened.camera)
        write_psfs(folder, psfs)
        made = calibrate_stitch(CalibrateStitchOptions(folder=folder), Quiet())
    size = (made.value.shape[-2], made.value.shape[-1])
    source = PointSource(distance_um=DISTANCE_UM, diameter_um=50.0)
    support = shot.support
    cases: dict[str, tuple[Tensor, PixelRectangle | None]] = {
        "captured": (ahead, None),
        "captured, region": (ahead, support),
        "captured, mean light around it, region": (filled(ahead, support), support),
        "stitched, region": (made.value, support),
        "the twin's wide PSF of straight ahead, region": (bench.psf(source, size), support),
    }
    truth = shot.truth * shot.response
    rows: list[dict[str, Any]] = []
    pictures = [truth]
    solutions: dict[str, Callable[[], tuple[Tensor, float]]] = {
        "captured, as the paper solves it": partial(as_the_paper, shot, ahead),
        **{name: partial(scene_of, shot, *case) for name, case in cases.items()},
    }
    for name, solve in solutions.items():
        seen, seconds = solve()
        fitted = scale_fit(seen, truth)
        rows.append({
            "psf": name, "psnr_db": round(psnr(fitted, truth, 1.0), 2),
            "seconds": round(seconds, 1),
        })  # fmt: skip
        print(rows[-1], flush=True)
        pictures.append(fitted)
    report = {
        "machine": describe(),
        "camera": opened.camera.name, "scene_deg": SCENE_DEG,
        "frames_per_capture": FRAMES, "angles_off_deg": OFF_DEG,
        "iterations": ITERATIONS, "tau": TAU,
        "region": [support.height, support.width], "cases": rows,
        "stitch": {key: made.summary[key] for key in (
            "pixels", "support", "known_fraction", "residual_pixels", "captures", "seconds",
            "warnings",
        )},
    }  # fmt: skip
    for row in made.summary["captures"]:
        print(row, flush=True)
    (arguments.out / "stitch.json").write_text(json.dumps(report, indent=1) + "\n")
    write_png(arguments.out / "stitch.png", torch.cat(pictures, dim=-1))


if __name__ == "__main__":
    main()
