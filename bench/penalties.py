"""How ADMM's penalties do, on sparse and dense scenes: the table of `docs/decisions/0002`.

`.venv/bin/python bench/penalties.py --data ../shared/data` prints, for each rule and problem, the
objective's relative distance to the lowest that any rule saw, and the PSNR after one scale factor
where there is a truth. Counts iterations, not seconds.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import torch
from skimage import data as photographs
from torch import Tensor

from cases import hand
from nolens.evaluate import psnr, scale_fit
from nolens.solvers import Problem, Progress, admm
from nolens.solvers.admm_state import Balance
from photographed import GREEN_ALONE, linear_light, mask_psf, shot

SENSOR = (380, 507)
MARKS = (20, 40, 60, 100)
LONG = 600

RULES: dict[str, dict[str, object]] = {
    "constant (1e-6, 1e-5, 4e-5), α = 1": {
        "penalties": (1e-6, 1e-5, 4e-5),
        "balance": None,
        "relaxation": 1.0,
    },
    "constant (0.01, 1, 1)": {"penalties": (0.01, 1.0, 1.0), "balance": None},
    "constant (0.1, 10, 10)": {"penalties": (0.1, 10.0, 10.0), "balance": None},
    "constant (0.01, 10, 0.1)": {"penalties": (0.01, 10.0, 0.1), "balance": None},
    "growth alone": {"balance": Balance(rate=0.0)},
    "balance alone": {"balance": Balance(growth=1.0)},
    "faster growth, 1.75 a look": {"balance": Balance(growth=1.75)},
    "α = 1": {"relaxation": 1.0},
    "the program's own": {},
}


def full_view(side: int, tau: float, photograph: Callable[[], object]) -> tuple[Problem, Tensor]:
    """A photograph on side×side cells through a mask that is wider than the sensor."""
    psf = mask_psf((SENSOR[0] + side, SENSOR[1] + side), GREEN_ALONE)
    seen = shot(linear_light(photograph(), side, channels=1), psf, SENSOR)
    return Problem.build(seen.psf, seen.data, support=seen.support, tau=tau), seen.truth


def run(
    problem: Problem, truth: Tensor | None, rule: dict[str, object], iterations: int
) -> dict[int, tuple[float, float | None]]:
    """Objective and PSNR at the marks."""
    seen: dict[int, tuple[float, float | None]] = {}

    def look(progress: Progress) -> None:
        if progress.iteration in (*MARKS, iterations):
            scene = progress.scene()
            quality = None if truth is None else psnr(scale_fit(scene, truth), truth, 1.0)
            seen[progress.iteration] = problem.objective(scene), quality

    admm(problem, iterations=iterations, tolerance=0.0, callback=look, **rule)  # type: ignore[arg-type]
    return seen


def cell(value: tuple[float, float | None], best: float) -> str:
    """One entry of the table."""
    objective, quality = value
    picture = "" if quality is None else f" / {quality:.1f} dB"
    return f"{objective / best - 1:.3f}{picture}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    folder = parser.parse_args().data / "diffusercam-hand"
    problems: dict[str, tuple[Problem, Tensor | None]] = {
        "full view, 200×200, τ = 1e-5": full_view(200, 1e-5, photographs.astronaut),
        "full view, 200×200, τ = 1e-4": full_view(200, 1e-4, photographs.coffee),
        "full view, 380×380, τ = 1e-5": full_view(380, 1e-5, photographs.astronaut),
    }
    if folder.is_dir():
        psf, frame = (torch.from_numpy(each).float() for each in hand(folder, 4))
        for tau in (1e-3, 1e-4, 1e-5):
            problems[f"hand, τ = {tau:g}"] = Problem.build(psf, frame, tau=tau), None
    for name, (problem, truth) in problems.items():
        long = [run(problem, truth, RULES[rule], LONG) for rule in list(RULES)[1:3]]
        long.append(run(problem, truth, {}, LONG))
        results = {label: run(problem, truth, rule, MARKS[-1]) for label, rule in RULES.items()}
        best = min(
            objective for each in (*long, *results.values()) for objective, _ in each.values()
        )
        print(f"\n**{name}**: lowest seen {best:.4g}, after {LONG} iterations "
              f"{cell(long[-1][LONG], best)}\n")  # fmt: skip
        print("| rule | " + " | ".join(str(mark) for mark in MARKS) + " |")
        print("|---|" + "---|" * len(MARKS))
        for label, each in results.items():
            print(f"| {label} | " + " | ".join(cell(each[mark], best) for mark in MARKS) + " |")


if __name__ == "__main__":
    main()
