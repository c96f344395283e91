"""The index of a store in a bucket: its files are fetched once, then asked as those of a folder.

What to use when: through `ledger.index_at`. Files of the index never change, so what was
fetched is kept on this machine (`$XDG_CACHE_HOME/gyrorig`); it may be deleted at any time.
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

from gyrorig_solver.fleet.bucket_ledger import JOURNAL, others_live
from gyrorig_solver.fleet.index import FOLDER, Index
from gyrorig_solver.fleet.journal import SUFFIX, told_of_disk
from gyrorig_solver.fleet.rows import Row
from gyrorig_solver.places.place import Place

_MIRROR = "mirror-"
_OLD_S = 7 * 86_400.0  # no command runs for a week


def kept_folder(place: Place) -> Path:
    """Return where this machine keeps what it may fetch again of a store.

    Raises:
        MachineError: it cannot be made.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "gyrorig" / hashlib.sha256(place.text.encode()).hexdigest()[:16]
    with told_of_disk(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


class BucketIndex(Index):
    """The rows of one store in a bucket. Used by one thread."""

    def __init__(self, place: Place) -> None:
        self._place = place
        self._kept = kept_folder(place)
        mirror = tempfile.mkdtemp(prefix=_MIRROR, dir=self._kept)
        weakref.finalize(self, shutil.rmtree, mirror, ignore_errors=True)
        super().__init__(Path(mirror))

    def fold(self, journal: Path) -> None:
        """Make a file of the index of a part of a journal, and remove that.

        Raises:
            MachineError: the bucket refuses; the journal stays.
            InputError: the journal is damaged; it stays.
        """
        part = journal.name.removesuffix(SUFFIX)
        pieces = [entry.name for entry in self._place.entries(f"{JOURNAL}/{part}/")]
        text = b"".join(self._place.read(piece) or b"" for piece in pieces)
        if text:  # else it has no row, or another has folded it while we looked
            self._put_part(journal, part, text)
        self._place.remove(pieces)

    def _put_part(self, journal: Path, part: str, text: bytes) -> None:
        """Write a file of the index of what a part of a journal holds."""
        here = self._store / JOURNAL / journal.name
        with told_of_disk(here):
            here.parent.mkdir(exist_ok=True)
            here.write_bytes(text)
        final = self._folder / f"{part}.parquet"
        final.unlink(missing_ok=True)
        super().fold(here)
        data = final.read_bytes()
        if not self._place.put_new(f"{FOLDER}/{part}.parquet", data):
            # Folded by another while its batch, asleep, wrote on: rows that are there twice
            # count once, and none is lost.
            digest = hashlib.sha256(data).hexdigest()[:8]
            self._place.put_new(f"{FOLDER}/{part}-{digest}.parquet", data)

    def fold_left_behind(self) -> int:
        """Fold the journals of batches that have ended; return how many parts."""
        parts = {entry.name.split("/")[1] for entry in self._place.entries(JOURNAL)}
        if not parts:
            return 0
        running = others_live(self._place, f"probe-{uuid4().hex[:12]}")
        dead = sorted(part for part in parts if part.rpartition("-")[0] not in running)
        for part in dead:
            self.fold(Path(part + SUFFIX))
        return len(dead)

    def sweep(self) -> None:
        """Remove what killed processes left on this machine; in the bucket they leave nothing."""
        for mirror in self._kept.glob(f"{_MIRROR}*"):
            if mirror != self._store and time.time() - mirror.stat().st_mtime > _OLD_S:
                shutil.rmtree(mirror, ignore_errors=True)

    def rebuild(self, rows: Iterable[Row], name: str) -> None:
        """See `Index`."""
        with self.connect():
            pass  # everything is here now
        old = [entry.name for entry in self._place.entries(FOLDER)]
        old += [entry.name for entry in self._place.entries(JOURNAL)]
        super().rebuild(rows, name)
        made = self._folder / f"{name}.parquet"
        self._place.put_new(f"{FOLDER}/{name}.parquet", made.read_bytes())
        self._place.remove(old)

    def connect(self) -> duckdb.DuckDBPyConnection:
        """See `Index`."""
        self._fetch()
        return super().connect()

    def _fetch(self) -> None:
        """Bring the mirror to what the bucket holds now."""
        for folder in (self._folder, self._store / JOURNAL):
            folder.mkdir(exist_ok=True)
            for path in folder.glob("[!.]*"):
                path.unlink()
        while True:
            pieces = [entry.name for entry in self._place.entries(JOURNAL)]
            # Listed second: what is folded in between is seen in both, and counts once.
            listed = [entry.name for entry in self._place.entries(FOLDER)]
            read = [(name.split("/")[1], self._place.read(name)) for name in pieces]
            if all(text is not None for _, text in read):
                break  # else it is in a file by now, which may not be in the list
        for name in listed:
            kept = self._keep(name)
            (self._folder / kept.name).symlink_to(kept)
        for part, text in read:
            with (self._store / JOURNAL / (part + SUFFIX)).open("ab") as journal:
                journal.write(text or b"")

    def _keep(self, name: str) -> Path:
        """Return this machine's copy of a file of the index."""
        kept = self._kept / Path(name).name
        if not kept.is_file():
            with self._place.local(name) as fetched, told_of_disk(kept):
                whole = kept.with_name(f".{kept.name}.{uuid4().hex[:8]}")
                shutil.copyfile(fetched, whole)
                whole.replace(kept)
        return kept
