"""What a job tells whoever watches it run."""

from nolens.solvers import Progress


class Reporter:
    """Whoever watches a job run; this one says nothing and lets it run to its end.

    Others derive from it and show what they want to.
    """

    def note(self, text: str) -> None:
        """Say something a person should know before it happens."""

    def warn(self, text: str) -> None:
        """Say what may make the result worse than it could be."""

    def advance(self, what: str, share: float) -> None:
        """See how much of a piece of work is done, from 0 to 1."""

    def step(self, what: str, done: int, limit: int, kept: str) -> bool:
        """See how many steps of some work are done; True ends it, and what it kept is written."""
        return False

    def progress(self, progress: Progress, limit: int) -> bool:
        """See an iteration; True stops the solver, and the picture so far is written."""
        return False
