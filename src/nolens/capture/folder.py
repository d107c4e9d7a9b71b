"""A folder that another camera writes raw files into, as a source of frames."""

import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from threading import Event
from typing import Self

from nolens.capture.source import CameraSource, Shot
from nolens.errors import CameraError, NolensError, OptionError
from nolens.files import frame_suffixes, read_frame

_POLL_S = 0.2
_QUIET_S = 0.4
"""How long a file must stay the same before it counts as written."""

_State = tuple[int, int]
"""Time of the last change in ns, and size in bytes."""


class FolderSource(CameraSource):
    """New raw files of a folder, each one once it has stopped growing, in the order of their time.

    Parameters
    ----------
    folder
        The folder; those inside it are passed over.
    existing
        Whether files that are there already are handed over first.
    mosaic
        As `nolens.files.read_frame` takes it.
    warn
        Called with a sentence about each file that cannot be read; it is passed over until it
        changes.
    """

    def __init__(
        self,
        folder: Path,
        *,
        existing: bool = False,
        mosaic: str | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> None:
        self._folder, self._existing, self._mosaic = folder, existing, mosaic
        self._warn = warn
        self._done: dict[Path, _State] | None = None
        self._observed: dict[Path, tuple[_State, float]] = {}
        self._closed = Event()

    @classmethod
    def of(
        cls,
        text: str,
        *,
        existing: bool,
        mosaic: str | None,
        warn: Callable[[str], None] | None,
    ) -> Self | None:
        """The source of ``folder:PATH``, for `open_source`."""
        if not text:
            return None
        folder = Path(text)
        with suppress(RuntimeError):  # No such user: then it is a name like any other.
            folder = folder.expanduser()
        return cls(folder, existing=existing, mosaic=mosaic, warn=warn)

    @property
    def name(self) -> str:
        """Of the folder."""
        return f"folder {self._folder}"

    @property
    def limits(self) -> None:
        """None: what takes these frames is set elsewhere."""
        return None

    def open(self) -> None:
        """Begin to watch."""
        if self._done is None:
            now = self._files()
            self._done = {} if self._existing else now
            self._observed.clear()
            self._closed.clear()

    def set(self, *, exposure_s: float, gain: float) -> None:
        """Refuse: nothing can be set."""
        raise OptionError(
            f"exposure and gain of the camera behind {self._folder} cannot be set from here: set "
            "them at that camera"
        )

    def shot(self) -> Shot:
        """Wait for the next file, until it is closed from another thread or the folder is gone."""
        while self._done is not None:
            for path, state in self._written(self._done):
                self._done[path] = state
                try:
                    return self._read(path, state)
                except NolensError as error:
                    if self._warn is not None:
                        self._warn(f"{error}. It is passed over")
            if self._closed.wait(_POLL_S):
                break
        raise CameraError(f"{self._folder} is not watched, or not any more: open it first")

    def close(self) -> None:
        """Stop watching."""
        self._done = None
        self._closed.set()

    def _files(self) -> dict[Path, _State]:
        files = {}
        try:
            for path in self._folder.iterdir():
                if path.suffix.lower() in frame_suffixes() and not path.name.startswith("."):
                    try:
                        stat = path.stat()
                    except OSError:  # It was moved or deleted since it was listed.
                        continue
                    files[path] = stat.st_mtime_ns, stat.st_size
        except OSError as error:
            raise CameraError(
                f"cannot watch {self._folder}: {error.strerror or error}. Give a folder that "
                "exists, into which the camera's raw files are written"
            ) from error
        return files

    def _written(self, done: dict[Path, _State]) -> list[tuple[Path, _State]]:
        """Files that are new and have stopped growing, the oldest first."""
        new = {path: state for path, state in self._files().items() if done.get(path) != state}
        observed = {}
        at = time.monotonic()
        for path, state in new.items():
            before, since = self._observed.get(path, (None, at))
            observed[path] = state, since if before == state else at
        self._observed = observed
        written = [
            (path, state)
            for path, (state, since) in observed.items()
            if at - since >= _QUIET_S and state[1] > 0
        ]
        return sorted(written, key=lambda each: (each[1][0], each[0]))

    def _read(self, path: Path, state: _State) -> Shot:
        frame = read_frame(path, mosaic=self._mosaic)
        return Shot(
            frame,
            datetime.fromtimestamp(state[0] * 1e-9, UTC),
            frame.exposure_s or 0.0,
            0.0,
            self.name,
            {"file": str(path)},
        )
