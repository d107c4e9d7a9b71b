"""White noise taken out of grey photographs, by the denoiser that comes with nolens and by BM3D.

`python bench/denoising.py` writes the table of `docs/priors.md`. The photographs are those of
`bench/priors.py`, which no prior was trained with (it downloads them), in grey, as they are shown
and 512 pixels long; the noise has a deviation of 25/255. It needs the package bm3d (`pip install
bm3d`), whose licence is for research alone, which is why nothing here installs it.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import bm3d
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from nolens.evaluate import bootstrap_mean
from nolens.files.weights import denoiser
from nolens.solvers.denoising_network import denoise
from page import write_part
from priors_photographs import PHOTOGRAPHS, Photograph

LONGER_SIDE = 512
SIGMA = 25 / 255

Grey = NDArray[np.float32]


def main() -> None:
    """Measure all photographs, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photographs", type=Path, default=Path("build/photographs"))
    parser.add_argument("--page", type=Path, default=Path("docs/priors.md"))
    asked = parser.parse_args()
    torch.set_num_threads(1)
    rows = {}
    for number, photograph in enumerate(PHOTOGRAPHS):
        clean = shown(photograph, asked.photographs)
        noise = np.random.default_rng(number).standard_normal(clean.shape).astype(np.float32)
        noisy = clean + np.float32(SIGMA) * noise
        row = psnr_db(by_network(noisy), clean), psnr_db(bm3d.bm3d(noisy, SIGMA), clean)
        rows[photograph.name] = row
        print(photograph.name, *(f"{each:.2f} dB" for each in row), flush=True)
    write_part(asked.page, "bench/denoising.py", table(rows))


def shown(photograph: Photograph, folder: Path) -> Grey:
    """A photograph in grey, 0 to 1, of sides that are multiples of four."""
    with Image.open(photograph.path(folder)) as picture:
        grey = picture.convert("L")
    smaller = LONGER_SIDE / max(grey.size)
    if smaller < 1:
        width, height = (round(side * smaller) for side in grey.size)
        grey = grey.resize((width, height), Image.Resampling.LANCZOS)
    values = np.asarray(grey, np.float32) / 255
    rows, columns = (side // 4 * 4 for side in values.shape)
    return values[:rows, :columns]


def by_network(noisy: Grey) -> Grey:
    """By the denoiser, told the noise."""
    with torch.inference_mode():
        taken = denoise(denoiser().network, torch.from_numpy(noisy)[None], torch.tensor([SIGMA]))
    return taken[0].numpy()


def psnr_db(picture: Grey, clean: Grey) -> float:
    """White is 1."""
    return -10 * math.log10(float(np.mean((picture - clean) ** 2)))


def table(rows: dict[str, tuple[float, float]]) -> str:
    """A line for each photograph, and for their mean."""
    ours, theirs = (np.array(each) for each in zip(*rows.values(), strict=True))
    mean = bootstrap_mean(ours - theirs)
    lines = [
        "Made by `bench/denoising.py`: noise of 25/255 in the photographs above, in grey and as "
        "they are shown, 512 pixels long; PSNR in dB.",
        "",
        "| photograph | denoiser | BM3D | difference |",
        "|---|---|---|---|",
        *(f"| {name} | {a:.2f} | {b:.2f} | {a - b:+.2f} |" for name, (a, b) in rows.items()),
        f"| **mean** | **{ours.mean():.2f}** | **{theirs.mean():.2f}** | **{mean.mean:+.2f}** "
        f"({mean.low:+.2f} to {mean.high:+.2f}) |",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
