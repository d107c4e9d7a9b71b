"""Whoever watches a job run, and remembers what it was told."""

from nolens.jobs import Reporter


class Watcher(Reporter):
    """Remembers what it is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self.fractions: list[float] = []

    def note(self, text: str) -> None:
        self.notes.append(text)

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def advance(self, what: str, fraction: float) -> None:
        self.fractions.append(fraction)
