"""Penalties that a frame of a stream starts from: the table of `docs/decisions/0007`.

`.venv/bin/python bench/streams.py --data ../shared/data` prints the PSNR in dB (after one factor,
mean of the last frames) of a photograph that stands still, or moves by some pixels from frame to
frame, each frame reconstructed with a few iterations from where the one before it ended. The
cameras are the studio's simulated one, a mask wider than its sensor, and DiffuserCam's PSF.
Counts iterations, not seconds; some minutes. The last row of each table is by the trained prior,
with so many turns of its network in place of iterations. `--trained` prints that and the program's
own alone.
"""

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import torch
from skimage import data as photographs
from torch import Tensor

from cases import hand
from nolens.capture import TwinSource
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_camera
from nolens.files.weights import denoiser
from nolens.solvers import Problem, Reconstructor, Stream, stream
from nolens.solvers.trained_stream import TrainedStream
from photographed import GREEN_ALONE, linear_light, mask_psf, shot

FRAMES, JUDGED = 12, 4
SPEEDS = (0, 2, 10)
ITERATIONS = (1, 2, 4, 8)
OWN = "the program's own"
WARM: dict[str, tuple[float, ...] | None] = {
    OWN: None,
    **{
        ", ".join(f"{each:g}" for each in warm): warm
        for warm in (
            (0.02, 2.0, 1.0), (0.1, 3.0, 1.0), (0.3, 3.0, 1.0), (1.0, 3.0, 1.0), (1.0, 5.0, 2.0),
            (0.3, 10.0, 3.0), (1.0, 10.0, 3.0), (1.0, 20.0, 5.0), (3.0, 30.0, 10.0),
        )
    },
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A camera, and what it looks at."""

    name: str
    psf: Tensor
    sensor: tuple[int, int]
    side: int
    tau: float


def cases(folder: Path) -> Iterator[Case]:
    """All of them."""
    live = TwinSource(read_camera("live"), seed=0).psf()[1:2]
    yield Case("the studio's camera", live, (live.shape[-2], live.shape[-1]), 220, 1e-4)
    sensor = (380, 507)
    wide = mask_psf((sensor[0] + 200, sensor[1] + 200), GREEN_ALONE)
    yield Case("mask wider than the sensor", wide, sensor, 200, 1e-5)
    if folder.is_dir():
        psf = torch.from_numpy(hand(folder, 4)[0]).float()
        yield Case("DiffuserCam", psf, (psf.shape[-2], psf.shape[-1]), 150, 1e-4)


def frames(case: Case, speed: int) -> tuple[list[Problem], list[Tensor]]:
    """Measurements and truths of a photograph that moves."""
    large = linear_light(photographs.astronaut(), case.side + FRAMES * max(SPEEDS), channels=1)
    problems, truths = [], []
    for number in range(FRAMES):
        start = number * speed
        truth = large[:, 40 : 40 + case.side, start : start + case.side].contiguous()
        seen = shot(truth, case.psf, case.sensor)
        if problems:
            problems.append(problems[0].measuring(seen.data))
        else:
            problems.append(Problem.build(seen.psf, seen.data, support=seen.support, tau=case.tau))
        truths.append(truth)
    return problems, truths


def quality(
    problems: list[Problem],
    truths: list[Tensor],
    warm: tuple[float, ...] | None,
    follower: Stream | TrainedStream,
) -> float:
    """Mean PSNR of the last frames."""
    with ExitStack() as changed:
        for name in () if warm is None else ("_WARM", "_WARM_FEW", "_WARM_SPILLING"):
            changed.enter_context(mock.patch.object(stream, name, warm))
        found = [
            psnr(scale_fit(scene, truth), truth, float(truth.max()))
            for problem, truth in zip(problems, truths, strict=True)
            for scene in (follower.solve(problem.data * problem.scale).scene,)
        ]
    return sum(found[-JUDGED:]) / JUDGED


def main() -> None:
    """Print a table for each camera."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--trained", action="store_true", help="no other penalties")
    asked = parser.parse_args()
    folder, network = asked.data / "diffusercam-hand", denoiser()
    columns = [(speed, iterations) for speed in SPEEDS for iterations in ITERATIONS]
    for case in cases(folder):
        print(f"\n**{case.name}**\n")
        heads = " | ".join(f"{speed} / {count}" for speed, count in columns)
        print(f"| pixels a frame / iterations | {heads} |")
        print("|---|" + "---|" * len(columns))
        shown = {speed: frames(case, speed) for speed in SPEEDS}
        for label, warm in list(WARM.items())[: 1 if asked.trained else None]:
            row = [
                f"{quality(*shown[speed], warm, Stream(shown[speed][0][0], iterations=count)):.1f}"
                for speed, count in columns
            ]
            print(f"| {label} | {' | '.join(row)} |", flush=True)
        row = []
        for speed, count in columns:
            problem = shown[speed][0][0]
            solver = Reconstructor(case.psf, problem.forward.support, case.tau, network)
            followed = quality(*shown[speed], None, solver.stream(problem, iterations=count))
            row.append(f"{followed:.1f}")
        print(f"| denoiser | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
