"""PSFs solved from four of the five pairs, judged on the fifth: `docs/results/pairs-psf.md`.

Each pair in turn is left out, its measurement reconstructed as `bench/results.py` does it, with
the PSF of the other four and with the estimate that lies beside the data. That one was solved from
nine pairs, these five perhaps among them.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from machine import describe
from nolens.calibrate.known_scenes import KnownScenes
from nolens.calibrate.psf_from_scenes import psf_from_scenes, unexplained
from nolens.evaluate import affine_fit, psnr, ssim
from nolens.files import write_png, write_tiff32
from results import OUT, PAIRS, pair

SHOWN = 160
"""Cells to each side of the middle."""


def read(data: Path, kind: str, name: str) -> Tensor:
    """A measurement or a picture, (B, G, R)."""
    array = np.load(data / "diffusercam-pairs" / kind / f"{name}.npy")
    return torch.from_numpy(array).permute(2, 0, 1).contiguous()


def known(data: Path, names: tuple[str, ...]) -> KnownScenes:
    """Some of the pairs."""
    return KnownScenes.of(
        [read(data, "lensed", name) for name in names],
        [read(data, "diffuser", name) for name in names],
    )


def judged(data: Path, name: str, scratch: Path, psf: Tensor) -> tuple[dict[str, Any], Tensor]:
    """How well a PSF explains and reconstructs a pair, and the picture."""
    path = scratch / "psf.tif"
    write_tiff32(path, psf[None])
    outcome, truth = pair(data, name, scratch, path)
    shown = affine_fit(outcome.value, truth).clamp(0, 1)
    residual = unexplained(known(data, (name,)), psf)
    figures = {
        "psnr_db": psnr(shown, truth, 1.0),
        "ssim": ssim(shown, truth, 1.0),
        "residual": float(residual.mean()),
    }
    return figures, shown


def middle(psf: Tensor) -> Tensor:
    """The part of a PSF that has light, as bright as its brightest lines, (1, rows, columns)."""
    rows, columns = (length // 2 for length in psf.shape)
    part = psf[rows - SHOWN : rows + SHOWN, columns - SHOWN : columns + SHOWN]
    return (part / torch.quantile(part, 0.995)).clamp(0, 1)[None]


def main() -> None:
    """Write the figures and the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the measurements")
    data: Path = parser.parse_args().data
    if not (data / "diffusercam-pairs").is_dir():
        sys.exit(f"there is no diffusercam-pairs in {data}; give the folder of the real data")
    supplied = torch.from_numpy(np.load(data / "diffusercam-pairs" / "psf_estimate.npy"))
    rows, panels = [], []
    with tempfile.TemporaryDirectory() as folder:
        for name in PAIRS:
            began = time.perf_counter()
            found = psf_from_scenes(known(data, tuple(n for n in PAIRS if n != name)))
            seconds = time.perf_counter() - began
            ours, shown = judged(data, name, Path(folder), found.psf)
            theirs, before = judged(data, name, Path(folder), supplied)
            truth = torch.flip(read(data, "lensed", name)[:, :, 60:470].flip(0), (-2,))
            panels.append(torch.cat([before, shown, truth.clamp(0, 1)], dim=-2))
            rows.append({
                "left_out": name, "solved": ours, "supplied": theirs, "seconds": seconds,
                "support_share": float(found.support.double().mean()),
            })  # fmt: skip
            print(json.dumps(rows[-1]), flush=True)
    every = psf_from_scenes(known(data, PAIRS)).psf
    write_png(OUT / "pairs-psf-patterns.png", torch.cat([middle(every), middle(supplied)], dim=-1))
    mean = {
        which: {key: float(np.mean([row[which][key] for row in rows])) for key in rows[0][which]}
        for which in ("solved", "supplied")
    }
    OUT.mkdir(parents=True, exist_ok=True)
    write_png(OUT / "pairs-psf.png", torch.cat(panels, dim=-1))
    result = {"machine": describe(), "mean": mean, "pairs": rows}
    (OUT / "pairs-psf.json").write_text(json.dumps(result, indent=2) + "\n")
    (OUT / "pairs-psf.md").write_text(page(result))
    print(json.dumps(mean))


def page(result: dict[str, Any]) -> str:
    """Markdown of the figures."""

    def line(name: str, ours: dict[str, Any], theirs: dict[str, Any]) -> str:
        return f"| {name} | " + " | ".join(
            f"{one[key]:{form}}"
            for key, form in (("psnr_db", ".2f"), ("ssim", ".3f"), ("residual", ".3f"))
            for one in (ours, theirs)
        ) + " |"  # fmt: skip

    rows = [line(row["left_out"], row["solved"], row["supplied"]) for row in result["pairs"]]
    rows.append(line("mean", result["mean"]["solved"], result["mean"]["supplied"]))
    seconds = float(np.median([row["seconds"] for row in result["pairs"]]))
    return f"""# A PSF from pairs

Made by `make results`. Each of the five pairs in turn is left out: its measurement is
reconstructed with the PSF that `nolens calibrate pairs` solves from the other four, and with the
estimate that lies beside the data. That one was solved from nine pairs, these five perhaps among
them. The residual is what the PSF leaves of the left-out measurement, weighted as the solver
weighs it.
Solving took {seconds:.0f} s (median) on {result["machine"]["cpu"]}.

| left out | PSNR, dB | supplied | SSIM | supplied | residual | supplied |
|---|---|---|---|---|---|---|
{chr(10).join(rows)}

Above with the supplied estimate, in the middle with the PSF of the other four pairs, below what
the lensed camera saw:

![the five pairs](pairs-psf.png)

The PSF of all five pairs, and the supplied one:

![the two PSFs](pairs-psf-patterns.png)
"""


if __name__ == "__main__":
    main()
