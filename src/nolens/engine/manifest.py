"""What is done of many items, kept beside the results."""

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from nolens.errors import FileError, OptionError
from nolens.files.atomic import Writer, write_into

MANIFEST_FILE = "manifest.sqlite"
_LAYOUT = "1"
_TABLES = """
create table about (name text primary key, value text not null);
create table notes (name text primary key, value text not null);
create table items (
    place integer primary key, key text unique not null, state text not null, row text not null
);
"""
_STATES = ("waiting", "writing", "done", "failed")
_LONGEST = 80


class Manifest:
    """The state of each item in a folder: ``waiting``, ``writing``, ``done`` or ``failed``.

    Only the process of the command writes it, and one at a time. Killed at any moment, it knows
    what was written: an item is ``writing`` before its files are, and ``done`` after them; when it
    is opened again, one that is ``writing`` is done if all of its files are there.

    Use `Manifest.open`, and close it.
    """

    def __init__(self, folder: Path, database: sqlite3.Connection, lock: int | None) -> None:
        self._folder, self._database, self._lock = folder, database, lock

    @classmethod
    def open(cls, folder: Path, about: Mapping[str, str], keys: Iterable[str]) -> Self:
        """Go on with the manifest of a folder, or begin one.

        Parameters
        ----------
        folder
            Made where it does not exist.
        about
            What the results depend on: version, options, inputs, as texts by name.
        keys
            All items, in their order.

        Raises
        ------
        OptionError
            If the folder has a manifest of other items, options, inputs or another version, or
            another command works on it.
        FileError
            If it cannot be read or written.
        """
        path = folder / MANIFEST_FILE
        about = {"layout of the manifest": _LAYOUT, **about}
        with _writing(path):
            folder.mkdir(parents=True, exist_ok=True)
            lock = _locked(folder)
            try:
                database = sqlite3.connect(path, isolation_level=None)
                manifest = cls(folder, database, lock)
                manifest._begin(about, keys)
            except BaseException:
                if lock is not None:
                    os.close(lock)
                raise
        return manifest

    def _begin(self, about: Mapping[str, str], keys: Iterable[str]) -> None:
        # A journal that stays until the end: to make and remove one costs 15 ms for each state. No
        # write-ahead log, as network file systems have none.
        self._database.execute("pragma journal_mode = persist")
        self._database.execute("pragma synchronous = normal")
        with self._transaction():
            made = self._database.execute("select 1 from sqlite_master").fetchone()
            if made and not self._has_results:
                for table in ("about", "notes", "items"):
                    self._database.execute(f"drop table {table}")
                made = None
            if not made:
                for statement in _TABLES.split(";"):
                    self._database.execute(statement)
                self._database.executemany("insert into about values (?, ?)", about.items())
                self._database.executemany(
                    "insert into items (key, state, row) values (?, 'waiting', '{}')",
                    ((key,) for key in keys),
                )
                return
            self._check(about, keys)
            for key, text in self._database.execute(
                "select key, row from items where state = 'writing'"
            ).fetchall():
                there = all((self._folder / name).exists() for name in json.loads(text)["files"])
                self._set(key, "done" if there else "waiting", text)

    @property
    def _has_results(self) -> bool:
        """Whether anything came of an item; else the folder is as good as new."""
        found = self._database.execute("select 1 from items where state != 'waiting' limit 1")
        return found.fetchone() is not None

    def _check(self, about: Mapping[str, str], keys: Iterable[str]) -> None:
        before = dict(self._database.execute("select name, value from about"))
        for name in {**about, **before}:
            here, there = about.get(name, "nothing"), before.get(name, "nothing")
            if here != there:
                raise OptionError(
                    f"{self._folder} has results with another {name}: {_short(there)} there, "
                    f"{_short(here)} now. Give the same again to go on, or another folder (-o)"
                )
        stored = [key for (key,) in self._database.execute("select key from items order by place")]
        given, known = list(keys), {*stored}
        if stored != given:
            other = next((key for key in given if key not in known), None)
            what = f"{len(given)} items now" if other is None else f"{other!r} is not among them"
            raise OptionError(
                f"{self._folder} has results of {len(stored)} other items: {what}. Give the same "
                "input again to go on, or another folder (-o)"
            )

    @property
    def counts(self) -> dict[str, int]:
        """How many items are in each state."""
        found = self._database.execute("select state, count(*) from items group by state")
        return dict.fromkeys(_STATES, 0) | dict(found.fetchall())

    @property
    def missing(self) -> list[str]:
        """Items that are not done, in their order; those that failed before are tried again."""
        found = self._database.execute("select key from items where state != 'done' order by place")
        return [key for (key,) in found]

    def rows(self, state: str) -> dict[str, dict[str, Any]]:
        """What was kept of the items in a state, in their order."""
        found = self._database.execute(
            "select key, row from items where state = ? order by place", (state,)
        )
        return {key: json.loads(text) for key, text in found}

    @property
    def notes(self) -> dict[str, Any]:
        """What runs before noted for those that go on."""
        found = self._database.execute("select name, value from notes")
        return {name: json.loads(value) for name, value in found}

    def note(self, **values: Any) -> None:
        """Note values that JSON has, for runs that go on.

        Raises
        ------
        FileError
            If that cannot be written.
        """
        rows = [(name, json.dumps(value)) for name, value in values.items()]
        with _writing(self._folder / MANIFEST_FILE), self._transaction():
            self._database.executemany("insert or replace into notes values (?, ?)", rows)

    def keep(self, key: str, row: Mapping[str, Any], writers: Mapping[Path, Writer]) -> None:
        """Write the files of an item, whole, and mark it as done.

        Parameters
        ----------
        key
            Of the item.
        row
            Figures of it, in values that JSON has.
        writers
            What writes each file.

        Raises
        ------
        FileError
            If a file cannot be written; the item is then as if it had not been worked on.
        """
        files = [os.path.relpath(path, self._folder) for path in writers]
        text = json.dumps({**row, "files": files})
        with _writing(self._folder / MANIFEST_FILE):
            # One of another run would pass for this one's.
            for path in writers:
                path.unlink(missing_ok=True)
            self._set(key, "writing", text)
            write_into(self._folder, writers)
            self._set(key, "done", text)

    def fail(self, key: str, reason: str, attempts: int) -> None:
        """Mark an item as failed.

        Raises
        ------
        FileError
            If that cannot be written.
        """
        with _writing(self._folder / MANIFEST_FILE):
            self._set(key, "failed", json.dumps({"error": reason, "attempts": attempts}))

    def close(self) -> None:
        """Let others open it."""
        with suppress(sqlite3.Error):  # Copies of the folder are to need one file.
            self._database.execute("pragma journal_mode = delete")
        self._database.close()
        if self._lock is not None:
            os.close(self._lock)

    def _set(self, key: str, state: str, row: str) -> None:
        self._database.execute(
            "update items set state = ?, row = ? where key = ?", (state, row, key)
        )

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._database.execute("begin immediate")
        try:
            yield
        except BaseException:
            with suppress(sqlite3.Error):  # SQLite has done so itself where the disk is full.
                self._database.execute("rollback")
            raise
        self._database.execute("commit")


def progress(path: Path, most: int) -> tuple[dict[str, int], dict[str, str]]:
    """How far a manifest is that another process may write: counts by state, and failures.

    Parameters
    ----------
    path
        Its file.
    most
        Failed items to name, with their reasons.

    Raises
    ------
    FileError
        If it is none, or cannot be read.
    """
    try:
        address = f"{path.resolve().as_uri()}?mode=ro"
        with closing(sqlite3.connect(address, uri=True, timeout=1.0)) as database:
            counts = dict(database.execute("select state, count(*) from items group by state"))
            failed = database.execute(
                "select key, row from items where state = 'failed' order by place limit ?", (most,)
            )
            reasons = {str(key): str(json.loads(text)["error"]) for key, text in failed}
            return {state: int(counts.get(state, 0)) for state in _STATES}, reasons
    except (sqlite3.Error, OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(f"{path} cannot be read as a manifest: {error}") from None


def _locked(folder: Path) -> int | None:
    """A lock on the folder, which goes with this process; None where the system has none."""
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        if isinstance(error, BlockingIOError):
            raise OptionError(
                f"another command writes into {folder}: wait for its end, or give another folder"
            ) from None
        return None  # A file system without locks.
    return lock


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Errors of the database as ours."""
    try:
        yield
    except sqlite3.DatabaseError as error:
        if isinstance(error, sqlite3.OperationalError):
            raise FileError(
                f"cannot write {path}: {error}. What was written before is kept: make room or "
                "rights, and run it again"
            ) from error
        raise FileError(
            f"{path} is no manifest of nolens ({error}): give another folder (-o)"
        ) from error
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
