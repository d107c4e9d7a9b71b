"""The default's picture against the best of a grid, over simulated cameras, scenes and exposures.

`make bench-default` (`python bench/default.py`) takes photographs of scikit-image with the paper's
camera at several angles and with other masks, on few large pixels around the scene, and
reconstructs each measurement without any option but its files, and with the scene's support and
other strengths of both priors until they are worse on both sides. With `--data` it measures real
measurements, too (`bench/default_real.py`). It writes its parts of `docs/default.md`, of all cases
that are kept in `--folder`, so that it can be interrupted and continued; `--photographs`,
`--exposures` and `--cameras` measure a part, and `--cameras` without a name real ones alone.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import torch
from skimage import data

import default_real
import nolens as nl
from grid import FACTOR, MEASURED, Row, compare, table
from nolens.files.cameras import read_camera
from nolens.quantities import Length
from page import write_part

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
WORST_DB = 0.8


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


def measure(case: Case, camera: nl.Camera, row: Row) -> None:
    """Add what the row does not have yet."""
    angle = CAMERAS[case.camera][0]
    scene = getattr(data, case.photograph)()
    shot = nl.simulate(scene, camera, angle=angle, fill=case.exposure, field_points=3)
    psf = nl.psf(camera, "300mm", support=wider(shot.support), wavelengths=1)
    rows, columns = overlap(shot)
    top, left = shot.support.top, shot.support.left
    there = shot.expected[:, lines_from(rows, top), lines_from(columns, left)]

    def default() -> tuple[float, float]:
        photo = nl.reconstruct(shot.frame, psf)
        return nl.psnr(photo.values[:, rows, columns], there), photo.tau

    def psnr_db(detail: float, tau: float | None) -> float:
        """With the scene's support."""
        photo = nl.reconstruct(shot, psf, detail=detail, tau=tau)
        return nl.psnr(photo.values[:, lines_from(rows, top), lines_from(columns, left)], there)

    compare(row, default, psnr_db)


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


def cases(
    cameras: Iterable[str] = CAMERAS,
    photographs: Iterable[str] = PHOTOGRAPHS,
    exposures: Iterable[float] = EXPOSURES,
) -> Iterator[Case]:
    """Camera by camera."""
    yield from (Case(*each) for each in product(cameras, photographs, exposures))


def page(rows: list[tuple[Case, Row]]) -> str:
    """Markdown of the losses."""
    lines = [
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
        *table(
            ("camera", "photograph", "exposure"),
            [((case.camera, case.photograph, f"{case.exposure:.0%}"), row) for case, row in rows],
            len(CAMERAS) * len(PHOTOGRAPHS) * len(EXPOSURES),
            WORST_DB,
        ),
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure what is missing, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/default"))
    parser.add_argument("--out", type=Path, default=Path("docs/default.md"))
    parser.add_argument("--cameras", nargs="*", choices=CAMERAS, default=list(CAMERAS))
    parser.add_argument("--photographs", nargs="+", default=list(PHOTOGRAPHS))
    parser.add_argument("--exposures", nargs="+", type=float, default=list(EXPOSURES))
    parser.add_argument("--data", type=Path, help="folder of the real measurements")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    cameras: dict[str, nl.Camera] = {}
    torch.manual_seed(0)
    for case in cases(asked.cameras, asked.photographs, asked.exposures):
        path = asked.folder / case.file
        row: Row = json.loads(path.read_text()) if path.exists() else {}
        if not row.keys() >= MEASURED:
            if case.camera not in cameras:
                cameras = {case.camera: CAMERAS[case.camera][1]()}
            measure(case, cameras[case.camera], row)
            path.write_text(json.dumps(row))
        figures = " ".join(f"{name} {value:.2f}" for name, value in row.items())
        print(case.file, figures, flush=True)
        kept = ((each, asked.folder / each.file) for each in cases())
        rows = [(each, json.loads(file.read_text())) for each, file in kept if file.exists()]
        part = page([each for each in rows if each[1].keys() >= MEASURED])
        write_part(asked.out, "bench/default.py", part)
    if asked.data is None:
        return
    if not (asked.data / "diffusercam-pairs").is_dir():
        print(f"there is no diffusercam-pairs in {asked.data}: real measurements are left out")
        return
    part = default_real.measure(asked.data, asked.folder)
    write_part(asked.out, "bench/default_real.py", part)


if __name__ == "__main__":
    main()
