"""A default against the best of a grid: how it is measured, and its table."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import torch

from machine import describe

FACTOR, STEPS = 1.6, 4
MEASURED = {"psnr_db", "tv_seconds", "denoiser_seconds"}
"""Figures that a case has when it is whole: the default's and the grids'."""
HEADS = (
    "default", "best, denoiser", "at detail", "best, total variation", "at weight", "loss", "time",
    "of its own",
)  # fmt: skip

Row = dict[str, float]


def compare(
    row: Row,
    default: Callable[[], tuple[float, float]],
    psnr_db: Callable[[float, float | None], float],
) -> None:
    """Add what the row does not have yet: the default's PSNR and seconds, the best of the grids.

    Parameters
    ----------
    row
        Figures of a case.
    default
        Reconstructs without any option; PSNR, and the weight that was chosen.
    psnr_db
        From the denoiser's detail, or the weight of total variation, to PSNR.
    """
    default_is_new = "psnr_db" not in row
    if default_is_new:
        begun = time.perf_counter()
        row["psnr_db"], row["tau"] = default()
        row["seconds"] = time.perf_counter() - begun
    if "best_tau" not in row:
        row["detail"], row["denoiser_db"] = best(lambda detail: psnr_db(detail, None))
        factor, row["tv_db"] = best(lambda factor: psnr_db(1.0, factor * row["tau"]))
        row["best_tau"] = factor * row["tau"]
    if default_is_new or not row.keys() >= MEASURED:  # Right after it, as machines are shared.
        begun = time.perf_counter()
        psnr_db(1.0, row["best_tau"])
        row["tv_seconds"] = time.perf_counter() - begun
        begun = time.perf_counter()
        psnr_db(row["detail"], None)
        row["denoiser_seconds"] = time.perf_counter() - begun


def best(psnr_db: Callable[[float], float]) -> tuple[float, float]:
    """Of factors in steps away from 1, until it gets worse on both sides: that, and its PSNR."""
    tried = {1.0: psnr_db(1.0)}
    for step in (FACTOR, 1 / FACTOR):
        last = 1.0
        for _ in range(STEPS):
            before, last = last, last * step
            tried[last] = psnr_db(last)
            if tried[last] < tried[before]:
                break
    factor = max(tried, key=tried.__getitem__)
    return factor, tried[factor]


def table(
    heads: tuple[str, ...], rows: list[tuple[tuple[str, ...], Row]], whole: int, worst_db: float
) -> list[str]:
    """Markdown of the losses, with their summary.

    Parameters
    ----------
    heads
        Of the columns that say what a case is.
    rows
        These columns, and the figures.
    whole
        Number of cases that there are.
    worst_db
        Losses beyond it are counted.
    """
    losses = [row["psnr_db"] - max(row["denoiser_db"], row["tv_db"]) for _, row in rows]
    times, own = (
        [row["seconds"] / row[name] for _, row in rows]
        for name in ("tv_seconds", "denoiser_seconds")
    )
    machine = describe()
    beyond = sum(loss < -worst_db for loss in losses)
    lines = [
        f"**{len(losses)} of {whole} cases: {statistics.mean(losses):+.2f} dB in the mean, "
        f"{min(losses):+.2f} dB at worst, {beyond} below {-worst_db:g} dB. Time: "
        f"{statistics.median(times):.2f} times total variation's (median; at most "
        f"{max(times):.2f}), {statistics.median(own):.2f} times its own prior's (at most "
        f"{max(own):.2f}).** Times on",
        f"{machine['cpu']}, {torch.get_num_threads()} of {machine['cores']} cores.",
        "",
        "| " + " | ".join((*heads, *HEADS)) + " |",
        "|---" * (len(heads) + len(HEADS)) + "|",
    ]
    for (case, row), loss, ratio, of_own in zip(rows, losses, times, own, strict=True):
        cells = [
            *case, f"{row['psnr_db']:.2f}", f"{row['denoiser_db']:.2f}", f"{row['detail']:.2f}",
            f"{row['tv_db']:.2f}", f"{row['best_tau'] / row['tau']:.2f}", f"{loss:+.2f}",
            f"{ratio:.2f}", f"{of_own:.2f}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return lines
