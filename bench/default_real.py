"""The default on real measurements: five pairs against the best of a grid, a hand without truth.

A part of `bench/default.py`. The pairs are those of `bench/pairs.py`. Of the hand, blocks of pixels
are left out of all that is chosen and fitted, and judge what the pictures predict of them.
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

import nolens as nl
from grid import FACTOR, MEASURED, Row, compare, table
from nolens.camera import black_level
from nolens.evaluate import affine_fit, psnr
from nolens.files import read_frame
from nolens.solvers import Development, Prior, Reconstructor, choose_psf
from nolens.solvers.held_out import Prediction, pixel_noise, pixels_of, prediction_errors
from nolens.solvers.scene_prior import PHOTO_PRIOR
from pairs import read
from results import PAIRS, SCREEN

WORST_DB = 0.2
HAND_BIN = 4
HELD_OUT, SIDE = 0.05, 4
"""Fraction of blocks that judge, and superpixels along each."""
WAYS = {
    "default": (PHOTO_PRIOR, 1.0),
    "total variation": (Prior.TV, 1.0),
    "total variation, detail 0.5": (Prior.TV, 0.5),
    "total variation, detail 2": (Prior.TV, 2.0),
}
"""Prior, and what its weight is divided by."""


def measure(data: Path, folder: Path) -> str:
    """Measure what is missing in the folder; the Markdown of all that is there."""
    pairs: dict[str, Row] = {}
    for name in PAIRS:
        path = folder / f"pair-{name}.json"
        pairs[name] = json.loads(path.read_text()) if path.exists() else {}
        if not pairs[name].keys() >= MEASURED:
            pair(data / "diffusercam-pairs", name, pairs[name])
            path.write_text(json.dumps(pairs[name]))
        print(path.name, " ".join(f"{key} {value:.3g}" for key, value in pairs[name].items()))
    path = folder / "hand.json"
    if not path.exists():
        path.write_text(json.dumps(hand(data / "diffusercam-hand")))
    print(path.name, path.read_text(), flush=True)
    return page(pairs, json.loads(path.read_text()))


def pair(folder: Path, name: str, row: Row) -> None:
    """Add what the row of a pair does not have yet."""
    measured, lensed = (read(folder.parent, kind, name).flip(0) for kind in ("diffuser", "lensed"))
    psf = torch.from_numpy(np.load(folder / "psf_estimate.npy"))[None]
    top, left, height, width = SCREEN
    window = (..., slice(top, top + height), slice(left, left + width))
    truth = lensed[window]

    def judged(photo: nl.Photograph) -> float:
        return psnr(affine_fit(photo.values[window], truth).clamp(0, 1), truth, 1.0)

    def default() -> tuple[float, float]:
        photo = nl.reconstruct(measured, psf)
        return judged(photo), photo.tau

    def psnr_db(detail: float, tau: float | None) -> float:
        return judged(nl.reconstruct(measured, psf, support="full", detail=detail, tau=tau))

    compare(row, default, psnr_db)


def hand(folder: Path) -> dict[str, Row]:
    """What the pictures of the hand do not explain of pixels that were left out, by way."""
    point, frame = (read_frame(folder / f"{name}_sample.tif") for name in ("psf", "rawdata_hand"))
    development = Development(point, black=black_level("auto", point), bin_by=HAND_BIN)
    development = choose_psf(development, frame).development
    measurement = development.measurement(frame)
    rows, columns = (length // SIDE for length in measurement.size)
    # Others than those that nolens leaves out, which choose the weight.
    blocks = torch.rand(rows, columns, generator=torch.Generator().manual_seed(1)) < HELD_OUT
    held = pixels_of(blocks, measurement.size)
    seen = replace(measurement, valid=measurement.valid & ~held)
    solver = Reconstructor(development.prepared(measurement).values, prior=PHOTO_PRIOR)
    solver = replace(solver, support=solver.choose_support(seen).support)
    weight = solver.choose_weight(seen)
    found: dict[str, Prediction] = {}
    figures: dict[str, Row] = {}
    for way, (prior, detail) in WAYS.items():
        begun = time.perf_counter()
        weighted = replace(solver, prior=prior).with_detail(weight, detail)
        result = weighted.solve(weighted.problem(seen))
        seconds = time.perf_counter() - begun
        whole = weighted.problem(measurement)
        errors, powers = (
            prediction_errors(whole, scene, held, blocks)
            for scene in (result.scene / whole.scale, whole.data.new_zeros(whole.scene_shape))
        )
        contrast = float(powers.mean())
        found[way] = Prediction(
            float(errors.mean()) ** 0.5, contrast**0.5, pixel_noise(whole), errors / contrast
        )
        more, error = found[way].excess(found["default"])
        figures[way] = {
            "unexplained": found[way].unexplained,
            "by_noise": found[way].unexplained_by_noise,
            "more": more,
            "error": error,
            "blocks": len(errors),
            "seconds": seconds,
        }
        print(way, figures[way], flush=True)
    return figures


def page(pairs: dict[str, Row], rows: dict[str, Row]) -> str:
    """Markdown of both."""
    of_default = rows["default"]
    lines = [
        "Made by `make bench-default` from measurements that lie beside the repository",
        "(`SOURCES.md` beside the data); nothing was tuned with them. The five pairs of",
        "[the results](results/README.md) by the default alone, and with light from everywhere by",
        f"the grids of the table above, in steps of {FACTOR:g}. PSNR in dB after a gain and an",
        "offset for each channel, of what the screen fills; the PSF is an estimate, and blurred.",
        "",
        *table(("pair",), [((name,), row) for name, row in pairs.items()], len(PAIRS), WORST_DB),
        "",
        f"The hand has no truth. On {HAND_BIN}×{HAND_BIN} pixels as one, {of_default['blocks']:.0f}"
        f" blocks of {SIDE}×{SIDE} are left out of the choice",
        "of support, weight and strength and of the fit. What is not explained is a fraction of",
        "their local contrast, as in the report; noise alone would be "
        f"{of_default['by_noise']:.2%}.",
        "",
        "| hand by | not explained | more than the default | standard error | seconds |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {way} | {row['unexplained']:.2%} | "
        + (f"{row['more']:+.2%} | {row['error']:.2%}" if way != "default" else " |")
        + f" | {row['seconds']:.0f} |"
        for way, row in rows.items()
    ]
    return "\n".join(lines)
