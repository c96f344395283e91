"""What recordings are, remembered: so that a spool of a million files is not read every night.

What to use when: `Heads` around `spool.spooled`. A file of the same name, size and time of
change is taken to be the same; the worker compares its digest again before it solves. The
memory is a help, not a part of the store: when it is lost or locked, files are read again.
"""

import contextlib
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from gyrorig_solver.fleet.spool import Spooled

_TABLE = """CREATE TABLE IF NOT EXISTS heads (
    path TEXT PRIMARY KEY, size INTEGER, changed_ns INTEGER, sha256 TEXT, session TEXT, part TEXT
) WITHOUT ROWID"""
_AT_ONCE = 10_000


class Heads:
    """The memory in one file. Use it as a context."""

    def __init__(self, path: Path) -> None:
        self._known: dict[str, tuple[int, int, str, str, str]] = {}
        self._new: list[tuple[str, int, int, str, str, str]] = []
        self._database: sqlite3.Connection | None = None
        with contextlib.suppress(sqlite3.Error, OSError):
            self._database = sqlite3.connect(path, timeout=2.0)
            self._database.execute(_TABLE)
            for name, *rest in self._database.execute("SELECT * FROM heads"):
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

    def recall(self, path: Path) -> Spooled | None:
        """Return what a file was when it was last read; None if it may have changed."""
        known = self._known.get(str(path))
        if known is None:
            return None
        status = path.stat()
        if (status.st_size, status.st_mtime_ns) != known[:2]:
            return None
        size, _, sha256, session, part = known
        return Spooled(path, sha256, session, part, size)

    def keep(self, found: Iterable[Spooled]) -> Iterator[Spooled]:
        """Remember what was found, and hand it on."""
        for one in found:
            if one.session:
                with contextlib.suppress(OSError):
                    status = one.path.stat()
                    entry = (status.st_size, status.st_mtime_ns, one.sha256, one.session, one.part)
                    self._new.append((str(one.path), *entry))
            if len(self._new) >= _AT_ONCE:
                self._save()
            yield one

    def split(self, paths: Sequence[Path]) -> tuple[list[Spooled], list[Path]]:
        """Return what is remembered of these files, and those that have to be read."""
        remembered: list[Spooled] = []
        unread: list[Path] = []
        for path in paths:
            with contextlib.suppress(OSError):
                one = self.recall(path)
                if one is None:
                    unread.append(path)
                else:
                    remembered.append(one)
        return remembered, unread

    def _save(self) -> None:
        if self._database is not None and self._new:
            with contextlib.suppress(sqlite3.Error), self._database:
                self._database.executemany(
                    "INSERT OR REPLACE INTO heads VALUES (?, ?, ?, ?, ?, ?)", self._new
                )
        self._new.clear()
