"""Sections of the report that are no comparison of sides. Standard library only."""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from statistics import median

from presets import DRAFT, PHOTO
from report_text import Json, label, met, table, times

PASSES_TARGET = 0.3
DENSE_DB, DENSE_NEAR_DB, DENSE_SECONDS = 23.0, 0.3, 3.0
PHOTO_SECONDS, PHOTO_GB, DRAFT_SECONDS = 15.0, 2.5, 1.5


def parts_sections(run: Json) -> list[str]:
    """All of them but that of a CUDA device, in the order of the report."""
    sections = ["## nolens alone: cost against size", sizes_section(run["sizes"])]
    written: dict[str, tuple[str, Callable[[Json], str]]] = {
        "passes": ("What an iteration spends its time on", passes_section),
        "dense": ("A photograph that fills the view", dense_section),
        "presets": ("The installed command", presets_section),
    }
    for name, (title, section) in written.items():
        sections += [f"## {title}", part_text(run, name, section)]
    return sections


def cuda_part(run: Json) -> str | None:
    """The section of a CUDA device; None where the run had none."""
    part = run["parts"]["cuda"]
    measured = "failed" in part or part["found"] is not None
    return f"## CUDA\n\n{part_text(run, 'cuda', cuda_section)}" if measured else None


def part_text(run: Json, name: str, section: Callable[[Json], str]) -> str:
    """Of a part, or why there is nothing."""
    part = run["parts"][name]
    text = f"Not measured: {part['failed']}" if "failed" in part else section(part["found"])
    again = run.get("again", {}).get(name)
    if again is None:
        return text
    return (
        f"Measured after the rest, on {again['date']}; load average at its start "
        f"{again['load'][0]:.2f}, others kept {again['others']:.2f} cores busy.\n\n{text}"
    )


def sizes_section(sizes: list[Json]) -> str:
    rows = [
        [
            f"{case['height'] * case['width'] / 1e6:.1f} MP, {label(case)}",
            times(case["period"]),
            f"{case['s_per_iteration']:.4f}",
            f"{case['min']:.4f}–{case['max']:.4f}",
            f"{1e9 * case['s_per_iteration'] / (prod(case['period']) * case['channels']):.1f}",
            f"{case['peak_mib']:.0f}",
        ]
        for case in sizes
    ]
    head = ["sensor", "FFT grid", "s per iteration", "min–max", "ns per pixel", "peak MiB"]
    return f"{table(head, rows)}\n\n{SIZES_NOTE}"


def passes_section(found: Json) -> str:
    seconds = found["median_s"]
    whole = sum(seconds.values())
    rows = [[name, f"{1e3 * each:.1f}", f"{each / whole:.1%}"] for name, each in seconds.items()]
    return "\n\n".join(
        [
            table(["pass", "median ms", "fraction"], rows),
            f"Target: at most {PASSES_TARGET:.0%} of an iteration is not transforms (solve and "
            f"update together): {found['share']:.1%}, {met(found['share'] <= PASSES_TARGET)}.",
            f"One channel, FFT grid {times(found['period'])}, {found['threads']} threads; medians "
            f"of {found['turns']} turns, in which the passes follow one another. The update, which "
            f"gathers sums once in {found['look']} iterations, is the mean over so many.",
        ]
    )


def dense_section(found: Json) -> str:
    best, quick = found["best"], found["quick"]
    rows = [
        [f"{run['tau']:g}", f"{run['psnr_db']:.2f} dB", f"{run['objective']:.4g}"]
        for run in found["converged"]
    ]
    short = best["psnr_db"] - quick["psnr_db"]
    holds = short <= DENSE_NEAR_DB and quick["median_s"] <= DENSE_SECONDS
    return "\n\n".join(
        [
            f"Sensor {times(found['sensor'])}, one channel, support "
            f"{found['side']}×{found['side']}, FFT grid {times(found['period'])}: "
            "skimage's astronaut (green, linear light) fills the support, "
            "through a random mask (`bench/caustic.py`) whose PSF is known wherever "
            "light from the support reaches the sensor; shot noise at 90 % of the paper's full "
            "well, and read noise. PSNR after one scale factor.",
            table(["τ", f"PSNR after {found['iterations']} iterations", "objective"], rows),
            f"Converged here means {found['iterations']} iterations with tolerance 0; the best of "
            f"the three is τ = {best['tau']:g}, {best['psnr_db']:.2f} dB.",
            "\n".join(
                [
                    f"- Target: at least {DENSE_DB:g} dB: {met(best['psnr_db'] >= DENSE_DB)}.",
                    f"- Target: from a cold start within {DENSE_NEAR_DB:g} dB of that in at most "
                    f"{DENSE_SECONDS:g} s: {solved(quick)} with `--low-frequency`, {short:.2f} dB "
                    f"short: {met(holds)}.",
                    f"- Quality `photo`: {solved(found['photo'])}.",
                ]
            ),
        ]
    )


def solved(run: Json) -> str:
    seconds = run["seconds"]
    return (
        f"{run['psnr_db']:.2f} dB after {run['iterations']} iterations in {run['median_s']:.2f} s "
        f"(median of {len(seconds)}: {min(seconds):.2f}–{max(seconds):.2f}; set-up included)"
    )


def presets_section(found: Json) -> str:
    height, width, channels, side = found["size"]
    rows = []
    for quality, runs in found["runs"].items():
        wall, own = ([run[key] for run in runs] for key in ("seconds", "own_seconds"))
        rows.append(
            [
                quality,
                *(f"{f(wall):.2f}" for f in (min, median, max)),
                *(f"{f(own):.2f}" for f in (min, median, max)),
                f"{max(run['peak_gb'] for run in runs):.2f}",
                f"{runs[-1]['iterations']} ({runs[-1]['stop_reason']})",
            ]
        )
    head = ["way", "command s: min", "median", "max", "own s: min", "median", "max",
            "peak GB", "iterations"]  # fmt: skip
    draft, photo = (found["runs"][way] for way in (DRAFT, PHOTO))
    photo_s, draft_s = (median(run["seconds"] for run in runs) for runs in (photo, draft))
    draft_own_s = median(run["own_seconds"] for run in draft)
    peak = max(run["peak_gb"] for run in photo)
    return "\n\n".join(
        [
            f"`nolens reconstruct m.npy --psf p.npy -o out.png --quality … --json`, "
            f"{len(draft)} runs of each, one after the other: {height}×{width} pixels in {channels}"
            f" channels; a photograph on {side}×{side} pixels through a random mask, which are the "
            "support where one is given.",
            table(head, rows),
            "\n".join(
                [
                    f"- Target: `photo` with its support in at most {PHOTO_SECONDS:g} s (the "
                    f"command) and {PHOTO_GB:g} GB: {photo_s:.2f} s and {peak:.2f} GB: "
                    f"{met(photo_s <= PHOTO_SECONDS and peak <= PHOTO_GB)}.",
                    f"- Target: `draft` in at most {DRAFT_SECONDS:g} s: "
                    f"{draft_s:.2f} s the command, {met(draft_s <= DRAFT_SECONDS)}; "
                    f"{draft_own_s:.2f} s by its own clock, {met(draft_own_s <= DRAFT_SECONDS)}.",
                ]
            ),
            "Command seconds are those on the wall from the start of Python to its end; own "
            "seconds those that the command says: files and solver, without the imports. Peak "
            "memory is the whole process's (`ru_maxrss`).",
        ]
    )


def cuda_section(found: Json) -> str:
    height, width, channels = found["size"]
    each = found["seconds"] / found["iterations"]
    floor = found["bytes_per_iteration"] / found["bytes_per_s"]
    return "\n\n".join(
        [
            f"{found['device']}; {height}×{width}, {channels} channels, FFT grid "
            f"{times(found['period'])}, random numbers.",
            "\n".join(
                [
                    f"- {found['iterations']} iterations: {found['seconds']:.2f} s, "
                    f"{1e3 * each:.2f} ms each.",
                    f"- Floor by memory: {found['bytes_per_iteration'] / 1e9:.2f} GB an iteration "
                    f"at {found['bytes_per_s'] / 1e12:.2f} TB/s take {1e3 * floor:.2f} ms, "
                    f"{found['share_of_floor']:.0%} of the time it takes.",
                    f"- Quality `photo`, frame to the device and picture back: "
                    f"{found['photo_s']:.2f} s.",
                    f"- Stream of {times(found['stream_size'][:2])}, {channels} channels, every "
                    f"frame set up and solved anew with quality `photo`: "
                    f"{found['frames_per_s']:.1f} frames/s.",
                ]
            ),
            CUDA_NOTE,
        ]
    )


SIZES_NOTE = """\
Full domain, PSF of the sensor's size, random numbers: what an iteration takes does not depend on \
them. Every case in a process of its own; medians of three timings. ns per pixel are those of the \
FFT grid, for one channel; peak memory has the imports in it."""

CUDA_NOTE = """\
The bandwidth is that of copies within the device, read and written bytes together. Bytes are \
counted from the sizes of the arrays, each moved once by every pass: both transforms read and \
write the complex pair along rows and along columns; the solve reads and writes it and reads the \
PSF's half spectrum; the update reads and writes it and the four real arrays of the splits, and \
reads the measurement and which of its pixels are valid."""
