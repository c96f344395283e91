"""A folder of this machine, or one that several machines mount."""

import contextlib
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_solver.calibration.store import write_whole
from gyrorig_solver.places.place import Entry


@dataclass(frozen=True, slots=True)
class Folder:
    """The files below one folder; what begins with a dot is somebody's temporary file."""

    path: Path

    @property
    def text(self) -> str:
        """As a person names it."""
        return str(self.path)

    def read(self, name: str) -> bytes | None:
        """See `Place`."""
        try:
            return (self.path / name).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as fault:
            raise MachineError(
                f"cannot read {self.path / name}, {fault.strerror}", "mend the disk or its rights"
            ) from fault

    def put(self, name: str, data: bytes) -> None:
        """See `Place`."""
        write_whole(self._made(name), data, replace=True)

    def put_new(self, name: str, data: bytes) -> bool:
        """See `Place`."""
        return write_whole(self._made(name), data, replace=False)

    def remove(self, names: Iterable[str]) -> None:
        """See `Place`."""
        for name in names:
            try:
                (self.path / name).unlink(missing_ok=True)
            except OSError as fault:
                raise MachineError(
                    f"cannot remove {self.path / name}, {fault.strerror}", "mend its rights"
                ) from fault

    def entries(self, below: str = "") -> Iterator[Entry]:
        """See `Place`. Links to folders are not followed: a loop of them has no end."""
        for root, folders, names in os.walk(self.path / below):
            folders.sort()
            for name in sorted(names):
                path = Path(root) / name
                with contextlib.suppress(OSError):  # gone a moment ago
                    status = path.stat()
                    yield Entry(
                        str(path.relative_to(self.path)),
                        status.st_size,
                        str(status.st_mtime_ns),
                        status.st_mtime,
                    )

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        """See `Place`."""
        path = self.path / name
        if not path.is_file():
            raise InputError(
                f"there is no file {path} any more", "it was removed meanwhile: run again"
            )
        yield path

    def _made(self, name: str) -> Path:
        """Return the path of a file to be, its folder made."""
        path = self.path / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise MachineError(
                f"cannot make the folder {path.parent}, {fault.strerror}",
                "make room, or mend its rights",
            ) from fault
        return path
