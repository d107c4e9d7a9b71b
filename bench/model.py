"""What a forward model that varies over the field gives, and what it costs.

`make bench-model` (`python bench/model.py`) takes photographs with simulated cameras whose PSF
varies over the field, with noise and a colour mosaic. It reconstructs them with PSFs at 1, 5, 9 and
25 field points, with PSFs captured at nine angles that are half a degree off, with noise (`nolens
calibrate stitch`), with one PSF and the colours apart, and by the trained prior with nine PSFs of
either kind. It times the operator and a photo against those of one PSF, and shows cameras a grid of
dots. It writes the tables in its part of `docs/model.md`; what was measured is in `--folder`.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from skimage import data

import nolens as nl
from machine import describe
from nolens.api.simulate import Psf
from nolens.camera import FieldPsf, preset_text
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import write_camera, write_png, write_psfs
from nolens.jobs import CalibrateStitchOptions, calibrate_stitch
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Reconstructor
from nolens.twin import Light, Twin
from page import write_part
from stitch import Quiet, captures

PIXELS = (1520, 2028)
"""Rows and columns of the sensor that are read; superpixels are half of them."""
CAMERAS: dict[str, Callable[[nl.Camera], nl.Camera]] = {
    "paper": lambda camera: camera,
    "Gaussian surface": lambda camera: nl.design_mask("diffuser", camera),
    "random lenslets of 150 um": lambda camera: nl.design_mask(
        "random-lenslets", camera, pitch="150um"
    ),
}
WAYS = {
    "one PSF, colours apart": "tv",
    "one PSF": "colour-tv",
    "5 PSFs": "colour-tv",
    "9 PSFs": "colour-tv",
    "9 captured PSFs": "colour-tv",
    "25 PSFs": "colour-tv",
    "9 PSFs, trained prior": "denoiser",
    "9 captured PSFs, trained prior": "denoiser",
}
"""Priors of the ways that photographs are reconstructed by."""
SCENES = {"astronaut": "60deg", "chelsea": "50deg"}
MIDDLE = [0, 2, 4, 10, 12, 14, 20, 22, 24]
"""Of 5×5 field points, 3×3."""
ROUNDS = 5
DOT_CAMERAS = {
    "random lenslets of 150 um": ((380, 508), 25, 13),
    "Gaussian surface of 5°": ((760, 1016), 7, 7),
}
"""Rows and columns that are read behind masks whose PSF varies most, and PSFs along each side that
the simulation blends, and that the reconstruction has: a Gaussian surface of 1° shows all dots with
one PSF."""
DOTS = {"pitch": "30mm", "extent": "37.5deg", "distance": "300mm"}
DOT_WAYS = {
    "one PSF": (False, "auto"),
    "one PSF, ℓ1": (False, "l1"),
    "PSFs over the field, ℓ1": (True, "l1"),
}
"""Whether the reconstruction has several PSFs, and its prior."""


def among(psf: Psf, numbers: list[int]) -> Psf:
    """The PSF with some of its field points."""
    whole = psf.field_psf
    assert whole is not None
    return replace(psf, field_psf=FieldPsf(whole.values[numbers], whole.places[numbers]))


def captured(camera: nl.Camera, scene_deg: tuple[float, float], folder: Path) -> Path:
    """The camera's folder, with PSFs stitched of nine captures for a scene across and down."""
    if not (folder / "psfs.toml").exists():
        twin = Twin.of(camera.loaded).reading(*PIXELS)
        write_camera(folder, twin.camera, camera.loaded.relief_um)
        experiment = VirtualExperiment(twin, Light("white-led"))
        write_psfs(folder, captures(experiment, scene_deg))
        calibrate_stitch(CalibrateStitchOptions(folder=folder), Quiet())
    return folder


def angles_deg(angle: str, photograph: str) -> tuple[float, float]:
    """Which angle a photograph fills across, and down."""
    across = float(angle.removesuffix("deg"))
    height, width = getattr(data, photograph)().shape[:2]
    half = math.atan(math.tan(math.radians(across / 2)) * height / width)
    return across, 2 * math.degrees(half)


def pictures(camera: nl.Camera, photograph: str, angle: str, path: Path) -> None:
    """Add PSNR, iterations and seconds of the ways that the row in `path` does not have yet."""
    row: dict[str, object] = json.loads(path.read_text()) if path.exists() else {}
    if all(name in row for name in WAYS):
        return
    shot = nl.simulate(getattr(data, photograph)(), camera, angle=angle, field_points=7)
    psfs = nl.psf(camera, "300mm", support=shot.support, wavelengths=1, field_points=5)
    one = replace(psfs, field_psf=None)

    def of_captures() -> Path:
        return captured(camera, angles_deg(angle, photograph), path.with_suffix(""))

    ways: tuple[Callable[[], Psf | Path], ...] = (
        lambda: one,
        lambda: one,
        lambda: among(psfs, [0, 4, 12, 20, 24]),
        lambda: among(psfs, MIDDLE),
        of_captures,
        lambda: psfs,
        lambda: among(psfs, MIDDLE),
        of_captures,
    )
    for (name, prior), way in zip(WAYS.items(), ways, strict=True):
        if name in row:
            continue
        psf = way()
        begun = time.process_time()
        points = 1 if "one" in name else int(name.split()[0])
        photo = nl.reconstruct(shot, psf, prior=prior, field_points=points)
        row[name] = {
            "psnr_db": nl.psnr(photo, shot.expected),
            "iterations": photo.result.iterations,
            "cpu_s": time.process_time() - begun,
        }
        photo.save(path.with_name(f"{path.stem}-{name.replace(' ', '-')}.png".replace(",", "")))
        print(path.stem, angle, name, row[name], flush=True)
        path.write_text(json.dumps(row))


def cost() -> dict[str, dict[str, list[float]]]:
    """Seconds of operator with adjoint, and of a photo of 24 iterations, in alternating rounds."""
    generator = torch.Generator().manual_seed(1)
    camera = nl.Camera("paper", pixels=(760, 1014))
    sensor, support = (380, 507), PixelRectangle(-33, 30, 446, 446)
    psfs = nl.psf(camera, "300mm", support=support, wavelengths=1, field_points=5)
    assert psfs.field_psf is not None
    green = replace(psfs, field_psf=FieldPsf(psfs.field_psf.values[:, 1:2], psfs.field_psf.places))
    operators: dict[int, CroppedConvolution] = {}
    reconstructors: dict[int, Reconstructor] = {}
    data_ = torch.rand((1, *sensor), generator=generator) + 5
    for points, field in ((1, None), (9, among(green, MIDDLE).field_psf), (25, green.field_psf)):
        solver = Reconstructor(green.field_psf.values[12], support, 1e-5, field_psf=field)
        reconstructors[points] = replace(solver, prior="tv")
        operators[points] = reconstructors[points].problem(data_).forward
    scene = torch.rand((1, support.height, support.width), generator=generator)
    seconds: dict[str, dict[str, list[float]]] = {"operator and adjoint": {}, "photo": {}}

    def photo(points: int) -> None:
        solver = reconstructors[points]
        limits = replace(solver.limits, iterations=24, tolerance=0.0, scene_tolerance=0.0)
        replace(solver, stop=limits).solve(data_)

    for measured in range(-1, ROUNDS):
        for points, operator in operators.items():
            for name, work in (
                ("operator and adjoint", lambda a=operator: a.adjoint(a(scene))),
                ("photo", lambda k=points: photo(k)),
            ):
                begun = time.perf_counter()
                work()
                if measured >= 0:
                    times = seconds[name].setdefault(str(points), [])
                    times.append(time.perf_counter() - begun)
    return seconds


def steep(pixels: tuple[int, int], folder: Path) -> nl.Camera:
    """The paper's layers on a sensor of its own, with a Gaussian surface of 5°.

    A relief over all of the paper's sensor, as fine as such slopes need, takes 46 GB.
    """
    text = preset_text("paper")
    for name, count in zip(("rows", "columns"), pixels, strict=True):
        text = re.sub(rf"(?m)^{name} = \d+$", f"{name} = {count}", text)
    path = folder / "few-pixels.toml"
    path.write_text(text)
    return nl.design_mask("diffuser", nl.Camera(path), angle="5deg", overhang="1.7mm")


def dots(name: str, folder: Path) -> dict[str, dict[str, float | None]]:
    """Up to which angle dots before the camera are good, and how many are, by way."""
    path = folder / f"dots-{name.replace(' ', '-').removesuffix('°')}.json"
    row: dict[str, dict[str, float | None]] = json.loads(path.read_text()) if path.exists() else {}
    pixels, simulated, several = DOT_CAMERAS[name]
    for way, (varies, prior) in DOT_WAYS.items():
        if way in row:
            continue
        points = several if varies else 1
        of_paper = CAMERAS.get(name)
        camera = of_paper(nl.Camera("paper", pixels=pixels)) if of_paper else steep(pixels, folder)
        begun = time.process_time()
        field = nl.measure_field(
            camera,
            dot_pitch=DOTS["pitch"],
            extent=DOTS["extent"],
            distance=DOTS["distance"],
            field_points=points,
            simulated_psfs=simulated,
            prior=prior,
        )
        grid = field.grid
        assert grid is not None
        good = sum(dot.grade == "good" for dot in grid.dots) / len(grid.dots)
        cpu_s = time.process_time() - begun
        assert grid.field_error is not None
        error = grid.field_error["of_contrast"]
        row[way] = {
            "good_deg": grid.angles.good_deg, "good": good, "cpu_s": cpu_s, "field_error": error,
        }  # fmt: skip
        file = path.with_name(f"{path.stem}-{points}-{prior}.png")
        write_png(file, grid.picture[None], float(grid.picture.max()) / 4)
        print(path.stem, way, row[way], flush=True)
        path.write_text(json.dumps(row))
    return row


def report(
    rows: dict[str, dict[str, dict[str, float]]],
    seconds: dict[str, dict[str, list[float]]],
    grids: dict[str, dict[str, dict[str, float | None]]],
) -> str:
    """Markdown of all."""
    machine = describe()
    lines = [
        f"Made by `make bench-model` on {machine['cpu']}, {machine['cores']} cores. Photographs of",
        f"scikit-image by simulated cameras (the middle {PIXELS[0]}×{PIXELS[1]} pixels of the",
        "paper's sensor, 7×7 PSFs, noise, mosaic, exposed to 90 % of the full well; PSFs without",
        "noise), reconstructed by total variation, and by the trained prior: PSNR in dB,",
        "iterations (turns of the network among them), processor seconds.",
        "Captured PSFs are of four noisy frames each, at angles half a degree off, of a grid a",
        "degree wider and higher than the scene (`calibrate stitch`).",
        "PSFs of sharp lenslets change fast with the angle",
        "([decision 18](decisions/0018-field-and-colours.md)).",
        f"{len(rows)} of {len(CAMERAS) * len(SCENES)} cases.",
        "",
    ]
    lines += ["| camera, scene | " + " | ".join(WAYS) + " |", "|---" * (1 + len(WAYS)) + "|"]
    for case, row in rows.items():
        cells = [
            f"{each['psnr_db']:.2f} ({each['iterations']}, {each['cpu_s']:.0f} s)"
            for each in map(row.__getitem__, WAYS)
        ]
        lines.append(f"| {case} | " + " | ".join(cells) + " |")
    lines += [
        "",
        "Cost beside one PSF of the paper's camera, on 380×507 pixels with a scene of 446×446",
        f"(median of {ROUNDS} alternating rounds; smallest and largest ratio). A photo is 24",
        "iterations with the measurement in the linear step, either way:",
        "",
        "| | 9 PSFs | 25 PSFs |",
        "|---|---|---|",
    ]
    for name, times in seconds.items():
        cells = []
        for points in ("9", "25"):
            ratios = [a / b for a, b in zip(times[points], times["1"], strict=True)]
            cells.append(
                f"{statistics.median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f})"
            )
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    lines += [
        "",
        f"Dots {DOTS['pitch']} apart at {DOTS['distance']}, up to {DOTS['extent']}, with noise",
        "and mosaic:",
        "angle up to which dots are good (`nolens measure field --dot-pitch`; ℓ1 by `--prior l1`),",
        "how many of all are, and processor seconds with the simulation.",
        "",
        "| camera, pixels | PSFs of the simulation, their error | of the reconstruction | "
        + " | ".join(DOT_WAYS)
        + " |",
        "|---" * (3 + len(DOT_WAYS)) + "|",
    ]
    for name, row in grids.items():
        cells = [
            f"{each['good_deg'] or 0:.1f}° ({each['good']:.0%}, {each['cpu_s']:.0f} s)"
            for each in map(row.__getitem__, DOT_WAYS)
        ]
        (rows_read, columns_read), simulated, several = DOT_CAMERAS[name]
        error = next(iter(row.values()))["field_error"] or 0.0
        psfs = f"{simulated}×{simulated}, {100 * error:.2g} % | {several}×{several}"
        lines.append(f"| {name}, {rows_read}×{columns_read} | {psfs} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure what is missing, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/model"))
    parser.add_argument("--out", type=Path, default=Path("docs/model.md"))
    parser.add_argument("--cameras", nargs="*", choices=CAMERAS, default=list(CAMERAS))
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    rows = {}
    for name in asked.cameras:
        camera: nl.Camera | None = None
        for photograph in asked.scenes:
            path = asked.folder / f"{name.replace(' ', '-')}-{photograph}.json"
            camera = camera or CAMERAS[name](nl.Camera("paper", pixels=PIXELS))
            pictures(camera, photograph, SCENES[photograph], path)
            rows[f"{name}, {photograph}, {SCENES[photograph].removesuffix('deg')}°"] = json.loads(
                path.read_text()
            )
    path = asked.folder / "cost.json"
    if not path.exists():
        path.write_text(json.dumps(cost()))
    grids = {name: dots(name, asked.folder) for name in DOT_CAMERAS}
    part = report(rows, json.loads(path.read_text()), grids)
    write_part(asked.out, "bench/model.py", part)


if __name__ == "__main__":
    main()
