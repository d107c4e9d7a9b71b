"""What a stream shows after a cut of the scene: started from the Wiener filter, or from before.

Frames of the simulated camera `live`, two iterations each; the error is the relative distance from
the picture that the stream settles at.

    .venv/bin/python bench/cuts.py
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from nolens.camera import Measurement, develop
from nolens.capture import Levels, TwinSource, exposure_for, open_source
from nolens.operators import PixelRectangle
from nolens.solvers import Problem, Stream
from nolens.solvers.admm_state import AdmmState
from nolens.studio.pictures import show_scene

CUTS = (("chart", "astronaut"), ("astronaut", "camera"), ("point", "chart"), ("dark", "chart"))
SETTLED, BEFORE, SHOWN = 40, 10, (0, 1, 2, 4, 8, 14)
RESIDUAL = AdmmState.residual


def frames(camera: TwinSource, scene: str) -> Iterator[tuple[Measurement, float]]:
    """Measurements of a scene and their exposure times, once the exposure fits."""
    show_scene(camera, scene)
    for _ in range(6):
        shot = camera.shot()
        fitting = exposure_for(Levels.of(shot.frame), shot.exposure_s, camera.limits)
        camera.set(exposure_s=min(fitting, 0.25), gain=1.0)
    while True:
        shot = camera.shot()
        yield develop(shot.frame), shot.exposure_s


def pictures(
    camera: TwinSource, problem: Problem, scenes: dict[str, int]
) -> tuple[list[Tensor], float]:
    """Pictures of the last of some scenes, each so many frames long; the residual at its cut."""
    stream, found = Stream(problem, iterations=2), []
    residual = 0.0
    for scene, count in scenes.items():
        found = []
        for number, (seen, exposure_s) in zip(range(count), frames(camera, scene), strict=False):
            run = stream._run
            if number == 0 and run is not None:
                residual = RESIDUAL(run.state, problem.measuring(seen.values, seen.valid))
            found.append(stream.solve(seen.values, seen.valid).scene / exposure_s)
    return found, residual


def main() -> None:
    camera = open_source("twin:live")
    assert isinstance(camera, TwinSource)
    camera.open()
    seen, _ = next(frames(camera, "chart"))
    support: PixelRectangle = camera.support
    problem = Problem.build(camera.psf(), seen.values, valid=seen.valid, support=support)
    best = {
        scene: pictures(camera, problem, {scene: SETTLED})[0][-1]
        for scene in dict.fromkeys(after for _, after in CUTS)
    }
    print(f"{'cut':22}{'residual':>9} {'start':7}" + "".join(f"{n + 1:7}" for n in SHOWN))
    for before, after in CUTS:
        for start in ("before", "wiener"):
            AdmmState.residual = RESIDUAL if start == "wiener" else lambda state, problem: 0.0
            found, residual = pictures(camera, problem, {before: BEFORE, after: max(SHOWN) + 1})
            errors = [float((found[n] - best[after]).norm() / best[after].norm()) for n in SHOWN]
            print(
                f"{before + ' to ' + after:22}{residual:9.2f} {start:7}"
                + "".join(f"{each:7.2f}" for each in errors)
            )


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
