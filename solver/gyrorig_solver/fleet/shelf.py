"""A fleet's store looked at: what is in it, and its index made anew.

What to use when: `newest` and `versions_of` for lists, `in_time` for one board's versions as
they were measured, `rebuild_index` where the index was
lost, `verifying.verify` for what is damaged, missing or unknown. The calibrations are what
counts; the index can always be made from them.
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
from gyrorig_solver.calibration.document import Calibration, parse_calibration
from gyrorig_solver.calibration.store import (
    STORE_FILE,
    VERSION_FILE,
    CalibrationStore,
    StoredVersion,
)
from gyrorig_solver.fleet.bucket_store import store_at
from gyrorig_solver.fleet.ledger import alone, index_at
from gyrorig_solver.fleet.manifest import (
    Signer,
    seal,
    unseal,
)
from gyrorig_solver.fleet.rows import NEWEST_FIRST, Row, row_of_calibration
from gyrorig_solver.fleet.task import key_of
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.place import Entry, Place

LISTED = ("board", "version", "trust", "created", "start", "sensor", "rig", "uid", "file")
_RECORDING = re.compile(r"\d{8}T\d{6}Z_(?P<rig>[A-Za-z0-9-]+)_(?P<session>.+?)(_p\d+)?\.mcap")
_IN_CALIB = 5  # calib/<h2>/<h2>/<board>/<file>


@dataclass(frozen=True, slots=True)
class Chosen:
    """Which rows of the index are asked for; what is None does not matter."""

    board: str | None = None  # with * and ? as in a shell
    sensor: str | None = None
    rig: str | None = None
    config_hash: str | None = None
    since: datetime | None = None
    until: datetime | None = None

    def clause(self) -> tuple[str, list[Any]]:
        """Return the words behind WHERE, and the values for their question marks."""
        asked: list[tuple[str, Any]] = [
            ("board GLOB ?", self.board),
            ("sensor = ?", self.sensor),
            ("rig = ?", self.rig),
            ("config_hash = ?", self.config_hash),
            ("created >= ?", self.since),
            ("created < ?", self.until),
        ]
        kept = [(words, value) for words, value in asked if value is not None]
        return " AND ".join(["TRUE", *(words for words, _ in kept)]), [v for _, v in kept]


def opened(store: Path | Place) -> CalibrationStore:
    """Return the calibrations of a fleet's store.

    Raises:
        UsageError: there is none.
        InputError: it is of another schema.
        MachineError: the bucket does not answer.
    """
    place = place_at(store)
    if place.read(STORE_FILE) is None:
        raise UsageError(
            f"{place.text} is no store of a fleet: it holds no {STORE_FILE}",
            "name what `gyrorig batch --store` wrote",
        )
    return store_at(place)


def newest(store: Path | Place, chosen: Chosen, limit: int) -> list[dict[str, Any]]:
    """Return the newest version of each board, that of the last recording, at most `limit`."""
    where, values = chosen.clause()
    sql = (
        f"SELECT {', '.join(LISTED)} FROM rows WHERE status = 'ok' AND {where} "  # noqa: S608
        f"QUALIFY row_number() OVER (PARTITION BY board ORDER BY {NEWEST_FIRST}) = 1 "
        "ORDER BY board LIMIT ?"
    )
    return _named(LISTED, index_at(place_at(store)).ask(sql, [*values, limit]))


def versions_of(store: Path | Place, chosen: Chosen, limit: int) -> list[dict[str, Any]]:
    """Return every version, at most `limit`, by board and version."""
    where, values = chosen.clause()
    sql = (
        f"SELECT {', '.join(LISTED)} FROM rows WHERE status = 'ok' AND {where} "  # noqa: S608
        "ORDER BY board, version LIMIT ?"
    )
    return _named(LISTED, index_at(place_at(store)).ask(sql, [*values, limit]))


@dataclass(frozen=True, slots=True)
class Measured:
    """One version of a board, and when and how the board was when it was measured."""

    stored: StoredVersion
    start: datetime  # UTC, of the first recording
    config_hash: str


def in_time(store: Place, board: BoardId) -> list[Measured]:
    """Return the versions of a board in the order in which they were measured.

    From the index; a version that it does not know, written by `gyrorig solve`, is opened.

    Raises:
        UsageError: there is no store.
        InputError: the index is damaged, or a version that it does not know.
    """
    versions = opened(store).versions(board)
    sql = "SELECT version, start, config_hash FROM rows WHERE status = 'ok' AND board = ?"
    known = {
        version: (start, config_hash or "")
        for version, start, config_hash in index_at(store).ask(sql, [board])
        if start is not None
    }
    found: list[Measured] = []
    for stored in versions:
        if stored.number not in known:
            made = parse_calibration(stored.data(), str(stored.path))
            begun = datetime.fromisoformat(made.inputs[0].start).replace(tzinfo=None)
            known[stored.number] = (begun, made.board.config.config_hash or "")
        found.append(Measured(stored, *known[stored.number]))
    return sorted(found, key=lambda one: (one.start, one.stored.number))


def gone_wrong(store: Path | Place, limit: int) -> list[dict[str, Any]]:
    """Return the work that has no calibration, the latest first."""
    names = ("status", "reason", "names", "board", "created", "trace")
    sql = (
        f"SELECT {', '.join(names)} FROM rows WHERE status <> 'ok' "  # noqa: S608
        "ORDER BY created DESC LIMIT ?"
    )
    return _named(names, index_at(place_at(store)).ask(sql, [limit]))


def rebuild_index(store: Path | Place, signer: Signer | None = None) -> int:
    """Make the index anew from the calibrations, and the manifests; return how many there are.

    What the old index knows of work without a calibration is kept where it can be read.

    Args:
        store: where it is.
        signer: signs the new manifest.

    Raises:
        UsageError: there is no store.
        BusyError: a batch is running.
        MachineError: the disk or the bucket refuses; the old index stays.
    """
    calibrations = opened(store)
    place = place_at(store)
    written = 0

    def counted() -> Iterator[Row]:
        nonlocal written
        for row in _rows_of_calibrations(place, calibrations):
            written += 1
            yield row

    now = datetime.now(UTC)
    with alone(place):
        index_at(place).rebuild(counted(), f"{now:%Y%m%dT%H%M%S%fZ}-rebuilt")
        unseal(place)
        seal(place, signer)
    return written


def documents(place: Place) -> Iterator[Entry]:
    """Yield the files of all boards, those of one board together."""
    for entry in place.entries("calib"):
        name = PurePosixPath(entry.name)
        if len(name.parts) == _IN_CALIB and not name.name.startswith("."):
            yield entry


def is_version(name: str) -> bool:
    """Return whether a file of that name is a calibration."""
    return VERSION_FILE.fullmatch(PurePosixPath(name).name) is not None


def _rows_of_calibrations(place: Place, store: CalibrationStore) -> Iterator[Row]:
    for entry in documents(place):
        if not is_version(entry.name):
            continue
        data = place.read(entry.name) or b""
        try:
            made = parse_calibration(data, entry.name)
        except GyrorigError:
            continue  # `verify` says so
        beside = store.digests_beside(store.stored(entry.name))
        yield _row(made, entry.name, hashlib.sha256(data).hexdigest(), beside)


def _row(made: Calibration, file: str, digest: str, beside: Sequence[str]) -> Row:
    """Return a version's row; the daemon names recordings by time, rig and session."""
    named = _RECORDING.fullmatch(made.inputs[0].name)
    inputs = [one.sha256 for one in made.inputs]
    return row_of_calibration(
        made,
        key=key_of(inputs, made.solver.version, made.solver.config_sha256),
        batch="rebuilt",
        session=named["session"] if named else "",
        rig=named["rig"] if named else "",
        file=file,
        file_sha256=digest,
        beside=beside,
    )


def _named(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[dict[str, Any]]:
    return [dict(zip(names, row, strict=True)) for row in rows]
