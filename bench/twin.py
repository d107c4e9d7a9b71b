"""What the simulated camera takes and how exact it is: `make bench-twin` writes docs/twin.md.

Every timed run is a process of its own, so that its peak memory is its own.
"""

import argparse
import json
import math
import resource
import statistics
import subprocess
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as nnf

from machine import Others, describe
from nolens.camera import LoadedCamera, preset
from nolens.evaluate import pattern_figures
from nolens.files import write_png
from nolens.optics import Grid, MaskSurface, PointSource, Relief, monochromatic_psf
from nolens.twin import Light, Plane, Twin, irradiate, point_spread, render_planes

DOCS = Path(__file__).parents[1] / "docs"
PICTURE = DOCS / "results" / "paper-psf.png"
ROUNDS = 3
SOURCE = PointSource(distance_um=300e3, diameter_um=50.0)
WHITE = Light("white-led")
GREEN = Light("535nm")


def run_psf(device: str) -> dict[str, Any]:
    """The paper's PSF on all pixels of its sensor, one wavelength, samples at half the pitch."""
    camera = LoadedCamera.of(preset("paper"))
    # One channel of the light is timed, as three would see the same wavelength.
    sensor = camera.camera.sensor.model_copy(update={"mosaic": "none"})
    curve = camera.quantum_efficiency
    grey = curve.model_copy(update={"values": {"grey": curve.values["G"]}})
    camera = replace(
        camera, camera=camera.camera.model_copy(update={"sensor": sensor}), quantum_efficiency=grey
    )
    start = time.perf_counter()
    twin = Twin.of(camera, device=device)
    surface = time.perf_counter() - start
    start = time.perf_counter()
    psf = point_spread(twin, SOURCE, (3040, 4056), light=GREEN)
    figures = pattern_figures(psf[0].cpu(), 1.55)
    return {
        "surface_s": surface,
        "seconds": time.perf_counter() - start,
        "width_um": figures.width_um,
        "pitch_um": figures.pitch_um,
    }


def run_field(device: str) -> dict[str, Any]:
    """A scene on all cells of the paper's sensor: 9×9 field points, a wavelength a colour."""
    twin = Twin.of(LoadedCamera.of(preset("paper")), device=device)
    picture = torch.rand((3, 512, 512), generator=torch.Generator().manual_seed(0))
    start = time.perf_counter()
    field, seen = render_planes(twin, (Plane(picture, 60.0, 300e3),))
    done = irradiate(twin, field, seen, field_points=9, light=WHITE, wavelengths=1)
    assert done.field_error is not None
    return {
        "seconds": time.perf_counter() - start,
        "region": f"{field.support.height}×{field.support.width}",
        "field_error": done.field_error / float(done.light.std()),
    }


WORK = {"psf": run_psf, "field": run_field}


def timed(name: str, device: str) -> dict[str, Any]:
    """One run in a process of its own; the least of its kind shows what the code takes."""
    command = [sys.executable, __file__, "--worker", name, "--device", device]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found: dict[str, Any] = json.loads(out)
    print(f"{name}: {found['seconds']:.2f} s, {found['memory_gb']:.2f} GB", file=sys.stderr)
    return found


def correlation(one: torch.Tensor, other: torch.Tensor) -> float:
    """Of two patterns about their means."""
    one, other = one.double() - one.double().mean(), other.double() - other.double().mean()
    return float((one * other).sum() / (one.norm() * other.norm()))


def exactness() -> dict[str, Any]:
    """What more wavelengths and finer samples change, on the middle of the paper's sensor."""
    twin = Twin.of(LoadedCamera.of(preset("paper"))).reading(1024, 1024)
    few, many = (
        point_spread(twin, SOURCE, (1024, 1024), light=WHITE, wavelengths=count)
        for count in (3, 21)
    )
    relief = twin.mask.relief
    rows, columns = (2 * n - 1 for n in relief.height_um.shape)
    finer = Relief(relief.sample(Grid(rows, columns, relief.grid_um / 2)), relief.grid_um / 2)
    pixels = [
        nnf.avg_pool2d(
            monochromatic_psf(
                twin.illumination(SOURCE, 535.0), MaskSurface(surface), twin.media(535.0),
                Grid(1024, 1024, twin.sensor_pitch_um).finer(samples),
            )[None],
            samples,
        )[0]
        for surface, samples in ((relief, 2), (finer, 4))
    ]  # fmt: skip
    return {
        "wavelengths": [correlation(a, b) for a, b in zip(few, many, strict=True)],
        "halving": float((pixels[0] - pixels[1]).norm() / pixels[1].norm()),
    }


def picture() -> None:
    """Parts of the PSF at 0, 20 and 40 degrees, each as bright as the first, side by side."""
    twin = Twin.of(LoadedCamera.of(preset("paper"))).reading(720, 720)
    parts = [
        point_spread(
            twin, PointSource((0.0, math.tan(math.radians(angle))), 300e3, 50.0), (360, 360),
            superpixel=2, light=WHITE,
        )
        for angle in (0.0, 20.0, 40.0)
    ]  # fmt: skip
    gap = torch.full((3, 360, 6), float(parts[0].max()))
    write_png(PICTURE, torch.cat([parts[0], gap, parts[1], gap, parts[2]], dim=-1))


def report(found: dict[str, Any]) -> str:
    """The page."""
    machine = found["machine"]
    others = found["others_cores"]
    lines = [
        "# The simulated camera",
        "",
        "Written by `make bench-twin`; do not edit.",
        "",
        f"- Machine: {machine['cpu']}, {machine['cores']} cores, {machine['memory_gib']:.0f} GiB; "
        + ("" if others is None else f"others kept {others:.2f} cores busy during the run; ")
        + f"computed on {found['device']}",
        f"- Date: {found['date']}; {ROUNDS} runs of each, every one in a process of its own",
        "",
        "| what | median s | min | max | peak memory | limit |",
        "|---|---|---|---|---|---|",
    ]
    names = {
        "psf": ("PSF of `paper` on all 4056×3040 pixels, one wavelength, samples at half the pitch",
                "10 s, 4 GB"),
        "field": ("scene on 2028×1520 pixels, one wavelength for each of 3 colours, 9×9 field "
                  "points", "600 s"),
    }  # fmt: skip
    for name, (what, limit) in names.items():
        runs = found[name]
        seconds = [run["seconds"] for run in runs]
        memory = max(run["memory_gb"] for run in runs)
        lines.append(
            f"| {what} | {statistics.median(seconds):.2f} | {min(seconds):.2f} | "
            f"{max(seconds):.2f} | {memory:.2f} GB | {limit} |"
        )
    surface = statistics.median(run["surface_s"] for run in found["psf"])
    psf, field, exact = found["psf"][0], found["field"][0], found["exactness"]
    colours = ", ".join(f"{value:.5f}" for value in exact["wavelengths"])
    lines += [
        "",
        f"The mask's surface, which both need before, takes {surface:.2f} s. Seconds are without "
        "the start of Python and torch; memory is the whole process's.",
        "",
        "| accuracy | measured | required |",
        "|---|---|---|",
        f"| autocorrelation of the PSF, full width at half maximum | {psf['width_um']:.2f} µm | "
        "20 ± 2 µm |",
        f"| pitch, from its first to its second peak | {psf['pitch_um']:.1f} µm | 70 ± 5 µm |",
        f"| halving the distance of all samples changes the pixels' PSF by | "
        f"{100 * exact['halving']:.4f} % | below 1 % |",
        f"| correlation of 3 with 21 wavelengths (R, G, B) | {colours} | above 0.99 |",
        f"| interpolation between 9×9 field points, scene of noise on {field['region']} pixels: "
        f"error, of the measurement's contrast | {100 * field['field_error']:.2f} % | |",
        "",
        f"![PSF at 0°, 20° and 40°](results/{PICTURE.name})",
        "",
        "*Middle of the PSF of `paper` (1.1 mm wide) for a white LED behind a 50 µm pinhole at "
        "300 mm, at 0°, 20° and 40°, re-centred on the chief ray.*",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--worker", choices=sorted(WORK))
    given = parser.parse_args()
    if given.worker:
        found = WORK[given.worker](given.device)
        found["memory_gb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
        print(json.dumps(found))
        return
    machine, others = describe(), Others()
    results: dict[str, Any] = {
        name: [timed(name, given.device) for _ in range(ROUNDS)] for name in WORK
    }
    results["others_cores"] = others.cores()
    results["exactness"] = exactness()
    picture()
    results |= {
        "machine": machine,
        "device": given.device,
        "date": datetime.now(UTC).date().isoformat(),
    }
    (DOCS / "twin.json").write_text(json.dumps(results, indent=1) + "\n")
    (DOCS / "twin.md").write_text(report(results))


if __name__ == "__main__":
    main()
