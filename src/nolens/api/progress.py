"""Progress of what takes a while: silent, a bar, or a function that is called."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = bool | Callable[[float], object]
"""False is silent, True draws a bar; a function is called with the fraction that is done."""


@contextmanager
def reported(progress: Progress, what: str) -> Iterator[Callable[[float], None]]:
    """A function for the fraction that is done, which shows it as was asked for.

    Parameters
    ----------
    progress
        What was asked for.
    what
        Beside the bar.
    """
    if progress is True:
        from rich.progress import Progress as Bar

        with Bar(transient=True) as bar:
            task = bar.add_task(what, total=1.0)
            yield lambda done: bar.update(task, completed=done)
        return
    call = progress

    def tell(done: float) -> None:
        if callable(call):
            call(done)

    yield tell
