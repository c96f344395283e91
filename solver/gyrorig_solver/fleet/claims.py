"""Who works on what: so that two batches on one store do nothing twice.

What to use when: `Claims.begin` once, at the start of a batch; `take` before each piece of
work; `done` when its rows are written.

Theory of operation: a claim is a file named by the work's key that holds the batch's name.
It is valid while that batch runs, which the lock on its journal tells, or once its work is
done. Claims of finished work are kept until a batch starts while no other runs: a batch
that looked at the index earlier would else do such work again. All this happens under one
lock of the store.
"""

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.journal import Journal, is_running, others_run

FOLDER = "claims"
_DONE = " done"


class Claims:
    """The claims of one batch. Used by one thread."""

    def __init__(self, store: Path, batch: str) -> None:
        self._store = store
        self._folder = store / FOLDER
        self._batch = batch

    def begin(self, index: Index) -> Journal:
        """Begin the batch: its journal, what others left behind, old claims.

        Raises:
            MachineError: the store cannot be written.
            InputError: a journal left behind is damaged.
        """
        with self._locked():
            journal = Journal(self._store, self._batch)
            index.fold_left_behind()
            if not others_run(self._store, self._batch):
                index.sweep()
                for old in self._folder.glob("??"):
                    shutil.rmtree(old, ignore_errors=True)
        return journal

    def end(self, index: Index) -> None:
        """Fold what this batch has written, and others left behind; its journal is closed.

        Raises:
            MachineError: the store cannot be written.
            InputError: a journal left behind is damaged.
        """
        with self._locked():  # whoever begins now would sweep away what is half folded
            index.fold_left_behind()

    def take(self, key: str) -> bool:
        """Return True if the work of that key is now this batch's.

        Raises:
            MachineError: the store cannot be written.
        """
        claim = self._claim(key)
        with self._locked():
            if claim.exists():
                holder = claim.read_text(encoding="utf-8")
                own = holder == self._batch  # it was put off, and is tried again
                if holder.endswith(_DONE) or (not own and is_running(self._store, holder)):
                    return False
            self._write(claim, self._batch)
        return True

    def done(self, key: str) -> None:
        """Say that the work of that key has its rows."""
        with self._locked():
            self._write(self._claim(key), self._batch + _DONE)

    def give_back(self, key: str) -> None:
        """Let the work of that key be taken again: it was not done."""
        with self._locked():
            self._claim(key).unlink(missing_ok=True)

    def _claim(self, key: str) -> Path:
        return self._folder / key[:2] / key

    def _write(self, claim: Path, text: str) -> None:
        claim.parent.mkdir(parents=True, exist_ok=True)
        claim.write_text(text, encoding="utf-8")

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            fd = os.open(self._folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX)
                yield
            finally:
                os.close(fd)
        except OSError as fault:
            raise MachineError(
                f"cannot write {self._folder}, {fault.strerror}",
                "make room for the store, or mend its rights",
            ) from fault


@contextlib.contextmanager
def kept_quiet(store: Path) -> Iterator[bool]:
    """Keep batches from beginning while the block runs; give whether none is running.

    Raises:
        MachineError: the store cannot be written.
    """
    with Claims(store, "")._locked():
        yield not others_run(store, "")
