"""The default's picture against the best of a grid, over simulated cameras, scenes and exposures.

`make bench-default` (`python bench/default.py`) takes photographs of scikit-image with the paper's
camera at several angles and with other masks, reads the middle of its sensor, and reconstructs each
measurement without any option but its files, and with weights of the prior by factors of two
around that until they are worse on both sides. It writes the table `docs/default.md`. Cases that
were measured are kept in `--folder`, so that it can be interrupted and continued; `--photographs`,
`--exposures` and `--cameras` measure a part.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from skimage import data

import nolens as nl
from machine import describe

PIXELS = (760, 1014)
"""Rows and columns of the sensor that are read: superpixels are half of them."""
CAMERAS: dict[str, tuple[str, Callable[[], nl.Camera]]] = {
    "paper, 30°": ("30deg", lambda: paper()),
    "paper, 50°": ("50deg", lambda: paper()),
    "paper, 60°": ("60deg", lambda: paper()),
    "contour": ("30deg", lambda: nl.design_mask("contour", paper())),
    "random lenslets of 35 um": (
        "30deg",
        lambda: nl.design_mask("random-lenslets", paper(), pitch="35um"),
    ),
    "optimised": ("30deg", lambda: nl.design_mask("optimised", paper())),
    "Gaussian": ("30deg", lambda: nl.design_mask("diffuser", paper())),
    "random lenslets of 150 um": (
        "30deg",
        lambda: nl.design_mask("random-lenslets", paper(), pitch="150um"),
    ),
}
PHOTOGRAPHS = ("astronaut", "coffee", "chelsea", "rocket")
EXPOSURES = (0.9, 0.1, 0.02)
FACTOR, STEPS = 2.0, 5


def paper() -> nl.Camera:
    """The middle of the paper's camera."""
    return nl.Camera("paper", pixels=PIXELS)


@dataclass(frozen=True)
class Case:
    """A measurement to reconstruct."""

    camera: str
    photograph: str
    exposure: float

    @property
    def file(self) -> str:
        """Where its figures are kept."""
        camera = self.camera.replace(",", "").replace(" ", "-")
        return f"{camera}-{self.photograph}-{self.exposure:g}.json"


def measured(case: Case, camera: nl.Camera) -> dict[str, object]:
    """PSNR by default and of the best of the grid, and seconds of both."""
    angle = CAMERAS[case.camera][0]
    scene = getattr(data, case.photograph)()
    shot = nl.simulate(scene, camera, angle=angle, fill=case.exposure, field_points=3)
    psf = nl.psf(camera, "300mm", support=shot.support, wavelengths=1)

    def solved(tau: float | None) -> tuple[float, float, float]:
        begun = time.perf_counter()
        photo = nl.reconstruct(shot, psf, tau=tau)
        return nl.psnr(photo, shot.expected), photo.tau, time.perf_counter() - begun

    psnr_db, tau, seconds = solved(None)
    grid = {tau: solved(tau)}
    for factor in (FACTOR, 1 / FACTOR):
        last = tau
        for _ in range(STEPS):
            before, last = last, last * factor
            grid[last] = solved(last)
            if grid[last][0] < grid[before][0]:
                break
    best_db, best_tau, best_s = max(grid.values())
    return {
        "psnr_db": psnr_db, "tau": tau, "seconds": seconds,
        "best_db": best_db, "best_tau": best_tau, "best_seconds": best_s,
    }  # fmt: skip


def cases(asked: argparse.Namespace) -> Iterator[Case]:
    """What was asked for, camera by camera."""
    for camera in asked.cameras:
        for photograph in asked.photographs:
            for exposure in asked.exposures:
                yield Case(camera, photograph, exposure)


def table(rows: list[tuple[Case, dict[str, float]]]) -> str:
    """Markdown of the losses."""
    losses = [row["psnr_db"] - row["best_db"] for _, row in rows]
    times = [row["seconds"] / row["best_seconds"] for _, row in rows]
    machine = describe()
    whole = len(CAMERAS) * len(PHOTOGRAPHS) * len(EXPOSURES)
    heads = ["camera", "photograph", "exposure", "default", "best", "loss", "weight/best", "time"]
    lines = [
        "# The default against the best of a grid",
        "",
        "Made by `make bench-default`: photographs of scikit-image through simulated cameras (the",
        f"middle {PIXELS[0]}×{PIXELS[1]} pixels of the paper's sensor; the PSF varies over the",
        "field), exposed to the fraction of the full well that is named. By default the weight of",
        "the prior is chosen from the measurement; the grid tries weights by factors of two around",
        "it. Both have the scene's support. PSNR in dB.",
        "",
        f"**{len(losses)} of {whole} cases: {statistics.mean(losses):+.2f} dB in the mean, "
        f"{min(losses):+.2f} dB at worst. Time of one run with the best weight: "
        f"{statistics.median(times):.2f} times (median; at most {max(times):.2f}).** Times on",
        f"{machine['cpu']}, {machine['cores']} cores.",
        "",
        "| " + " | ".join(heads) + " |",
        "|---" * len(heads) + "|",
    ]
    for (case, row), loss, ratio in zip(rows, losses, times, strict=True):
        cells = [
            case.camera, case.photograph, f"{case.exposure:.0%}", f"{row['psnr_db']:.2f}",
            f"{row['best_db']:.2f}", f"{loss:+.2f}", f"{row['tau'] / row['best_tau']:.2f}",
            f"{ratio:.2f}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Measure what is missing, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/default"))
    parser.add_argument("--out", type=Path, default=Path("docs/default.md"))
    parser.add_argument("--cameras", nargs="+", choices=CAMERAS, default=list(CAMERAS))
    parser.add_argument("--photographs", nargs="+", default=list(PHOTOGRAPHS))
    parser.add_argument("--exposures", nargs="+", type=float, default=list(EXPOSURES))
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    rows: list[tuple[Case, dict[str, float]]] = []
    cameras: dict[str, nl.Camera] = {}
    torch.manual_seed(0)
    for case in cases(asked):
        path = asked.folder / case.file
        if not path.exists():
            if case.camera not in cameras:
                cameras = {case.camera: CAMERAS[case.camera][1]()}
            path.write_text(json.dumps(measured(case, cameras[case.camera])))
        rows.append((case, json.loads(path.read_text())))
        row = rows[-1][1]
        print(case.file, f"{row['psnr_db']:.2f} of {row['best_db']:.2f} dB", flush=True)
    asked.out.write_text(table(rows))


if __name__ == "__main__":
    main()
