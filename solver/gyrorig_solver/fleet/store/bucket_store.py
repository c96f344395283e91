"""Calibrations of a fleet in a bucket: the same names and chain of versions as in a folder.

What to use when: `open_calibration_store` for the calibrations in any storage, `create_store` at
the start of a batch. The number of a version is taken by a put that never replaces an object; if
another batch was first, the next number is tried.
"""

from collections.abc import Callable
from pathlib import Path

from gyrorig_protocol.errors import BusyError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import STORE_FILE, VERSION_FILE, CalibrationStore, StoredVersion
from gyrorig_solver.calibration.calibration_store import (
    MAX_ATTEMPTS,
    STORE_MARKER,
    check_store_marker,
    create_sharded_store,
    sharded_folder_name,
)
from gyrorig_solver.storage import Folder, Storage


class BucketStore(CalibrationStore):
    """The versions of every board below one prefix. Its paths are names of objects."""

    def __init__(self, storage: Storage) -> None:
        """Use the store at `storage`.

        Raises:
            InputError: its `gyrorig-store.yaml` is of another schema.
            MachineError: the bucket does not answer.
        """
        self.storage = storage
        self.folder = Path()
        self.sharded = True
        marker = storage.read(STORE_FILE)
        if marker is not None:
            check_store_marker(marker, f"{storage.location}/{STORE_FILE}")

    def versions(self, board: BoardId) -> list[StoredVersion]:
        """See `CalibrationStore`."""
        stored_versions = (
            StoredVersion(int(match[1]), Path(entry.name), self._read_object)
            for entry in self.storage.list_files(sharded_folder_name(board) + "/")
            if (match := VERSION_FILE.fullmatch(entry.name.rpartition("/")[2]))
        )
        return sorted(stored_versions, key=lambda version: version.number)

    def version_named(self, name: str) -> StoredVersion:
        """See `CalibrationStore`."""
        path = Path(name)
        return StoredVersion(int(path.stem[1:]), path, self._read_object)

    def prepare_folder(self, board: BoardId) -> Path:
        """Return the folder of `board`, which need not be created in a bucket."""
        return self.folder_of(board)

    def write_companion(self, version: StoredVersion, suffix: str, data: bytes) -> Path:
        """See `CalibrationStore`."""
        path = version.path.with_suffix(suffix)
        self.storage.write(path.as_posix(), data)
        return path

    def add_version(
        self,
        board: BoardId,
        make_text: Callable[[int, str | None], str],
        check_before: Callable[[], None] = lambda: None,
    ) -> StoredVersion:
        """See `CalibrationStore`."""
        for _ in range(MAX_ATTEMPTS):
            check_before()
            last = self.latest(board)
            number = last.number + 1 if last else 1
            text = make_text(number, last.digest() if last else None)
            name = self.folder_of(board) / f"v{number:04d}.yaml"
            if self.storage.write_new(name.as_posix(), text.encode()):
                return StoredVersion(number, name, self._read_object)
        raise BusyError(
            f"the calibration was not added to {self.folder_of(board)}: at each of "
            f"{MAX_ATTEMPTS} attempts, another solver had just added one",
            "run the command again later",
        )

    def _folder_files(self, version: StoredVersion) -> list[Path]:
        folder = f"{version.path.parent.as_posix()}/"
        return [Path(entry.name) for entry in self.storage.list_files(folder)]

    def _read_object(self, path: Path) -> bytes:
        data = self.storage.read(path.as_posix())
        if data is None:
            raise MachineError(
                f"the file {self.storage.location}/{path} of the store no longer exists",
                f"check the store with `gyrorig store verify {self.storage.location}`",
            )
        return data


def open_calibration_store(storage: Storage) -> CalibrationStore:
    """Return the calibrations of a store.

    Raises:
        InputError: it has another schema.
        MachineError: the bucket does not answer.
    """
    return CalibrationStore(storage.path) if isinstance(storage, Folder) else BucketStore(storage)


def create_store(storage: Storage) -> CalibrationStore:
    """Return the store of a fleet; it is created if the storage is empty.

    Raises:
        InputError: it has another schema.
        UsageError: the storage contains something else.
        MachineError: the store cannot be created.
    """
    if isinstance(storage, Folder):
        return create_sharded_store(storage.path)
    if storage.read(STORE_FILE) is None:
        first_file = next(storage.list_files(), None)
        if first_file is not None and storage.read(STORE_FILE) is None:
            raise UsageError(
                f"the location {storage.location} is neither empty nor a calibration store: it "
                f"contains {first_file.name}, but no file {STORE_FILE}",
                "choose an empty or a new location with --store",
            )
        storage.write_new(STORE_FILE, STORE_MARKER)
    return BucketStore(storage)
