"""Trains the ridge regulariser that comes with nolens, from nothing; `make weights` calls it.

It goes on from `--folder`/ridge.state.pt where that is, and writes ridge.npz and its card there. A
step is a batch of 8 patches of 40×40 pixels; 4000 of them take about half an hour on one core.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import time
from pathlib import Path

import numpy as np
import torch
from skimage.restoration import denoise_tv_chambolle
from torch import Tensor

from nolens.evaluate import psnr
from nolens.jobs.training.card import GENERATED, commit
from nolens.solvers.ridge import RidgeRegulariser, RidgeWeights
from nolens.training.patches import PicturePool, photograph_patch
from nolens.training.pictures import training_picture
from nolens.training.ridge import RidgeSchedule, RidgeTrainer
from nolens.training.validation import MOST_GENERATED

PICTURES, SEED = 700, 0
EVERY = 100
"""Steps from one checkpoint to the next."""
SIGMA, SIDE, EACH = 25 / 255, 160, 4
"""Noise, pixels and number of the pictures that a score is of."""
TV_WEIGHTS = (0.05, 0.07, 0.1, 0.14)
NOT_FOR = (
    "measuring: brightness and fine detail are those that pictures usually have (compare with "
    "--prior tv)"
)


def photographs(folder: Path) -> list[Tensor]:
    """Those of a folder, (3, height, width) each."""
    return [
        torch.from_numpy(np.load(path)).permute(2, 0, 1).contiguous()
        for path in sorted(folder.glob("*.npy"))
    ]


def scores(weights: RidgeWeights, held_out: list[Tensor]) -> dict[str, dict[str, float]]:
    """Mean PSNR in dB of pictures that are not trained on, of their noise taken out."""
    random = np.random.Generator(np.random.Philox(SEED))
    kinds = {
        "generated": [training_picture(SIDE, SIDE, MOST_GENERATED + k) for k in range(EACH)],
        "photographs": [photograph_patch(random, each, SIDE) for each in held_out],
    }
    ridge = RidgeRegulariser(weights, SIGMA, iterations=200)
    rows = {}
    for kind, pictures in kinds.items():
        found = []
        for clean in pictures:
            noise = random.standard_normal(tuple(clean.shape), np.float32)
            noisy = clean + SIGMA * torch.from_numpy(noise)
            tv = max(
                psnr(torch.from_numpy(by_tv(noisy.numpy(), weight)), clean, 1.0)
                for weight in TV_WEIGHTS
            )
            denoised = ridge.prox(noisy, 1.0)
            found.append((psnr(noisy, clean, 1.0), tv, psnr(denoised, clean, 1.0)))
        noisy_db, tv_db, ridge_db = np.mean(found, axis=0).round(2).tolist()
        rows[kind] = {"noisy": noisy_db, "tv_chambolle": tv_db, "ridge": ridge_db}
    return rows


def by_tv(noisy: np.ndarray, weight: float) -> np.ndarray:
    """A picture by total variation, by scikit-image."""
    result = denoise_tv_chambolle(noisy, weight, channel_axis=0, max_num_iter=400)
    return np.asarray(result, np.float32)


def main() -> None:
    """Train, and write weights and card."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--photographs", type=Path, default=Path("build/training"))
    parser.add_argument("--folder", type=Path, default=Path("build/weights"))
    parser.add_argument("--steps", type=int, default=4000)
    asked = parser.parse_args()
    state = asked.folder / "ridge.state.pt"
    trainer = RidgeTrainer(RidgeSchedule(asked.steps), SEED)
    if state.exists():
        trainer.resume(torch.load(state, weights_only=True))
    pool = PicturePool.generate(PICTURES, SEED, photographs(asked.photographs / "train"))
    begun, first = time.monotonic(), trainer.step
    losses = []
    while trainer.step < asked.steps:
        losses.append(trainer.learn(pool))
        if trainer.step % EVERY == 0:
            torch.save(trainer.state(), state.with_suffix(".part"))
            state.with_suffix(".part").replace(state)
            left = (time.monotonic() - begun) / (trainer.step - first)
            minutes = left * (asked.steps - trainer.step) / 60
            print(
                f"step {trainer.step}: loss {np.mean(losses[-EVERY:]):.4f}, {minutes:.0f} min left",
                flush=True,
            )
    content = io.BytesIO()
    arrays = {name: each.astype(np.float16) for name, each in trainer.trained().arrays().items()}
    np.savez(content, allow_pickle=False, **arrays)
    stored = RidgeWeights.from_arrays(arrays)
    held_out = photographs(asked.photographs / "held-out")
    card = {
        "sha256": hashlib.sha256(content.getvalue()).hexdigest(),
        "prior": "ridge",
        "data": [
            {"pictures": PICTURES, "licence": GENERATED},
            {"photographs": asked.photographs.name, "licence": "cc0-1.0"},
        ],
        "seed": SEED,
        "steps": asked.steps,
        "command": f"python bench/ridge_weights.py --steps {asked.steps}",
        "commit": commit(),
        "scores_db_sigma_25_255_colour": scores(stored, held_out),
        "not_for": NOT_FOR,
    }
    (asked.folder / "ridge.npz").write_bytes(content.getvalue())
    text = json.dumps(card, indent=2, ensure_ascii=False)
    (asked.folder / "ridge.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
