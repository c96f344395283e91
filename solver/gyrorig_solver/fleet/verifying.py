"""Whether a store is whole: every file against its digest, its successor, index and manifests.

What to use when: `verify`.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from gyrorig_protocol.errors import GyrorigError
from gyrorig_solver.calibration.document import parse_calibration
from gyrorig_solver.fleet.ledger import index_at
from gyrorig_solver.fleet.manifest import index_files, manifest_of, read_manifests
from gyrorig_solver.fleet.shelf import documents, is_version, opened
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.place import Entry, Place


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong with a store."""

    kind: str  # damaged | missing | unknown | chain | unreadable | unsigned
    file: str
    text: str


REMEDIES = {
    "damaged": "bring the file back from a copy; without one remove it, and do as for missing",
    "missing": "bring the file back from a copy; without one: gyrorig store rebuild-index STORE",
    "unknown": "gyrorig store rebuild-index STORE takes it in; or remove it",
    "chain": "a version was changed or taken away: bring it back from a copy",
    "unreadable": "bring the file back from a copy; without one remove it, and do as for missing",
    "unsigned": "if it is yours: gyrorig store rebuild-index STORE --sign KEY; else bring it back",
}


@dataclass(frozen=True, slots=True)
class Verified:
    """What `verify` looked at, and what is wrong."""

    boards: int
    versions: int
    rows: int
    sealed: int  # files that a manifest names
    faults: tuple[Fault, ...]


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
    for _, entries in groupby(documents(place), lambda entry: PurePosixPath(entry.name).parent):
        look.at_board(list(entries))
    missing = sorted({*listed.of, *sealed} - look.seen)
    gone = [Fault("missing", one, "it was written, and it is not there") for one in missing]
    (count,) = index.ask("SELECT count(*) FROM rows")[0]
    found = (*faults, *look.faults, *gone)
    return Verified(look.boards, look.versions, int(count), len(sealed), found)


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
        documents = {entry.name for entry in entries if is_version(entry.name)}
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


def _number(name: str) -> int:
    return int(PurePosixPath(name).stem[1:])
