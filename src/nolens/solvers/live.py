"""A stream beside a camera that does not wait."""

from collections.abc import Callable
from threading import Condition, Thread
from types import TracebackType

from nolens.errors import NolensError
from nolens.solvers.inputs import Plane
from nolens.solvers.stream import Frame, Stream


class Live:
    """Solves the newest frame of a camera, always, in a thread of its own.

    One frame waits at most. A newer one takes its place, and the older is counted as dropped: what
    is shown is never older than the frame in work and the one that waits, and memory does not
    grow, however slow the solver is. Frames that cannot be solved for are counted as refused.

    Used as a context; at its end the frame that waits is still solved.

    Parameters
    ----------
    stream
        What solves; nobody else may use it meanwhile.
    show
        Called with every picture, in the thread of the solver. What it raises ends the thread, and
        is raised again at the end of the context.
    """

    def __init__(self, stream: Stream, show: Callable[[Frame], None]) -> None:
        self.dropped = 0
        self.refused = 0
        self._stream, self._show = stream, show
        self._waiting: tuple[Plane, Plane | None] | None = None
        self._ending = False
        self._failure: BaseException | None = None
        self._changed = Condition()
        self._thread = Thread(target=self._work, name="nolens-live", daemon=True)

    def __enter__(self) -> "Live":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._changed:
            self._ending = True
            self._changed.notify()
        self._thread.join()
        if self._failure is not None and error is None:
            raise self._failure

    def offer(self, data: Plane, valid: Plane | None = None) -> None:
        """Hand over the newest frame, and return at once.

        Parameters
        ----------
        data, valid
            As `Stream.solve` takes them; not to be changed afterwards.
        """
        with self._changed:
            self.dropped += self._waiting is not None
            self._waiting = data, valid
            self._changed.notify()

    def _next(self) -> tuple[Plane, Plane | None] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None or self._ending)
            frame, self._waiting = self._waiting, None
            return frame

    def _work(self) -> None:
        try:
            while (frame := self._next()) is not None:
                try:
                    solved = self._stream.solve(*frame)
                except NolensError:
                    self.refused += 1
                    continue
                self._show(solved)
        except BaseException as failure:
            self._failure = failure
