"""Index of a store in a bucket: its files are fetched once, then queried as those of a folder.

What to use when: through `store_backend.open_index`. Files of the index never change, so fetched
ones are cached on this machine (`$XDG_CACHE_HOME/gyrorig`). The cache can be deleted at any time.
"""

import hashlib
import os
import shutil
import tempfile
import time
import weakref
from collections.abc import Iterable
from pathlib import Path
from uuid import uuid4

import duckdb

from gyrorig_solver.fleet.store.bucket_coordination import JOURNAL_FOLDER, other_live_batches
from gyrorig_solver.fleet.store.folder_journal import JOURNAL_SUFFIX, report_disk_errors
from gyrorig_solver.fleet.store.index_rows import IndexRow
from gyrorig_solver.fleet.store.store_index import INDEX_FOLDER, StoreIndex
from gyrorig_solver.storage import Storage

_MIRROR_PREFIX = "mirror-"
_STALE_MIRROR_S = 7 * 86_400.0  # no command runs for so long


def cache_folder(storage: Storage) -> Path:
    """Return the folder in which this machine caches files of a store.

    Raises:
        MachineError: the folder cannot be created.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "gyrorig" / hashlib.sha256(storage.location.encode()).hexdigest()[:16]
    with report_disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


class BucketIndex(StoreIndex):
    """The rows of one store in a bucket. Used by one thread."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self._cache = cache_folder(storage)
        mirror = tempfile.mkdtemp(prefix=_MIRROR_PREFIX, dir=self._cache)
        weakref.finalize(self, shutil.rmtree, mirror, ignore_errors=True)
        super().__init__(Path(mirror))

    def merge_journal(self, journal: Path) -> None:
        """Write a part of a journal as a file of the index, and remove the part.

        Raises:
            MachineError: the bucket refuses; the journal stays.
            InputError: the journal is damaged; it stays.
        """
        part = journal.name.removesuffix(JOURNAL_SUFFIX)
        pieces = [entry.name for entry in self._storage.list_files(f"{JOURNAL_FOLDER}/{part}/")]
        text = b"".join(self._storage.read(piece) or b"" for piece in pieces)
        if text:  # else it has no row, or another batch has merged it meanwhile
            self._write_part(journal, part, text)
        self._storage.remove(pieces)

    def _write_part(self, journal: Path, part: str, text: bytes) -> None:
        """Write the rows of a part as a file of the index."""
        local_journal = self._store / JOURNAL_FOLDER / journal.name
        with report_disk_errors(local_journal):
            local_journal.parent.mkdir(exist_ok=True)
            local_journal.write_bytes(text)
        final = self._folder / f"{part}.parquet"
        final.unlink(missing_ok=True)
        super().merge_journal(local_journal)
        data = final.read_bytes()
        if not self._storage.write_new(f"{INDEX_FOLDER}/{part}.parquet", data):
            # Another batch merged this part while its own batch was asleep and wrote on later.
            # Rows that exist twice count once, and none is lost.
            digest = hashlib.sha256(data).hexdigest()[:8]
            self._storage.write_new(f"{INDEX_FOLDER}/{part}-{digest}.parquet", data)

    def merge_abandoned_journals(self) -> int:
        """Merge the journals of batches that have ended; return the number of parts."""
        parts = {entry.name.split("/")[1] for entry in self._storage.list_files(JOURNAL_FOLDER)}
        if not parts:
            return 0
        live = other_live_batches(self._storage, f"probe-{uuid4().hex[:12]}")
        ended_parts = sorted(part for part in parts if part.rpartition("-")[0] not in live)
        for part in ended_parts:
            self.merge_journal(Path(part + JOURNAL_SUFFIX))
        return len(ended_parts)

    def remove_temporary_files(self) -> None:
        """Remove old mirrors of killed processes from this machine's cache."""
        for mirror in self._cache.glob(f"{_MIRROR_PREFIX}*"):
            if mirror != self._store and time.time() - mirror.stat().st_mtime > _STALE_MIRROR_S:
                shutil.rmtree(mirror, ignore_errors=True)

    def rebuild(self, rows: Iterable[IndexRow], name: str) -> None:
        """See `StoreIndex`."""
        with self.connect():
            pass  # fetches all files
        old_objects = [entry.name for entry in self._storage.list_files(INDEX_FOLDER)]
        old_objects += [entry.name for entry in self._storage.list_files(JOURNAL_FOLDER)]
        super().rebuild(rows, name)
        parquet = self._folder / f"{name}.parquet"
        self._storage.write_new(f"{INDEX_FOLDER}/{name}.parquet", parquet.read_bytes())
        self._storage.remove(old_objects)

    def connect(self) -> duckdb.DuckDBPyConnection:
        """See `StoreIndex`."""
        self._update_mirror()
        return super().connect()

    def _update_mirror(self) -> None:
        """Update the mirror to the contents of the bucket."""
        for folder in (self._folder, self._store / JOURNAL_FOLDER):
            folder.mkdir(exist_ok=True)
            for path in folder.glob("[!.]*"):
                path.unlink()
        while True:
            pieces = [entry.name for entry in self._storage.list_files(JOURNAL_FOLDER)]
            # Listed second: a part that is merged in between is in both lists, and counts once.
            index_files = [entry.name for entry in self._storage.list_files(INDEX_FOLDER)]
            journal_pieces = [(name.split("/")[1], self._storage.read(name)) for name in pieces]
            if all(text is not None for _, text in journal_pieces):
                break  # else the part was merged into a file that may not be in the list
        for name in index_files:
            copy = self._cached_copy(name)
            (self._folder / copy.name).symlink_to(copy)
        for part, text in journal_pieces:
            with (self._store / JOURNAL_FOLDER / (part + JOURNAL_SUFFIX)).open("ab") as journal:
                journal.write(text or b"")

    def _cached_copy(self, name: str) -> Path:
        """Return the cached copy of a file of the index."""
        copy = self._cache / Path(name).name
        if not copy.is_file():
            with self._storage.local_copy(name) as fetched, report_disk_errors(copy):
                temporary = copy.with_name(f".{copy.name}.{uuid4().hex[:8]}")
                shutil.copyfile(fetched, temporary)
                temporary.replace(copy)
        return copy
