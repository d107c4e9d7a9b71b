"""PSNR by the weight of the prior: the paper's camera, simulated, and three photographs.

`python bench/tau.py [build/tau]` takes scikit-image's photographs as `nolens simulate` does, each
50° wide at 300 mm, and prints a row for each weight. Files of an earlier run are taken again.
"""

from __future__ import annotations

import sys
from pathlib import Path

from nolens.evaluate import psnr, scale_fit
from nolens.files import read_frame, write_png
from nolens.jobs import (
    PsfOptions,
    ReconstructOptions,
    Reporter,
    SimulateOptions,
    reconstruct,
    simulate,
    simulate_psf,
)
from nolens.jobs.sample_pictures import sample_picture

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
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/tau")
    folder.mkdir(parents=True, exist_ok=True)
    print("| τ | " + " | ".join(PHOTOGRAPHS) + " |", flush=True)
    rows: dict[float, list[str]] = {tau: [] for tau in TAUS}
    for name in PHOTOGRAPHS:
        summary = shot(folder, name)
        psf = folder / f"psf-{summary['psf_cells']}.tif"
        if not psf.exists():
            given = {"camera": "paper", "depth": "300mm", "cells": summary["psf_cells"]}
            simulate_psf(PsfOptions.gather({**given, "output": psf}), Reporter())
        truth = read_frame(folder / f"{name}-truth.tif").counts
        truth = truth * read_frame(folder / f"{name}-response.tif").counts
        for tau in TAUS:
            options = ReconstructOptions(
                measurement=folder / f"{name}-raw.tif", psf=psf, psf_wider=True, tau=tau,
                region=summary["region"], output=(folder / f"{name}-{tau:g}.png",),
            )  # fmt: skip
            picture = reconstruct(options, Reporter()).picture
            peak = float(truth.max())
            rows[tau].append(f"{psnr(scale_fit(picture, truth), truth, peak):.1f}")
            print(name, tau, rows[tau][-1], flush=True)
    for tau, cells in rows.items():
        print(f"| {tau:g} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
