"""What a job tells whoever watches it run."""

from typing import Protocol

from nolens.solvers import Progress


class Reporter(Protocol):
    """Whoever watches a job run."""

    def note(self, text: str) -> None:
        """Say something a person should know before it happens."""

    def warn(self, text: str) -> None:
        """Say what may make the result worse than it could be."""

    def advance(self, what: str, share: float) -> None:
        """See how much of a piece of work is done, from 0 to 1."""

    def step(self, what: str, done: int, limit: int, kept: str) -> bool:
        """See how many steps of some work are done; True ends it, and what it kept is written."""

    def progress(self, progress: Progress, limit: int) -> bool:
        """See an iteration; True stops the solver, and the picture so far is written."""
