"""Store of calibrations: one folder per board, one immutable file per version.

    STORE/<board>/v0001.yaml  v0001.report.html  v0002.yaml ...

A fleet's store, marked by `gyrorig-store.yaml`, distributes its boards over 65536 folders,
because a folder of a million entries is slow:

    STORE/calib/<h2>/<h2>/<board>/v0001.yaml ...    h2: digits of the SHA-256 of the board's name

What to use when: `CalibrationStore.add_version` to write the next version, `latest` to read one.
Each version contains the digest of the previous one, therefore a changed or missing version is
detected. Two solvers can write at the same time: a version's name is taken by a hard link, which
never replaces a file.
"""

import hashlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import BusyError, InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.storage import write_file

STORE_FILE = "gyrorig-store.yaml"
STORE_SCHEMA = "gyrorig/store/1"
STORE_MARKER = f'schema: "{STORE_SCHEMA}"\n'.encode()
VERSION_FILE = re.compile(r"v(\d{4,9})\.yaml")
MAX_ATTEMPTS = 100  # each failed attempt means that another solver wrote a version


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
    """The versions of all boards in one folder."""

    def __init__(self, folder: Path) -> None:
        """Open the store in `folder`, which need not exist yet.

        Raises:
            InputError: its `gyrorig-store.yaml` has another schema.
        """
        self.folder = folder
        self.sharded = _is_sharded(folder)

    def folder_of(self, board: BoardId) -> Path:
        """Return the folder of the versions of `board`."""
        return self.folder / (sharded_folder_name(board) if self.sharded else board)

    def versions(self, board: BoardId) -> list[StoredVersion]:
        """Return the versions of `board`, oldest first."""
        folder = self.folder_of(board)
        if not folder.is_dir():
            return []
        stored_versions = (
            StoredVersion(int(match[1]), path)
            for path in folder.iterdir()
            if (match := VERSION_FILE.fullmatch(path.name))
        )
        return sorted(stored_versions, key=lambda version: version.number)

    def latest(self, board: BoardId) -> StoredVersion | None:
        """Return the newest version of `board`, None if it has none."""
        versions = self.versions(board)
        return versions[-1] if versions else None

    def prepare_folder(self, board: BoardId) -> Path:
        """Create the folder of `board`, before the calibration is computed.

        Raises:
            MachineError: the folder cannot be created or written.
        """
        folder = self.folder_of(board)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise MachineError(
                f"the folder {folder} cannot be created ({fault.strerror})",
                "choose another folder with --out",
            ) from fault
        if not os.access(folder, os.W_OK | os.X_OK):
            raise MachineError(
                f"the user has no permission to write to the folder {folder}",
                "choose another folder with --out",
            )
        return folder

    def version_named(self, name: str) -> StoredVersion:
        """Return the version of that name in the store."""
        path = self.folder / name
        return StoredVersion(int(path.stem[1:]), path)

    def name_of(self, version: StoredVersion) -> str:
        """Return the path of a version in the store."""
        return str(version.path.relative_to(self.folder))

    def companion_digests(self, version: StoredVersion) -> list[str]:
        """Return `<sha256>  <name>` of each file that belongs to a version, as sha256sum does.

        Raises:
            MachineError: one of them cannot be read.
        """
        prefix = f"{version.path.stem}."
        return [
            f"{hashlib.sha256(version.read(path)).hexdigest()}  {path.name}"
            for path in sorted(self._folder_files(version))
            if path.name.startswith(prefix) and path != version.path
        ]

    def _folder_files(self, version: StoredVersion) -> list[Path]:
        return list(version.path.parent.iterdir())

    def write_companion(self, version: StoredVersion, suffix: str, data: bytes) -> Path:
        """Write a file that belongs to a version, such as `v0001.report.html`; return its path.

        Raises:
            MachineError: it cannot be written.
        """
        path = version.path.with_suffix(suffix)
        write_file(path, data, replace=True)
        return path

    def add_version(
        self,
        board: BoardId,
        make_text: Callable[[int, str | None], str],
        check_before: Callable[[], None] = lambda: None,
    ) -> StoredVersion:
        """Write the next version of `board`.

        Args:
            board: whose version.
            make_text: returns the document for a version number and the digest of the
                previous version; called again when another solver took the number.
            check_before: called before each attempt; an exception stops the write.

        Returns:
            The version on disk, synced.

        Raises:
            MachineError: it cannot be written.
            BusyError: other solvers took a hundred numbers in succession.
        """
        folder = self.prepare_folder(board)
        for _ in range(MAX_ATTEMPTS):
            check_before()
            last = self.latest(board)
            number = last.number + 1 if last else 1
            text = make_text(number, last.digest() if last else None)
            final = folder / f"v{number:04d}.yaml"
            if write_file(final, text.encode(), replace=False):
                return StoredVersion(number, final)
        raise BusyError(
            f"the calibration was not added to {folder}: at each of {MAX_ATTEMPTS} attempts, "
            "another solver had just added one",
            "run the command again later",
        )


def sharded_folder_name(board: BoardId) -> str:
    """Return the folder of a board in a fleet's store."""
    digest = hashlib.sha256(board.encode()).hexdigest()
    return f"calib/{digest[:2]}/{digest[2:4]}/{board}"


def create_sharded_store(folder: Path) -> CalibrationStore:
    """Return the fleet's store in `folder`; create it if the folder is empty or missing.

    Raises:
        InputError: it has another schema.
        UsageError: it contains other files.
        MachineError: it cannot be created.
    """
    marker = folder / STORE_FILE
    if not marker.exists():
        temporary_prefix = f".{STORE_FILE}."  # of another process that writes now, see write_file
        try:
            folder.mkdir(parents=True, exist_ok=True)
            others = [p.name for p in folder.iterdir() if not p.name.startswith(temporary_prefix)]
        except OSError as fault:
            raise MachineError(
                f"the calibration store {folder} cannot be created ({fault.strerror})",
                "choose another folder with --store",
            ) from fault
        # Check again: another process writes the marker before any other file.
        if others and not marker.exists():
            raise UsageError(
                f"the folder {folder} is neither empty nor a calibration store: it contains "
                f"{sorted(others)[0]}, but no file {STORE_FILE}",
                "choose an empty or a new folder with --store",
            )
        write_file(marker, STORE_MARKER, replace=False)
    return CalibrationStore(folder)


def _is_sharded(folder: Path) -> bool:
    """Return whether `folder` is marked as a fleet's store.

    Raises:
        InputError: the marker has another schema.
    """
    marker = folder / STORE_FILE
    try:
        text = marker.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as fault:
        raise MachineError(
            f"the file {marker} of the calibration store cannot be read ({fault.strerror})",
            "correct the permissions of the file",
        ) from fault
    check_store_marker(text, str(marker))
    return True


def check_store_marker(text: bytes, name: str) -> None:
    """Check the schema of a `gyrorig-store.yaml`.

    Raises:
        InputError: it has another schema, or cannot be read.
    """
    marker = parse_yaml(text, name, InputError)
    schema = marker.get("schema") if isinstance(marker, dict) else None
    if schema != STORE_SCHEMA:
        raise InputError(
            f"the store file {name} has the schema {str(schema)[:40]!r} instead of "
            f"{STORE_SCHEMA!r}",
            "use the version of gyrorig that wrote the store, or a newer version",
        )
