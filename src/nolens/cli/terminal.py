"""What a person at a terminal sees of a running job."""

import signal
import sys
from contextlib import suppress
from types import FrameType, TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from nolens.amounts import duration_text
from nolens.cli.messages import say
from nolens.jobs.run import Reporter
from nolens.printable import printable
from nolens.progress import Pace
from nolens.solvers import Progress as Iteration

_LONG_S = 60.0
"""Work that takes longer is worth a line."""


class TerminalReporter(Reporter):
    """Notes and warnings on standard error; a progress bar where that is a terminal.

    Where it is none, work that takes minutes says so once its pace is known, and again when half
    of that is left, or twice as much, as after slow first steps.

    The first Ctrl-C during work that goes in steps ends it after a step, and what is done so far
    is written. A second one, or one during any other work, does what it did before the job: the
    command stops at once (`nolens.interrupt`).
    """

    def __init__(self) -> None:
        self.interrupted = False
        self._promise: str | None = None
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        self._work = ""
        self._pace, self._announced, self._announced_s = Pace(), "", 0.0
        # FORCE_COLOR and the like make rich take anything for a terminal.
        if sys.stderr is not None and sys.stderr.isatty():
            self._bar = Progress(
                # Brackets in a name are no markup.
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TextColumn("{task.fields[state]}", markup=False),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )

    def __enter__(self) -> "TerminalReporter":
        self._before = signal.getsignal(signal.SIGINT)
        signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        signal.signal(signal.SIGINT, self._before)
        self._put_away()

    def note(self, text: str) -> None:
        """Say something a person should know before it happens."""
        say(text)

    def warn(self, text: str) -> None:
        """Say what may make the picture worse than it could be."""
        say(f"warning: {text}")

    def advance(self, what: str, fraction: float) -> None:
        """Show how much of a piece of work is done, from 0 to 1."""
        self._promise = None
        self._show(what, what, f"{100 * fraction:.0f} %", fraction, 1.0)

    def progress(self, progress: Iteration, limit: int) -> bool:
        """Show an iteration; True if the person wants to stop."""
        state = f"objective {progress.objective:.4g}"
        return self.step("iteration", progress.iteration, limit, "the picture", state)

    def step(self, what: str, done: int, limit: int, result: str, state: str = "") -> bool:
        """Show how many steps are done; True if the person wants to stop and keep what there is."""
        percent = what.startswith("%")
        ending = "soon" if percent else f"after this {what}"
        self._promise = f"stopping {ending}; {result} so far will be written"
        text = f"{done} {what}" if percent else f"{what} {done}/{limit}"
        self._show(what, text, state, done, limit)
        return self.interrupted

    def _show(self, work: str, text: str, state: str, done: float, total: float) -> None:
        """Move the bar; a new one, with a clock of its own, for other work than before."""
        left = self._pace.seconds_left(work, done / total)
        if self._bar is None:
            if left is not None and left > _LONG_S and self._pace.sure:
                self._announce(work, text, left)
            return
        if not state and left is not None:
            state = _rate_text(total * self._pace.per_second(done / total))
        text = printable(text)
        if self._task is None or work != self._work:
            if self._task is not None:
                self._bar.remove_task(self._task)
            self._bar.start()
            self._task, self._work = self._bar.add_task(text, total=total, state=state), work
        self._bar.update(self._task, description=text, completed=done, state=state)

    def _announce(self, work: str, text: str, left: float) -> None:
        """Say how long work takes, unless that is about what was said of it."""
        about_as_said = self._announced_s / 2 < left < self._announced_s * 2
        if work != self._announced or not about_as_said:
            self._announced, self._announced_s = work, left
            say(f"{printable(text)}: about {duration_text(left)} to go")

    def _put_away(self) -> None:
        """Give the terminal back as it was."""
        if self._bar is not None:
            # Ctrl-C in the midst of its start, or of a write, leaves it in any state.
            with suppress(Exception):
                self._bar.stop()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if not self.interrupted and self._promise is not None:
            self.interrupted = True
            say(self._promise)
            return
        self._put_away()
        if callable(self._before):
            self._before(number, frame)
        else:  # Python started with Ctrl-C switched off, as behind nohup, but it was meant.
            raise KeyboardInterrupt


def _rate_text(rate: float) -> str:
    """Steps in a second, or seconds for a step."""
    return f"{rate:.3g}/s" if rate >= 1 else f"{1 / rate:.3g} s each" if rate > 0 else ""
