"""What is measured, in which order: rounds A B C A B C, memory, objective against seconds."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from subprocess import run
from typing import Any

from protocol import Worker

HERE = Path(__file__).parent
NOLENS, NUMPY, TORCH = "nolens", "peer numpy", "peer torch"
SIDES = (NOLENS, NUMPY, TORCH)
# Rough costs of an iteration, which only the time left is guessed from.
COST = {NOLENS: 1.0, NUMPY: 7.0, TORCH: 10.0}
# nolens is faster: it does more iterations, so that each side is timed over about as many seconds.
MORE = {NOLENS: 4, NUMPY: 1, TORCH: 1}
WARM_UP = 6  # iterations of the warm-up and the set-up, roughly
PAUSE = 0.3  # seconds between sides, for the threads of the last one to go to sleep


@dataclass(frozen=True)
class Case:
    """A problem that lies in a folder as psf.npy and data.npy."""

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
    """A case to be solved until its end by some sides, and for how many iterations each."""

    case: Case
    iterations: dict[str, int]


class Clock:
    """Progress lines with the time left."""

    def __init__(self, total: float) -> None:
        self._total, self._done, self._start = total, 0.0, time.monotonic()

    @contextmanager
    def step(self, label: str, weight: float) -> Iterator[None]:
        """Say what is done now, then how long it took and what is left."""
        print(f"{label} ...", end="", file=sys.stderr, flush=True)
        start = time.monotonic()
        yield
        now = time.monotonic()
        self._done += weight
        left = (now - self._start) * (self._total / self._done - 1)
        known = self._done > 0.05 * self._total
        ahead = f", about {spoken(left)} left" if known else ""
        print(f" {now - start:.1f} s{ahead}", file=sys.stderr, flush=True)
        time.sleep(PAUSE)


@dataclass
class Bench:
    """Everything a run needs; `all` gives what it found."""

    pythons: dict[str, Path]
    cases: list[Case]
    races: list[Race]
    rounds: int
    iterations: int

    def all(self) -> dict[str, Any]:
        """Measure everything."""
        self._clock = Clock(self._weight())
        with tempfile.TemporaryDirectory(prefix="nolens-bench-") as folder:
            self._folder = Path(folder)
            with ExitStack() as stack:
                workers = {side: stack.enter_context(self._worker(side)) for side in SIDES}
                about = {side: worker.ask("about") for side, worker in workers.items()}
                timing = [self._time(case, workers) for case in self.cases]
                races = [self._race(race, workers) for race in self.races]
            memory = [self._memory(case) for case in self.cases]
        return {"versions": about, "timing": timing, "memory": memory, "races": races}

    def _time(self, case: Case, workers: dict[str, Worker]) -> dict[str, Any]:
        files = self._make(case)
        found: dict[str, dict[str, Any]] = {}
        for side, worker in workers.items():
            with self._step(side, f"{case.name}, warm-up and set-up", case.values * WARM_UP):
                self._set_up(worker, files)  # compiles, fills caches
                found[side] = {"setup_s": self._set_up(worker, files), "s_per_iteration": []}
        for number in range(self.rounds):
            for side, worker in workers.items():
                count = self.iterations * MORE[side]
                label = f"{case.name}, round {number + 1} of {self.rounds}"
                with self._step(side, label, case.values * count):
                    seconds = worker.ask("iterate", iterations=count)["s_per_iteration"]
                    found[side]["s_per_iteration"].append(seconds)
        for worker in workers.values():
            worker.ask("drop")
        return {**case.about(), "sides": found}

    def _set_up(self, worker: Worker, files: dict[str, str]) -> float:
        """Seconds of what comes before the first iteration."""
        posed: float = worker.ask("load", **files)["setup_s"]
        first: float = worker.ask("iterate", iterations=1).get("setup_s", 0.0)
        return posed + first

    def _memory(self, case: Case) -> dict[str, Any]:
        files = self._make(case)
        found = {}
        for side in SIDES:
            step = self._step(side, f"{case.name}, memory", case.values * 3)
            with step, self._worker(side) as worker:
                worker.ask("load", **files)
                worker.ask("iterate", iterations=2)
                found[side] = worker.ask("peak")
        return {**case.about(), "sides": found}

    def _race(self, race: Race, workers: dict[str, Worker]) -> dict[str, Any]:
        files = self._make(race.case)
        found = {}
        for side, count in race.iterations.items():
            worker = workers[side]
            label = f"{race.case.name}, {count} iterations"
            with self._step(side, label, race.case.values * count * 1.2):
                self._set_up(worker, files)
                worker.ask("drop")
                found[side] = worker.ask("trace", **files, tau=1e-4, iterations=count)
                worker.ask("drop")
        return {**race.case.about(), "tau": 1e-4, "sides": found}

    def _step(self, side: str, label: str, values: float) -> Any:
        return self._clock.step(f"{side}: {label}", values * COST[side])

    def _weight(self) -> float:
        """What all the steps together weigh."""
        total = 0.0
        for side in SIDES:
            count = WARM_UP + 3 + self.rounds * self.iterations * MORE[side]
            total += COST[side] * count * sum(case.values for case in self.cases)
            for race in self.races:
                total += COST[side] * 1.2 * race.case.values * race.iterations.get(side, 0)
        return total

    def _make(self, case: Case) -> dict[str, str]:
        """The case's files, made when they are first asked for."""
        folder = self._folder / case.name.replace(" ", "-").replace(",", "")
        if not folder.exists():
            kind, *rest = case.make
            script = [self.pythons[NOLENS], HERE / "cases.py", kind, folder, *rest]
            run([str(word) for word in script], check=True)
        return {"psf": str(folder / "psf.npy"), "data": str(folder / "data.npy")}

    def _worker(self, side: str) -> Worker:
        if side == NOLENS:
            return Worker(side, [self.pythons[side], HERE / "worker_nolens.py"], {})
        backend = side.split()[1]
        script = HERE / "worker_peer.py"
        return Worker(side, [self.pythons[side], script, backend], {"MPLBACKEND": "Agg"})


def spoken(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
