"""When a photo is done, and what the low-frequency correction is worth: `docs/decisions/0007`.

`.venv/bin/python bench/engine.py --data ../shared/data` prints PSNR in dB after one scale factor.
Photographs as the paper's camera takes them (`nolens.twin`, PSFs that vary over the field; green),
the same without that error of the model, and full views of `penalties.py`. Counts iterations, not
seconds; about a quarter of an hour.
"""

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import torch
from skimage import data as photographs
from torch import Tensor

from cases import hand
from nolens.camera import develop
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_camera
from nolens.operators import PixelRectangle
from nolens.reproduction.photographs import SCENES
from nolens.reproduction.setup import FULL, ExperimentSetup
from nolens.solvers import Problem, admm
from nolens.twin import Plane
from penalties import full_view
from photo import QUICK, photo, quick
from photographed import linear_light, shot

LONG = 400
MARKS = (16, 24, 32, 40)
GREEN = slice(1, 2)
PICTURES = 4
TAU = 1e-5
SIDE = 400
VIEWS = ((200, 1e-5, "astronaut"), (200, 1e-4, "coffee"), (380, 1e-5, "astronaut"))

Case = tuple[str, Problem, Tensor | None]


def taken() -> Iterator[Case]:
    """Photographs of the paper's camera, and one through its PSF alone."""
    setup = ExperimentSetup(read_camera("paper"), FULL, 0)
    for number, scene in enumerate(SCENES[:PICTURES]):
        plane = Plane(setup.picture(scene.picture), scene.angle_deg, scene.distance_um)
        photograph = setup.experiment.measure((plane,), seed=0)
        measured = develop(photograph.frame)
        psf = setup.wide_psf(scene.distance_um, photograph.support)[GREEN]
        problem = Problem.build(
            psf, measured.values[GREEN], valid=measured.valid[GREEN],
            support=photograph.support, tau=TAU,
        )  # fmt: skip
        yield f"twin, {scene.picture}", problem, (photograph.truth * photograph.response)[GREEN]
        if number == 0:
            sensor = (measured.values.shape[-2], measured.values.shape[-1])
            exact = shot(linear_light(photographs.astronaut(), SIDE, channels=1), psf, sensor)
            support = PixelRectangle.centred(SIDE, SIDE, sensor)
            posed = Problem.build(psf, exact.data, support=support, tau=TAU)
            yield "its PSF alone, astronaut", posed, exact.truth


def cases(folder: Path) -> Iterator[Case]:
    """All of them."""
    yield from taken()
    for side, tau, picture in (
        (200, 1e-5, "astronaut"),
        (200, 1e-4, "coffee"),
        (380, 1e-5, "astronaut"),
    ):
        problem, truth = full_view(side, tau, getattr(photographs, picture))
        yield f"full view, {side}×{side}, τ = {tau:g}", problem, truth
    if folder.is_dir():
        psf, frame = (torch.from_numpy(each).float() for each in hand(folder, 4))
        yield "hand, binned 4×4", Problem.build(psf, frame, tau=1e-4), None


def judge(truth: Tensor, scene: Tensor) -> float:
    """PSNR after one factor."""
    return psnr(scale_fit(scene, truth), truth, float(truth.max()))


def course(
    problem: Problem, seen: Callable[[Tensor], float], low_frequency: bool
) -> dict[int, float]:
    """PSNR of the iterate at the marks."""
    found: dict[int, float] = {}

    def look(progress: object) -> None:
        if progress.iteration in MARKS:  # type: ignore[attr-defined]
            found[progress.iteration] = seen(progress.scene())  # type: ignore[attr-defined]

    admm(problem, iterations=MARKS[-1], tolerance=0.0, low_frequency=low_frequency, callback=look)
    return found


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    folder = parser.parse_args().data / "diffusercam-hand"
    marks = " | ".join(str(mark) for mark in MARKS)
    print(
        f"| problem | photo: iterations | PSNR | objective | after {LONG} | objective "
        f"| ADMM: {marks} | corrected: {marks} | and in the end, {QUICK} iterations |"
    )
    print("|---|" + "---|" * (6 + 2 * len(MARKS)))
    for name, problem, truth in cases(folder):
        done, long = photo(problem), admm(problem, iterations=LONG, tolerance=0.0)
        row = [name, str(done.iterations)]
        if truth is None:
            row += ["–", f"{done.objective:.4g}", "–", f"{long.objective:.4g}"]
            row += ["–"] * (2 * len(MARKS) + 1)
        else:

            def seen(scene: Tensor, truth: Tensor = truth) -> float:
                return judge(truth, scene)

            for result in (done, long):
                row += [f"{seen(result.scene):.2f}", f"{result.objective:.4g}"]
            for low_frequency in (False, True):
                at = course(problem, seen, low_frequency)
                row += [f"{at[mark]:.2f}" for mark in MARKS]
            row.append(f"{seen(quick(problem).scene):.2f}")
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
