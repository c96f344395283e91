"""A fleet's store looked at: what is in it, whether it is whole, its index made anew.

What to use when: `newest` and `versions_of` for lists, `verify` for what is damaged,
missing or unknown, `rebuild_index` where the index was lost. The calibrations are what
counts; the index can always be made from them.
"""

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gyrorig_protocol.errors import BusyError, GyrorigError, UsageError
from gyrorig_solver.calibration.document import Calibration, parse_calibration
from gyrorig_solver.calibration.store import STORE_FILE, CalibrationStore
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.journal import others_run
from gyrorig_solver.fleet.rows import Row, row_of_calibration
from gyrorig_solver.fleet.task import key_of

LISTED = ("board", "version", "trust", "created", "start", "sensor", "rig", "uid", "file")
_RECORDING = re.compile(r"\d{8}T\d{6}Z_(?P<rig>[A-Za-z0-9-]+)_(?P<session>.+?)(_p\d+)?\.mcap")
_VERSION_FILE = re.compile(r"v(\d{4,9})\.yaml")


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


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong with a store."""

    kind: str  # damaged | missing | unknown | chain | unreadable
    file: str
    text: str


@dataclass(frozen=True, slots=True)
class Verified:
    """What `verify` looked at, and what is wrong."""

    boards: int
    versions: int
    rows: int
    faults: tuple[Fault, ...]


def opened(folder: Path) -> CalibrationStore:
    """Return the fleet's store in `folder`.

    Raises:
        UsageError: there is none.
        InputError: it is of another schema.
    """
    if not (folder / STORE_FILE).is_file():
        raise UsageError(
            f"{folder} is no store of a fleet: it holds no {STORE_FILE}",
            "name the folder that `gyrorig batch --store` wrote",
        )
    return CalibrationStore(folder)


def newest(folder: Path, chosen: Chosen, limit: int) -> list[dict[str, Any]]:
    """Return the newest version of each board, at most `limit`, by name."""
    where, values = chosen.clause()
    sql = (
        f"SELECT {', '.join(LISTED)} FROM rows WHERE status = 'ok' AND {where} "  # noqa: S608
        "QUALIFY row_number() OVER (PARTITION BY board ORDER BY version DESC) = 1 "
        "ORDER BY board LIMIT ?"
    )
    return _named(LISTED, Index(folder).ask(sql, [*values, limit]))


def versions_of(folder: Path, chosen: Chosen, limit: int) -> list[dict[str, Any]]:
    """Return every version, at most `limit`, by board and version."""
    where, values = chosen.clause()
    sql = (
        f"SELECT {', '.join(LISTED)} FROM rows WHERE status = 'ok' AND {where} "  # noqa: S608
        "ORDER BY board, version LIMIT ?"
    )
    return _named(LISTED, Index(folder).ask(sql, [*values, limit]))


def gone_wrong(folder: Path, limit: int) -> list[dict[str, Any]]:
    """Return the work that has no calibration, the latest first."""
    names = ("status", "reason", "names", "board", "created", "trace")
    sql = (
        f"SELECT {', '.join(names)} FROM rows WHERE status <> 'ok' "  # noqa: S608
        "ORDER BY created DESC LIMIT ?"
    )
    return _named(names, Index(folder).ask(sql, [limit]))


def verify(folder: Path) -> Verified:
    """Compare every version with its digest, its successor and the index.

    Raises:
        UsageError: there is no store.
        InputError: the index cannot be read.
    """
    opened(folder)
    index = Index(folder)
    sql = "SELECT file, file_sha256 FROM rows WHERE status = 'ok'"
    listed: dict[str, str] = dict(index.ask(sql))
    faults: list[Fault] = []
    seen: set[str] = set()
    boards = 0
    for board in _boards(folder):
        boards += 1
        before = ""
        for path in _versions(board):
            name = str(path.relative_to(folder))
            seen.add(name)
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            faults += _faults_of(path, name, digest, before, listed.get(name))
            before = digest
    missing = sorted(set(listed) - seen)
    faults += [
        Fault("missing", name, "the index names it, and it is not there") for name in missing
    ]
    (count,) = index.ask("SELECT count(*) FROM rows")[0]
    return Verified(boards, len(seen), int(count), tuple(faults))


def rebuild_index(folder: Path) -> int:
    """Make the index anew from the calibrations; return how many there are.

    What the old index knows of work without a calibration is kept where it can be read.

    Raises:
        UsageError: there is no store.
        BusyError: a batch is running.
        MachineError: the disk refuses; the old index stays.
    """
    opened(folder)
    if others_run(folder, ""):
        raise BusyError(f"a batch writes to {folder}", "wait until it has ended")
    written = 0

    def counted() -> Iterator[Row]:
        nonlocal written
        for row in _rows_of_calibrations(folder):
            written += 1
            yield row

    now = datetime.now(UTC)
    Index(folder).rebuild(counted(), f"{now:%Y%m%dT%H%M%S%fZ}-rebuilt")
    return written


def _faults_of(
    path: Path, name: str, digest: str, before: str, listed: str | None
) -> Iterator[Fault]:
    if listed is None:
        yield Fault("unknown", name, "the index does not name it")
    elif listed != digest:
        yield Fault("damaged", name, "its bytes are not those that were written")
    try:
        made = parse_calibration(path.read_bytes(), name)
    except GyrorigError as fault:
        yield Fault("unreadable", name, str(fault))
        return
    expected = f"sha256:{before}" if before else None
    if made.previous != expected:
        yield Fault("chain", name, "the version before it is not the one it was made after")


def _boards(folder: Path) -> Iterator[Path]:
    for board in sorted((folder / "calib").glob("??/??/*")):
        if board.is_dir():
            yield board


def _versions(board: Path) -> Sequence[Path]:
    found = (path for path in board.iterdir() if _VERSION_FILE.fullmatch(path.name))
    return sorted(found, key=lambda path: int(path.stem[1:]))


def _rows_of_calibrations(folder: Path) -> Iterator[Row]:
    for board in _boards(folder):
        for path in _versions(board):
            data = path.read_bytes()
            try:
                made = parse_calibration(data, str(path))
            except GyrorigError:
                continue  # `verify` says so
            yield _row(made, str(path.relative_to(folder)), hashlib.sha256(data).hexdigest())


def _row(made: Calibration, file: str, digest: str) -> Row:
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
    )


def _named(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[dict[str, Any]]:
    return [dict(zip(names, row, strict=True)) for row in rows]
