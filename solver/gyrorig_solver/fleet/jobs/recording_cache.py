"""Recording cache: digest and session of known recordings, so that a spool is read only once.

What to use when: `RecordingCache` around `spool_scanner.read_recordings`. A file with the same
storage, name, size and time of change (in a bucket: tag) counts as unchanged; the worker compares
its digest again before it solves. If the cache is lost or locked, files are read again.
"""

import contextlib
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import Self

from gyrorig_solver.fleet.jobs.spool_scanner import UNREAD_PREFIX, SpooledRecording, SpoolListing
from gyrorig_solver.storage import StorageEntry

_CREATE_TABLE_SQL = """CREATE TABLE IF NOT EXISTS spooled (
    path TEXT PRIMARY KEY, size INTEGER, stamp TEXT, sha256 TEXT, session TEXT, part TEXT
) WITHOUT ROWID"""
_ROWS_PER_WRITE = 10_000


class RecordingCache:
    """The cache, in one SQLite file. Use it as a context manager."""

    def __init__(self, path: Path, spool: str) -> None:
        """Open the cache."""
        self._spool = spool
        self._known: dict[str, tuple[int, str, str, str, str]] = {}
        self._new: list[tuple[str, int, str, str, str, str]] = []
        self._database: sqlite3.Connection | None = None
        with contextlib.suppress(sqlite3.Error, OSError):
            self._database = sqlite3.connect(path, timeout=2.0)
            self._database.execute(_CREATE_TABLE_SQL)
            for name, *rest in self._database.execute("SELECT * FROM spooled"):
                self._known[name] = tuple(rest)

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Write the new entries."""
        self._save()
        if self._database is not None:
            self._database.close()

    def lookup(self, entry: StorageEntry) -> SpooledRecording | None:
        """Return a file's entry; None if the file is new, or may have changed."""
        known = self._known.get(self._key(entry.name))
        if known is None or (entry.size, entry.change_tag) != known[:2]:
            return None
        size, change_tag, sha256, session, part = known
        return SpooledRecording(PurePosixPath(entry.name), sha256, session, part, size, change_tag)

    def remember(self, recordings: Iterable[SpooledRecording]) -> Iterator[SpooledRecording]:
        """Yield recordings, and add them to the cache."""
        for recording in recordings:
            # Also a file without a readable head: it is rejected once, and not read every night.
            if not recording.read_error and not recording.sha256.startswith(UNREAD_PREFIX):
                entry = (
                    recording.size,
                    recording.change_tag,
                    recording.sha256,
                    recording.session,
                    recording.part,
                )
                self._new.append((self._key(str(recording.path)), *entry))
            if len(self._new) >= _ROWS_PER_WRITE:
                self._save()
            yield recording

    def split_known(
        self, listing: SpoolListing
    ) -> tuple[list[SpooledRecording], list[StorageEntry]]:
        """Return the known recordings, and the files that have to be read."""
        known: list[SpooledRecording] = []
        unread: list[StorageEntry] = []
        for entry in listing.recordings:
            recording = self.lookup(entry)
            if recording is None:
                unread.append(entry)
            else:
                known.append(recording)
        return known, unread

    def _key(self, name: str) -> str:
        # SQLite stores UTF-8 only, and a file name can have other bytes.
        return f"{self._spool}/{name}".encode("utf-8", "backslashreplace").decode()

    def _save(self) -> None:
        if self._database is not None and self._new:
            with contextlib.suppress(sqlite3.Error), self._database:
                self._database.executemany(
                    "INSERT OR REPLACE INTO spooled VALUES (?, ?, ?, ?, ?, ?)", self._new
                )
        self._new.clear()
