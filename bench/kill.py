"""Kills and Ctrl-C at random moments: no half file, no traceback, and every rerun is good.

`.venv/bin/python bench/kill.py` makes small inputs with `nolens`, runs eight commands to their end,
and then ends them 100 times by SIGKILL and 100 times by SIGINT: a third of the moments in the
first 100 ms, a third in the first 700 ms, the rest anywhere in the run. Half of the runs begin
without outputs, half over those of an earlier run. It prints a table, then all that was wrong,
and exits with 1 if anything was.

Until Python has run a program's first line, Ctrl-C is Python's own: it ends without a word, or
with a traceback of its start, which no program can prevent. Such tracebacks have a column of their
own, beside `python -c pass` interrupted at the same moments.
"""

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
import zipfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import gdstk
import numpy as np
import pypdf
import tifffile
import trimesh
from PIL import Image

from nolens.files import read_frame

NOLENS = Path(sys.executable).with_name("nolens")
LONGEST_S = 600.0
EARLY_S = 0.2
AT_THE_END_S = 0.5
"""What is left for a run to do that has written its files."""
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}
BROKEN = re.compile(r"Traceback|Fatal Python error|Exception ignored|terminate called")
FIRST_LINES = re.compile(r"/nolens/(__init__|__main__|interrupt)\.py")
"""What is loaded until Ctrl-C is ours."""
OURS = re.compile(r"/nolens/\S+\.py")
STATE = ".state.npz"


@dataclass(frozen=True)
class Command:
    """A command as it is killed.

    Parameters
    ----------
    name
        For the table.
    arguments
        ``{inputs}`` and ``{out}`` stand for the folders.
    """

    name: str
    arguments: str

    def line(self, inputs: Path, out: Path) -> list[str]:
        """What is run."""
        words = self.arguments.split()
        return [str(NOLENS), *(word.format(inputs=inputs, out=out) for word in words)]


COMMANDS = (
    Command(
        "reconstruct",
        "reconstruct {inputs}/raw.dng --psf {inputs}/psf-1.dng --iterations 400 --tolerance 0 "
        "-o {out}/a.png -o {out}/a.tif",
    ),
    Command(
        "reconstruct, sequence",
        "reconstruct {inputs}/frames --psf {inputs}/psf-1.dng -o {out}/pictures",
    ),
    Command(
        "simulate",
        "simulate {inputs}/scene.png --camera {inputs}/camera.toml --light 550nm -o {out}/raw.dng",
    ),
    Command("psf", "psf --camera {inputs}/camera.toml --light 550nm -o {out}/psf.dng"),
    Command(
        "refocus",
        "refocus {inputs}/raw.dng --psfs {inputs}/camera --stack 200mm,400mm --steps 3 "
        "-o {out}/stack",
    ),
    Command(
        "design mask",
        "design mask optimised --camera {inputs}/camera.toml --period 0.1mm --iterations 60 "
        "-o {out}/mask",
    ),
    Command(
        "calibrate",
        "calibrate {inputs}/psf-1.dng {inputs}/psf-2.dng --distance 300mm "
        "--camera {inputs}/camera.toml -o {out}/camera",
    ),
    Command(
        "fabricate",
        "fabricate {inputs}/camera.toml --crop 0.1x0.1mm --triangles 500 -o {out}/workshop",
    ),
)


@dataclass
class Reference:
    """A run to its end.

    Parameters
    ----------
    folder
        Its outputs.
    names
        Of the outputs.
    seconds
        How long it took.
    """

    folder: Path
    names: set[str]
    seconds: float


@dataclass
class Ended:
    """A run that was ended, and the one after it.

    Parameters
    ----------
    command
        What was run.
    number
        SIGKILL or SIGINT.
    moment
        When, in seconds from the start.
    how
        What it ended with.
    wrong
        All that should not have been.
    """

    command: Command
    number: signal.Signals
    moment: float
    how: str = ""
    wrong: list[str] = field(default_factory=list)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--interrupts", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="runs beside each other")
    parser.add_argument("--folder", type=Path, default=Path("build/kill"))
    given = parser.parse_args()
    # A shell's job in the background ignores Ctrl-C, and would hand that on.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    shutil.rmtree(given.folder, ignore_errors=True)
    inputs = make_inputs(given.folder / "inputs")
    with ThreadPoolExecutor(given.jobs) as pool:
        runs = pool.map(lambda each: reference(each, inputs, given.folder), COMMANDS)
        references = dict(zip(COMMANDS, runs, strict=True))
        chance = random.Random(given.seed)
        numbers = given.kills * [signal.SIGKILL] + given.interrupts * [signal.SIGINT]
        asked = []
        for place, number in enumerate(numbers):
            command = COMMANDS[place % len(COMMANDS)]
            ranges = (0.1, 0.7, references[command].seconds)
            asked.append(Ended(command, number, chance.uniform(0, ranges[place % 3])))
        began = time.monotonic()
        done = []
        tried = pool.map(
            lambda pair: ended(pair[1], references, inputs, given.folder / str(pair[0]), pair[0]),
            enumerate(asked),
        )
        for each in tried:
            done.append(each)
            if each.wrong or sys.stderr.isatty():
                print(f"{len(done)}/{len(asked)} {told(each)}", file=sys.stderr, flush=True)
        early = [
            each.moment for each in done if each.number == signal.SIGINT and each.moment < EARLY_S
        ]
        control = list(pool.map(interrupted_python, early))
    print(table(done, references))
    starts = [each.moment for each in done if each.how == "Python's start"]
    print(
        f"Tracebacks of Python's start, before the command's first line: {of(starts)}; of `python "
        f"-c pass` at the {len(early)} moments of the first {1e3 * EARLY_S:.0f} ms: "
        f"{of([moment for moment in control if moment is not None])}"
    )
    wrong = [each for each in done if each.wrong]
    for each in wrong:
        print(told(each))
    print(
        f"{len(done)} runs ended, {len(wrong)} of them wrong; seed {given.seed}, "
        f"{time.monotonic() - began:.0f} s"
    )
    sys.exit(1 if wrong else 0)


def make_inputs(folder: Path) -> Path:
    """A tiny camera, what it measures, and its PSFs, all by the command itself."""
    folder.mkdir(parents=True)
    text = run("camera", "show", "small")
    for key, value in {"rows": 64, "columns": 80, "overhang": '"0.3 mm"'}.items():
        text = re.sub(rf"^{key} = .*", f"{key} = {value}", text, flags=re.MULTILINE)
    (folder / "camera.toml").write_text(text)
    row, column = np.mgrid[:120, :160]
    scene = np.stack([2 * row, column, 200 * ((row // 20 + column // 20) % 2)], -1)
    Image.fromarray(scene.astype(np.uint8)).save(folder / "scene.png")
    camera = ("--camera", folder / "camera.toml", "--light", "550nm")
    run("simulate", folder / "scene.png", *camera, "-o", folder / "raw.dng")
    for seed in (1, 2):
        run("psf", *camera, "--seed", seed, "-o", folder / f"psf-{seed}.dng")
    frames = [folder / f"psf-{seed}.dng" for seed in (1, 2)]
    to = ("--distance", "300mm", "--camera", folder / "camera.toml", "-o", folder / "camera")
    run("calibrate", *frames, *to)
    (folder / "frames").mkdir()
    for number in range(3):
        shutil.copy(folder / "raw.dng", folder / "frames" / f"frame-{number}.dng")
    return folder


def run(*arguments: object) -> str:
    """A command that is needed to its end."""
    line = [str(NOLENS), *map(str, arguments)]
    done = subprocess.run(line, capture_output=True, text=True, env=ENVIRONMENT, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(line)}: {done.stderr}")
    return done.stdout


def start(line: list[str]) -> "subprocess.Popen[str]":
    """A process of one thread, whose outputs are read."""
    return subprocess.Popen(
        line, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        text=True, env=ENVIRONMENT,
    )  # fmt: skip


def reference(command: Command, inputs: Path, folder: Path) -> Reference:
    """What a command leaves when nothing ends it; it must run twice."""
    out = folder / f"reference, {command.name}"
    out.mkdir()
    seconds = 0.0
    for _ in range(2):  # The first one compiles.
        began = time.monotonic()
        with start(command.line(inputs, out)) as process:
            error = process.communicate(timeout=LONGEST_S)[1]
        seconds = time.monotonic() - began
        if process.returncode:
            raise SystemExit(f"{command.name} does not run: {error}")
    wrong = [text for name in names(out) for text in unreadable(out / name)]
    if wrong:
        raise SystemExit(f"{command.name}: {'; '.join(wrong)}")
    return Reference(out, names(out), seconds)


def renewed(out: Path, good: Reference, before: dict[str, int]) -> bool:
    """Whether a run has written all of its files."""
    after = stamps(out)
    return all(after.get(name, 0) != before.get(name, 0) for name in good.names)


def ended(
    this: Ended, references: dict[Command, Reference], inputs: Path, out: Path, place: int
) -> Ended:
    """End a run at its moment, see what it left, and run it again."""
    good = references[this.command]
    if place // len(COMMANDS) % 2:
        shutil.copytree(good.folder, out)
    else:
        out.mkdir()
    before = stamps(out)
    line = this.command.line(inputs, out)
    with start(line) as process:
        time.sleep(this.moment)
        finished = renewed(out, good, before)
        process.send_signal(this.number)
        sent = time.monotonic()
        try:
            error = process.communicate(timeout=LONGEST_S)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            error = process.communicate()[1]
            this.wrong.append("did not end")
        # Its last file may have been written between the look and the signal.
        finished |= time.monotonic() - sent < AT_THE_END_S and renewed(out, good, before)
    judge_end(this, process.returncode, error, finished=finished)
    judge_files(this, out, good, set(before))
    with start(line) as process:
        error = process.communicate(timeout=LONGEST_S)[1]
    if process.returncode or BROKEN.search(error):
        this.wrong.append(f"the rerun ended with {process.returncode}: {error.strip()[-300:]}")
    judge_rerun(this, out, good)
    if not this.wrong:
        shutil.rmtree(out)
    return this


def judge_end(this: Ended, code: int, error: str, *, finished: bool) -> None:
    """Exit code and words of a run that was ended."""
    broken = BROKEN.search(error) is not None
    if this.number == signal.SIGKILL:
        this.how = "killed" if code == -signal.SIGKILL else "finished"
        if code not in (0, -signal.SIGKILL):
            this.wrong.append(f"exit code {code}")
    elif broken and not OURS.search(FIRST_LINES.sub("", error)):
        this.how = "Python's start"
    elif code == 130:
        this.how = "kept" if "so far will be written" in error else "stopped"
    elif code == -signal.SIGINT and not error:
        this.how = "stopped"  # Before Python took the signal over: 130 to a shell.
    elif code == 0 and finished:
        this.how = "finished"
    else:
        this.how = "wrong"
        this.wrong.append(f"exit code {code} {'at the end' if finished else 'before the end'}")
    if broken and this.how != "Python's start":
        this.wrong.append(f"a traceback: {error.strip()[-300:]}")


def judge_files(this: Ended, out: Path, good: Reference, before: set[str]) -> None:
    """What a run that was ended left: each output whole or not at all, and nothing else."""
    for name in names(out):
        if ".nolens-" in name and this.number == signal.SIGKILL:
            continue
        if name not in good.names and not name.endswith(STATE):
            this.wrong.append(f"{name} is left")
        else:
            this.wrong += unreadable(out / name)
    this.wrong += [f"{name} is gone" for name in before - names(out)]
    if this.number == signal.SIGINT:
        empty = [path for path in out.rglob("*") if path.is_dir() and not any(path.iterdir())]
        this.wrong += [f"{path.name} is left empty" for path in empty]


def judge_rerun(this: Ended, out: Path, good: Reference) -> None:
    """The same files as of a run that nothing ended, with the same pictures in them."""
    left = {name for name in names(out) if not name.endswith(STATE)}
    if left != good.names:
        this.wrong.append(f"the rerun left {sorted(left ^ good.names)} too many or too few")
    for name in sorted(left & good.names):
        trouble = unreadable(out / name)
        if not trouble and Path(name).suffix in PICTURES:
            one, other = (pixels(folder / name) for folder in (out, good.folder))
            if one.shape != other.shape or np.abs(one - other).max() > 1e-2 * np.abs(other).max():
                trouble = ["differs from a run that nothing ended"]
        this.wrong += [f"after the rerun, {text}" for text in trouble]


def pixels(path: Path) -> np.ndarray:
    """What a picture holds; a stack's pages are no frame."""
    if path.name == "stack.tif":
        return tifffile.imread(path).astype(np.float64)
    return read_frame(path).counts.numpy().astype(np.float64)


def read_json(path: Path) -> object:
    return json.loads(path.read_text())


def read_html(path: Path) -> None:
    if not path.read_text().rstrip().endswith("</html>"):
        raise ValueError("it has no end")


def read_csv(path: Path) -> None:
    if not path.read_text().endswith("\n"):
        raise ValueError("it has no end")


PICTURES = (".png", ".tif", ".dng")
READERS: dict[str, Callable[[Path], object]] = {
    ".npz": lambda path: dict(np.load(path)),
    ".json": read_json,
    ".toml": lambda path: tomllib.loads(path.read_text()),
    ".html": read_html,
    ".csv": read_csv,
    ".pdf": lambda path: [page.extract_text() for page in pypdf.PdfReader(path).pages],
    ".stl": lambda path: trimesh.load_mesh(path).volume,
    ".3mf": lambda path: zipfile.ZipFile(path).testzip(),
    ".gds": lambda path: gdstk.read_gds(path),
    ".oas": lambda path: gdstk.read_oas(path),
}


def unreadable(path: Path) -> list[str]:
    """What is wrong with an output; nothing if it can be read to its end."""
    try:
        (pixels if path.suffix in PICTURES else READERS[path.suffix])(path)
    except Exception as error:
        return [f"{path.name} is no whole file: {type(error).__name__}: {error}"]
    return []


def names(out: Path) -> set[str]:
    """All files below a folder."""
    return {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}


def stamps(out: Path) -> dict[str, int]:
    """When each file was written."""
    found = {}
    for name in names(out):
        try:
            found[name] = (out / name).stat().st_mtime_ns
        except OSError:  # A temporary one, gone by now.
            continue
    return found


def interrupted_python(moment: float) -> float | None:
    """The moment, if Python alone says a traceback when it is interrupted then."""
    with start([sys.executable, "-c", "pass"]) as process:
        time.sleep(moment)
        process.send_signal(signal.SIGINT)
        error = process.communicate()[1]
    return moment if BROKEN.search(error) else None


def of(moments: list[float]) -> str:
    """How many there are, and from when to when."""
    if not moments:
        return "0"
    return f"{len(moments)} ({1e3 * min(moments):.0f} to {1e3 * max(moments):.0f} ms)"


def told(each: Ended) -> str:
    """A run in a line."""
    text = f"{each.command.name}, {each.number.name} after {1e3 * each.moment:.0f} ms: {each.how}"
    return "; ".join([text, *each.wrong])


def table(done: list[Ended], references: dict[Command, Reference]) -> str:
    """How the runs of each command ended."""
    heads = ["killed", "stopped", "kept", "finished", "Python's start", "wrong"]
    lines = [f"{'command':<22} {'seconds':>7} " + " ".join(f"{head:>14}" for head in heads)]
    for command, good in references.items():
        mine = [each for each in done if each.command is command]
        counts = Counter(each.how for each in mine)
        counts["wrong"] = sum(bool(each.wrong) for each in mine)
        cells = " ".join(f"{counts[head]:>14}" for head in heads)
        lines.append(f"{command.name:<22} {good.seconds:>7.1f} {cells}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
