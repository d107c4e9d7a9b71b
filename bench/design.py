"""Thickness, tolerances and masks of the paper's camera: `make bench-design` writes docs/design.md.

It uses the commands as a person would, files in and files out, on a quarter of the paper's sensor.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as nnf
from PIL import Image
from skimage import data as photographs
from torch import Tensor

from machine import Others, describe
from nolens.amounts import shown_unit
from nolens.camera import exposure_white, preset_text
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_frame, write_png

DOCS = Path(__file__).parents[1] / "docs"
NOLENS = Path(sys.executable).with_name("nolens")
ROWS, COLUMNS = 1520, 2028
EXPOSURE = "12ms"
FILM = ("--film", "0.305mm", "--film-distance", "0.4mm±0.2mm")
SCENES = {
    "coffee at 50°": ("coffee", "50deg"),
    "astronaut at 30°": ("astronaut", "30deg"),
}
MASKS: dict[str, tuple[str, ...]] = {
    "the paper's random lenslets": (
        "random-lenslets", "--radius", "0.67mm", "--pitch", "70um", "--smoothing", "11um",
    ),
    "random lenslets that focus": ("random-lenslets", "--pitch", "90um", "--smoothing", "6um"),
    "regular lenslets": ("lenslet-array", "--pitch", "90um"),
    "Gaussian diffuser, 1°": ("diffuser",),
    "contour": ("contour",),
    "optimised": ("optimised",),
}  # fmt: skip


def told(*arguments: object) -> dict[str, Any]:
    """What a command prints with --json."""
    command = [str(NOLENS), *map(str, arguments), "--json"]
    out = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    found: dict[str, Any] = json.loads(out)
    return found


def scenes(folder: Path) -> None:
    """Photographs that no mask was designed on."""
    pictures = {
        "coffee": photographs.coffee()[:400, 100:500],
        "astronaut": photographs.astronaut()[:400, 50:450],
    }
    for name, picture in pictures.items():
        Image.fromarray(picture).save(folder / f"{name}.png")


def values(path: Path) -> Tensor:
    """A TIFF that a command wrote, (channels, rows, columns)."""
    return read_frame(path).counts.float()


def pictures(folder: Path, mask: Path, camera: Path) -> dict[str, float]:
    """PSNR of every scene's reconstruction, after one factor, against what reaches the sensor."""
    found: dict[str, float] = {}
    for name, (scene, angle) in SCENES.items():
        stem = mask / scene
        seen = told(
            "simulate", folder / f"{scene}.png", "--camera", camera, "--angle", angle,
            "--exposure", EXPOSURE, "-o", f"{stem}.dng",
            "--truth", f"{stem}-truth.tif", "--response", f"{stem}-response.tif",
        )  # fmt: skip
        psf = mask / f"psf-{seen['psf_pixels']}.tif"
        if not psf.exists():
            told("psf", "--camera", camera, "--pixels", seen["psf_pixels"], "-o", psf)
        told(
            "reconstruct", f"{stem}.dng", "--psf", psf, "--psf-extent", "wide",
            "--support", seen["support"],
            "--tau", "5e-6", "--iterations", 300, "--tolerance", 0,
            "-o", f"{stem}-out.tif", "--tiff-bits", 32,
        )  # fmt: skip
        truth = values(Path(f"{stem}-truth.tif")) * values(Path(f"{stem}-response.tif"))
        picture = scale_fit(values(Path(f"{stem}-out.tif")), truth)
        found[name] = psnr(picture, truth, float(truth.max()))
        print(f"{camera.name}, {name}: {found[name]:.2f} dB", file=sys.stderr)
    return found


def shown(stem: Path) -> Tensor:
    """A reconstruction whose white is 1."""
    picture = values(Path(f"{stem}-out.tif"))
    return picture / exposure_white(picture)


def design_figures() -> dict[str, Any]:
    """Thickness from the paper's measurement, and what tolerances do to its camera."""
    with tempfile.TemporaryDirectory() as scratch:
        study = told("design", "tolerance", "paper", "--limit", "1.05x", "-o", scratch)
        del study["outputs"]
        return {"thickness": told("design", "thickness", *FILM), "tolerance": study}


def thickness_table(found: dict[str, Any]) -> list[str]:
    """Exact and printed forms beside the paper's own figures."""
    thick = found["thickness"]
    radius = thick["radius_mm"]
    lines = [
        "## Thickness of the replica",
        "",
        f"`nolens design thickness {' '.join(FILM)}`: the radius of curvature is "
        f"{radius['value']:.3f} ± {radius['plus_minus']:.3f} mm by exact ray matrices, "
        f"{thick['printed_radius_mm']:.3f} mm by the paper's eq. 3 as it is printed.",
        "",
        "| replica | exact | eq. 3 as printed | the paper | focal length, as in air | NA of a "
        "lenslet | depth of focus, as in air |",
        "|---|---|---|---|---|---|---|",
    ]
    master = radius["value"] / (thick["film"]["index"] - 1)
    papers = {"pdms": "1.44 ± 0.41 mm", "pua311": "1.28 ± 0.37 mm"}
    for each in thick["materials"]:
        exact = each["thickness_mm"]
        lines.append(
            f"| {each['material']} | {exact['value']:.2f} ± {exact['plus_minus']:.2f} mm | "
            f"{each['printed_thickness_mm']:.2f} mm | {papers[each['material']]} | "
            f"{each['focal_length_mm']['value']:.2f} mm | {each['aperture']['value']:.3f} | "
            f"{each['depth_of_focus_mm']['value']:.2f} mm |"
        )
    return [
        *lines,
        "",
        "The paper's focal length of about 1 mm, and so its NA of 0.035 and its depth of focus of "
        f"0.41 mm, are those of its master film: R/(n_p − 1) is {master:.2f} mm there.",
        "",
    ]


def tolerance_table(found: dict[str, Any]) -> list[str]:
    """Worst offenders, prediction and yield."""
    study = found["tolerance"]
    unit, passed, guess = shown_unit(study["unit"]), study["yield"], study["prediction"]
    lines = [
        "## Tolerances",
        "",
        f"`nolens design tolerance paper --limit 1.05x`: {study['criterion']} of the PSF, nominal "
        f"{study['nominal']:.2f} {unit}, by waves at {study['light']}; the tolerances are assumed.",
        "",
        "| parameter | tolerance | change at −, + |",
        "|---|---|---|",
    ]
    for row in study["sensitivities"]:
        lines.append(
            f"| {row['parameter']} | {row['mean']:.4g} ± {row['tolerance']:g} "
            f"{shown_unit(row['unit'])} ({row['tolerance_means']}) | "
            f"{row['change_at_minus']:+.2g}, {row['change_at_plus']:+.2g} {unit} |"
        )
    low, high = passed["interval_95"]
    return [
        *lines,
        "",
        f"Predicted: mean {guess['mean']:.2f} {unit}, σ {guess['second_order_sigma']:.2f} {unit}; "
        f"drawn, of {study['trials']} cameras: mean {study['mean']:.2f} {unit}, σ "
        f"{study['sigma']:.2f} {unit}. "
        f"{100 * passed['share']:.1f} % (95 % interval {100 * low:.1f} to {100 * high:.1f} %) have "
        f"lines of at most {study['limit']:.2f} {unit}.",
        "",
    ]


def report(found: dict[str, Any]) -> str:
    """The page."""
    machine, others = found["machine"], found["others_cores"]
    lines = [
        "# Design",
        "",
        "Written by `make bench-design`; do not edit.",
        "",
        f"- Machine: {machine['cpu']}, {machine['cores']} cores, {machine['memory_gib']:.0f} GiB; "
        + ("" if others is None else f"others kept {others:.2f} cores busy during the run"),
        f"- Date: {found['date']}",
        "",
        *thickness_table(found),
        *tolerance_table(found),
        "## Masks",
        "",
        f"- Camera: {COLUMNS}×{ROWS} pixels of the paper's sensor, its layers (1.06 mm of resin), "
        f"exposed {EXPOSURE} to every scene: equal light and noise for every mask",
        "- Reconstruction: the central PSF, 300 iterations, τ 1e-5; scenes from 5×5 PSFs over the "
        "field; photographs of scikit-image that no mask was designed on",
        "",
        "| mask (`nolens design mask …`) | PSF width | sparsity | spectral magnitude of 1 mm² at "
        f"20, 40, 80 /mm | height | {' | '.join(SCENES)} | design |",
        "|---|---|---|---|---|" + "---|" * len(SCENES) + "---|",
    ]
    for name, each in found["masks"].items():
        own = each["figures"]
        magnitude = ", ".join(f"{100 * value:.2f}" for value in own["magnitude"])
        width = "–" if own["width_um"] is None else f"{own['width_um']:.1f} µm"
        scores = " | ".join(f"{each['psnr'][scene]:.1f} dB" for scene in SCENES)
        lines.append(
            f"| {name} (`{' '.join(MASKS[name])}`) | {width} | {100 * own['sparsity']:.1f} % | "
            f"{magnitude} % | {own['height_um']:.1f} µm | {scores} | {each['seconds']:.0f} s |"
        )
    contour = found["masks"]["contour"]["target_correlation"]
    lines += [
        "",
        "The contour mask's PSF correlates with the drawing that it was made for by "
        + ", ".join(f"{value:.3f}" for value in contour)
        + " in red, green and blue. Contour masks made by edge filtering are the subject of a "
        "patent application (US 2025/0377536 A1); these come from level lines of a random field.",
        "",
    ]
    for name, picture in (("the paper's random lenslets", "papers"), ("optimised", "optimised")):
        lines += [f"![{name}](results/design-{picture}.png)", ""]
    lines += [
        "*Coffee and astronaut: above from the paper's random lenslets, below from the "
        "optimised mask.*",
        "",
        "![the optimised mask](results/design-mask.png)",
        "",
        "*The optimised mask and its PSF, beside the paper's diffuser in the same camera.*",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Design, simulate, reconstruct, and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    machine, others = describe(), Others()
    masks: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        scenes(folder)
        text = preset_text("paper").replace("rows = 3040", f"rows = {ROWS}")
        (folder / "camera.toml").write_text(text.replace("columns = 4056", f"columns = {COLUMNS}"))
        for number, (name, options) in enumerate(MASKS.items()):
            camera = folder / f"mask{number}"
            start = time.perf_counter()
            done = told("design", "mask", *options, "--camera", folder, "-o", camera)
            masks[name] = {
                "figures": done["figures"],
                "target_correlation": done.get("target_correlation"),
                "seconds": time.perf_counter() - start,
                "psnr": pictures(folder, camera, camera),
            }
        for number, name in ((0, "papers"), (len(MASKS) - 1, "optimised")):
            row = [shown(folder / f"mask{number}" / scene) for scene, _ in SCENES.values()]
            height = max(each.shape[1] for each in row)
            padded = [nnf.pad(each, (0, 6, 0, height - each.shape[1])) for each in row]
            write_png(DOCS / "results" / f"design-{name}.png", torch.cat(padded, dim=-1))
        picture = (folder / f"mask{len(MASKS) - 1}" / "mask.png").read_bytes()
        (DOCS / "results" / "design-mask.png").write_bytes(picture)
    found = {
        "machine": machine,
        "others_cores": others.cores(),
        "date": datetime.now(UTC).date().isoformat(),
        "masks": masks,
        **design_figures(),
    }
    (DOCS / "design.json").write_text(json.dumps(found, indent=1) + "\n")
    (DOCS / "design.md").write_text(report(found))


if __name__ == "__main__":
    main()
