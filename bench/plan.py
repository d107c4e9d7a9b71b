"""What is measured: sides, cases, races, sizes and parts. Standard library only."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NOLENS, NUMPY, TORCH, SCICO = "nolens", "peer numpy", "peer torch", "scico"
SIDES = (NOLENS, NUMPY, TORCH, SCICO)
# Rough costs of an iteration, which only the time left is guessed from.
COST = {NOLENS: 1.0, NUMPY: 7.0, TORCH: 7.0, SCICO: 18.0}
# Fast sides do more iterations, so that each is timed over about as many seconds.
MORE = {NOLENS: 4.0, NUMPY: 1.0, TORCH: 1.0, SCICO: 0.4}

HAND = (1200, 1600)
PAPER = (1520, 2028)
CASES = ((*PAPER, 1), (*PAPER, 3), (1200, 1600, 1))
QUICK = ((152, 202, 1), (152, 202, 3))
# 4:3, of 0.1, 0.3, 1, 3, 6 and 12 megapixels.
SENSORS = ((274, 366), (474, 632), (866, 1154), (1500, 2000), (2122, 2828), (3000, 4000))
# The most that a run holds, for each cell of the period and channel (docs/benchmarks.md).
BYTES_PER_CELL = 95
MEMORY_SHARE = 0.8
# The photograph of the full-size race: its cells, the weight of the prior, nolens's iterations.
SIDE, TAU, OURS = 512, 1e-5, 300
LOOKS = 30


@dataclass(frozen=True)
class Case:
    """A problem that lies in a folder as psf.npy and data.npy, perhaps with a truth.npy."""

    name: str
    height: int
    width: int
    channels: int
    make: tuple[str, ...]

    @property
    def values(self) -> int:
        """How many numbers the measurement holds."""
        return self.height * self.width * self.channels

    def about(self) -> dict[str, Any]:
        """Name and size, as the results have them."""
        size = {"height": self.height, "width": self.width, "channels": self.channels}
        return {"name": self.name, **size}


@dataclass(frozen=True)
class Race:
    """A case to be solved until its end by some sides, and for how many iterations each.

    Parameters
    ----------
    case
        The problem.
    iterations
        By side.
    tau
        Weight of the prior.
    looks
        How often iterates are judged, in geometric steps; None for nearly always.
    """

    case: Case
    iterations: dict[str, int]
    tau: float = 1e-4
    looks: int | None = None


@dataclass(frozen=True)
class Part:
    """A script of its own that prints one JSON object, and about how long it takes."""

    name: str
    script: str
    arguments: tuple[str, ...]
    seconds: float


def of_kind(kind: str, height: int, width: int, channels: int, *rest: int) -> Case:
    """A case that `cases.py` makes from its size alone."""
    size = (height, width, channels)
    name = f"{kind} " + "×".join(str(number) for number in size)
    return Case(name, *size, make=(kind, *(str(number) for number in (*size, *rest))))


def plan_cases(quick: bool) -> list[Case]:
    """What all sides are timed on."""
    return [of_kind("synthetic", *size) for size in (QUICK if quick else CASES)]


def plan_sizes(quick: bool, memory_gib: float) -> tuple[list[Case], list[str]]:
    """Sensors that nolens alone is timed on, and which of them would not fit."""
    sizes, skipped = [], []
    for height, width in SENSORS[:2] if quick else SENSORS:
        for channels in (1, 3):
            forecast = 4 * height * width * channels * BYTES_PER_CELL / 2**30
            if forecast < MEMORY_SHARE * memory_gib:
                sizes.append(of_kind("random", height, width, channels))
            else:
                skipped.append(
                    f"{height}×{width} with {channels} channels: about {forecast:.0f} GiB, more "
                    f"than {100 * MEMORY_SHARE:.0f} % of this machine's {memory_gib:.0f} GiB."
                )
    return sizes, skipped


def plan_races(options: argparse.Namespace) -> tuple[list[Race], list[str]]:
    """The hand, binned, and what is left out."""
    folder = _hand_folder(options.data)
    if folder is None:
        return [], [f"the hand: not in {options.data} (name its folder with --data)."]
    peers = min(options.peers, 50) if options.quick else options.peers
    counts = {NOLENS: options.ours, **dict.fromkeys((NUMPY, TORCH, SCICO), peers)}
    return [Race(hand(folder, 4), counts)], []


def plan_full_size(data: Path, quick: bool) -> tuple[list[Race], list[str]]:
    """A photograph whose truth is known, the hand, and what is left out."""
    peers = 20 if quick else 1000
    races, skipped = [photograph(quick, {NUMPY: peers, NOLENS: OURS})], []
    folder = _hand_folder(data)
    if folder is None:
        skipped.append(f"the hand: not in {data} (name its folder with --data).")
    elif not quick:
        races.append(Race(hand(folder, 1), {NUMPY: peers, NOLENS: OURS}, looks=LOOKS))
    return races, skipped


def _hand_folder(data: Path) -> Path | None:
    there = (folder for folder in (data, data / "diffusercam-hand"))
    return next((folder for folder in there if (folder / "psf_sample.tif").exists()), None)


def hand(folder: Path, factor: int) -> Case:
    """DiffuserCam's hand, binned."""
    name = "Hand, full size" if factor == 1 else f"Hand, binned {factor}×{factor}"
    size = (HAND[0] // factor, HAND[1] // factor, 1)
    return Case(name, *size, make=("hand", str(folder), str(factor)))


def photograph(quick: bool, iterations: dict[str, int]) -> Race:
    """A problem of the paper's size whose truth is known."""
    size = (*QUICK[0], 64) if quick else (*PAPER, 1, SIDE)
    made = of_kind("photograph", *size)
    case = Case("Photograph, full size", *size[:3], make=made.make)
    return Race(case, iterations, tau=TAU, looks=LOOKS)


def plan_parts(quick: bool, nolens: Path) -> list[Part]:
    """What is not a comparison of sides."""
    height, width = (str(number) for number in (QUICK[0][:2] if quick else PAPER))
    region, side, count = ("64", "64", "10") if quick else ("400", "512", "1000")
    long = 0.1 if quick else 1.0
    return [
        Part("passes", "passes.py", ("--share", height, width), 30 * long),
        Part("dense", "dense.py", (height, width, region), 240 * long),
        Part("presets", "presets.py", (str(nolens), height, width, "3", side), 150 * long),
        Part("cuda", "on_cuda.py", (height, width, count), 30 * long),
    ]
