"""Fig. 7: photographs of a screen and of scenes at other distances."""

import time
from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import develop
from nolens.evaluate import psnr, scale_fit, ssim
from nolens.experiments.virtual_experiment import SimulatedMeasurement, solved
from nolens.operators import Region
from nolens.reproduction.steps import Found, Step, Tick, within
from nolens.reproduction.workbench import SCREEN_UM, TAU, Workbench
from nolens.solvers import Problem, Progress, Reconstructor
from nolens.twin import FieldMap, Plane

PAPERS_TAU = 1e-4
PAPERS_PENALTIES = (1e-6, 1e-5, 4e-5)
"""Fixed penalties such as published ADMM codes for such cameras use; the paper tunes by hand."""
_SHOWN_ROWS = 400


@dataclass(frozen=True)
class Scene:
    """A photograph that stands for a scene of the paper.

    Parameters
    ----------
    name
        Of the paper's figure.
    picture
        Of scikit-image.
    angle_deg
        That its longer side fills.
    distance_um
        From the camera.
    """

    name: str
    picture: str
    angle_deg: float
    distance_um: float


SCENES = (
    Scene("7a", "astronaut", 60.0, SCREEN_UM),
    Scene("7b", "coffee", 50.0, SCREEN_UM),
    Scene("7c", "chelsea", 30.0, SCREEN_UM),
    Scene("7d", "coins", 40.0, 100e3),
    Scene("7e", "camera", 40.0, 500e3),
    Scene("7f", "rocket", 40.0, 600e3),
)
"""The paper gives angles for the screen only; its own pictures are not to be had."""
SOLVED_AS_PAPER = "7a"


def steps(work: Workbench) -> tuple[Step, ...]:
    """A step for every scene."""
    return tuple(_step(work, scene) for scene in SCENES)


def _step(work: Workbench, scene: Scene) -> Step:
    planes = _planes(work, scene)
    region = FieldMap.covering(work.preview, planes[0].tangents).region
    seconds = work.scene_seconds() + work.solve_seconds(region, work.size.iterations)
    if scene.name == SOLVED_AS_PAPER:
        seconds += work.solve_seconds(None, work.size.papers_iterations)
    distance = f"{scene.distance_um * 1e-4:g} cm"
    return Step(
        f"scene-{scene.name}",
        f"fig. {scene.name}: a scene of {scene.angle_deg:g}° at {distance}",
        work.parameters(scene=scene.__dict__, tau=TAU),
        seconds,
        lambda tick: _photograph(work, scene, tick),
    )


def _planes(work: Workbench, scene: Scene) -> tuple[Plane, ...]:
    return (Plane(work.picture(scene.picture), scene.angle_deg, scene.distance_um),)


def _photograph(work: Workbench, scene: Scene, tick: Tick) -> Found:
    """Measure a scene, and solve for it with a PSF that was taken at its distance."""
    solved_share = 0.3 if scene.name == SOLVED_AS_PAPER else 0.5
    shot = work.bench.photograph(_planes(work, scene), seed=work.seed, tick=within(tick, 0.0, 0.5))
    seen = shot.truth * shot.response
    psf = work.wide_psf(scene.distance_um, shot.region)
    begun = time.perf_counter()
    picture = solved(
        shot.frame,
        psf,
        shot.region,
        iterations=work.size.iterations,
        tau=TAU,
        tick=within(tick, 0.5, solved_share),
    )
    seconds = {"photograph": time.perf_counter() - begun}
    figures: dict[str, Any] = {
        "region": [shot.region.height, shot.region.width],
        "exposure_cd_s_m2": shot.exposure_cd_s_m2,
        "contrast": _contrast(shot),
        **_quality(picture, seen),
    }
    arrays = {"picture": scale_fit(picture, seen), "truth": seen, "measurement": _small(shot)}
    if scene.name == SOLVED_AS_PAPER:
        papers = _as_the_paper(work, shot, within(tick, 0.8, 0.2))
        figures |= {f"papers_{name}": value for name, value in _quality(papers, seen).items()}
        arrays["papers"] = scale_fit(papers, seen)
    return Found(figures, arrays, seconds)


def _as_the_paper(work: Workbench, shot: SimulatedMeasurement, tick: Tick) -> Tensor:
    """The same frame with a captured PSF of the sensor's size, no region and fixed penalties."""
    limit = work.size.papers_iterations
    captured = develop(work.bench.point(work.source, seed=work.seed + 1))
    seen = develop(shot.frame)
    reconstructor = Reconstructor(
        captured.values.clamp_min(0), tau=PAPERS_TAU, penalties=PAPERS_PENALTIES, balance=None
    ).for_iterations(limit)
    problem = reconstructor.problem(seen)

    def advance(progress: Progress) -> None:
        tick(progress.iteration / limit)

    result = reconstructor.solve(problem, callback=advance)
    return _cut(result.scene, problem, shot.region)


def _cut(scene: Tensor, problem: Problem, region: Region) -> Tensor:
    """The cells of a region of a scene that was solved for on others, zero where it was not."""
    origin = problem.forward.geometry.origin
    top, left = region.top - origin[0], region.left - origin[1]
    rows, columns = scene.shape[-2:]
    beyond = (-left, left + region.width - columns, -top, top + region.height - rows)
    return nnf.pad(scene, beyond)


def _quality(picture: Tensor, truth: Tensor) -> dict[str, float]:
    """PSNR and SSIM after one factor; the peak is the truth's."""
    fitted, peak = scale_fit(picture, truth), float(truth.max())
    return {"psnr_db": psnr(fitted, truth, peak), "ssim": ssim(fitted, truth, peak)}


def _contrast(shot: SimulatedMeasurement) -> float:
    """Standard deviation of the measurement over its mean, the mean of all colours."""
    values = develop(shot.frame).values.double()
    spread = values.std(dim=(-2, -1)) / values.mean(dim=(-2, -1))
    return float(spread.mean())


def _small(shot: SimulatedMeasurement) -> Tensor:
    """The measurement, small enough to be shown."""
    values = develop(shot.frame).values
    rows, columns = values.shape[-2:]
    height = min(rows, _SHOWN_ROWS)
    size = (height, round(columns * height / rows))
    return torch.clone(nnf.interpolate(values[None], size=size, mode="area")[0])
