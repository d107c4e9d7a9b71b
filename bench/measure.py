"""How it is measured: rounds A B C A B C, memory, objective against seconds, sizes, parts."""

from __future__ import annotations

import json
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from subprocess import run
from typing import Any

from clock import PER_SECOND, Clock
from plan import COST, MORE, NOLENS, SCICO, SIDES, Case, Part, Race
from protocol import Worker, WorkerKilledError

HERE = Path(__file__).parent
WARM_UP = 6  # iterations of the warm-up and the set-up, roughly
REPEATS = 3  # timings for each size
SIZED = 3e7  # values that nolens alone goes over for one of them, in about two seconds


@dataclass
class Bench:
    """Everything a run needs; `all` gives what it found."""

    pythons: dict[str, Path]
    cases: list[Case]
    races: list[Race]
    sizes: list[Case]
    parts: list[Part]
    rounds: int
    iterations: int

    def all(self) -> dict[str, Any]:
        """Measure everything."""
        self._clock = Clock(self._weight())
        self._lost: list[str] = []
        with tempfile.TemporaryDirectory(prefix="nolens-bench-") as folder:
            self._folder = Path(folder)
            with ExitStack() as stack:
                workers = {side: stack.enter_context(self._worker(side)) for side in self.pythons}
                about = {side: worker.ask("about") for side, worker in workers.items()}
                timing = [self._time(case, workers, stack) for case in self.cases]
                races = [self._race(race, workers) for race in self.races]
            memory = [self._memory(case) for case in self.cases]
            sizes = [self._size(case) for case in self.sizes]
        parts = {part.name: self._part(part) for part in self.parts}
        return {
            "versions": about, "timing": timing, "memory": memory, "races": races,
            "sizes": sizes, "parts": parts, "lost": self._lost,
        }  # fmt: skip

    def _time(self, case: Case, workers: dict[str, Worker], stack: ExitStack) -> dict[str, Any]:
        files = self._make(case)
        found: dict[str, dict[str, Any]] = {}
        for side, worker in list(workers.items()):
            label = f"{case.name}, warm-up and set-up"
            try:
                with self._step(side, label, case.values * WARM_UP):
                    self._set_up(worker, files)  # compiles, fills caches
                    found[side] = {"setup_s": self._set_up(worker, files), "s_per_iteration": []}
            except WorkerKilledError as error:
                self._lost.append(f"{case.name}: {error}, with all sides loaded.")
                workers[side] = stack.enter_context(self._worker(side))
        for number in range(self.rounds):
            for side in found:
                worker = workers[side]
                count = counted(self.iterations, side)
                label = f"{case.name}, round {number + 1} of {self.rounds}"
                with self._step(side, label, case.values * count):
                    seconds = worker.ask("iterate", iterations=count)["s_per_iteration"]
                    found[side]["s_per_iteration"].append(seconds)
        for worker in workers.values():
            worker.ask("drop")
        return {**case.about(), "sides": found}

    def _set_up(self, worker: Worker, files: dict[str, str]) -> float:
        """Seconds of what comes before the first iteration."""
        worker.ask("drop")  # two problems at once may be more than there is memory for
        posed: float = worker.ask("load", psf=files["psf"], data=files["data"])["setup_s"]
        first: float = worker.ask("iterate", iterations=1).get("setup_s", 0.0)
        return posed + first

    def _memory(self, case: Case) -> dict[str, Any]:
        files = self._make(case)
        found = {}
        for side in SIDES:
            step = self._step(side, f"{case.name}, memory", case.values * 3)
            try:
                with step, self._worker(side) as worker:
                    worker.ask("load", **files)
                    worker.ask("iterate", iterations=2)
                    found[side] = worker.ask("peak")
            except WorkerKilledError as error:
                self._lost.append(f"Memory of {case.name}: {error}, by itself.")
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
                found[side] = worker.ask(
                    "trace", **files, tau=race.tau, iterations=count, count=race.looks
                )
                worker.ask("drop")
        return {**race.case.about(), "tau": race.tau, "looks": race.looks, "sides": found}

    def _size(self, case: Case) -> dict[str, Any]:
        """One size of sensor, by nolens alone in a process of its own."""
        files = self._make(case)
        count = sized(case)
        step = self._step(NOLENS, case.name, case.values * (REPEATS * count + WARM_UP))
        with step, self._worker(NOLENS) as worker:
            period = worker.ask("load", **files)["period"]
            worker.ask("iterate", iterations=1)
            seconds = [
                worker.ask("iterate", iterations=count)["s_per_iteration"] for _ in range(REPEATS)
            ]
            peak = worker.ask("peak")["peak_mib"]
        each = {"s_per_iteration": median(seconds), "min": min(seconds), "max": max(seconds)}
        return {**case.about(), "period": period, "iterations": count, **each, "peak_mib": peak}

    def _part(self, part: Part) -> dict[str, Any]:
        """What a script prints, or why there is nothing."""
        command = [self.pythons[NOLENS], HERE / part.script, *part.arguments]
        with self._clock.step(part.name, part.seconds * PER_SECOND):
            done = run([str(word) for word in command], capture_output=True, text=True)
        if done.returncode:
            lines = done.stderr.strip().splitlines()
            return {"failed": lines[-1] if lines else f"ended with {done.returncode}"}
        return {"found": json.loads(done.stdout)}

    def _step(self, side: str, label: str, values: float) -> Any:
        return self._clock.step(f"{side}: {label}", values * COST[side])

    def _weight(self) -> float:
        """What all the steps together weigh."""
        total = sum(part.seconds * PER_SECOND for part in self.parts)
        total += sum(case.values * (REPEATS * sized(case) + WARM_UP) for case in self.sizes)
        for side in self.pythons:
            count = WARM_UP + 3 + self.rounds * counted(self.iterations, side)
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
        return {path.stem: str(path) for path in folder.glob("*.npy")}

    def _worker(self, side: str) -> Worker:
        python = self.pythons[side]
        if side == NOLENS:
            return Worker(side, [python, HERE / "worker_nolens.py"], {})
        if side == SCICO:
            # jax on the processor, and no search for another device.
            return Worker(side, [python, HERE / "worker_scico.py"], {"JAX_PLATFORMS": "cpu"})
        script = HERE / "worker_peer.py"
        return Worker(side, [python, script, side.split()[1]], {"MPLBACKEND": "Agg"})


def counted(iterations: int, side: str) -> int:
    """A side's iterations in a round."""
    return max(1, round(iterations * MORE[side]))


def sized(case: Case) -> int:
    """Iterations of a timing of nolens alone."""
    return min(40, max(8, round(SIZED / case.values)))
