"""The bar that a person sees while a job runs."""

import io
import re
import sys

import pytest
import torch

from nolens.cli.terminal import TerminalReporter
from nolens.solvers import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown(monkeypatch: pytest.MonkeyPatch, stream: io.StringIO) -> str:
    monkeypatch.setattr(sys, "stderr", stream)
    with TerminalReporter() as reporter:
        reporter.advance("mask", 0.0)
        for share in (0.25, 0.5):
            reporter.advance("scene", share)
        step = Progress(7, 0.125, 0.1, 0.1, 0.1, (1.0,), lambda: torch.zeros(1))
        assert reporter.progress(step, 90) is False
        reporter.advance("[red]file[/nothing]\x1b[2J", 0.0)
        reporter.advance("scene", 1.0)
    return stream.getvalue()


def test_each_piece_of_work_has_its_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bar is drawn ten times a second; new work is drawn at once."""
    text = shown(monkeypatch, Terminal())
    for words in (
        "mask .*0 %.*-:--:--",
        "scene .*%",
        "iteration 7/90",
        "scene .*100 %.*0:00:00",
        r"\[red\]file\[/nothing\]\\u001b\[2J .*0 %",
    ):
        assert re.search(words, text), (words, text)


def test_no_bar_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    assert shown(monkeypatch, io.StringIO()) == ""


def test_without_a_terminal_the_time_to_go_is_told_by_the_pace(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """When the pace has been seen for some seconds, and half later; only for what takes minutes."""
    stream, now = io.StringIO(), 1000.0
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr("nolens.progress.time.perf_counter", lambda: now)
    with TerminalReporter() as reporter:
        reporter.advance("mask", 0.0)
        for work, seconds in (("scene", 400.0), ("picture", 40.0)):
            for percent in range(101):
                reporter.advance(work, percent / 100)
                now += seconds / 100
        for done in range(21):  # The first step is slow.
            reporter.step("step", done, 20, "the PSF")
            now += 60.0 if done else 600.0
        for done in range(0, 101, 50):
            reporter.step("% of the sweep", done, 100, "the pictures")
            now += 200.0
    assert stream.getvalue().replace("nolens: ", "").splitlines() == [
        "scene: about 7 min to go",
        "scene: about 3 min to go",
        "scene: about 2 min to go",
        "step 1/20: about 3.2 h to go",
        "step 3/20: about 68 min to go",
        "step 7/20: about 30 min to go",
        "step 12/20: about 14 min to go",
        "step 16/20: about 6 min to go",
        "step 18/20: about 3 min to go",
        "step 19/20: about 88 s to go",
        "50 % of the sweep: about 3 min to go",
    ]


def test_ctrl_c_while_the_bar_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is Ctrl-C that comes out, not what rich makes of a bar that it only half started."""

    def interrupted(*_: object) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr("rich.console.Console.set_live", interrupted)
    with pytest.raises(KeyboardInterrupt), TerminalReporter() as reporter:
        reporter.advance("mask", 0.0)
