"""What a person at a terminal sees of a running job."""

import signal
import sys
from types import FrameType, TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from nolens.cli.messages import say
from nolens.solvers import Progress as Iteration


class TerminalReporter:
    """Notes and warnings on standard error; a progress bar where that is a terminal.

    The first Ctrl-C from the first iteration on ends the solver after its iteration, and the
    picture so far is written; a second one, or one during any other work, stops at once.
    """

    def __init__(self) -> None:
        self.interrupted = False
        self._solving = False
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        self._work = ""
        # FORCE_COLOR and the like make rich take anything for a terminal.
        if sys.stderr is not None and sys.stderr.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.fields[state]}"),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )

    def __enter__(self) -> "TerminalReporter":
        self._before = signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        signal.signal(signal.SIGINT, self._before)
        if self._bar is not None:
            self._bar.stop()

    def note(self, text: str) -> None:
        """Say something a person should know before it happens."""
        say(text)

    def warn(self, text: str) -> None:
        """Say what may make the picture worse than it could be."""
        say(f"warning: {text}")

    def advance(self, what: str, share: float) -> None:
        """Show how much of a piece of work is done, from 0 to 1."""
        self._solving = False
        self._show(what, what, f"{100 * share:.0f} %", share, 1.0)

    def progress(self, progress: Iteration, limit: int) -> bool:
        """Show an iteration; True if the person wants to stop."""
        self._solving = True
        at = progress.iteration
        state = f"objective {progress.objective:.4g}"
        self._show("iterations", f"iteration {at}/{limit}", state, at, limit)
        return self.interrupted

    def _show(self, work: str, text: str, state: str, done: float, total: float) -> None:
        """Move the bar; a new one, with a clock of its own, for other work than before."""
        if self._bar is None:
            return
        if self._task is None or work != self._work:
            if self._task is not None:
                self._bar.remove_task(self._task)
            self._bar.start()
            self._task, self._work = self._bar.add_task(text, total=total, state=state), work
        self._bar.update(self._task, description=text, completed=done, state=state)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted or not self._solving:
            raise KeyboardInterrupt
        self.interrupted = True
        say("stopping after this iteration; the picture so far will be written")
