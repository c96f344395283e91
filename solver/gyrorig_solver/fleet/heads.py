"""What recordings are, remembered: so that a spool of a million files is not read every night.

What to use when: `Heads` around `spool.spooled`. A file of the same place, name, size and time
of change (in a bucket: tag) is taken to be the same; the worker compares its digest again
before it solves. The memory is a help, not a part of the store: when it is lost or locked,
files are read again.
"""

import contextlib
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Self

from gyrorig_solver.fleet.spool import Spool, Spooled
from gyrorig_solver.places.place import Entry

_TABLE = """CREATE TABLE IF NOT EXISTS spooled (
    path TEXT PRIMARY KEY, size INTEGER, stamp TEXT, sha256 TEXT, session TEXT, part TEXT
) WITHOUT ROWID"""
_AT_ONCE = 10_000


class Heads:
    """The memory in one file. Use it as a context."""

    def __init__(self, path: Path, spool: str) -> None:
        """Open the memory.

        Args:
            path: its file.
            spool: whose recordings are asked for, as a person names it.
        """
        self._spool = spool
        self._known: dict[str, tuple[int, str, str, str, str]] = {}
        self._new: list[tuple[str, int, str, str, str, str]] = []
        self._database: sqlite3.Connection | None = None
        with contextlib.suppress(sqlite3.Error, OSError):
            self._database = sqlite3.connect(path, timeout=2.0)
            self._database.execute(_TABLE)
            for name, *rest in self._database.execute("SELECT * FROM spooled"):
                self._known[name] = tuple(rest)

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write what is new."""
        self._save()
        if self._database is not None:
            self._database.close()

    def recall(self, entry: Entry) -> Spooled | None:
        """Return what a file was when it was last read; None if it may have changed."""
        known = self._known.get(self._key(entry.name))
        if known is None or (entry.size, entry.stamp) != known[:2]:
            return None
        size, stamp, sha256, session, part = known
        return Spooled(PurePosixPath(entry.name), sha256, session, part, size, stamp)

    def keep(self, found: Iterable[Spooled]) -> Iterator[Spooled]:
        """Remember what was found, and hand it on."""
        for one in found:
            if one.session:
                entry = (one.size, one.stamp, one.sha256, one.session, one.part)
                self._new.append((self._key(str(one.path)), *entry))
            if len(self._new) >= _AT_ONCE:
                self._save()
            yield one

    def split(self, spool: Spool) -> tuple[list[Spooled], list[Entry]]:
        """Return what is remembered of these files, and those that have to be read."""
        remembered: list[Spooled] = []
        unread: list[Entry] = []
        for entry in spool.recordings:
            one = self.recall(entry)
            if one is None:
                unread.append(entry)
            else:
                remembered.append(one)
        return remembered, unread

    def _key(self, name: str) -> str:
        return f"{self._spool}/{name}"

    def _save(self) -> None:
        if self._database is not None and self._new:
            with contextlib.suppress(sqlite3.Error), self._database:
                self._database.executemany(
                    "INSERT OR REPLACE INTO spooled VALUES (?, ?, ?, ?, ?, ?)", self._new
                )
        self._new.clear()
