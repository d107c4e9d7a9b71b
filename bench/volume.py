"""Planes of several depths, solved together: beads, and two objects one before the other.

`make bench-model` runs it after `bench/model.py`. Simulated cameras with noise and mosaic take 200
beads in 8 planes, 60 fluorescent ones in water, and the two objects of the reproduction (8 and
20 cm). Rows that were measured are in `--folder`; the table goes into `docs/volume.md`, between
its markers.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as nnf
from PIL import Image

import nolens as nl
from nolens.camera import Camera, LoadedCamera, preset
from nolens.camera.measurement import bin_mean
from nolens.evaluate import psnr, scale_fit
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import read_camera, read_light, write_camera, write_frame, write_png
from nolens.files.sample_pictures import sample_picture
from nolens.jobs import PsfOptions, ReconstructOptions, Reporter, reconstruct, simulate_psf
from nolens.operators import PixelRectangle
from nolens.quantities import Length
from nolens.twin import FieldMap, Plane, PlaneView, Twin, render_planes
from page import write_part

APART, OBJECTS_DEG, OBJECTS_BIN = 5, 40, 4
MASKS = {"diffuser": {}, "random-lenslets": {"pitch": "150um"}}
GFP = "wavelength_nm,power\n470,0\n490,0.3\n509,1\n530,0.5\n560,0.12\n600,0\n"


@dataclass(frozen=True)
class Volume:
    """Beads in planes before the middle of the paper's sensor.

    Parameters
    ----------
    name
        Of its files.
    per_m
        1/z of the planes, from the nearest on.
    calibrated
        Numbers of the planes that PSFs are known of.
    count
        Of the beads.
    sensor
        Rows and columns of pixels.
    bin_by
        Superpixels along a bead, and along a pixel of the reconstruction.
    field_deg
        Angle that the PSFs cover.
    field_points
        Along each side of the simulated scene.
    channels
        That are reconstructed.
    outside
        Index of the space of the beads.
    fluorescent
        Whether they shine with an emission spectrum, in place of a white LED.
    fill
        Fraction of a full pixel that the brightest one is exposed to.
    mask
        Kind of the mask; empty for the preset's.
    """

    name: str
    per_m: tuple[float, ...]
    calibrated: tuple[int, ...]
    count: int
    sensor: tuple[int, int]
    bin_by: int
    field_deg: float
    field_points: int
    channels: str = "grey"
    outside: float = 1.0
    fluorescent: bool = False
    fill: float = 0.9
    mask: str = ""

    @property
    def depths_um(self) -> list[float]:
        """Of the planes."""
        return [1e6 / each if each else math.inf for each in self.per_m]

    @property
    def texts(self) -> list[str]:
        """The same as --depths takes them."""
        return ["inf" if math.isinf(z) else f"{z * 1e-3:.4f}mm" for z in self.depths_um]


BEADS = Volume(
    "beads", tuple(8.8 * k for k in reversed(range(8))), (0, 5, 7), 200, (1200, 1600), 2, 45, 5
)
GAUSSIAN = replace(BEADS, name="beads, Gaussian surface of 1°", mask="diffuser")
LENSLETS = replace(BEADS, name="beads, random lenslets of 150 µm", mask="random-lenslets")
WATER = Volume(
    "water", (250, 230, 210, 190), (0, 3), 60, (600, 800), 1, 24, 3, "g", 1.33, True, 0.2
)


class Quiet(Reporter):
    """Prints warnings and notes."""

    def warn(self, text: str) -> None:
        """Print it."""
        print("warning:", text, flush=True)


def camera_folder(
    folder: Path,
    sensor: tuple[int, int],
    distances: list[str],
    field_deg: float,
    light: str = "white-led",
    outside: float = 1.0,
    mask: str = "",
) -> Path:
    """A camera's folder with PSFs over the field, at some distances."""
    out = folder / "camera"
    if not (out / "psfs.toml").exists():
        paper = preset("paper")
        size = dict(zip(("rows", "columns"), sensor, strict=True))
        read: dict[str, Any] = {
            "sensor": paper.sensor.model_copy(update=size),
            "name": "middle of the paper's",
        }
        if outside > 1:  # Lenslets that focus beads at 4 mm in water.
            focused = paper.mask.relief.model_copy(update={"radius": Length("0.126", "mm")})
            read |= {"outside": outside, "mask": paper.mask.model_copy(update={"relief": focused})}
        camera: Camera = paper.model_copy(update=read)
        relief = None
        if mask:
            made = nl.design_mask(mask, nl.Camera(LoadedCamera.of(camera)), **MASKS[mask]).loaded
            camera, relief = made.camera, made.relief_um
        write_camera(folder / "described", camera, relief)
        for distance in distances:
            simulate_psf(
                PsfOptions(
                    camera=str(folder / "described"),
                    output=out,
                    field=f"{field_deg:g}deg",
                    field_points=3,
                    distance=distance,
                    wavelengths=1,
                    size="0um",
                    light=light,
                ),
                Quiet(),
            )
    return out


def simulated_beads(
    folder: Path, camera: LoadedCamera, volume: Volume, light: str
) -> tuple[Path, list[list[int]]]:
    """A frame of beads, and the plane, row and column of each on pixels of the reconstruction."""
    raw, truth = folder / f"{volume.name}.tif", folder / f"{volume.name}-places.json"
    if not raw.exists():
        experiment = VirtualExperiment(
            Twin.of(camera), read_light(light), 1, field_points=volume.field_points
        )
        shape, side = experiment.twin.shape, volume.bin_by
        support = PixelRectangle.centred(shape[0] // 2, shape[1] // 2, shape)
        generator = torch.Generator().manual_seed(0)
        scene = torch.zeros(len(volume.per_m), 3, support.height, support.width)
        places: list[list[int]] = []
        while len(places) < volume.count:
            row, column = (
                int(torch.randint(3, count // side - 3, (1,), generator=generator))
                for count in (support.height, support.width)
            )
            if any(max(abs(row - r), abs(column - c)) <= APART for _, r, c in places):
                continue
            plane = len(places) % len(volume.per_m)
            window = (
                slice(side * row, side * (row + 1)),
                slice(side * column, side * (column + 1)),
            )
            scene[plane, :, *window] = 0.5 + 0.5 * float(torch.rand(1, generator=generator))
            places.append([plane, row, column])
        views = tuple(map(PlaneView, scene, volume.depths_um))
        shot = experiment.measure_views(FieldMap(experiment.twin, support), views, fill=volume.fill)
        print(volume.name, "error between field points", shot.field_error, flush=True)
        write_frame(raw, shot.frame, model="nolens simulated camera")
        truth.write_text(json.dumps(places))
    return raw, json.loads(truth.read_text())


def found_beads(volume: torch.Tensor, least: float) -> list[tuple[float, int, int]]:
    """Plane, row and column of what is brighter than a part of the brightest."""
    light = volume.sum(0)
    peaks = (light == nnf.max_pool2d(light[None], 5, 1, 2)[0]) & (light > least * light.max())
    number = torch.arange(len(volume), dtype=volume.dtype)
    out = []
    for row, column in peaks.nonzero().tolist():
        part = volume[:, max(0, row - 1) : row + 2, max(0, column - 1) : column + 2].sum((1, 2))
        out.append((float((part * number).sum() / part.sum()), row, column))
    return out


def judged(volume: torch.Tensor, places: list[list[int]], least: float = 0.05) -> dict[str, float]:
    """Recall and precision of beads within a pixel, and how many of those in depth."""
    found = found_beads(volume, least)
    left, errors = set(range(len(found))), []
    for plane, row, column in places:
        near = [k for k in left if max(abs(found[k][1] - row), abs(found[k][2] - column)) <= 1]
        if near:
            left.discard(near[0])
            errors.append(abs(found[near[0]][0] - plane))
    return {
        "recall": len(errors) / len(places),
        "precision": len(errors) / max(1, len(found)),
        "within_depth_of_focus": sum(each <= 1 for each in errors) / max(1, len(errors)),
        "in_its_plane": sum(each <= 0.5 for each in errors) / max(1, len(errors)),
        "rms_planes": (sum(each**2 for each in errors) / max(1, len(errors))) ** 0.5,
    }


def beads(folder: Path, volume: Volume, ways: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Every way of reconstructing the beads."""
    light = "white-led"
    if volume.fluorescent:
        light = str(folder / "gfp.csv")
        Path(light).write_text(GFP)
    psfs = camera_folder(
        folder if volume is BEADS else folder / (volume.mask or volume.name),
        volume.sensor,
        [volume.texts[k].replace("inf", "infinity") for k in volume.calibrated],
        volume.field_deg,
        light,
        volume.outside,
        volume.mask,
    )
    raw, places = simulated_beads(folder, read_camera(psfs), volume, light)
    rows = {}
    for name, options in ways.items():
        path = folder / f"{volume.name}-{name.replace(', ', '-').replace(' ', '-')}.json"
        if not path.exists():
            begun = time.perf_counter()
            height, width = (side // 2 // volume.bin_by // 2 for side in volume.sensor)
            result = reconstruct(
                ReconstructOptions(
                    measurement=raw,
                    psf=psfs,
                    depths=",".join(volume.texts),
                    output=(path.with_suffix(""),),
                    bin=volume.bin_by,
                    channels=volume.channels,
                    mosaic="RGGB",
                    black=256,
                    support=f"{height}x{width}",
                    **options,
                ),
                Quiet(),
            )
            row = judged(result.value[:, :1].sum(1), places)
            row |= {key: result.summary[key] for key in ("tau", "iterations")}
            path.write_text(json.dumps({**row, "seconds": time.perf_counter() - begun}))
        rows[f"{volume.name}, {name}"] = json.loads(path.read_text())
        print(volume.name, name, rows[f"{volume.name}, {name}"], flush=True)
    return rows


def simulated_objects(folder: Path, camera: LoadedCamera) -> tuple[Path, torch.Tensor]:
    """A frame of the reproduction's two objects, and the light of each, (2, 3, height, width)."""
    raw, truth = folder / "objects.tif", folder / "objects.pt"
    if not raw.exists():
        experiment = VirtualExperiment.of(camera, wavelengths=1, field_points=3)
        near, far = (sample_picture(name, "the benchmark") for name in ("chelsea", "astronaut"))
        side = near.shape[-2]
        picture, opacity = torch.zeros(3, side, 2 * side), torch.zeros(side, 2 * side)
        picture[..., :side], opacity[:, :side] = near[..., -side:], 1.0
        wide = torch.zeros(3, far.shape[-2], 2 * far.shape[-1])
        wide[..., far.shape[-1] :] = far
        planes = (
            Plane(picture, OBJECTS_DEG, 80e3, opacity),
            Plane(wide, OBJECTS_DEG, 200e3),
        )
        field, views = render_planes(experiment.twin, planes)
        shot = experiment.measure_views(field, views)
        print("objects", shot.field_error, field.support.text, flush=True)
        write_frame(raw, shot.frame, model="nolens simulated camera")
        light = torch.stack([view.radiance for view in views]) * shot.response
        torch.save((field.support, light), truth)
    return raw, torch.load(truth, weights_only=False)


def best_psnr(page: torch.Tensor, light: torch.Tensor, rows: slice, columns: slice) -> float:
    """PSNR of a page, laid on its truth to a superpixel: binning moves the middle of a PSF."""
    reach = range(-OBJECTS_BIN, OBJECTS_BIN + 1)
    moved = (light.roll((down, right), (1, 2)) for down in reach for right in reach)
    truths = (bin_mean(each[..., rows, columns], OBJECTS_BIN) for each in moved)
    return max(psnr(scale_fit(page, each), each, float(light.max())) for each in truths)


def objects(folder: Path, mask: str = "") -> dict[str, Any]:
    """PSNR of each object alone in its plane, solved together and one by one."""
    folder = folder / mask
    path = folder / "objects.json"
    if not path.exists():
        psfs = camera_folder(
            folder / "whole", (3040, 4056), ["8cm", "20cm"], OBJECTS_DEG, mask=mask
        )
        raw, (support, truth) = simulated_objects(folder, read_camera(psfs))
        edges = [
            (-(-first // OBJECTS_BIN), (first + side) // OBJECTS_BIN)
            for first, side in ((support.top, support.height), (support.left, support.width))
        ]
        (top, bottom), (left, right) = edges
        rows, columns = (
            slice(OBJECTS_BIN * low - first, OBJECTS_BIN * high - first)
            for (low, high), first in zip(edges, (support.top, support.left), strict=True)
        )
        window = PixelRectangle(top, left, bottom - top, right - left)
        common: dict[str, Any] = {
            "measurement": raw,
            "psf": psfs,
            "bin": OBJECTS_BIN,
            "mosaic": "RGGB",
            "black": 256,
            "support": window.text,
            "field_points": 5,
        }
        row: dict[str, Any] = {}
        for name, more in (("apart", {}), ("together", {"depths": "8cm,20cm"})):
            kept = folder / f"objects-{name}.pt"
            if not kept.exists():
                pages, begun = [], time.perf_counter()
                if more:
                    options = ReconstructOptions(output=(folder / "objects",), **more, **common)
                    pages = list(reconstruct(options, Quiet()).value)
                else:
                    for distance in ("8cm", "20cm"):
                        output = (folder / f"objects-{distance}.png",)
                        options = ReconstructOptions(output=output, distance=distance, **common)
                        pages.append(reconstruct(options, Quiet()).value)
                torch.save((pages, time.perf_counter() - begun), kept)
            pages, seconds = torch.load(kept)
            errors = [
                best_psnr(page, light, rows, columns)
                for page, light in zip(pages, truth, strict=True)
            ]
            row[name] = {"psnr_db": errors, "seconds": seconds}
            write_png(folder / f"objects-{name}.png", torch.cat(pages, dim=-2))
        path.write_text(json.dumps(row))
    row = json.loads(path.read_text())
    print("objects", row, flush=True)
    return row


def picture(folder: Path, out: Path) -> None:
    """All light of the beads, beside their depths."""
    depth = Image.open(folder / "depth.png").convert("RGB")
    light = Image.open(folder / "all-in-focus.png").convert("RGB")
    side = depth.height * light.width // light.height
    both = Image.new("RGB", (side + depth.width, depth.height), "white")
    both.paste(light.resize((side, depth.height), Image.Resampling.BOX))
    both.paste(depth, (side, 0))
    both.save(out, optimize=True)


def report(bead_rows: dict[str, Any], two: dict[str, Any]) -> str:
    """Markdown of both."""
    lines = [
        "| beads | recall | precision | in depth of focus | in its plane | rms, planes | s |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, row in bead_rows.items():
        lines.append(
            f"| {name} | {row['recall']:.3f} | {row['precision']:.3f} | "
            f"{row['within_depth_of_focus']:.3f} | {row['in_its_plane']:.3f} | "
            f"{row['rms_planes']:.2f} | {row['seconds']:.0f} |"
        )
    lines += ["", "| two objects, PSNR | 8 cm | 20 cm | s |", "|---|---|---|---|"]
    for name, row in two.items():
        cells = " | ".join(f"{each:.1f} dB" for each in row["psnr_db"])
        lines.append(f"| {name} | {cells} | {row['seconds']:.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Measure what is missing, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/volume"))
    parser.add_argument("--page", type=Path, default=Path("docs/volume.md"))
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    ways = {
        "l1": {"prior": "l1", "field_points": 5},
        "l1, one PSF": {"prior": "l1", "field_points": 1},
        "tv, one PSF": {"prior": "tv", "field_points": 1},
    }
    rows = beads(asked.folder, BEADS, ways)
    for volume in (GAUSSIAN, LENSLETS, WATER):
        rows |= beads(asked.folder, volume, {"l1": ways["l1"]})
    two = objects(asked.folder)
    for mask, name in (
        ("diffuser", "Gaussian surface of 1°"),
        ("random-lenslets", "random lenslets of 150 µm"),
    ):
        two |= {f"{way}, {name}": row for way, row in objects(asked.folder, mask).items()}
    picture(asked.folder / "beads-l1", Path("docs/results/volume-beads.png"))
    write_part(asked.page, "bench/volume.py", report(rows, two))


if __name__ == "__main__":
    main()
