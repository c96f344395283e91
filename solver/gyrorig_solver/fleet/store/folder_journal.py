"""Journal in a folder: the rows of a running batch, as JSON lines that are synced and locked.

What to use when: `FolderJournal` for the batch that writes; `abandoned_journals` for journals
whose batch has ended. A journal is held by a file lock that ends with the process, so whether its
batch still runs is known, and not guessed from times or process numbers.
"""

import contextlib
import fcntl
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Self
from uuid import uuid4

import msgspec

from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.store.index_rows import IndexRow, row_columns

JOURNAL_FOLDER = "journal"
JOURNAL_SUFFIX = ".jsonl"
ROWS_PER_PART = 5_000  # then it is merged into the index


class FolderJournal:
    """The rows of one running batch, in parts. Used by one thread."""

    def __init__(self, store: Path, batch: str) -> None:
        """Start the first part.

        Raises:
            MachineError: the store cannot be written.
        """
        self._folder = store / JOURNAL_FOLDER
        self._batch = batch
        self._part = 0
        self._fd = -1
        self._path = Path()
        self.row_count = 0
        with report_disk_errors(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
        self._open_part()

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Close the journal; the next merge takes its rows."""
        self.close()

    def add(self, rows: Sequence[IndexRow]) -> None:
        """Append the rows of one job, all or none of them, and sync.

        Raises:
            MachineError: the disk refuses; no row was written.
        """
        text = b"".join(msgspec.json.encode(row_columns(row)) + b"\n" for row in rows)
        with report_disk_errors(self._path):
            size_before = os.fstat(self._fd).st_size
            try:
                _write_all(self._fd, text)
                os.fdatasync(self._fd)
            except OSError:
                os.ftruncate(self._fd, size_before)  # a partial line would corrupt the next one
                raise
        self.row_count += len(rows)

    @property
    def is_full(self) -> bool:
        """Whether it is time to merge the journal into the index."""
        return self.row_count >= ROWS_PER_PART

    def start_next_part(self) -> Path:
        """Start another part and return the one before, which can be merged now.

        Raises:
            MachineError: the disk refuses; the current part stays in use.
        """
        finished, finished_fd = self._path, self._fd
        self._part += 1
        # Opened before the old lock is released, so that the batch is always seen running.
        self._open_part()
        os.close(finished_fd)
        return finished

    def close(self) -> None:
        """Release the lock. Closing twice is allowed."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _open_part(self) -> None:
        """Open a part, locked before it has its name: it is never visible without its lock.

        Raises:
            MachineError: the disk refuses; the current part stays in use.
        """
        path = self._folder / f"{self._batch}-{self._part:04d}{JOURNAL_SUFFIX}"
        unnamed = path.with_name(f".{path.name}.{uuid4().hex}")
        with report_disk_errors(path):
            fd = os.open(unnamed, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                unnamed.rename(path)
            except OSError:
                os.close(fd)
                unnamed.unlink(missing_ok=True)
                raise
        self._path, self._fd, self.row_count = path, fd, 0


@contextlib.contextmanager
def abandoned_journals(store: Path) -> Iterator[list[Path]]:
    """Provide the journals whose batch has ended, locked while the block runs."""
    descriptors: list[int] = []
    journals: list[Path] = []
    try:
        for path in sorted((store / JOURNAL_FOLDER).glob(f"*{JOURNAL_SUFFIX}")):
            try:
                fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            except FileNotFoundError:  # merged by another batch a moment ago
                continue
            descriptors.append(fd)
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if path.exists():
                    journals.append(path)
        yield journals
    finally:
        for fd in descriptors:
            os.close(fd)


def is_batch_running(store: Path, batch: str) -> bool:
    """Return whether the batch of that name still holds its journal."""
    return any(
        _is_locked(path) for path in (store / JOURNAL_FOLDER).glob(f"{batch}-*{JOURNAL_SUFFIX}")
    )


def other_batch_running(store: Path, batch: str) -> bool:
    """Return whether a batch of another name holds a journal; no batch has the name "".

    A batch can start its next part and release the one before between the listing and the
    check. The parts are therefore listed again until no new one has appeared.
    """
    checked: set[Path] = set()
    while True:
        parts = {
            path
            for path in (store / JOURNAL_FOLDER).glob(f"*{JOURNAL_SUFFIX}")
            if not (batch and path.name.startswith(f"{batch}-"))
        }
        if any(_is_locked(path) for path in parts):
            return True
        if parts <= checked:
            return False
        checked |= parts


def _is_locked(path: Path) -> bool:
    try:
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(fd)
    return False


def complete_lines(path: Path) -> bytes:
    """Return a journal up to its last complete line: a power cut can leave a partial one."""
    data = path.read_bytes()
    return data[: data.rfind(b"\n") + 1]


def _write_all(fd: int, data: bytes) -> None:
    while data:
        data = data[os.write(fd, data) :]


@contextlib.contextmanager
def report_disk_errors(path: Path) -> Iterator[None]:
    """Turn errors of the disk in the block into a MachineError that names the file."""
    try:
        yield
    except OSError as fault:
        raise MachineError(
            f"the file {path} of the store cannot be written ({fault.strerror})",
            "free some disk space, or correct the permissions of the store",
        ) from fault
