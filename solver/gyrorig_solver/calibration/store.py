"""A folder of calibrations: one folder a board, one immutable file a version.

    STORE/<board>/v0001.yaml  v0001.report.html  v0002.yaml ...

A store of a fleet, which says so in `gyrorig-store.yaml`, spreads its boards over 65536
folders, because a folder of a million entries is slow to list and to make:

    STORE/calib/<h2>/<h2>/<board>/v0001.yaml ...    h: of the SHA-256 of the board's name

What to use when: `CalibrationStore.add` to write the next version, `latest` to read
back. Each version names the digest of the one before, so that a store is a chain that
shows when something in it was changed or is missing. Two solvers may write at once: a
version's name is taken by a hard link, which never replaces what is there.
"""

import errno
import hashlib
import os
import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import BusyError, InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId

STORE_FILE = "gyrorig-store.yaml"
STORE_SCHEMA = "gyrorig/store/1"
MARK = f'schema: "{STORE_SCHEMA}"\n'.encode()
VERSION_FILE = re.compile(r"v(\d{4,9})\.yaml")
MOST_TRIES = 100  # each lost race means that another solver wrote a version


@dataclass(frozen=True, slots=True)
class StoredVersion:
    """One version in the store."""

    number: int
    path: Path
    read: Callable[[Path], bytes] = Path.read_bytes

    def data(self) -> bytes:
        """Return the file's bytes."""
        return self.read(self.path)

    def digest(self) -> str:
        """Return `sha256:` and the digest of the file's bytes."""
        return "sha256:" + hashlib.sha256(self.data()).hexdigest()


class CalibrationStore:
    """The versions of every board below one folder."""

    def __init__(self, folder: Path) -> None:
        """Use the store below `folder`, which need not be there yet.

        Raises:
            InputError: its `gyrorig-store.yaml` is of another schema.
        """
        self.folder = folder
        self.sharded = _is_sharded(folder)

    def folder_of(self, board: BoardId) -> Path:
        """Return where the versions of `board` are, or will be."""
        return self.folder / (sharded_name(board) if self.sharded else board)

    def versions(self, board: BoardId) -> list[StoredVersion]:
        """Return the versions of `board`, oldest first."""
        folder = self.folder_of(board)
        if not folder.is_dir():
            return []
        found = (
            StoredVersion(int(match[1]), path)
            for path in folder.iterdir()
            if (match := VERSION_FILE.fullmatch(path.name))
        )
        return sorted(found, key=lambda version: version.number)

    def latest(self, board: BoardId) -> StoredVersion | None:
        """Return the newest version of `board`, None if it has none."""
        versions = self.versions(board)
        return versions[-1] if versions else None

    def prepare(self, board: BoardId) -> Path:
        """Make the folder of `board`, before any work is spent on it.

        Raises:
            MachineError: the folder cannot be made or written.
        """
        folder = self.folder_of(board)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise MachineError(
                f"cannot make the folder {folder}, {fault.strerror}", "choose another with --out"
            ) from fault
        if not os.access(folder, os.W_OK | os.X_OK):
            raise MachineError(f"may not write into {folder}", "choose another with --out")
        return folder

    def stored(self, name: str) -> StoredVersion:
        """Return the version of that name in the store."""
        path = self.folder / name
        return StoredVersion(int(path.stem[1:]), path)

    def name_of(self, stored: StoredVersion) -> str:
        """Return where in the store a version is."""
        return str(stored.path.relative_to(self.folder))

    def digests_beside(self, stored: StoredVersion) -> list[str]:
        """Return `<sha256>  <name>` of each file beside a version, as sha256sum writes it.

        Raises:
            MachineError: one of them cannot be read.
        """
        start = f"{stored.path.stem}."
        return [
            f"{hashlib.sha256(stored.read(path)).hexdigest()}  {path.name}"
            for path in sorted(self._neighbours(stored))
            if path.name.startswith(start) and path != stored.path
        ]

    def _neighbours(self, stored: StoredVersion) -> list[Path]:
        return list(stored.path.parent.iterdir())

    def beside(self, stored: StoredVersion, suffix: str, data: bytes) -> Path:
        """Write a file beside a version, such as `v0001.report.html`; return its path.

        Raises:
            MachineError: it cannot be written.
        """
        path = stored.path.with_suffix(suffix)
        write_whole(path, data, replace=True)
        return path

    def add(
        self,
        board: BoardId,
        text_of: Callable[[int, str | None], str],
        before: Callable[[], None] = lambda: None,
    ) -> StoredVersion:
        """Write the next version of `board`.

        Args:
            board: whose version.
            text_of: makes the document, given the version's number and the digest of
                the version before; called again when another solver took the number.
            before: called before each try; what it raises ends this.

        Returns:
            The version as it is on disk, synced.

        Raises:
            MachineError: it cannot be written.
            BusyError: other solvers took a hundred numbers in a row.
        """
        folder = self.prepare(board)
        for _ in range(MOST_TRIES):
            before()
            last = self.latest(board)
            number = last.number + 1 if last else 1
            text = text_of(number, last.digest() if last else None)
            final = folder / f"v{number:04d}.yaml"
            if write_whole(final, text.encode(), replace=False):
                return StoredVersion(number, final)
        raise BusyError(f"other solvers keep writing to {folder}", "try again")


def sharded_name(board: BoardId) -> str:
    """Return the folder of a board within a fleet's store."""
    digest = hashlib.sha256(board.encode()).hexdigest()
    return f"calib/{digest[:2]}/{digest[2:4]}/{board}"


def make_sharded(folder: Path) -> CalibrationStore:
    """Return the fleet's store in `folder`, which is made one if it is empty or not there.

    Raises:
        InputError: it is of another schema.
        UsageError: it holds something else.
        MachineError: it cannot be made.
    """
    mark = folder / STORE_FILE
    if not mark.exists():
        making = f".{STORE_FILE}."  # by another, at this moment: see write_whole
        try:
            folder.mkdir(parents=True, exist_ok=True)
            others = [p.name for p in folder.iterdir() if not p.name.startswith(making)]
        except OSError as fault:
            raise MachineError(
                f"cannot make the store {folder}, {fault.strerror}", "choose another with --store"
            ) from fault
        # Looked at again after the rest: whoever makes a store writes its mark before all else.
        if others and not mark.exists():
            raise UsageError(
                f"{folder} is no store of a fleet: it holds {sorted(others)[0]}",
                "name an empty or a new folder with --store",
            )
        write_whole(mark, MARK, replace=False)
    return CalibrationStore(folder)


def _is_sharded(folder: Path) -> bool:
    """Return whether `folder` says that it is a fleet's store.

    Raises:
        InputError: it says so in another schema.
    """
    mark = folder / STORE_FILE
    try:
        text = mark.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as fault:
        raise MachineError(f"cannot read {mark}, {fault.strerror}", "mend its rights") from fault
    check_mark(text, str(mark))
    return True


def check_mark(text: bytes, named: str) -> None:
    """Refuse a `gyrorig-store.yaml` of another schema.

    Raises:
        InputError: it is, or it cannot be read.
    """
    found = parse_yaml(text, named, InputError)
    schema = found.get("schema") if isinstance(found, dict) else None
    if schema != STORE_SCHEMA:
        raise InputError(
            f"{named} is of schema {str(schema)[:40]!r}, this program knows {STORE_SCHEMA!r}",
            "use the program that wrote it, or a newer one",
        )


def write_whole(final: Path, data: bytes, *, replace: bool) -> bool:
    """Write `data` under the name `final`, whole and synced, or not at all.

    Args:
        final: the name to take.
        data: everything the file shall hold.
        replace: whether a file of that name may be replaced.

    Returns:
        False if the name is taken and must not be replaced; nothing was changed.

    Raises:
        MachineError: the file system refuses; nothing was changed.
    """
    temporary: Path | None = None
    try:
        descriptor, name = tempfile.mkstemp(prefix=f".{final.name}.", dir=final.parent)
        temporary = Path(name)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fchmod(file.fileno(), 0o644)
            os.fsync(file.fileno())
        if replace:
            temporary.replace(final)
        else:
            os.link(temporary, final)
        _sync_folder(final.parent)
    except FileExistsError:
        return False
    except OSError as fault:
        raise MachineError(f"cannot write {final}, {fault.strerror}", _remedy(fault)) from fault
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
    return True


def _remedy(fault: OSError) -> str:
    if fault.errno in (errno.EPERM, errno.EOPNOTSUPP):
        return "use a folder on a file system with hard links, such as ext4"
    if fault.errno in (errno.ENOSPC, errno.EDQUOT):
        return "make space and solve again"
    return "choose another folder with --out"


def _sync_folder(folder: Path) -> None:
    """Make a new name last through a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
