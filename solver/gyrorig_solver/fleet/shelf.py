"""A fleet's store looked at: what is in it, whether it is whole, its index made anew.

What to use when: `newest` and `versions_of` for lists, `verify` for what is damaged,
missing or unknown, `rebuild_index` where the index was lost. The calibrations are what
counts; the index can always be made from them.
"""

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from gyrorig_protocol.errors import BusyError, GyrorigError, UsageError
from gyrorig_solver.calibration.document import Calibration, parse_calibration
from gyrorig_solver.calibration.store import STORE_FILE, VERSION_FILE, CalibrationStore
from gyrorig_solver.fleet.bucket_store import store_at
from gyrorig_solver.fleet.ledger import index_at, others_write
from gyrorig_solver.fleet.manifest import (
    Signer,
    index_files,
    manifest_of,
    read_manifests,
    seal,
    unseal,
)
from gyrorig_solver.fleet.rows import Row, row_of_calibration
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


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong with a store."""

    kind: str  # damaged | missing | unknown | chain | unreadable | unsigned
    file: str
    text: str


@dataclass(frozen=True, slots=True)
class Verified:
    """What `verify` looked at, and what is wrong."""

    boards: int
    versions: int
    rows: int
    sealed: int  # files that a manifest names
    faults: tuple[Fault, ...]


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
    """Return the newest version of each board, at most `limit`, by name."""
    where, values = chosen.clause()
    sql = (
        f"SELECT {', '.join(LISTED)} FROM rows WHERE status = 'ok' AND {where} "  # noqa: S608
        "QUALIFY row_number() OVER (PARTITION BY board ORDER BY version DESC) = 1 "
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


def gone_wrong(store: Path | Place, limit: int) -> list[dict[str, Any]]:
    """Return the work that has no calibration, the latest first."""
    names = ("status", "reason", "names", "board", "created", "trace")
    sql = (
        f"SELECT {', '.join(names)} FROM rows WHERE status <> 'ok' "  # noqa: S608
        "ORDER BY created DESC LIMIT ?"
    )
    return _named(names, index_at(place_at(store)).ask(sql, [limit]))


def verify(store: Path | Place, key: Ed25519PublicKey | None = None) -> Verified:
    """Compare every file with its digest, its successor, the index and the manifests.

    Args:
        store: where it is.
        key: the manifests have to be signed with it, and to name every calibration.

    Raises:
        UsageError: there is no store.
        InputError: the index cannot be read.
        MachineError: the bucket does not answer.
    """
    opened(store)
    place = place_at(store)
    index = index_at(place)
    sql = "SELECT file, file_sha256, beside FROM rows WHERE status = 'ok'"
    listed = _listed(index.ask(sql))
    sealed, faults = _sealed(place, key)
    look = _Look(place, listed, sealed, key is not None)
    for _, entries in groupby(_documents(place), lambda entry: PurePosixPath(entry.name).parent):
        look.at_board(list(entries))
    missing = sorted({*listed.of, *sealed} - look.seen)
    gone = [Fault("missing", one, "it was written, and it is not there") for one in missing]
    (count,) = index.ask("SELECT count(*) FROM rows")[0]
    found = (*faults, *look.faults, *gone)
    return Verified(look.boards, look.versions, int(count), len(sealed), found)


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
    if others_write(place):
        raise BusyError(f"a batch writes to {place.text}", "wait until it has ended")
    written = 0

    def counted() -> Iterator[Row]:
        nonlocal written
        for row in _rows_of_calibrations(place, calibrations):
            written += 1
            yield row

    now = datetime.now(UTC)
    index_at(place).rebuild(counted(), f"{now:%Y%m%dT%H%M%S%fZ}-rebuilt")
    unseal(place)
    seal(place, signer)
    return written


@dataclass(frozen=True, slots=True)
class _Listed:
    """What the index names."""

    of: dict[str, str]  # digests by name, of documents and of what lies beside them
    documents: frozenset[str]


def _listed(rows: Sequence[Sequence[Any]]) -> _Listed:
    digests: dict[str, str] = {}
    for file, digest, beside in rows:
        digests[file] = digest
        folder = file.rpartition("/")[0]
        for line in beside or ():
            one, _, name = line.partition("  ")
            digests[f"{folder}/{name}"] = one
    return _Listed(digests, frozenset(file for file, *_ in rows))


def _sealed(place: Place, key: Ed25519PublicKey | None) -> tuple[dict[str, str], list[Fault]]:
    """Return the digests that manifests name, and what is wrong with manifests and index."""
    sealed: dict[str, str] = {}
    faults: list[Fault] = []
    there = set(index_files(place))
    manifests = {one.name: one for one in read_manifests(place, key)}
    for one in manifests.values():
        if one.signed is False:
            faults.append(Fault("unsigned", one.name, "this key has not signed it"))
            continue
        sealed.update(one.digests)
        if one.index_file in there:
            data = place.read(one.index_file) or b""
            if hashlib.sha256(data).hexdigest() != sealed.get(one.index_file):
                faults.append(Fault("damaged", one.index_file, "its manifest has another digest"))
        sealed.pop(one.index_file, None)
    if key is not None:
        faults += [
            Fault("unsigned", file, "no manifest names it")
            for file in sorted(there)
            if manifest_of(file) not in manifests
        ]
    return sealed, faults


@dataclass(slots=True)
class _Look:
    """All documents looked at, board by board."""

    place: Place
    listed: _Listed
    sealed: dict[str, str]
    asks_signed: bool
    boards: int = 0
    versions: int = 0
    seen: set[str] = field(default_factory=set)
    faults: list[Fault] = field(default_factory=list)

    def at_board(self, entries: Sequence[Entry]) -> None:
        """Look at all files of one board."""
        self.boards += 1
        before = ""
        documents = {entry.name for entry in entries if _is_version(entry.name)}
        for name in sorted(documents, key=_number):
            data = self.place.read(name) or b""
            digest = hashlib.sha256(data).hexdigest()
            self._compare(name, digest)
            self._parse(name, data, before)
            before = digest
            self.versions += 1
        for name in sorted({entry.name for entry in entries} - documents):
            # What no row names: a report whose batch was killed before its row, say.
            if name in self.listed.of or name in self.sealed:
                self._compare(name, hashlib.sha256(self.place.read(name) or b"").hexdigest())

    def _compare(self, name: str, digest: str) -> None:
        self.seen.add(name)
        if name not in self.listed.of:
            if name not in self.sealed:
                self.faults.append(Fault("unknown", name, "the index does not name it"))
        elif self.listed.of[name] != digest:
            self.faults.append(Fault("damaged", name, "its bytes are not those that were written"))
            return
        if name in self.sealed and self.sealed[name] != digest:
            self.faults.append(Fault("damaged", name, "its manifest has another digest"))
        elif self.asks_signed and name not in self.sealed:
            self.faults.append(Fault("unsigned", name, "no signed manifest names it"))

    def _parse(self, name: str, data: bytes, before: str) -> None:
        try:
            made = parse_calibration(data, name)
        except GyrorigError as fault:
            self.faults.append(Fault("unreadable", name, str(fault)))
            return
        if made.previous != (f"sha256:{before}" if before else None):
            text = "the version before it is not the one it was made after"
            self.faults.append(Fault("chain", name, text))


def _documents(place: Place) -> Iterator[Entry]:
    """Yield the files of all boards, those of one board together."""
    for entry in place.entries("calib"):
        name = PurePosixPath(entry.name)
        if len(name.parts) == _IN_CALIB and not name.name.startswith("."):
            yield entry


def _is_version(name: str) -> bool:
    return VERSION_FILE.fullmatch(PurePosixPath(name).name) is not None


def _number(name: str) -> int:
    return int(PurePosixPath(name).stem[1:])


def _rows_of_calibrations(place: Place, store: CalibrationStore) -> Iterator[Row]:
    for entry in _documents(place):
        if not _is_version(entry.name):
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
