"""Trained priors against total variation that is retuned by the truth, on the simulated camera.

`make bench-priors` (`python bench/priors.py --fetch`) takes photographs that no prior was trained
on with three masks at three exposures, reconstructs them by every prior, and compares with total
variation whose weight and kind are the best for the truth. It writes the tables of `docs/priors.md`
and the pictures in `docs/priors`. `--fetch` downloads photographs in packages of Debian (170 MB);
without it nothing is downloaded.

Measurements, PSFs and what was measured are kept in `--folder`, so that it can be interrupted and
continued, and another prior can be measured later. Cases are in an order whose beginnings are
balanced: `--cases 40` measures the first 40. `--unseen` adds masks that no prior was trained with,
`--charts` a Siemens star, two points and text, which show detail that is invented. `--again`
replaces what was measured of the named priors.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import nolens as nl
from nolens.api.simulate import Psf, SimulatedMeasurement
from nolens.errors import OptionError
from priors_cases import (
    FACTOR,
    KINDS,
    STEPS,
    TRAINED,
    Case,
    Figures,
    better,
    cases,
    figures,
    psf_for,
    simulated,
    unseen_cases,
    written,
)
from priors_charts import chart_rows
from priors_page import Measured, Page
from priors_photographs import fetch


def measured(
    shot: SimulatedMeasurement, psf: Psf, prior: str
) -> tuple[dict[str, Figures], dict[str, Tensor]]:
    """Figures and pictures by weight: that of the program, ``auto``, and for TV a grid around it.

    The grid goes on by factors of two, to both sides, until PSNR is worse in linear light and as
    shown.
    """
    rows: dict[str, Figures] = {}
    pictures: dict[str, Tensor] = {}

    def solved(name: str, tau: float | None) -> Figures:
        begun = time.perf_counter()
        photo = nl.reconstruct(shot, psf, prior=prior, tau=tau)
        seconds = time.perf_counter() - begun
        found, pictures[name] = figures(photo.values, shot.expected)
        rows[name] = {**found, "tau": photo.tau, "seconds": seconds}
        return rows[name]

    first = solved("auto", None)
    if prior in KINDS:
        for factor in (FACTOR, 1 / FACTOR):
            last = first
            for step in range(1, STEPS + 1):
                weight = factor**step
                row = solved(f"{weight:g}", first["tau"] * weight)
                if not any(better(name, row, last) for name in ("psnr_db", "shown_psnr_db")):
                    break
                last = row
    return rows, pictures


def refused(prior: str) -> str | None:
    """Why nolens does not take a prior of this name; None where it does."""
    light = torch.rand(3, 64, 64)
    point = torch.zeros(3, 64, 64)
    point[:, 32, 32] = 1.0
    try:
        nl.reconstruct(light, point, prior=prior, tau=1e-5, iterations=1, support="full")
    except OptionError as error:
        return str(error)
    return None


def measure(folder: Path, case: Case, priors: list[str], asked: argparse.Namespace) -> None:
    """Measure what is missing of a case."""
    rows = folder / "rows" / case.name
    missing = [each for each in priors if not (rows / f"{Path(each).stem}.json").exists()]
    again = [each for each in priors if asked.again and each not in KINDS]
    for prior in dict.fromkeys((*missing, *again)):
        shot = simulated(
            folder / "shots" / f"{case.name}.npz",
            case.mask,
            lambda: case.photograph.radiance(asked.photographs),
            case.exposure,
        )
        found, pictures = measured(shot, psf_for(folder, case.mask, shot), prior)
        if case.photograph.shown:
            best = max(found, key=lambda name: found[name]["psnr_db"])
            picture = pictures[best].half().numpy()
            path = rows / f"{Path(prior).stem}.npz"
            written(path, lambda part, each=picture: np.savez_compressed(part, picture=each))
        text = json.dumps(found)
        written(rows / f"{Path(prior).stem}.json", lambda part, each=text: part.write_text(each))
        best_db = max(each["psnr_db"] for each in found.values())
        seconds = sum(each["seconds"] for each in found.values())
        print(
            f"{case.name} {prior} {found['auto']['psnr_db']:.2f} dB, best {best_db:.2f} dB, "
            f"{len(found)} weights, {seconds:.0f} s",
            flush=True,
        )


def kept(folder: Path, wanted: list[Case], priors: list[str]) -> list[Measured]:
    """What was measured of all these priors."""
    found: list[Measured] = []
    for case in wanted:
        paths = {
            Path(prior).stem: folder / "rows" / case.name / f"{Path(prior).stem}.json"
            for prior in priors
        }
        if all(path.exists() for path in paths.values()):
            rows = {prior: json.loads(path.read_text()) for prior, path in paths.items()}
            found.append(Measured(case, rows))
    return found


def main() -> None:
    """Measure what is missing, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, default=Path("build/priors"))
    parser.add_argument("--photographs", type=Path, default=Path("build/photographs"))
    parser.add_argument("--page", type=Path, default=Path("docs/priors.md"))
    parser.add_argument("--pictures", type=Path, default=Path("docs/priors"))
    parser.add_argument("--priors", nargs="+", default=[*KINDS, *TRAINED])
    parser.add_argument("--cases", type=int, help="how many of them, from the first on")
    parser.add_argument("--unseen", action="store_true", help="then masks of no training, too")
    parser.add_argument("--charts", action="store_true", help="then Siemens star, points, text")
    parser.add_argument("--fetch", action="store_true", help="download photographs by apt-get")
    parser.add_argument("--again", action="store_true", help="measure trained priors again")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    if asked.fetch:
        fetch(asked.photographs)
    priors = []
    for prior in asked.priors:
        reason = None if prior in KINDS else refused(prior)
        if reason is None:
            priors.append(prior)
        else:
            print(f"{prior} is left out: {reason}", flush=True)
    for case in [*cases()[: asked.cases], *(unseen_cases()[: asked.cases] if asked.unseen else ())]:
        measure(asked.folder, case, priors, asked)
    compared = [*KINDS, *(each for each in priors if each not in KINDS)]
    page = Page(
        asked.folder,
        tuple(Path(each).stem for each in compared if each not in KINDS),
        kept(asked.folder, cases(), compared),
        kept(asked.folder, unseen_cases(), compared),
        chart_rows(asked.folder, compared, measure=asked.charts, again=asked.again),
    )
    page.write(asked.page, asked.pictures)


if __name__ == "__main__":
    main()
