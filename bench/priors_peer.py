"""A peer's plug-and-play beside the trained prior of nolens, on cases of `bench/priors.py`.

`python bench/priors_peer.py --fetch` measures the first nine cases, which have every mask with
every exposure once, each another photograph: by total variation and the denoiser as they come, and
by scico's plug-and-play with its DnCNN (`worker_scico_network.py`) at the penalty that is the best
for the truth. It writes its part of `docs/priors.md`. Measurements and figures are kept in
`--folder`, so that it can be interrupted and continued. scico's environment is made in
`.bench-venv` where it is missing; `--fetch` downloads photographs as `bench/priors.py` does.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import nolens as nl
from machine import describe
from nolens.api.simulate import Psf, SimulatedMeasurement
from nolens.files.contact_sheet import SheetPicture, write_contact_sheet
from nolens.kernels import irfft2
from nolens.solvers import Reconstructor
from page import write_part
from peer_env import SCICO_PEER
from priors_cases import (
    ANGLE,
    PIXELS,
    Case,
    Figures,
    cases,
    figures,
    psf_for,
    simulated,
    written,
)
from priors_photographs import fetch

HERE = Path(__file__).parent
OWN, PEER = ("colour-tv", "denoiser"), "scico"
CASES = 9
_WHITE = 0.995


def by_peer(
    shot: SimulatedMeasurement, psf: Psf, first: Tensor, folder: Path
) -> tuple[list[Tensor], list[float]]:
    """Pictures of a measurement by the peer, one for each penalty, and their seconds.

    It starts from a first one, by total variation, whose white is its unit.
    """
    white = float(torch.quantile(first.flatten(), _WHITE))
    problem = Reconstructor(psf.values, shot.support, tau=0.0).problem(shot.values)
    geometry = problem.forward.geometry
    transfer = torch.cat([problem.transfer(each)[None] for each in range(len(shot.channels))])
    unit = white / problem.scale
    source, target = folder / "case.npz", folder / "pictures.npz"
    np.savez(
        source,
        kernel=irfft2(transfer, geometry.padded).numpy(),
        data=(problem.data / unit).numpy(),
        sensor=np.array(geometry.sensor),
        scene=np.array(geometry.scene),
        start=(first / white).numpy(),
    )
    python = SCICO_PEER.ensure(HERE.parent / ".bench-venv")
    subprocess.run([python, HERE / "worker_scico_network.py", source, target], check=True)
    with np.load(target) as result:
        pictures = [white * torch.from_numpy(each) for each in result["pictures"]]
        return pictures, result["seconds"].tolist()


def measure(folder: Path, photographs: Path, case: Case) -> dict[str, Figures]:
    """Figures of a case by total variation, the denoiser and the peer; kept in a file."""
    path = folder / "peer" / f"{case.name}.json"
    if path.exists():
        kept: dict[str, Figures] = json.loads(path.read_text())
        return kept
    shot = simulated(
        folder / "shots" / f"{case.name}.npz",
        case.mask,
        lambda: case.photograph.radiance(photographs),
        case.exposure,
    )
    psf = psf_for(folder, case.mask, shot)
    rows: dict[str, Figures] = {}
    pictures = {}
    firsts = []
    for prior in OWN:
        begun = time.perf_counter()
        photo = nl.reconstruct(shot, psf, prior=prior)
        seconds = time.perf_counter() - begun
        values, pictures[prior] = figures(photo.values, shot.expected)
        rows[prior] = {**values, "seconds": seconds}
        firsts.append(photo.values)
    path.parent.mkdir(parents=True, exist_ok=True)
    for number, (picture, seconds) in enumerate(
        zip(*by_peer(shot, psf, firsts[0], path.parent), strict=True)
    ):
        values, shown = figures(picture.clamp_min(0), shot.expected)
        if PEER not in rows or values["psnr_db"] > rows[PEER]["psnr_db"]:
            rows[PEER] = {**values, "seconds": seconds, "penalty": float(number)}
            pictures[PEER] = shown
    sheet = [
        SheetPicture(f"{name}, {row['psnr_db']:.2f} dB", pictures[name])
        for name, row in rows.items()
    ]
    sheet.append(SheetPicture("truth", shot.expected))
    white = float(shot.expected.max())
    write_contact_sheet(path.with_suffix(".png"), pictures=sheet, white=white)
    written(path, lambda part: part.write_text(json.dumps(rows)))
    return rows


def section(measured: dict[Case, dict[str, Figures]]) -> str:
    """Markdown of all that was measured."""
    rows, columns = PIXELS
    lines = [
        f"Made by `python bench/priors_peer.py` on {describe()['cpu']}: {len(measured)} cases of",
        f"the table above (the middle {rows}×{columns} pixels of the paper's sensor, scenes of",
        f"{ANGLE}, one PSF), each another photograph. *scico* is its plug-and-play (0.0.7) with",
        "the DnCNN of 17 layers whose weights come with it, posed as in its example of a",
        "deconvolution: 12 iterations from the photograph by colour-tv, whose seconds are not in",
        "its own, the support that nolens has, one colour after the other. It has no penalty for",
        "this problem: for each case the better of two by the truth is taken. The two others are",
        "as they come. PSNR in dB; seconds of one run.",
        "",
        "| photograph | mask | exposure | colour-tv | scico | denoiser | seconds |",
        "|---|---|---|---|---|---|---|",
    ]
    names = (OWN[0], PEER, OWN[1])
    for case, of_case in measured.items():
        cells = [case.photograph.name, case.mask, f"{case.exposure:.0%}"]
        cells += [f"{of_case[name]['psnr_db']:.2f}" for name in names]
        cells.append(", ".join(f"{of_case[name]['seconds']:.0f}" for name in names))
        lines.append("| " + " | ".join(cells) + " |")
    means = [statistics.mean(each[name]["psnr_db"] for each in measured.values()) for name in names]
    lines.append("| mean | | | " + " | ".join(f"{each:.2f}" for each in means) + " | |")
    return "\n".join(lines)


def main() -> None:
    """Measure what is missing, and write the section."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/priors"))
    parser.add_argument("--photographs", type=Path, default=Path("build/photographs"))
    parser.add_argument("--page", type=Path, default=Path("docs/priors.md"))
    parser.add_argument("--cases", type=int, default=CASES)
    parser.add_argument("--fetch", action="store_true", help="download photographs by apt-get")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    if asked.fetch:
        fetch(asked.photographs)
    measured: dict[Case, dict[str, Figures]] = {}
    for case in cases()[: asked.cases]:
        measured[case] = measure(asked.folder, asked.photographs, case)
        texts = [f"{name} {row['psnr_db']:.2f} dB" for name, row in measured[case].items()]
        print(case.name, ", ".join(texts), flush=True)
        write_part(asked.page, "bench/priors_peer.py", section(measured))


if __name__ == "__main__":
    main()
