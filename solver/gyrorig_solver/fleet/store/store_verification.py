"""Verification of a store: every file against its digest, its successor, index and manifests.

What to use when: `verify`, and `REMEDIES` for what to do about each kind of fault.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from gyrorig_protocol.errors import GyrorigError
from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.fleet.store.manifest import manifest_name, read_manifests
from gyrorig_solver.fleet.store.store_heads import find_rolled_back
from gyrorig_solver.fleet.store.store_index import StoreIndex, index_files
from gyrorig_solver.fleet.store.store_queries import (
    is_version_file,
    list_documents,
    open_existing_store,
)
from gyrorig_solver.storage import Storage, StorageEntry, storage_at


@dataclass(frozen=True, slots=True)
class StoreFault:
    """One fault of a store."""

    kind: str  # damaged | missing | unknown | chain | unreadable | unsigned | rolled back
    file: str
    text: str


REMEDIES = {
    "damaged": "Restore the file from a backup. Without a backup, remove the file and run "
    "`gyrorig store rebuild-index STORE`.",
    "missing": "Restore the file from a backup. Without a backup, run "
    "`gyrorig store rebuild-index STORE`.",
    "unknown": "Add the file to the index with `gyrorig store rebuild-index STORE`, or remove it.",
    "chain": (
        "A version of the calibration was changed or removed. Restore the version from a backup."
    ),
    "unreadable": "Restore the file from a backup. Without a backup, remove the file and run "
    "`gyrorig store rebuild-index STORE`.",
    "rolled back": "Restore the store from a newer backup.",
    "unsigned": "If the file is yours, run `gyrorig store rebuild-index STORE --sign KEY`. "
    "Otherwise restore it from a backup.",
}


@dataclass(frozen=True, slots=True)
class VerificationResult:
    """Result of `verify`: counts of what was checked, and the faults."""

    boards: int
    versions: int
    rows: int
    manifest_files: int  # files that a manifest lists
    faults: tuple[StoreFault, ...]


def verify(
    store: Path | Storage, key: Ed25519PublicKey | None = None, heads: Path | None = None
) -> VerificationResult:
    """Compare every file with its digest, its successor, the index and the manifests.

    With a key, manifests must be signed with it and list every calibration. With a list of heads,
    the store must contain what it contained when the list was written.

    Raises:
        UsageError: there is no store at this location.
        InputError: the index or the list of heads cannot be read.
        MachineError: the bucket does not answer.
    """
    open_existing_store(store)
    storage = storage_at(store)
    index = StoreIndex(storage)
    sql = "SELECT file, file_sha256, beside FROM rows WHERE status = 'ok'"
    indexed = _indexed_digests(index.query(sql))
    manifest_digests, faults = _read_manifest_digests(storage, key, indexed)
    check = _StoreCheck(storage, indexed, manifest_digests, key is not None)
    for _, entries in groupby(
        list_documents(storage), lambda entry: PurePosixPath(entry.name).parent
    ):
        check.check_board(list(entries))
    missing = sorted({*indexed, *manifest_digests} - check.seen)
    missing_faults = [
        StoreFault("missing", name, "the file was written, but it no longer exists")
        for name in missing
    ]
    (count,) = index.query("SELECT count(*) FROM rows")[0]
    rolled_back = [] if heads is None else find_rolled_back(storage, heads)
    rollback_faults = [StoreFault("rolled back", name, text) for name, text in rolled_back]
    all_faults = (*faults, *check.faults, *missing_faults, *rollback_faults)
    return VerificationResult(
        check.boards, check.versions, int(count), len(manifest_digests), all_faults
    )


def _indexed_digests(rows: Sequence[Sequence[Any]]) -> dict[str, str]:
    """Return the digests in the index by name, of documents and the files next to them."""
    digests: dict[str, str] = {}
    for file, digest, companions in rows:
        digests[file] = digest
        folder = file.rpartition("/")[0]
        for line in companions or ():
            companion_digest, _, name = line.partition("  ")
            digests[f"{folder}/{name}"] = companion_digest
    return digests


def _read_manifest_digests(
    storage: Storage, key: Ed25519PublicKey | None, indexed: Mapping[str, str]
) -> tuple[dict[str, str], list[StoreFault]]:
    """Return the digests in the manifests, and the faults of manifests and index.

    A file of the index is missing if a document of its manifest has no row. A later batch may have
    written the rows again, into another file.
    """
    manifest_digests: dict[str, str] = {}
    faults: list[StoreFault] = []
    present = set(index_files(storage))
    manifests = {manifest.name: manifest for manifest in read_manifests(storage, key)}
    for manifest in manifests.values():
        if manifest.signed is False:
            faults.append(
                StoreFault("unsigned", manifest.name, "the manifest is not signed with this key")
            )
            continue
        manifest_digests.update(manifest.digests)
        data = storage.read(manifest.index_file)
        if data is None:
            without_row = manifest.digests.keys() - indexed.keys() - {manifest.index_file}
            if without_row:
                text = f"{len(without_row)} files of its manifest have no row"
                faults.append(StoreFault("missing", manifest.index_file, text))
        elif hashlib.sha256(data).hexdigest() != manifest_digests.get(manifest.index_file):
            faults.append(
                StoreFault("damaged", manifest.index_file, "its SHA-256 differs from the manifest")
            )
        manifest_digests.pop(manifest.index_file, None)
    if key is not None:
        faults += [
            StoreFault("unsigned", file, "no manifest lists it")
            for file in sorted(present)
            if manifest_name(file) not in manifests
        ]
    return manifest_digests, faults


@dataclass(slots=True)
class _StoreCheck:
    """State of a verification that goes through all documents, board by board."""

    storage: Storage
    indexed: dict[str, str]  # digests by name
    manifest_digests: dict[str, str]
    requires_signature: bool
    boards: int = 0
    versions: int = 0
    seen: set[str] = field(default_factory=set)
    faults: list[StoreFault] = field(default_factory=list)

    def check_board(self, entries: Sequence[StorageEntry]) -> None:
        """Check all files of one board."""
        self.boards += 1
        previous_digest = ""
        documents = {entry.name for entry in entries if is_version_file(entry.name)}
        for name in sorted(documents, key=_version_number):
            data = self.storage.read(name) or b""
            digest = hashlib.sha256(data).hexdigest()
            self._check_digest(name, digest)
            self._check_document(name, data, previous_digest)
            previous_digest = digest
            self.versions += 1
        for name in sorted({entry.name for entry in entries} - documents):
            # Files without a row are skipped, such as a report whose batch was killed.
            if name in self.indexed or name in self.manifest_digests:
                self._check_digest(name, hashlib.sha256(self.storage.read(name) or b"").hexdigest())

    def _check_digest(self, name: str, digest: str) -> None:
        self.seen.add(name)
        if name not in self.indexed:
            if name not in self.manifest_digests:
                self.faults.append(StoreFault("unknown", name, "the index does not list it"))
        elif self.indexed[name] != digest:
            self.faults.append(StoreFault("damaged", name, "its SHA-256 differs from the index"))
            return
        if name in self.manifest_digests and self.manifest_digests[name] != digest:
            self.faults.append(StoreFault("damaged", name, "its SHA-256 differs from the manifest"))
        elif self.requires_signature and name not in self.manifest_digests:
            self.faults.append(StoreFault("unsigned", name, "no signed manifest lists it"))

    def _check_document(self, name: str, data: bytes, previous_digest: str) -> None:
        try:
            calibration = parse_calibration(data, name)
        except GyrorigError as fault:
            self.faults.append(StoreFault("unreadable", name, str(fault)))
            return
        if calibration.previous != (f"sha256:{previous_digest}" if previous_digest else None):
            text = "the reference of the version to the previous version does not match"
            self.faults.append(StoreFault("chain", name, text))


def _version_number(name: str) -> int:
    return int(PurePosixPath(name).stem[1:])
