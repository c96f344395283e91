"""What a batch has done since its last fold: lines of JSON, appended, synced, locked.

What to use when: `Journal` for the batch that writes; `left_behind` for journals whose
batch is no more. A journal is held by a lock of the system that ends with the process, so
that nobody has to guess from a time or a process number whether its batch still runs.
"""

import contextlib
import fcntl
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self
from uuid import uuid4

import msgspec

from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.rows import Row, flat

FOLDER = "journal"
SUFFIX = ".jsonl"
ROWS_A_PART = 5_000  # then it is folded into the index


class Journal:
    """The rows of one running batch, in parts. Used by one thread."""

    def __init__(self, store: Path, batch: str) -> None:
        """Begin the first part.

        Raises:
            MachineError: the store cannot be written.
        """
        self._folder = store / FOLDER
        self._batch = batch
        self._part = 0
        self._fd = -1
        self._path = Path()
        self.rows = 0
        with told_of_disk(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
        self._begin()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Let go; what is in it stays for the next fold."""
        self.close()

    def add(self, rows: Sequence[Row]) -> None:
        """Append the rows of one piece of work, all or none of them, and sync.

        Raises:
            MachineError: the disk refuses; nothing of them is in it.
        """
        text = b"".join(msgspec.json.encode(flat(row)) + b"\n" for row in rows)
        with told_of_disk(self._path):
            before = os.fstat(self._fd).st_size
            try:
                _write_all(self._fd, text)
                os.fdatasync(self._fd)
            except OSError:
                os.ftruncate(self._fd, before)  # a torn line would hide those behind it
                raise
        self.rows += len(rows)

    @property
    def is_full(self) -> bool:
        """Whether it is time to fold."""
        return self.rows >= ROWS_A_PART

    def next_part(self) -> Path:
        """Begin another part and return the one before, which may be folded now.

        Raises:
            MachineError: the disk refuses; the part before goes on.
        """
        done, held = self._path, self._fd
        self._part += 1
        self._begin()  # before the old one is let go: the batch is seen to run all the time
        os.close(held)
        return done

    def close(self) -> None:
        """Let go of the lock. Closing twice is no fault."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _begin(self) -> None:
        """Begin a part, locked before it has its name: nobody finds it without its holder.

        Raises:
            MachineError: the disk refuses; the part before goes on.
        """
        path = self._folder / f"{self._batch}-{self._part:04d}{SUFFIX}"
        unnamed = path.with_name(f".{path.name}.{uuid4().hex}")
        with told_of_disk(path):
            fd = os.open(unnamed, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                unnamed.rename(path)
            except OSError:
                os.close(fd)
                unnamed.unlink(missing_ok=True)
                raise
        self._path, self._fd, self.rows = path, fd, 0


@contextlib.contextmanager
def left_behind(store: Path) -> Iterator[list[Path]]:
    """Give the journals whose batch has ended, locked while the block runs."""
    held: list[int] = []
    free: list[Path] = []
    try:
        for path in sorted((store / FOLDER).glob(f"*{SUFFIX}")):
            try:
                fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            except FileNotFoundError:  # folded by another batch a moment ago
                continue
            held.append(fd)
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if path.exists():
                    free.append(path)
        yield free
    finally:
        for fd in held:
            os.close(fd)


def is_running(store: Path, batch: str) -> bool:
    """Return whether the batch of that name still holds its journal."""
    return any(_is_held(path) for path in (store / FOLDER).glob(f"{batch}-*{SUFFIX}"))


def others_run(store: Path, batch: str) -> bool:
    """Return whether a batch of another name holds a journal; "" is nobody's name."""
    names = (store / FOLDER).glob(f"*{SUFFIX}")
    return any(
        _is_held(path) for path in names if not (batch and path.name.startswith(f"{batch}-"))
    )


def _is_held(path: Path) -> bool:
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


def whole_lines(path: Path) -> bytes:
    """Return a journal up to its last whole line: a power cut may have torn the last."""
    data = path.read_bytes()
    return data[: data.rfind(b"\n") + 1]


def _write_all(fd: int, data: bytes) -> None:
    while data:
        data = data[os.write(fd, data) :]


@contextlib.contextmanager
def told_of_disk(path: Path) -> Iterator[None]:
    """Turn what the disk refuses in the block into a MachineError that names the file."""
    try:
        yield
    except OSError as fault:
        raise MachineError(
            f"cannot write {path}, {fault.strerror}", "make room for the store, or mend its rights"
        ) from fault
