"""The default's picture against the best of a grid, over simulated cameras, scenes and exposures.

`make bench-default` (`python bench/default.py`) takes photographs of scikit-image with the paper's
camera at several angles and with other masks, on few large pixels around the scene, and
reconstructs each measurement without any option but its files, and with the scene's support and
other strengths of both priors until they are worse on both sides. It writes the table
`docs/default.md` of all cases that are kept in `--folder`, so that it can be interrupted and
continued; `--photographs`, `--exposures` and `--cameras` measure a part.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import torch
from skimage import data

import nolens as nl
from machine import describe
from nolens.files.cameras import read_camera
from nolens.quantities import Length

PIXELS = (608, 812)
"""Rows and columns of the sensor: superpixels are half of them."""
PITCH = "3.1um"
"""Twice the paper's, so that few pixels reach as far around the scene as a sensor does."""
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
FACTOR, STEPS = 1.6, 4
WORST_DB = 0.8
MEASURED = {"psnr_db", "tv_seconds", "denoiser_seconds"}
"""Figures that a case has when it is whole: the default's and the grids'."""


def paper() -> nl.Camera:
    """The middle of the paper's camera, on larger pixels."""
    loaded = read_camera("paper")
    rows, columns = PIXELS
    sensor = loaded.camera.sensor.model_copy(
        update={"pitch": Length.parse(PITCH), "rows": rows, "columns": columns}
    )
    return nl.Camera(replace(loaded, camera=loaded.camera.model_copy(update={"sensor": sensor})))


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


def measure(case: Case, camera: nl.Camera, row: dict[str, float]) -> None:
    """Add what the row does not have yet: the default's PSNR and seconds, the best of the grids."""
    angle = CAMERAS[case.camera][0]
    scene = getattr(data, case.photograph)()
    shot = nl.simulate(scene, camera, angle=angle, fill=case.exposure, field_points=3)
    psf = nl.psf(camera, "300mm", support=wider(shot.support), wavelengths=1)
    rows, columns = overlap(shot)
    top, left = shot.support.top, shot.support.left
    there = shot.expected[:, lines_from(rows, top), lines_from(columns, left)]
    default_is_new = "psnr_db" not in row
    if default_is_new:
        begun = time.perf_counter()
        photo = nl.reconstruct(shot.frame, psf)
        row["seconds"] = time.perf_counter() - begun
        row["psnr_db"] = nl.psnr(photo.values[:, rows, columns], there)
        row["tau"] = photo.tau

    def psnr_db(detail: float = 1.0, tau: float | None = None) -> float:
        """With the scene's support."""
        photo = nl.reconstruct(shot, psf, detail=detail, tau=tau)
        return nl.psnr(photo.values[:, lines_from(rows, top), lines_from(columns, left)], there)

    if "best_tau" not in row:
        row["detail"], row["denoiser_db"] = best(psnr_db)
        factor, row["tv_db"] = best(lambda factor: psnr_db(tau=factor * row["tau"]))
        row["best_tau"] = factor * row["tau"]
    if default_is_new or not row.keys() >= MEASURED:  # Right after it, as machines are shared.
        begun = time.perf_counter()
        psnr_db(tau=row["best_tau"])
        row["tv_seconds"] = time.perf_counter() - begun
        begun = time.perf_counter()
        psnr_db(detail=row["detail"])
        row["denoiser_seconds"] = time.perf_counter() - begun


def wider(support: nl.PixelRectangle) -> nl.PixelRectangle:
    """By a quarter on each side: nobody who makes a PSF knows the scene to a pixel."""
    rows, columns = support.height // 4, support.width // 4
    return nl.PixelRectangle(
        support.top - rows,
        support.left - columns,
        support.height + 2 * rows,
        support.width + 2 * columns,
    )


def overlap(shot: nl.SimulatedMeasurement) -> tuple[slice, slice]:
    """Rows and columns of the sensor's frame that the scene is on."""
    support, (height, width) = shot.support, shot.values.shape[-2:]
    rows, columns = (
        slice(max(0, first), min(size, first + length))
        for first, length, size in (
            (support.top, support.height, height),
            (support.left, support.width, width),
        )
    )
    return rows, columns


def lines_from(part: slice, first: int) -> slice:
    """The same lines, counted from another first one."""
    return slice(part.start - first, part.stop - first)


def best(psnr_db: Callable[[float], float]) -> tuple[float, float]:
    """Of factors in steps away from 1, until it gets worse on both sides: that, and its PSNR."""
    tried = {1.0: psnr_db(1.0)}
    for step in (FACTOR, 1 / FACTOR):
        last = 1.0
        for _ in range(STEPS):
            before, last = last, last * step
            tried[last] = psnr_db(last)
            if tried[last] < tried[before]:
                break
    factor = max(tried, key=tried.__getitem__)
    return factor, tried[factor]


def cases(
    cameras: Iterable[str] = CAMERAS,
    photographs: Iterable[str] = PHOTOGRAPHS,
    exposures: Iterable[float] = EXPOSURES,
) -> Iterator[Case]:
    """Camera by camera."""
    yield from (Case(*each) for each in product(cameras, photographs, exposures))


def table(rows: list[tuple[Case, dict[str, float]]]) -> str:
    """Markdown of the losses."""
    losses = [row["psnr_db"] - max(row["denoiser_db"], row["tv_db"]) for _, row in rows]
    times, own = (
        [row["seconds"] / row[name] for _, row in rows]
        for name in ("tv_seconds", "denoiser_seconds")
    )
    machine = describe()
    whole = len(CAMERAS) * len(PHOTOGRAPHS) * len(EXPOSURES)
    heads = [
        "camera", "photograph", "exposure", "default", "best, denoiser", "at detail",
        "best, total variation", "at weight", "loss", "time", "of its own",
    ]  # fmt: skip
    beyond = sum(loss < -WORST_DB for loss in losses)
    lines = [
        "# The default against the best of a grid",
        "",
        "Made by `make bench-default`: photographs of scikit-image through simulated cameras (the",
        f"middle of the paper's sensor on {PIXELS[0]}×{PIXELS[1]} pixels of {PITCH}; the PSF",
        "varies over the field, and one is given), exposed to a fraction of the full well. The",
        "default chooses the support of the scene, the weight of total variation, and the",
        "denoiser's strength from the measurement. The grids have the scene's true support, and",
        f"factors in steps of {FACTOR:g}: of detail with the denoiser, and of the chosen weight",
        "with total variation. PSNR in dB, of what lies in the sensor's frame; time of the default",
        "over one run by total variation with the best weight, and over one of its own prior, the",
        "denoiser, at the best detail, both with the scene's support.",
        "",
        f"**{len(losses)} of {whole} cases: {statistics.mean(losses):+.2f} dB in the mean, "
        f"{min(losses):+.2f} dB at worst, {beyond} below {-WORST_DB:g} dB. Time: "
        f"{statistics.median(times):.2f} times total variation's (median; at most "
        f"{max(times):.2f}), {statistics.median(own):.2f} times its own prior's (at most "
        f"{max(own):.2f}).** Times on",
        f"{machine['cpu']}, {torch.get_num_threads()} of {machine['cores']} cores.",
        "",
        "| " + " | ".join(heads) + " |",
        "|---" * len(heads) + "|",
    ]
    for (case, row), loss, ratio, of_own in zip(rows, losses, times, own, strict=True):
        cells = [
            case.camera, case.photograph, f"{case.exposure:.0%}", f"{row['psnr_db']:.2f}",
            f"{row['denoiser_db']:.2f}", f"{row['detail']:.2f}", f"{row['tv_db']:.2f}",
            f"{row['best_tau'] / row['tau']:.2f}", f"{loss:+.2f}", f"{ratio:.2f}",
            f"{of_own:.2f}",
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
    cameras: dict[str, nl.Camera] = {}
    torch.manual_seed(0)
    for case in cases(asked.cameras, asked.photographs, asked.exposures):
        path = asked.folder / case.file
        row: dict[str, float] = json.loads(path.read_text()) if path.exists() else {}
        if not row.keys() >= MEASURED:
            if case.camera not in cameras:
                cameras = {case.camera: CAMERAS[case.camera][1]()}
            measure(case, cameras[case.camera], row)
            path.write_text(json.dumps(row))
        figures = " ".join(f"{name} {value:.2f}" for name, value in row.items())
        print(case.file, figures, flush=True)
        kept = ((each, asked.folder / each.file) for each in cases())
        rows = [(each, json.loads(file.read_text())) for each, file in kept if file.exists()]
        asked.out.write_text(table([each for each in rows if each[1].keys() >= MEASURED]))


if __name__ == "__main__":
    main()
