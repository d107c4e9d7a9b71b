"""`nolens train`: weights of a prior that knows pictures."""

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import PRESETS
from nolens.errors import DataError, FileError, OptionError
from nolens.files import InputFile, read_picture, write_state
from nolens.files.pictures import picture_files
from nolens.files.state import read_about, read_state
from nolens.files.weights import denoiser, read_weights, unrolled, weights_writers
from nolens.jobs.run import Product, Run, Writer, job
from nolens.jobs.training.camera import (
    SIMULATED,
    SIMULATED_BYTES,
    named_camera,
    random_cameras,
)
from nolens.jobs.training.card import rounded, weights_card
from nolens.jobs.training.options import TrainOptions
from nolens.jobs.training.pairs import Pairs, training_pairs
from nolens.solvers.denoising_network import DenoisingNetwork
from nolens.solvers.plug_and_play import PlugAndPlay, Refinement
from nolens.training.cameras import TrainingCamera
from nolens.training.course import Course, Lessons
from nolens.training.denoising import NoiseLessons, Schedule, Trainer, network_of
from nolens.training.patches import PicturePool
from nolens.training.unrolled import (
    RefinementLessons,
    lessons_bytes,
    lessons_count,
    refinement_for_others,
    refinement_network,
)
from nolens.training.validation import ALL, HeldOut, measured_pictures, noisy_pictures

SPREADS = tuple(0.3 * (2 / 15) ** (turn / 9) for turn in range(10))
"""Of a denoiser's turns (`PlugAndPlay`)."""
BATCHES = {"denoiser": (24, 64), "unrolled": (12, 96)}
"""Patches of a batch, and pixels along a side."""
_CHECKPOINT_S = 180.0
"""From one to the next."""
_SHIPPED: dict[str, Callable[[], PlugAndPlay]] = {"denoiser": denoiser, "unrolled": unrolled}


@job
def train(run: Run[TrainOptions]) -> Product[PlugAndPlay]:
    """Train a network, and give the prior that it makes.

    Raises
    ------
    NolensError
        If an option, a picture, the camera or the weights to start from cannot be used, or the
        training gives NaN or infinity.
    """
    options, reporter = run.options, run.reporter
    schedule = Schedule(
        options.steps, options.largest_rate, *BATCHES[options.prior], options.precision
    )
    learnt = _photograph_files(run, options.photographs, "photograph")
    unseen = _photograph_files(run, options.validation, "held-out photograph")
    _check_unseen(learnt, unseen)
    photographs, validation = (_photographs(run, each, schedule.side) for each in (learnt, unseen))
    first, start = _first(run)
    trainer = Trainer(first, schedule, options.seed, run.device)
    resumed = None if options.resume is None else _read_checkpoint(run, trainer)
    camera = named_camera(run)
    pairs = training_pairs(run, schedule.side)
    unrolled = options.prior == "unrolled"
    run.begin(_lessons_bytes(options) if unrolled else 0.0, "fewer --steps need less")
    about = _identity(run, start)
    if resumed is not None:
        _check_same(run.options, about, resumed[0])
    if unrolled:
        _say_parts(run)
    pool = PicturePool.generate(
        options.pictures, options.seed, photographs, partial(reporter.advance, "pictures")
    )
    lessons, held_out = _lessons(run, pool, camera, pairs, validation)
    course = Course(trainer, lessons, held_out, options.patience)
    if resumed is not None:
        _restore(run.options, course, resumed)
    lessons.begin(trainer, partial(reporter.advance, "measurements"))
    interrupted = _follow(run, course, about)
    # Before the check, which an uninterrupted run would not do here.
    checkpoint = _checkpoint(course, about) if interrupted else None
    course.check()
    if course.got_no_better and not interrupted and trainer.step < options.steps:
        reporter.note(f"{options.patience} checks brought no better weights: the training ends")
    if course.best_step == 0:
        run.warn(
            f"no check was better than the {course.scores_start[ALL]:.2f} dB of the weights that "
            f"it began with, so {options.output} holds these: give more --steps, more --pictures "
            "or a smaller --rate"
        )
    prior = _prior(options, course.best)
    before = held_out.scores_before()
    writers = weights_writers(options.output, prior, weights_card(options, course, start, before))
    if checkpoint is not None:
        writers[options.state] = checkpoint
    figures = {
        "prior": options.prior,
        "steps": trainer.step,
        "steps_planned": options.steps,
        "stop_reason": _reason(course, interrupted),
        "validation_db": round(course.scores[ALL], 3),
        "validation_start_db": round(course.scores_start[ALL], 3),
        "validation_before_db": round(before[ALL], 3),
        "scores_db": rounded(course.scores),
        "spreads": list(prior.spreads),
        "start": start,
    }
    return Product(
        prior,
        figures,
        writers,
        history=course.history,
        spent=() if interrupted else (options.state,),
    )


def _lessons_bytes(options: TrainOptions) -> float:
    """That a training on measurements holds at once."""
    return lessons_bytes(options.steps) + (SIMULATED_BYTES if options.camera is None else 0)


def _say_parts(run: Run[TrainOptions]) -> None:
    """Say what comes before a network learns by measurements."""
    options = run.options
    cameras = f"{SIMULATED} cameras are simulated and " if options.camera is None else ""
    run.reporter.note(
        f"first {cameras}{lessons_count(options.steps)} scenes are measured and reconstructed, "
        f"then the network learns for {options.steps} steps; each part says how long it takes"
    )


def _photograph_files(run: Run[TrainOptions], folder: Path | None, role: str) -> list[Path]:
    """Photographs of a folder, which are read."""
    if folder is None:
        return []
    if not folder.is_dir():
        raise FileError(f"{folder} is no folder: give one with photographs")
    paths = picture_files(folder, below=True)
    run.reads({f"{role} {each.relative_to(folder)}": each for each in paths})
    return paths


def _check_unseen(learnt: list[Path], unseen: list[Path]) -> None:
    """Refuse a photograph to hold out that is trained on, under whatever name."""
    if not unseen:
        return
    known = {InputFile.of(each).sha256: each for each in learnt}
    for path in unseen:
        same = known.get(InputFile.of(path).sha256)
        if same is not None:
            raise OptionError(
                f"{path} of --validation is the same picture as {same} of --photographs, and what "
                "is held out must not be trained on: leave it out of one of the two folders"
            )


def _photographs(run: Run[TrainOptions], paths: list[Path], side: int) -> list[Tensor]:
    """Photographs in linear light, (3, height, width) each."""
    photographs = []
    for number, path in enumerate(paths):
        radiance = read_picture(path).radiance
        height, width = radiance.shape[1:]
        if min(height, width) < side:
            raise DataError(
                f"{path} has {height}×{width} pixels, and patches of {side}×{side} are cut from "
                "photographs: leave it out"
            )
        photographs.append(radiance)
        run.reporter.advance("photographs", (number + 1) / len(paths))
    return photographs


def _first(run: Run[TrainOptions]) -> tuple[DenoisingNetwork, dict[str, Any]]:
    """The network to start from, and what a card says of it."""
    options = run.options
    first, refines = options.first, options.prior == "unrolled"
    if first == "none":
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(options.seed)
            network = DenoisingNetwork()
        return (refinement_network(network) if refines else network), {"weights": "none"}
    if isinstance(first, Path):
        run.reads({"weights to start from": first})
        before, name = read_weights(first), first.name
    else:
        before, name = _shipped(first), first
    facts = {"weights": name, "sha256": before.facts["weights_sha256"]}
    if isinstance(before.refinement, Refinement):
        _check_kind(options, "unrolled")
        return _copy(before.refinement.network), facts
    if facts["sha256"] != denoiser().facts["weights_sha256"]:
        _check_kind(options, "denoiser")
    return (refinement_network(before.network) if refines else _copy(before.network)), facts


def _check_kind(options: TrainOptions, kind: str) -> None:
    """Refuse weights of another kind to start from."""
    if kind != options.prior:
        raise OptionError(
            f"--start {options.start} holds weights of --prior {kind}, and --prior "
            f"{options.prior} is trained: give weights of that (an unrolled prior mends what the "
            "denoiser that comes with nolens leaves, no other), or leave --start out"
        )


def _shipped(name: str) -> PlugAndPlay:
    try:
        return _SHIPPED[name]()
    except FileError:
        raise FileError(
            f"the weights {name}, which training starts from, did not come with this nolens: "
            "give others (--start FILE.npz), or begin with none (--start none)"
        ) from None


def _copy(network: DenoisingNetwork) -> DenoisingNetwork:
    return network_of(network.state_dict(), like=network)


def _prior(options: TrainOptions, network: DenoisingNetwork) -> PlugAndPlay:
    """The prior that a trained network makes."""
    if options.prior == "denoiser":
        return PlugAndPlay(network, SPREADS, {"prior": options.prior})
    turns = denoiser()
    facts = {"prior": options.prior, "refines": turns.facts["weights_sha256"]}
    return replace(turns, facts=facts, refinement=_refinement(options)(network))


def _refinement(options: TrainOptions) -> Callable[[DenoisingNetwork], Refinement]:
    """What makes a refinement of a network; with limits where it learns on random cameras."""
    return refinement_for_others if options.camera is None else Refinement


def _lessons(
    run: Run[TrainOptions],
    pool: PicturePool,
    camera: TrainingCamera | None,
    pairs: Pairs,
    validation: list[Tensor],
) -> tuple[Lessons, HeldOut]:
    """What is learnt from, and what tells how much was learnt."""
    if run.options.prior == "denoiser":
        return NoiseLessons(pool), noisy_pictures(validation)
    turns, camera = denoiser(), camera or random_cameras(run)
    watch = partial(run.reporter.advance, "measurements held out")
    refinement = _refinement(run.options)
    held_out = measured_pictures(turns, camera, validation, pairs.held_out, watch, refinement)
    return RefinementLessons(pool, turns, camera, pairs.learnt), held_out


def _follow(run: Run[TrainOptions], course: Course, about: dict[str, Any]) -> bool:
    """Do step after step; whether the person ended it before its end."""
    options, stored = run.options, time.monotonic()
    while not course.ended:
        course.advance()
        state = f"{course.history[-1]['validation_db']:.2f} dB" if course.history else ""
        if run.reporter.step("step", course.trainer.step, options.steps, "the weights", state):
            return not course.ended
        if time.monotonic() - stored > _CHECKPOINT_S:
            _checkpoint(course, about)(options.state)
            stored = time.monotonic()
    return False


def _reason(course: Course, interrupted: bool) -> str:
    if interrupted:
        return "interrupted"
    return "no better" if course.got_no_better else "all steps"


def _identity(run: Run[TrainOptions], start: dict[str, Any]) -> dict[str, Any]:
    """What a run must have in common with one that goes on with its checkpoint."""
    options = run.options
    files = {role: file.sha256 for role, file in run.inputs.items()}
    return {
        **files,
        "prior": options.prior,
        "start": start.get("sha256", "none"),
        "steps": options.steps,
        "rate": options.largest_rate,
        "precision": options.precision,
        "seed": options.seed,
        "pictures": options.pictures,
        "patience": options.patience,
        "camera": options.camera if options.camera in PRESETS else options.camera is not None,
        "distance": None if options.distance is None else str(options.distance),
        "angle": str(options.angle),
    }


def _checkpoint(course: Course, about: dict[str, Any]) -> Writer:
    """What writes where a course stands, before its next step."""
    return partial(
        write_state, arrays=course.arrays(), about={"run": about, "course": course.figures()}
    )


def _read_checkpoint(
    run: Run[TrainOptions], trainer: Trainer
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Tensor]]:
    """What run a checkpoint is of, the figures of its course, and its tensors."""
    path = run.options.resume
    assert path is not None
    about = read_about(path)
    of_run, figures = about.get("run"), about.get("course")
    if not isinstance(of_run, dict) or not isinstance(figures, dict):
        raise FileError(
            f"{path} is no checkpoint of a training. Accepted is a .state.npz that nolens train "
            "wrote"
        )
    # The best network so far has the shapes of the one in training.
    like = trainer.like_arrays()
    like |= {
        name.replace("network.", "best.", 1): each
        for name, each in like.items()
        if name.startswith("network.")
    }
    arrays = read_state(path, like, lambda _: None)
    wrong = [
        name
        for name, each in like.items()
        if name not in arrays
        or arrays[name].shape != each.shape
        or not bool(torch.isfinite(arrays[name]).all())
    ]
    if wrong:
        raise FileError(
            f"{path} is no checkpoint of this training: its array {wrong[0]} is missing, has "
            "another shape, or holds NaN or infinity"
        )
    return of_run, figures, arrays


def _check_same(options: TrainOptions, about: Mapping[str, Any], before: Mapping[str, Any]) -> None:
    """Refuse a checkpoint of another run."""
    here = json.loads(json.dumps(about))
    names = sorted(name for name in {*here, *before} if here.get(name) != before.get(name))
    if names:
        known = [name for name in names if name in here] or ["file"]
        raise OptionError(
            f"{options.resume} is the checkpoint of a training with another "
            f"{' and '.join(known)}; give the same files and options again, or leave out --resume"
        )


def _restore(
    options: TrainOptions,
    course: Course,
    resumed: tuple[dict[str, Any], dict[str, Any], dict[str, Tensor]],
) -> None:
    _, figures, arrays = resumed
    try:
        course.restore(arrays, figures)
    # Of an edited checkpoint, anything.
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise FileError(
            f"{options.resume} is no checkpoint of this training: it is damaged or was edited"
        ) from error
