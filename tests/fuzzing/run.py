"""``make fuzz SECONDS=…``: damaged files, hostile options and requests, until the time is over.

Every command must end with exit code 0, 2, 3 or 130 and a message, within 20 s and within its
memory, and write nothing where it fails. What breaks is kept, once for each place, with the call
that repeats it; mend it, then move the file into ``tests/corpus/`` under a name that begins with
its target's.
"""

import argparse
import json
import multiprocessing as mp
import os
import random
import re
import shutil
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from damage import damaged
from executor import Executor, Outcome
from hypothesis import HealthCheck, Phase, given, seed, settings
from seeds import make_seeds
from server import Server
from targets import BASES, FILES, FileTarget, calls, of_corpus, requests

_AT_ONCE = 40
_PLACES = 300
Report = Callable[[str, Outcome, Any], None]


class Fuzzer:
    """One worker: its executor, its copy of the seeds, and what it found.

    Parameters
    ----------
    folder
        Of this worker.
    failures
        Where the inputs that break something go.
    """

    def __init__(self, folder: Path, failures: Path) -> None:
        self._folder, self._failures = folder, failures
        self._executor = Executor()
        self._server: Server | None = None
        self.counts: Counter[str] = Counter()
        self.codes: Counter[str] = Counter()

    def file(self, target: FileTarget, data: bytes, suffix: str | None = None) -> Outcome:
        """Run a target on one damaged file, with another suffix than its seed's if one is given."""
        for before in self._folder.glob("bad.*"):  # A bad.toml would belong to a bad.mkv.
            before.unlink()
        bad = self._folder / f"bad{suffix or target.suffix}"
        if target.in_folder:
            folder, name = target.seed.split("/")
            copy = self._folder / ("curved" if name == "curve.csv" else "bad")
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(self._folder / folder, copy)
            if name == "curve.csv":
                (copy / "curve.toml").replace(copy / "camera.toml")
            bad = copy / name
            bad.write_bytes(data)
            bad = copy
        else:
            bad.write_bytes(data)
        return self._executor.run(target.arguments(bad.name), self._folder)

    def call(self, arguments: list[str]) -> Outcome:
        """Run a command with hostile options."""
        shutil.rmtree(self._folder / "out", ignore_errors=True)
        return self._executor.run(arguments, self._folder)

    def request(self, method: str, path: str, body: Any) -> Outcome:
        """Send a request to a studio."""
        if self._server is None:
            self._server = Server(self._folder / "studio")
        return self._server.request(method, path, body)

    def note(self, name: str, outcome: Outcome, data: Any) -> None:
        """Count an outcome, and keep what broke something new."""
        self.counts[name] += 1
        announced = outcome.trouble == "hang" and " to go\n" in outcome.err
        self.codes["long, as it said" if announced else str(outcome.code)] += 1
        if outcome.trouble is None or announced:
            return
        # One of each: sizes and the numbers in a message differ from input to input.
        words = re.sub(r"(?<!:)\b[0-9.]+", "N", f"{name} {outcome.trouble}")
        place = "".join(c if c.isalnum() else "-" for c in words)[:100]
        file = self._failures / f"{place}{'' if isinstance(data, bytes) else '.json'}"
        with suppress(FileExistsError), file.open("xb") as stream:
            text = data if isinstance(data, bytes) else json.dumps(data).encode()
            stream.write(text)
            error = outcome.err[-6000:]
            file.with_name(f"{file.name}.err").write_text(f"{outcome.trouble}\n{error}\n")
            print(f"BROKEN {name}: {outcome.trouble}: {file}", flush=True)

    def close(self) -> None:
        """End what runs."""
        self._executor.close()
        if self._server is not None:
            trouble = self._server.close()
            if trouble is not None:
                self.note("studio", trouble, {})


def _round(fuzzer: Fuzzer, chance: random.Random, only: str, end: float) -> None:
    """Forty inputs for one target."""
    with_files = [each for each in FILES if each.name.startswith(only)]
    choices: list[Any] = [*with_files, *(() if only else BASES)]
    if not only or only == "studio":
        choices += ["studio"] * max(1, len(choices) // 10)
    chosen = chance.choice(choices)
    number = chance.randrange(2**32)
    how = settings(
        max_examples=_AT_ONCE,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    if isinstance(chosen, FileTarget):
        good = (Path("seeds") / chosen.seed).read_bytes()

        @seed(number)
        @how
        @given(damaged(good, chosen.suffix))
        def work(data: bytes) -> None:
            if time.monotonic() < end:
                fuzzer.note(chosen.name, fuzzer.file(chosen, data), data)
    elif chosen == "studio":

        @seed(number)
        @how
        @given(requests())
        def work(asked: tuple[str, str, Any]) -> None:
            if time.monotonic() < end:
                fuzzer.note("studio", fuzzer.request(*asked), asked)
    else:

        @seed(number)
        @how
        @given(calls(chosen))
        def work(arguments: list[str]) -> None:
            if time.monotonic() < end:
                fuzzer.note("options " + " ".join(chosen), fuzzer.call(arguments), arguments)

    work()


def _check_seeds(folder: Path) -> list[str]:
    """Targets whose good file is refused: what is made of it would break nothing new."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree("seeds", folder)
    fuzzer = Fuzzer(folder, Path("failures").resolve())
    refused = []
    for target in FILES:
        outcome = fuzzer.file(target, (Path("seeds") / target.seed).read_bytes())
        if outcome.code != 0 or outcome.trouble:
            refused.append(f"{' '.join(target.command)} {target.seed}: {outcome.err[-400:]}")
    for command, base in BASES.items():
        outcome = fuzzer.call([*command, *base])
        if outcome.code != 0 or outcome.trouble:
            refused.append(f"{' '.join((*command, *base))}: {outcome.err[-400:]}")
    fuzzer.close()
    return refused


def _replay(corpus: Path) -> int:
    """Every file of the corpus through all commands of its name; 1 if one of them breaks."""
    folder = Path("replay").resolve()
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree("seeds", folder)
    fuzzer, broken, count = Fuzzer(folder, Path("failures").resolve()), 0, 0
    for each in sorted(corpus.iterdir()):
        if each.suffix == ".md":
            continue
        name, data = each.name, each.read_bytes()
        if name.startswith("options-"):
            outcomes = [fuzzer.call(json.loads(data))]
        elif name.startswith("studio-"):
            outcomes = [fuzzer.request(*json.loads(data))]
        else:
            outcomes = [fuzzer.file(target, data, each.suffix) for target in of_corpus(name)]
        if not outcomes:
            print(f"{each}: no command is known for its name")
            broken += 1
        for outcome in outcomes:
            count += 1
            if outcome.trouble is not None:
                print(f"{each}: {outcome.trouble}\n{outcome.err[-2000:]}")
                broken += 1
    fuzzer.close()
    print(f"{count} runs of the corpus, {broken} broken")
    return 1 if broken else 0


def _work(number: int, base: int, seconds: float, only: str, results: Any) -> None:
    folder = Path(f"worker-{number}").resolve()
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree("seeds", folder)
    fuzzer = Fuzzer(folder, Path("failures").resolve())
    chance, end = random.Random(f"{base}-{number}"), time.monotonic() + seconds
    try:
        while time.monotonic() < end:
            _round(fuzzer, chance, only, end)
    finally:
        fuzzer.close()
        results.put((fuzzer.counts, fuzzer.codes))
        shutil.rmtree(folder, ignore_errors=True)


def main() -> int:
    """Fuzz, and say what broke; 1 if anything did."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=None, help="repeats a run; default: new")
    parser.add_argument("--only", default="", help="targets whose name begins so, or studio")
    parser.add_argument("--replay", type=Path, help="run this corpus, and nothing else")
    parser.add_argument("--folder", type=Path, default=Path("build/fuzz"))
    given_ = parser.parse_args()
    corpus = given_.replay and given_.replay.resolve()
    base = random.SystemRandom().randrange(2**32) if given_.seed is None else given_.seed
    failures = given_.folder / "failures"
    shutil.rmtree(failures, ignore_errors=True)
    failures.mkdir(parents=True)
    os.chdir(given_.folder)
    make_seeds(Path("seeds"))
    if corpus is not None:
        return _replay(corpus)
    print(f"fuzzing for {given_.seconds:g} s, --seed {base}", flush=True)
    refused = _check_seeds(Path("check").resolve())
    if refused:
        print("good files are refused:", *refused, sep="\n")
        return 1
    context = mp.get_context("spawn")
    results = context.Queue()
    workers = [
        context.Process(target=_work, args=(each, base, given_.seconds, given_.only, results))
        for each in range(given_.workers)
    ]
    for each in workers:
        each.start()
    counts: Counter[str] = Counter()
    codes: Counter[str] = Counter()
    for _ in workers:
        some, ended = results.get(timeout=given_.seconds + 300)
        counts, codes = counts + some, codes + ended
    for each in workers:
        each.join()
    for name, count in sorted(counts.items()):
        print(f"{count:7}  {name}")
    print("exit codes: " + ", ".join(f"{code}: {count}" for code, count in sorted(codes.items())))
    broken = sorted(each.name for each in Path("failures").glob("*.err"))
    print(f"{sum(counts.values())} inputs, {len(broken)} kinds of failure")
    early = sum(each.exitcode != 0 for each in workers)
    if early:
        print(f"{early} of {len(workers)} workers ended early, by an error of the fuzzer's own")
    return 1 if broken or early else 0


if __name__ == "__main__":
    sys.exit(main())
