"""Store of calibrations: one folder per board, one immutable file per version, also in a bucket.

    STORE/<board>/v0001.yaml  v0001.report.html  v0002.yaml ...

A fleet's store, marked by `gyrorig-store.yaml`, distributes its boards over 65536 folders,
because a folder of a million entries is slow:

    STORE/calib/<h2>/<h2>/<board>/v0001.yaml ...    h2: digits of the SHA-256 of the board's name

What to use when: `CalibrationStore.add_version` to write the next version, `latest` to read one,
`create_store` at the start of a batch.
Each version contains the digest of the previous one, therefore a changed or missing version is
detected. Two solvers can write at the same time: a version's name is taken by a write that never
replaces a file. If another solver was first, the next number is tried.
"""

import hashlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import BusyError, InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.storage import Folder, Storage, storage_at

STORE_FILE = "gyrorig-store.yaml"
STORE_SCHEMA = "gyrorig/store/1"
STORE_MARKER = f'schema: "{STORE_SCHEMA}"\n'.encode()
VERSION_FILE = re.compile(r"v(\d{4,9})\.yaml")
MAX_ATTEMPTS = 100  # each failed attempt means that another solver wrote a version


@dataclass(frozen=True, slots=True)
class StoredVersion:
    """One version in the store."""

    number: int
    name: str  # in the store
    storage: Storage

    @property
    def path(self) -> Path:
        """The path of its file; in a bucket the name of the object."""
        return _path_in(self.storage, self.name)

    def data(self) -> bytes:
        """Return the file's bytes."""
        return _read_existing(self.storage, self.name)

    def digest(self) -> str:
        """Return `sha256:` and the digest of the file's bytes."""
        return "sha256:" + hashlib.sha256(self.data()).hexdigest()


class CalibrationStore:
    """The versions of all boards in one folder, or below one prefix of a bucket."""

    def __init__(self, location: Path | Storage) -> None:
        """Open the store, which need not exist yet.

        Raises:
            InputError: its `gyrorig-store.yaml` has another schema.
            MachineError: the folder cannot be read, or the bucket does not answer.
        """
        self.storage = storage_at(location)
        marker = self.storage.read(STORE_FILE)
        if marker is not None:
            _check_marker(marker, f"{self.storage.location}/{STORE_FILE}")
        self.sharded = marker is not None or not isinstance(self.storage, Folder)

    def folder_of(self, board: BoardId) -> Path:
        """Return the folder of the versions of `board`; in a bucket the prefix of their names."""
        return _path_in(self.storage, self._folder_name(board))

    def versions(self, board: BoardId) -> list[StoredVersion]:
        """Return the versions of `board`, oldest first."""
        folder = f"{self._folder_name(board)}/"
        stored_versions = (
            StoredVersion(int(match[1]), entry.name, self.storage)
            for entry in self.storage.list_files(folder)
            if (match := VERSION_FILE.fullmatch(entry.name.removeprefix(folder)))
        )
        return sorted(stored_versions, key=lambda version: version.number)

    def latest(self, board: BoardId) -> StoredVersion | None:
        """Return the newest version of `board`, None if it has none."""
        versions = self.versions(board)
        return versions[-1] if versions else None

    def prepare_folder(self, board: BoardId) -> Path:
        """Create the folder of `board`.

        Raises:
            MachineError: the folder cannot be created or written.
        """
        folder = self.folder_of(board)
        if not isinstance(self.storage, Folder):
            return folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise MachineError(
                f"the folder {folder} cannot be created ({fault.strerror})",
                "choose another folder with --out",
            ) from fault
        _check_permission(folder)
        return folder

    def check_folder(self, board: BoardId) -> None:
        """Check that the folder of `board` can be written, before the calibration is computed.

        Nothing is created, so that a refused solve leaves no empty folder.

        Raises:
            MachineError: the folder cannot be created or written.
        """
        folder = self.folder_of(board)
        if not isinstance(self.storage, Folder):
            return
        # Path.exists raises an exception below a folder that the user must not enter.
        parents = (folder, *folder.parents)
        existing = next(path for path in parents if os.path.exists(path))  # noqa: PTH110
        if not existing.is_dir():
            raise MachineError(
                f"the folder {folder} cannot be created, because {existing} is a file",
                "choose another folder with --out",
            )
        _check_permission(existing)

    def version_named(self, name: str) -> StoredVersion:
        """Return the version of that name in the store."""
        return StoredVersion(int(PurePosixPath(name).stem[1:]), name, self.storage)

    def companion_digests(self, version: StoredVersion) -> list[str]:
        """Return `<sha256>  <name>` of each file that belongs to a version, as sha256sum does.

        Raises:
            MachineError: one of them cannot be read.
        """
        prefix = version.name.removesuffix("yaml")  # v0001.
        folder = prefix.rpartition("/")[0]
        return [
            f"{hashlib.sha256(_read_existing(self.storage, name)).hexdigest()}  "
            f"{name.removeprefix(folder + '/')}"
            for name in sorted(entry.name for entry in self.storage.list_files(f"{folder}/"))
            if name.startswith(prefix) and name != version.name
        ]

    def write_companion(self, version: StoredVersion, suffix: str, data: bytes) -> Path:
        """Write a file that belongs to a version, such as `v0001.report.html`; return its path.

        Raises:
            MachineError: it cannot be written.
        """
        name = version.name.removesuffix(".yaml") + suffix
        self.storage.write(name, data)
        return _path_in(self.storage, name)

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

        Raises:
            MachineError: it cannot be written.
            BusyError: other solvers took a hundred numbers in succession.
        """
        folder = self.prepare_folder(board)
        for _ in range(MAX_ATTEMPTS):
            last = self.latest(board)
            # A version that another solver adds from here on takes this number, and the next
            # attempt checks it.
            check_before()
            number = last.number + 1 if last else 1
            text = make_text(number, last.digest() if last else None)
            name = f"{self._folder_name(board)}/v{number:04d}.yaml"
            if self.storage.write_new(name, text.encode()):
                return StoredVersion(number, name, self.storage)
        raise BusyError(
            f"the calibration was not added to {folder}: at each of {MAX_ATTEMPTS} attempts, "
            "another solver had just added one",
            "run the command again later",
        )

    def _folder_name(self, board: BoardId) -> str:
        if not self.sharded:
            return str(board)
        digest = hashlib.sha256(board.encode()).hexdigest()
        return f"calib/{digest[:2]}/{digest[2:4]}/{board}"


def _check_permission(folder: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise MachineError(
            f"the user has no permission to write to the folder {folder}",
            "choose another folder with --out",
        )


def create_store(location: Path | Storage) -> CalibrationStore:
    """Return the store of a fleet; it is created if the location is empty.

    Raises:
        InputError: it has another schema.
        UsageError: the location contains other files.
        MachineError: the store cannot be created.
    """
    storage = storage_at(location)
    if storage.read(STORE_FILE) is None:
        temporary_prefix = f".{STORE_FILE}."  # of another process that writes now
        others = (entry.name for entry in storage.list_files())
        other = next((name for name in others if not name.startswith(temporary_prefix)), None)
        # Read again: another process writes the marker before any other file.
        if other is not None and storage.read(STORE_FILE) is None:
            raise UsageError(
                f"the location {storage.location} is neither empty nor a calibration store: it "
                f"contains {other}, but no file {STORE_FILE}",
                "choose an empty or a new location with --store",
            )
        storage.write_new(STORE_FILE, STORE_MARKER)
    return CalibrationStore(storage)


def _path_in(storage: Storage, name: str) -> Path:
    return storage.path / name if isinstance(storage, Folder) else Path(name)


def _read_existing(storage: Storage, name: str) -> bytes:
    data = storage.read(name)
    if data is None:
        raise MachineError(
            f"the file {storage.location}/{name} of the store no longer exists",
            f"check the store with `gyrorig store verify {storage.location}`",
        )
    return data


def _check_marker(text: bytes, name: str) -> None:
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
