"""A folder of this machine, or one that several machines mount, as a storage."""

import contextlib
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_solver.storage.file_writing import write_file
from gyrorig_solver.storage.storage_protocol import StorageEntry


@dataclass(frozen=True, slots=True)
class Folder:
    """The files below one folder. Names that begin with a dot are temporary files."""

    path: Path

    @property
    def location(self) -> str:
        """See `Storage`."""
        return str(self.path)

    def read(self, name: str) -> bytes | None:
        """See `Storage`."""
        try:
            return (self.path / name).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as fault:
            raise MachineError(
                f"the file {self.path / name} cannot be read ({fault.strerror})",
                "check the permissions of the file and the disk",
            ) from fault

    def write(self, name: str, data: bytes) -> None:
        """See `Storage`."""
        write_file(self.path / name, data, replace=True, make_folder=True)

    def write_new(self, name: str, data: bytes) -> bool:
        """See `Storage`."""
        return write_file(self.path / name, data, replace=False, make_folder=True)

    def remove(self, names: Iterable[str]) -> None:
        """See `Storage`."""
        for name in names:
            try:
                (self.path / name).unlink(missing_ok=True)
            except OSError as fault:
                raise MachineError(
                    f"the file {self.path / name} cannot be removed ({fault.strerror})",
                    "check the permissions of the folder of the file",
                ) from fault

    def list_files(self, folder: str = "") -> Iterator[StorageEntry]:
        """See `Storage`. Links to folders are not followed, because they can form a loop."""
        for root, folders, names in os.walk(self.path / folder):
            folders.sort()
            for name in sorted(names):
                path = Path(root) / name
                with contextlib.suppress(OSError):  # removed since the folder was read
                    status = path.stat()
                    yield StorageEntry(
                        str(path.relative_to(self.path)),
                        status.st_size,
                        str(status.st_mtime_ns),
                        status.st_mtime,
                    )

    def dangling_links(self) -> Iterator[str]:
        """Yield the names of links whose file cannot be reached; `list_files` omits them."""
        for root, _folders, names in os.walk(self.path):
            for name in names:
                path = Path(root) / name
                if _is_dangling(path):
                    yield str(path.relative_to(self.path))

    def cache_folder(self) -> Path:
        """See `Storage`: the folder itself."""
        return self.path

    def cached_copy(self, name: str) -> Path:
        """See `Storage`: the file itself."""
        return self.path / name

    @contextlib.contextmanager
    def local_copy(self, name: str) -> Iterator[Path]:
        """See `Storage`."""
        path = self.path / name
        if _is_dangling(path):
            raise InputError(
                f"the file {path} cannot be read, because it is a link to a file that does not "
                "exist or that the user must not read",
                "correct the link or remove it",
            )
        if not path.is_file():
            raise InputError(
                f"the file {path} was removed while the program ran",
                "run the command again",
            )
        yield path


def _is_dangling(path: Path) -> bool:
    """Return whether a name is a link whose file does not exist or cannot be reached."""
    if not path.is_symlink():
        return False
    try:
        path.stat()
    except OSError:
        return True
    return False
