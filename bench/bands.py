"""Spectra and polarisation by simulated cameras with filters, against the truth.

`make bench-model` (`python bench/bands.py`) makes scenes of random leaves with smooth random
spectra and a lamp of two lines 30 nm apart, simulates a small camera with filters, with noise, and
reconstructs by the defaults. It writes the table of `docs/spectra.md`; cases that were measured
are in `--folder`.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import time
import tomllib
from pathlib import Path

import numpy as np
import tifffile
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray

import nolens as nl
from machine import describe
from nolens.camera import Camera, exposure_white, from_mapping, preset_text, srgb_from_linear
from nolens.camera.spectra import spectral_srgb
from nolens.files import write_camera
from nolens.jobs import Reporter, reconstruct, simulate
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.simulation import SimulateOptions

Array = NDArray[np.float32]
BANDS_NM = [465 + 15 * k for k in range(12)]
LAMP = np.s_[10:34, 10:34]
MASKS = {"diffuser": {}, "random-lenslets": {"pitch": "150um"}}
BEGIN, END = "<!-- bench/bands.py -->", "<!-- end -->"


def camera(folder: Path, polarised: bool, mask: str = "") -> Path:
    """288×384 pixels of 3.45 µm behind the mask of the preset `small`, or one of a kind.

    The aperture is larger than the preset's.
    """
    folder.mkdir(parents=True, exist_ok=True)
    mapping = tomllib.loads(preset_text("small"))
    filters: dict[str, object] = {
        "tile": [[f"F{nm}" for nm in BANDS_NM[4 * k : 4 * k + 4]] for k in range(3)],
        "transmission": {"file": "filters.csv"},
    }
    if polarised:
        angles = {str(a): {"angle": f"{a} deg", "extinction": 100} for a in (0, 45, 90, 135)}
        filters = {"tile": [["90", "45"], ["135", "0"]], "polarisers": angles}
    curve = {"source": "even", "wavelength_nm": [400, 700], "values": {"grey": [0.7, 0.7]}}
    del mapping["sensor"]["package"]
    mapping["sensor"] |= {
        "name": "288 x 384", "rows": 288, "columns": 384, "pitch": "3.45 um", "mosaic": "none",
        "full_well_electrons": 10500, "read_noise_electrons": 2.4, "counts_per_electron": 0.36,
        "quantum_efficiency": curve, "filters": filters,
    }  # fmt: skip
    mapping["mask"]["aperture"] = {"shape": "rectangle", "width": "0.65 mm", "height": "0.5 mm"}
    rows = ["wavelength_nm," + ",".join(f"F{nm}" for nm in BANDS_NM)]
    for nm in np.arange(430, 666, 2.5):
        passed = [2 ** -((2 * (nm - centre) / 20) ** 2) for centre in BANDS_NM]
        rows.append(f"{nm:g}," + ",".join(f"{each:.5f}" for each in passed))
    (folder / "filters.csv").write_text("\n".join(rows) + "\n")
    described = from_mapping(Camera, mapping, "bench")
    write_camera(folder, described)
    if mask:
        made = nl.design_mask(mask, nl.Camera(folder), **MASKS[mask]).loaded
        behind = made.camera.mask.model_copy(update={"aperture": described.mask.aperture})
        write_camera(folder, made.camera.model_copy(update={"mask": behind}), made.relief_um)
    return folder


def leaves(places: Array, seed: int, smoothness: float) -> Array:
    """Ellipses that hide each other, radii after 1/r³, each of one smooth random spectrum."""
    height, width, random = 150, 200, np.random.default_rng(seed)
    kernel = np.exp(-(((places[:, None] - places) / smoothness) ** 2) / 2)
    root = np.linalg.cholesky(kernel + 1e-6 * np.eye(len(places)))
    rows, columns = np.mgrid[:height, :width]
    scene = np.zeros((len(places), height, width), np.float32)
    clear = np.ones((height, width), dtype=bool)
    while clear.mean() > 0.002:
        radius = 1 / math.sqrt(random.uniform(1 / 45**2, 1 / 12**2))
        row, column, angle = random.uniform(0, (height, width, math.pi))
        down, right = rows - row, columns - column
        along = right * math.cos(angle) + down * math.sin(angle)
        across = down * math.cos(angle) - right * math.sin(angle)
        inside = np.hypot(along, across / random.uniform(0.5, 1)) < radius
        spectrum = 1 / (1 + np.exp(-1.5 * root @ random.normal(size=len(places))))
        scene[:, inside & clear] = (spectrum * random.uniform(0.2, 1))[:, None]
        clear &= ~inside
    return scene


def spectral_scene(path: Path, per_band: int, seed: int, first_line_nm: int) -> str:
    """A cube of `per_band` wavelengths for each band, with the lamp; their names."""
    step = 15 / per_band
    places = np.array(
        [nm + step * (k - (per_band - 1) / 2) for nm in BANDS_NM for k in range(per_band)]
    )
    scene = leaves(places.astype(np.float32), seed, 60.0) / per_band
    scene[:, *LAMP] = 0.02 / per_band
    for line in (first_line_nm, first_line_nm + 30):
        scene[int(np.argmin(abs(places - line))), *LAMP] = 1
    np.save(path, scene)
    return ",".join(f"{place:g}nm" for place in places)


def polarised_scene(path: Path, seed: int) -> str:
    """Leaves whose light is polarised at random angles, by random amounts."""
    angles = np.arange(0, 180, 45, dtype=np.float32)
    # Four numbers without an order: no smoothness between them.
    np.save(path, leaves(angles, seed, 1e-3))
    return ",".join(f"{angle:g}deg" for angle in angles)


def shot(case: dict[str, object], folder: Path) -> tuple[str, Array]:
    """Simulate a case; its support, and the bands that a reconstruction is to show."""
    polarised = bool(case.get("polarised"))
    seed, per_band = int(str(case.get("seed", 1))), int(str(case.get("per_band", 1)))
    scene = folder / "scene.npy"
    if polarised:
        bands = polarised_scene(scene, seed)
    else:
        bands = spectral_scene(scene, per_band, seed, int(str(case.get("line_nm", 525))))
    result = simulate(
        SimulateOptions(
            scenes=(scene,),
            camera=str(camera(folder / "camera", polarised, str(case.get("mask", "")))),
            bands=bands,
            angle=("15deg",),
            field_points=3,
            output=folder / "raw.tif",
            truth=folder / "truth.tif",
            response=folder / "response.tif",
            fill=str(case.get("fill", "90%")),
        ),
        Reporter(),
    )
    truth = tifffile.imread(folder / "truth.tif").squeeze() * tifffile.imread(
        folder / "response.tif"
    )
    summed = truth.reshape(-1, per_band, *truth.shape[1:]).sum(axis=1)
    return str(result.summary["support"]), summed


def measure(case: dict[str, object], folder: Path) -> dict[str, object]:
    """Figures of a case."""
    folder.mkdir(parents=True, exist_ok=True)
    support, truth = shot(case, folder)
    polarised = bool(case.get("polarised"))
    begun = time.process_time()
    result = reconstruct(
        ReconstructOptions(
            measurement=folder / "raw.tif",
            psf=folder / "camera",
            bands="8" if polarised else ",".join(f"{nm}nm" for nm in BANDS_NM),
            support=support,
            spectrum_at=None if polarised else (10, 10),
            output=(folder / "cube",),
        ),
        Reporter(),
    )
    cpu_s = time.process_time() - begun
    found = tifffile.imread(folder / "cube" / "cube.ome.tif").squeeze()
    figures: dict[str, object] = {name: result.summary[name] for name in ("tau", "iterations")} | {
        "cpu_s": cpu_s,
        "size": truth.shape,
    }
    if polarised:
        true = np.stack([truth.sum(0), truth[0] - truth[2], truth[1] - truth[3]])
        scale = float((found[0] * true[0]).sum() / (found[0] ** 2).sum())
        lit = true[0] > 0.05 * true[0].max()
        degree = np.hypot(true[1], true[2])[lit] / true[0][lit]
        turned = np.degrees(np.arctan2(true[2], true[1])) / 2
        off = (found[4] - turned + 90) % 180 - 90
        strong = lit & (np.hypot(true[1], true[2]) > 0.2 * true[0])
        return figures | {
            "degree": float(np.abs(found[3][lit] - degree).mean()),
            "angle_deg": float(np.abs(off[strong]).mean()),
            "psnr_db": psnr(scale * found[0], true[0]),
        }
    scale = float((found * truth).sum() / (found**2).sum())
    lit = truth.max(axis=0) > 0
    norms = np.linalg.norm(found, axis=0) * np.linalg.norm(truth, axis=0)
    cosine = (found * truth).sum(axis=0)[lit] / np.maximum(norms[lit], 1e-12)
    picture(folder / "spectra.png", truth, scale * found)
    lines = found[:, 7:14, 7:14].mean(axis=(1, 2))
    return figures | {
        "spectral_angle_deg": float(np.degrees(np.arccos(cosine.clip(-1, 1))).mean()),
        "psnr_db": psnr(scale * found, truth),
        "dip": float(lines[5] / min(lines[4], lines[6])),
    }


def picture(path: Path, truth: Array, found: Array) -> None:
    """Draw false colours of the scene and of the reconstruction, and two spectra."""
    figure = Figure(figsize=(9, 2.7), layout="constrained")
    axes = figure.subplots(1, 3)
    for ax, title, cube in zip(axes, ("scene", "reconstruction"), (truth, found), strict=False):
        rgb = spectral_srgb(torch.from_numpy(cube), [float(nm) for nm in BANDS_NM])
        shown = srgb_from_linear(rgb / exposure_white(rgb)).movedim(0, -1).numpy()
        ax.imshow(shown, interpolation="nearest")
        ax.set_title(title, fontsize=9)
        ax.set_axis_off()
    for colour, (row, column) in (("#2a7f62", (10, 10)), ("#c23b2e", (60, 85))):
        axes[2].plot(BANDS_NM, truth[:, row, column], "--", color=colour, linewidth=1)
        name = f"row {row}, column {column}"
        axes[2].plot(BANDS_NM, found[:, row, column], "o-", color=colour, markersize=3, label=name)
    axes[2].set_xlabel("wavelength in nm (dashed: scene)", fontsize=8)
    axes[2].tick_params(labelsize=8)
    axes[2].legend(fontsize=7)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def psnr(found: Array, truth: Array) -> float:
    return float(10 * np.log10(truth.max() ** 2 / np.square(found - truth).mean()))


CASES: dict[str, dict[str, object]] = {
    "12 bands": {},
    "12 bands, other leaves": {"seed": 2},
    "12 bands, a tenth of the light": {"fill": "9%"},
    "12 bands, each of 3 wavelengths": {"per_band": 3},
    "the same, lines of 530 and 560 nm": {"per_band": 3, "line_nm": 530},
    "12 bands, a Gaussian surface of 1°": {"mask": "diffuser"},
    "12 bands, random lenslets of 150 µm": {"mask": "random-lenslets"},
    "polarisers at 4 angles": {"polarised": True},
}


def report(rows: dict[str, dict[str, float]]) -> str:
    """Markdown of the table."""
    machine = describe()
    lines = [
        f"By `make bench-model` on {machine['cpu']}, {machine['cores']} cores; {len(rows)} of "
        f"{len(CASES)} cases.",
        "",
        "| | spectral angle | PSNR | between two lines 30 nm apart | τ, iterations | processor |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in rows.items():
        if "degree" in row:
            what = f"degree ± {row['degree']:.3f}, angle ± {row['angle_deg']:.1f}°"
            cells = [what, f"{row['psnr_db']:.1f} dB (S0)", ""]
        else:
            between = f"{100 * row['dip']:.0f} % of the weaker line"
            cells = [f"{row['spectral_angle_deg']:.1f}°", f"{row['psnr_db']:.1f} dB", between]
        cells += [f"{row['tau']:.2g}, {row['iterations']}", f"{row['cpu_s']:.0f} s"]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure what is missing, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/bands"))
    parser.add_argument("--out", type=Path, default=Path("docs/spectra.md"))
    parser.add_argument("--cases", nargs="*", choices=CASES, default=list(CASES))
    asked = parser.parse_args()
    torch.set_num_threads(1)
    rows = {}
    for name in CASES:
        folder = asked.folder / name.replace(" ", "-").replace(",", "")
        path = folder / "figures.json"
        if not path.exists() and name in asked.cases:
            figures = measure(CASES[name], folder)
            print(name, figures, flush=True)
            path.write_text(json.dumps(figures))
        if path.exists():
            rows[name] = json.loads(path.read_text())
    drawn = asked.folder / "12-bands" / "spectra.png"
    if drawn.exists():
        shutil.copyfile(drawn, asked.out.parent / "results" / "spectra.png")
    before, _, rest = asked.out.read_text().partition(BEGIN)
    after = rest.partition(END)[2]
    asked.out.write_text(f"{before}{BEGIN}\n{report(rows)}\n{END}{after}")


if __name__ == "__main__":
    main()
