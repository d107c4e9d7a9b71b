"""Ctrl-C, kills, pipes that break, terminals, and bugs."""

import importlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from little_camera import Camera, save
from running import NOLENS, command, listing, read_terminal, run, start

from nolens.cli.terminal import TerminalReporter
from nolens.files import read_frame
from nolens.solvers import Reconstructor
from patience import PATIENCE_S

JOB = importlib.import_module("nolens.jobs.reconstruction.job")
"""The module; its name in the package is the function's."""


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> tuple[object, ...]:
    """Arguments of a run that goes on for minutes, and prints nothing before it ends."""
    folder = tmp_path_factory.mktemp("large")
    generator = torch.Generator().manual_seed(0)
    spots = (torch.rand(1, 240, 320, generator=generator) < 2e-3).float()
    raw = save(folder / "raw.npy", torch.rand(1, 240, 320, generator=generator))
    psf = save(folder / "psf.npy", spots)
    asked = ("--support", "full", "--tau", 1e-4, "--iterations", 100_000, "--tolerance", 0)
    return "reconstruct", raw, "--psf", psf, *asked


def test_ctrl_c_on_a_terminal_keeps_the_picture_so_far(
    large: tuple[object, ...], tmp_path: Path
) -> None:
    png = tmp_path / "out.png"
    ours, theirs = pty.openpty()
    with start(*large, "-o", png, "--json", stderr=theirs) as process:
        os.close(theirs)
        shown = read_terminal(ours, r"iteration [1-9]\d+/100000")
        # The bar: iteration of limit, objective, time left.
        assert re.search(r"objective \S*\d.*?\d+:\d\d", shown, re.DOTALL), shown[-300:]
        process.send_signal(signal.SIGINT)
        shown = read_terminal(ours, "")
        out = process.communicate(timeout=PATIENCE_S)[0]
    os.close(ours)
    assert process.returncode == 130
    assert "the picture so far will be written" in shown
    assert out.count("\n") == 1
    summary = json.loads(out)
    assert summary["stop_reason"] == "interrupted" and 1 < summary["iterations"] < 100_000
    assert read_frame(png).counts.shape == (1, 240, 320)
    record = json.loads((tmp_path / "out.json").read_text())
    assert record["result"] == summary
    assert record["history"][-1]["iteration"] == summary["iterations"]
    state = tmp_path / "out.state.npz"
    assert sorted(listing(tmp_path)) == ["out.json", "out.png", state.name]
    assert str(state) in summary["outputs"]
    limit = summary["iterations"] + 5
    done = run(*large[:8], "--iterations", limit, "--tolerance", 0, "-o", png, "--resume", state)
    assert done.code == 0, done.err
    assert json.loads((tmp_path / "out.json").read_text())["result"]["iterations"] == limit


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="sees by /proc what is loaded")
@pytest.mark.parametrize("library", ["libtorch_cpu", "llvmlite"])
def test_ctrl_c_before_the_iterations(
    library: str, large: tuple[object, ...], tmp_path: Path
) -> None:
    """While the libraries load, which takes longer than all else that comes before."""
    with start(*large, "-o", tmp_path / "out.png") as process:
        maps = Path(f"/proc/{process.pid}/maps")
        while process.poll() is None and library not in maps.read_text():
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, err
    assert out == "" and "Traceback" not in err
    assert "stopped at once" in err
    assert listing(tmp_path) == {}


STOPPED = """
import os, signal, sys
import nolens, nolens.jobs
assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
from nolens.__main__ import main
from nolens.files.atomic import write_together
from nolens.files.atomic import write_into
from pathlib import Path

def write(path):
    path.write_text("half")
    if path.parent.name == "new":
        signal.raise_signal(signal.SIGINT)

def replace(self, other, before=Path.replace):
    signal.raise_signal(signal.SIGINT)
    return before(self, other)

if sys.argv[1] == "together":
    Path.replace = replace
    write_together({Path("a.txt"): write, Path("b.txt"): write})
elif sys.argv[1] == "folder":
    write_into(Path("above/new"), {Path("above/new/a.txt"): write})
else:
    import atexit
    atexit.register(signal.raise_signal, signal.SIGINT)
    sys.argv[1:] = ["--version"]
    main()
"""


@pytest.mark.parametrize(
    ("when", "code", "left"),
    [("together", 130, ["a.txt", "b.txt"]), ("folder", 130, []), ("afterwards", 0, [])],
)
def test_ctrl_c_leaves_nothing_half(when: str, code: int, left: list[str], tmp_path: Path) -> None:
    """Files of one result are written together or not; who imports the package has their Ctrl-C."""
    done = subprocess.run(
        [sys.executable, "-c", STOPPED, when], cwd=tmp_path, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    said = "" if code == 0 else "nolens: stopped at once; files that were not finished are not wr"
    assert (done.returncode, list(listing(tmp_path))) == (code, left), done.stderr
    assert done.stderr.startswith(said) and done.stderr.count("\n") == bool(said)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_killed_run_leaves_the_earlier_picture(
    number: signal.Signals, large: tuple[object, ...], tmp_path: Path
) -> None:
    png = tmp_path / "out.png"
    png.write_bytes(b"earlier")
    ours, theirs = pty.openpty()
    with start(*large, "-o", png, stderr=theirs) as process:
        os.close(theirs)
        read_terminal(ours, "iteration [1-9]")
        process.send_signal(number)
        process.communicate(timeout=PATIENCE_S)
    os.close(ours)
    assert process.returncode == -number
    assert png.read_bytes() == b"earlier"
    assert list(listing(tmp_path)) == ["out.png"]


def test_reader_that_leaves(camera: Camera) -> None:
    line = f"{NOLENS} info {camera.raw} | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_standard_output_that_is_full(camera: Camera) -> None:
    with Path("/dev/full").open("w") as full:
        done = command("info", camera.raw, stdout=full)
    assert done.code == 2
    assert done.err == "nolens: cannot write to standard output: No space left on device\n"


def test_bug_is_raised(camera: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python then shows where, and leaves with code 1."""

    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr(Reconstructor, "solve", broken)
    with pytest.raises(RuntimeError, match="a bug"):
        run("reconstruct", camera.raw, "--psf", camera.psf, "-o", tmp_path / "out.png")
    assert listing(tmp_path) == {}


def test_bug_while_writing_leaves_nothing(
    camera: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr(JOB, "write_tiff16", broken)
    names = ("-o", tmp_path / "a.png", "-o", tmp_path / "b.tif")
    with pytest.raises(RuntimeError, match="a bug"):
        run("reconstruct", camera.raw, "--psf", camera.psf, *names, "--iterations", 2)
    assert listing(tmp_path) == {}


def test_ctrl_c_twice_stops_at_once(
    camera: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    watch = TerminalReporter.progress

    def press(self: TerminalReporter, *about: object) -> bool:
        stop = watch(self, *about)  # type: ignore[arg-type]
        seen.append(stop)
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        return stop

    monkeypatch.setattr(TerminalReporter, "progress", press)
    before = signal.getsignal(signal.SIGINT)
    done = run("reconstruct", camera.raw, "--psf", camera.psf, "-o", tmp_path / "out.png")
    assert done.code == 130 and seen == [False]
    assert "stopped at once" in done.err
    assert listing(tmp_path) == {}
    assert signal.getsignal(signal.SIGINT) is before
