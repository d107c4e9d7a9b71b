"""PSNR by the weight of the prior: photographs through the simulated paper camera, and real pairs.

`python bench/tau.py` takes scikit-image's photographs as `nolens simulate` does, each 50° wide at
300 mm, and prints a row for each weight. With `--data FOLDER` it adds the mean of the five real
pairs, with the settings of `bench/results.py`. A PSF of an earlier run is taken again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from nolens.evaluate import psnr, scale_fit
from nolens.files import read_frame, write_png
from nolens.files.sample_pictures import sample_picture
from nolens.jobs import (
    PsfOptions,
    ReconstructOptions,
    Reporter,
    SimulateOptions,
    reconstruct,
    simulate,
    simulate_psf,
)
from results import PAIRS, judged, pair

PHOTOGRAPHS = ("astronaut", "coffee", "chelsea")
TAUS = (1e-4, 5e-5, 3e-5, 2e-5, 1e-5, 3e-6)


def shot(folder: Path, name: str) -> dict[str, object]:
    """Summary of a simulated measurement, beside its truth and response."""
    paths = {
        part: folder / f"{name}-{part}.tif" for part in ("picture", "raw", "truth", "response")
    }
    picture = folder / f"{name}.png"
    write_png(picture, sample_picture(name, "the scene comes"), 1.0)
    given = {
        "scenes": picture, "camera": "paper", "distance": "300mm", "angle": "50deg",
        "output": paths["raw"], "truth": paths["truth"], "response": paths["response"],
    }  # fmt: skip
    return simulate(SimulateOptions.gather(given), Reporter()).summary


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of the real measurements")
    parser.add_argument("--folder", type=Path, default=Path("build/tau"), help="for files")
    asked = parser.parse_args()
    folder: Path = asked.folder
    folder.mkdir(parents=True, exist_ok=True)
    rows: dict[float, list[str]] = {tau: [] for tau in TAUS}
    for name in PHOTOGRAPHS:
        summary = shot(folder, name)
        psf = folder / f"psf-{summary['psf_pixels']}.tif"
        if not psf.exists():
            given = {"camera": "paper", "depth": "300mm", "pixels": summary["psf_pixels"]}
            simulate_psf(PsfOptions.gather({**given, "output": psf}), Reporter())
        truth = read_frame(folder / f"{name}-truth.tif").counts
        truth = truth * read_frame(folder / f"{name}-response.tif").counts
        for tau in TAUS:
            options = ReconstructOptions(
                measurement=folder / f"{name}-raw.tif", psf=psf, psf_extent="wide", tau=tau,
                support=summary["support"], output=(folder / f"{name}-{tau:g}.png",),
            )  # fmt: skip
            picture = reconstruct(options, Reporter()).value
            peak = float(truth.max())
            rows[tau].append(f"{psnr(scale_fit(picture, truth), truth, peak):.1f}")
            print(name, tau, rows[tau][-1], flush=True)
    heads = list(PHOTOGRAPHS)
    if asked.data is not None:
        heads.append("five pairs, mean (SSIM)")
        for tau in TAUS:
            found = [judged(*pair(asked.data, name, folder, tau=tau)) for name in PAIRS]
            psnrs, ssims = ([figures[key] for _, figures in found] for key in ("psnr_db", "ssim"))
            rows[tau].append(f"{sum(psnrs) / len(PAIRS):.1f} ({sum(ssims) / len(PAIRS):.3f})")
            print("pairs", tau, rows[tau][-1], flush=True)
    print("| τ | " + " | ".join(heads) + " |")
    for tau, cells in rows.items():
        print(f"| {tau:g} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
