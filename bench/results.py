"""Reconstructions of real measurements: pictures and a table for `docs/results/`.

`make results` runs this in the repository's root. It uses the installed `nolens` as a person
would: files in, files out, the program's own penalties, and the same parameters for all five pairs.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from machine import describe
from nolens.evaluate import compare_pictures
from nolens.files import write_png
from nolens.jobs import ReconstructOptions, Reporter, Result, reconstruct

OUT = Path("docs") / "results"
PriorName = Literal["tv", "denoiser", "unrolled"]
PRIORS: tuple[PriorName, ...] = ("tv", "denoiser", "unrolled")
PAIRS = ("im43", "im65", "im157", "im189", "im394")
# The screen fills columns 60 to 470 of the frame (SOURCES.md beside the data).
SCREEN = (0, 60, 270, 410)


class Quiet(Reporter):
    """Passes warnings on, and nothing else."""

    def warn(self, text: str) -> None:
        """Show it."""
        print(f"warning: {text}", file=sys.stderr)


def hand(data: Path, prior: PriorName) -> Result[Tensor]:
    """Reconstruct the hand at full size."""
    folder = data / "diffusercam-hand"
    name = "hand.png" if prior == "tv" else f"hand-{prior}.png"
    return reconstruct(
        ReconstructOptions(
            measurement=folder / "rawdata_hand_sample.tif",
            psf=folder / "psf_sample.tif",
            black="auto",
            bin=1,
            prior=prior,
            output=(OUT / name,),
        ),
        Quiet(),
    )


def pair(
    data: Path,
    name: str,
    scratch: Path,
    psf: Path | None = None,
    tau: float | Literal["auto"] = "auto",
    prior: PriorName = "tv",
) -> tuple[Result[Tensor], Tensor]:
    """Reconstruct one of the five pairs; its picture and what the lensed camera saw.

    With the estimate of the PSF beside the data, or with another one; with the program's own
    weight of the prior, or with another one; by total variation or by a trained prior.
    """
    folder = data / "diffusercam-pairs"
    top, left, height, width = SCREEN
    outcome = reconstruct(
        ReconstructOptions(
            measurement=folder / "diffuser" / f"{name}.npy",
            psf=psf or folder / "psf_estimate.npy",
            psf_extent="wide",
            tau=tau,
            prior=prior,
            bgr=True,
            crop=f"{height}x{width}+{top}+{left}",
            flip="vertical",
            output=(scratch / f"{name}.png",),
        ),
        Quiet(),
    )
    lensed: NDArray[np.float32] = np.load(folder / "lensed" / f"{name}.npy")
    window = lensed[top : top + height, left : left + width, ::-1]
    truth = torch.from_numpy(np.ascontiguousarray(window)).permute(2, 0, 1)
    return outcome, torch.flip(truth, (-2,))


def judged(picture: Tensor, truth: Tensor) -> tuple[Tensor, dict[str, float]]:
    """A picture as bright as the truth, and how near it is: as `nolens compare` says it."""
    found = compare_pictures(picture, truth)
    return found.picture, {name: found.figures[name] for name in ("psnr_db", "ssim")}


def main() -> None:
    """Write the pictures and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the measurements")
    data: Path = parser.parse_args().data
    if not (data / "diffusercam-hand").is_dir():
        sys.exit(
            f"there is no diffusercam-hand in {data}; give the folder of the real "
            "measurements: make results DATA=FOLDER"
        )
    OUT.mkdir(parents=True, exist_ok=True)
    rows = []
    panels: dict[str, list[Tensor]] = {name: [] for name in PAIRS}
    with tempfile.TemporaryDirectory() as scratch:
        for prior in PRIORS:
            outcome = hand(data, prior)
            rows.append({"name": "hand", "psnr_db": None, "ssim": None, **outcome.summary})
            for name in PAIRS:
                outcome, truth = pair(data, name, Path(scratch), prior=prior)
                fitted, figures = judged(outcome.value, truth)
                rows.append({"name": name, **figures, **outcome.summary})
                panels[name].append(fitted)
                if prior == PRIORS[-1]:
                    panels[name].append(truth.clamp(0, 1))
    write_png(
        OUT / "pairs.png", torch.cat([torch.cat(each, dim=-2) for each in panels.values()], dim=-1)
    )
    for row in rows:
        del row["outputs"]
    (OUT / "results.json").write_text(json.dumps(rows, indent=2) + "\n")
    (OUT / "README.md").write_text(table(rows))
    print(f"written to {OUT}")


def table(rows: list[dict[str, object]]) -> str:
    """Markdown of the results."""
    machine = describe()
    lines = [
        "# Real measurements",
        "",
        "Made by `make results` from the files that `SOURCES.md` beside the data describes; they",
        "are not part of this repository. Penalties, start and stopping rule are the program's",
        "own, and so is the weight of the prior. PSNR and SSIM compare with what a lensed camera",
        "saw, after a gain and an offset for each channel, over the pixels that the screen fills.",
        "The PSF of the pairs is itself an estimate, and blurred: it limits these figures. The",
        "pairs are solved without a support, as light comes from beside the screen too.",
        "",
        f"Seconds are those of the whole command on {machine['cpu']}, {machine['cores']} cores.",
        "",
        "| measurement | prior | PSNR | SSIM | iterations | stopped by | seconds |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        psnr_db, similarity = row["psnr_db"], row["ssim"]
        lines.append(
            f"| {row['name']} | {row['prior']} "
            f"| {'' if psnr_db is None else f'{psnr_db:.2f} dB'} "
            f"| {'' if similarity is None else f'{similarity:.3f}'} "
            f"| {row['iterations']} | {row['stop_reason']} "
            f"| {row['seconds']:.1f} |"
        )
    lines += [
        "",
        "The hand (Waller-Lab/DiffuserCam-Tutorial, BSD-3-Clause), 1200×1600 pixels, by total",
        "variation, by `--prior denoiser` and by `--prior unrolled`:",
        "",
        "![hand, total variation](hand.png)",
        "",
        "![hand, denoiser](hand-denoiser.png)",
        "",
        "![hand, unrolled](hand-unrolled.png)",
        "",
        "The five pairs (Waller-Lab/LenslessLearning, BSD-3-Clause): total variation above, then",
        "`--prior denoiser` and `--prior unrolled`, lensed camera below.",
        "",
        "![pairs](pairs.png)",
        "",
        "[A PSF from four pairs, judged on the fifth](pairs-psf.md)",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
