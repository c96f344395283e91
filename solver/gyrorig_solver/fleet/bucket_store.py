"""A fleet's calibrations in a bucket: the same names and chain of versions as in a folder.

What to use when: `store_at` for the calibrations of any place, `make_store` at the start of
a batch. A version's number is taken by a put that replaces nothing; the next number is tried
when another batch was first.
"""

from collections.abc import Callable
from pathlib import Path

from gyrorig_protocol.errors import BusyError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.store import (
    MARK,
    MOST_TRIES,
    STORE_FILE,
    VERSION_FILE,
    CalibrationStore,
    StoredVersion,
    check_mark,
    make_sharded,
    sharded_name,
)
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Place


class BucketStore(CalibrationStore):
    """The versions of every board below one prefix. Paths in it are names."""

    def __init__(self, place: Place) -> None:
        """Use the store at `place`.

        Raises:
            InputError: its `gyrorig-store.yaml` is of another schema.
            MachineError: the bucket does not answer.
        """
        self.place = place
        self.folder = Path()
        self.sharded = True
        mark = place.read(STORE_FILE)
        if mark is not None:
            check_mark(mark, f"{place.text}/{STORE_FILE}")

    def versions(self, board: BoardId) -> list[StoredVersion]:
        """See `CalibrationStore`."""
        found = (
            StoredVersion(int(match[1]), Path(entry.name), self._read)
            for entry in self.place.entries(sharded_name(board) + "/")
            if (match := VERSION_FILE.fullmatch(entry.name.rpartition("/")[2]))
        )
        return sorted(found, key=lambda version: version.number)

    def stored(self, name: str) -> StoredVersion:
        """See `CalibrationStore`."""
        path = Path(name)
        return StoredVersion(int(path.stem[1:]), path, self._read)

    def prepare(self, board: BoardId) -> Path:
        """Return the folder of `board`: a bucket has no folders to be made."""
        return self.folder_of(board)

    def beside(self, stored: StoredVersion, suffix: str, data: bytes) -> Path:
        """See `CalibrationStore`."""
        path = stored.path.with_suffix(suffix)
        self.place.put(path.as_posix(), data)
        return path

    def add(
        self,
        board: BoardId,
        text_of: Callable[[int, str | None], str],
        before: Callable[[], None] = lambda: None,
    ) -> StoredVersion:
        """See `CalibrationStore`."""
        for _ in range(MOST_TRIES):
            before()
            last = self.latest(board)
            number = last.number + 1 if last else 1
            text = text_of(number, last.digest() if last else None)
            final = self.folder_of(board) / f"v{number:04d}.yaml"
            if self.place.put_new(final.as_posix(), text.encode()):
                return StoredVersion(number, final, self._read)
        raise BusyError(f"other solvers keep writing to {self.folder_of(board)}", "try again")

    def _neighbours(self, stored: StoredVersion) -> list[Path]:
        folder = f"{stored.path.parent.as_posix()}/"
        return [Path(entry.name) for entry in self.place.entries(folder)]

    def _read(self, path: Path) -> bytes:
        data = self.place.read(path.as_posix())
        if data is None:
            raise MachineError(
                f"{self.place.text}/{path} is gone",
                f"see what else is: gyrorig store verify {self.place.text}",
            )
        return data


def store_at(place: Place) -> CalibrationStore:
    """Return the calibrations of a store.

    Raises:
        InputError: it is of another schema.
        MachineError: the bucket does not answer.
    """
    return CalibrationStore(place.path) if isinstance(place, Folder) else BucketStore(place)


def make_store(place: Place) -> CalibrationStore:
    """Return the store of a fleet, which is made one if it is empty or not there.

    Raises:
        InputError: it is of another schema.
        UsageError: it holds something else.
        MachineError: it cannot be made.
    """
    if isinstance(place, Folder):
        return make_sharded(place.path)
    if place.read(STORE_FILE) is None:
        other = next(place.entries(), None)
        if other is not None and place.read(STORE_FILE) is None:
            raise UsageError(
                f"{place.text} is no store of a fleet: it holds {other.name}",
                "name an empty or a new one with --store",
            )
        place.put_new(STORE_FILE, MARK)
    return BucketStore(place)
