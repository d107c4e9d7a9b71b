"""When a photo is done, and the measurement in the linear step: `docs/decisions/0017`.

`.venv/bin/python bench/engine.py --data ../shared/data` prints PSNR in dB after one scale factor.
Photographs as the paper's camera takes them (`nolens.twin`, PSFs that vary over the field; green),
the same without that error of the model, and full views of `penalties.py`. A quarter of an hour.
"""

import argparse
import time
from collections.abc import Iterator
from functools import partial
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
from photo import photo
from photographed import linear_light, shot

LONG = 400
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
    for side, tau, picture in VIEWS:
        problem, truth = full_view(side, tau, getattr(photographs, picture))
        yield f"full view, {side}×{side}, τ = {tau:g}", problem, truth
    if folder.is_dir():
        psf, frame = (torch.from_numpy(each).float() for each in hand(folder, 4))
        yield "hand, binned 4×4", Problem.build(psf, frame, tau=1e-4), None


def judge(truth: Tensor, scene: Tensor) -> float:
    """PSNR after one factor."""
    return psnr(scale_fit(scene, truth), truth, float(truth.max()))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    folder = parser.parse_args().data / "diffusercam-hand"
    ways = ("data step", "paper's splitting", f"the same, {LONG} iterations")
    titles = [f"{way}: iterations | PSNR | objective | CPU s" for way in ways]
    print(f"| problem | {' | '.join(titles)} |")
    print("|---|" + "---|" * (4 * len(ways)))
    for name, problem, truth in cases(folder):
        row = [name]
        runs = (
            partial(photo, problem),
            partial(photo, problem, low_frequency=False),
            partial(admm, problem, iterations=LONG, tolerance=0.0),
        )
        for run in runs:
            begun = time.process_time()
            done = run()
            used = time.process_time() - begun
            quality = "–" if truth is None else f"{judge(truth, done.scene):.2f}"
            row += [str(done.iterations), quality, f"{done.objective:.4g}", f"{used:.1f}"]
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
