"""Queries on a calibration store: lists of versions, and writing the index again.

What to use when: `newest_versions` and `all_versions` for lists, `versions_by_measurement_time`
for the versions of one board in the order of their recordings, `rebuild_index` if the index was
lost; `store_verification.verify` to find damaged, missing or unknown files. The index can always
be written again from the calibrations, which are authoritative.
"""

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import (
    STORE_FILE,
    VERSION_FILE,
    CalibrationDocument,
    CalibrationStore,
    StoredVersion,
    parse_calibration,
)
from gyrorig_solver.fleet.store.coordination import exclusive_access
from gyrorig_solver.fleet.store.index_rows import (
    NEWEST_FIRST_SQL,
    UNSUCCESSFUL_ROWS_SQL,
    IndexRow,
    calibration_row,
    job_key,
)
from gyrorig_solver.fleet.store.manifest import Signer, remove_manifests, write_manifests
from gyrorig_solver.fleet.store.store_index import StoreIndex
from gyrorig_solver.storage import Folder, Storage, StorageEntry, storage_at

LISTED_COLUMNS = ("board", "version", "trust", "created", "start", "sensor", "rig", "uid", "file")
_RECORDING_NAME = re.compile(r"\d{8}T\d{6}Z_(?P<rig>[A-Za-z0-9-]+)_(?P<session>.+?)(_p\d+)?\.mcap")
_PARTS_OF_A_VERSION_PATH = 5  # calib/<h2>/<h2>/<board>/<file>


@dataclass(frozen=True, slots=True)
class VersionFilter:
    """Filter of a query on the index; None matches everything."""

    board: str | None = None  # with the wildcards * and ?
    sensor: str | None = None
    rig: str | None = None
    config_hash: str | None = None
    since: datetime | None = None
    until: datetime | None = None

    def where_clause(self) -> tuple[str, list[Any]]:
        """Return the SQL condition, and the values for its question marks."""
        conditions: list[tuple[str, Any]] = [
            ("board GLOB ?", self.board),
            ("sensor = ?", self.sensor),
            ("rig = ?", self.rig),
            ("config_hash = ?", self.config_hash),
            ("created >= ?", self.since),
            ("created < ?", self.until),
        ]
        active = [(sql, value) for sql, value in conditions if value is not None]
        return " AND ".join(["TRUE", *(sql for sql, _ in active)]), [
            parameter for _, parameter in active
        ]


def open_existing_store(store: Path | Storage) -> CalibrationStore:
    """Return the calibrations of a fleet's store.

    Raises:
        UsageError: there is no store at this location.
        InputError: it has another schema.
        MachineError: the bucket does not answer.
    """
    storage = storage_at(store)
    if isinstance(storage, Folder) and storage.path.is_file():
        raise UsageError(
            f"{storage.location} is a file. A calibration store, which is a folder, is expected "
            "here",
            "give the location that was used with `gyrorig batch --store`",
        )
    if storage.read(STORE_FILE) is None:
        raise UsageError(
            f"the location {storage.location} is not a calibration store, because it has no "
            f"file {STORE_FILE}",
            "give the location that was used with `gyrorig batch --store`",
        )
    return CalibrationStore(storage)


def newest_versions(
    store: Path | Storage, version_filter: VersionFilter, limit: int
) -> list[dict[str, Any]]:
    """Return the version of each board's last recording, at most `limit`."""
    where, values = version_filter.where_clause()
    sql = (
        f"SELECT {', '.join(LISTED_COLUMNS)} FROM rows WHERE status = 'ok' AND {where} "  # noqa: S608
        f"QUALIFY row_number() OVER (PARTITION BY board ORDER BY {NEWEST_FIRST_SQL}) = 1 "
        "ORDER BY board LIMIT ?"
    )
    return _rows_as_dicts(LISTED_COLUMNS, StoreIndex(store).query(sql, [*values, limit]))


def all_versions(
    store: Path | Storage, version_filter: VersionFilter, limit: int
) -> list[dict[str, Any]]:
    """Return every version, at most `limit`, by board and version."""
    where, values = version_filter.where_clause()
    sql = (
        f"SELECT {', '.join(LISTED_COLUMNS)} FROM rows WHERE status = 'ok' AND {where} "  # noqa: S608
        "ORDER BY board, version LIMIT ?"
    )
    return _rows_as_dicts(LISTED_COLUMNS, StoreIndex(store).query(sql, [*values, limit]))


@dataclass(frozen=True, slots=True)
class MeasuredVersion:
    """One version of a board, with time and configuration of its recording."""

    version: StoredVersion
    start: datetime  # UTC, of the first recording
    config_hash: str


def versions_by_measurement_time(store: Storage, board: BoardId) -> list[MeasuredVersion]:
    """Return the versions of a board in the order of their recordings.

    A version that the index does not have, because `gyrorig solve` wrote it, is opened.

    Raises:
        UsageError: there is no store at this location.
        InputError: the index or a version that it does not have is damaged.
    """
    versions = open_existing_store(store).versions(board)
    sql = "SELECT version, start, config_hash FROM rows WHERE status = 'ok' AND board = ?"
    known = {
        version: (start, config_hash or "")
        for version, start, config_hash in StoreIndex(store).query(sql, [board])
        if start is not None
    }
    measured: list[MeasuredVersion] = []
    for stored_version in versions:
        if stored_version.number not in known:
            calibration = parse_calibration(stored_version.data(), str(stored_version.path))
            # a calibration from a table has no recording
            start = calibration.inputs[0].start if calibration.inputs else calibration.created
            started = datetime.fromisoformat(start).replace(tzinfo=None)
            known[stored_version.number] = (started, calibration.board.config.config_hash or "")
        measured.append(MeasuredVersion(stored_version, *known[stored_version.number]))
    return sorted(measured, key=lambda item: (item.start, item.version.number))


def unsuccessful_work(
    store: Path | Storage, version_filter: VersionFilter, limit: int
) -> list[dict[str, Any]]:
    """Return the recordings without a calibration, those of the latest job first."""
    where, values = version_filter.where_clause()
    names = ("status", "reason", "names", "board", "created", "trace")
    sql = (
        f"SELECT {', '.join(names)} FROM {UNSUCCESSFUL_ROWS_SQL} WHERE {where} "  # noqa: S608
        "ORDER BY created DESC, names, board, key LIMIT ?"
    )
    return _rows_as_dicts(names, StoreIndex(store).query(sql, [*values, limit]))


def rebuild_index(store: Path | Storage, signer: Signer | None = None) -> int:
    """Write the index and the manifests again from the calibrations; return their number.

    Rows of jobs without a calibration are copied from the old index if it can be read.

    Raises:
        UsageError: there is no store.
        BusyError: a batch is running.
        MachineError: the disk or the bucket refuses; the old index stays.
    """
    calibrations = open_existing_store(store)
    storage = storage_at(store)
    row_count = 0

    def counted() -> Iterator[IndexRow]:
        nonlocal row_count
        for row in _calibration_rows(storage, calibrations):
            row_count += 1
            yield row

    now = datetime.now(UTC)
    with exclusive_access(storage):
        StoreIndex(storage).rebuild(counted(), f"{now:%Y%m%dT%H%M%S%fZ}-rebuilt")
        remove_manifests(storage)
        write_manifests(storage, signer)
    return row_count


def list_documents(storage: Storage) -> Iterator[StorageEntry]:
    """Yield the files of all boards, those of one board after each other."""
    for entry in storage.list_files("calib"):
        name = PurePosixPath(entry.name)
        if len(name.parts) == _PARTS_OF_A_VERSION_PATH and not name.name.startswith("."):
            yield entry


def is_version_file(name: str) -> bool:
    """Return whether a file of that name is a calibration."""
    return VERSION_FILE.fullmatch(PurePosixPath(name).name) is not None


def _calibration_rows(storage: Storage, store: CalibrationStore) -> Iterator[IndexRow]:
    for entry in list_documents(storage):
        if not is_version_file(entry.name):
            continue
        data = storage.read(entry.name) or b""
        try:
            calibration = parse_calibration(data, entry.name)
        except GyrorigError:
            continue  # `verify` reports it
        companions = store.companion_digests(store.version_named(entry.name))
        yield _rebuilt_row(calibration, entry.name, hashlib.sha256(data).hexdigest(), companions)


def _rebuilt_row(
    calibration: CalibrationDocument, file: str, digest: str, companions: Sequence[str]
) -> IndexRow:
    """Return a version's row; session and rig come from the recording's file name."""
    name = calibration.inputs[0].name if calibration.inputs else ""
    match = _RECORDING_NAME.fullmatch(name)
    inputs = [recording.sha256 for recording in calibration.inputs]
    return calibration_row(
        calibration,
        key=job_key(inputs, calibration.solver.version, calibration.solver.config_sha256),
        batch="rebuilt",
        session=match["session"] if match else "",
        rig=match["rig"] if match else "",
        file=file,
        file_sha256=digest,
        companions=companions,
    )


def _rows_as_dicts(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[dict[str, Any]]:
    return [dict(zip(names, row, strict=True)) for row in rows]
