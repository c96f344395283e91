"""Manifests: SHA-256 digests of all files of a store, as `sha256sum -c` checks, signed on request.

    manifest/<index file>.sha256        one line per file: the index file, documents, reports
    manifest/<index file>.sha256.sig    Ed25519 signature of those bytes, 64 bytes

What to use when: `write_manifests` at the end of a batch; `read_manifests` to verify. A manifest
depends on its index file only. Therefore the next batch completes an interrupted run, and two
batches that write a manifest for one file write the same bytes.

Without a signature, a manifest detects damage. With one, whoever has the public key also detects
forgery: the holder of the private key has signed these bytes. A batch signs what it wrote itself.
Files of others that no manifest lists get a manifest without a signature.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import duckdb
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_pem_public_key

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.fleet.store.coordination import INDEX_FOLDER as INDEX
from gyrorig_solver.fleet.store.index_rows import IndexRow
from gyrorig_solver.fleet.store.store_index import index_files
from gyrorig_solver.storage import Storage

MANIFEST_FOLDER = "manifest"
_SUFFIX = ".sha256"
_SIGNATURE_SUFFIX = ".sig"
_DIGEST_CHARS = 64  # characters of a SHA-256


@dataclass(frozen=True, slots=True)
class Signer:
    """A private key."""

    key: Ed25519PrivateKey

    def sign(self, data: bytes) -> bytes:
        """Return the signature of `data`."""
        return self.key.sign(data)


@dataclass(frozen=True, slots=True)
class Manifest:
    """One manifest of a store."""

    name: str
    index_file: str
    digests: dict[str, str]  # by name below the store
    signed: bool | None = None  # None if no key was given to check it


def read_signer(path: Path) -> Signer:
    """Return the key in a PEM file, as `openssl genpkey -algorithm ed25519` writes it.

    Raises:
        UsageError: the file has no such key.
    """
    try:
        key = load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as fault:
        raise _key_error(
            path, "private", "openssl genpkey -algorithm ed25519 -out KEY.pem"
        ) from fault
    if not isinstance(key, Ed25519PrivateKey):
        raise _key_error(path, "private", "openssl genpkey -algorithm ed25519 -out KEY.pem")
    return Signer(key)


def read_public_key(path: Path) -> Ed25519PublicKey:
    """Return the public key in a PEM file.

    Raises:
        UsageError: the file has no such key.
    """
    try:
        key = load_pem_public_key(path.read_bytes())
    except (OSError, ValueError, UnsupportedAlgorithm) as fault:
        raise _key_error(path, "public", "openssl pkey -in KEY.pem -pubout -out PUB.pem") from fault
    if not isinstance(key, Ed25519PublicKey):
        raise _key_error(path, "public", "openssl pkey -in KEY.pem -pubout -out PUB.pem")
    return key


def write_manifests(
    storage: Storage, signer: Signer | None, own_rows: Iterable[IndexRow] | None = None
) -> int:
    """Write the missing manifests, and sign only these; return their number.

    Args:
        storage: of the store.
        signer: the key; None: no manifest is signed.
        own_rows: what the caller wrote. A manifest that lists anything else is not signed. None:
            every manifest is signed, whoever wrote the files.

    Raises:
        MachineError: the store does not answer, or refuses.
        InputError: a file of the index is damaged.
    """
    existing = {entry.name for entry in storage.list_files(MANIFEST_FOLDER)}
    own_lines = None if own_rows is None else set(_manifest_lines(own_rows))
    written_count = 0
    for file in index_files(storage):
        name = manifest_name(file)
        if name not in existing:
            text = _manifest_text(storage, file)
            listed = set(text.decode().splitlines()[1:])
            if signer is not None and (own_lines is None or listed <= own_lines):
                # First, so that no own manifest is ever unsigned.
                storage.write(name + _SIGNATURE_SUFFIX, signer.sign(text))
            written_count += storage.write_new(name, text)
    return written_count


def _manifest_lines(rows: Iterable[IndexRow]) -> Iterator[str]:
    """Yield the lines of a manifest that lists these rows."""
    for row in rows:
        if row.status == "ok":
            yield from _document_lines(row.file, row.file_sha256, row.beside)


def _document_lines(file: str, digest: str, companions: Iterable[str] | None) -> Iterator[str]:
    yield f"{digest}  {file}"
    folder = PurePosixPath(file).parent
    for line in companions or ():
        yield f"{line[:_DIGEST_CHARS]}  {folder / line[_DIGEST_CHARS + 2 :]}"


def remove_manifests(storage: Storage) -> None:
    """Remove all manifests, because the index is written again.

    Raises:
        MachineError: the store does not answer, or refuses.
    """
    storage.remove([entry.name for entry in storage.list_files(MANIFEST_FOLDER)])


def manifest_name(index_file: str) -> str:
    """Return the name of the manifest of a file of the index."""
    return f"{MANIFEST_FOLDER}/{PurePosixPath(index_file).stem}{_SUFFIX}"


def read_manifests(storage: Storage, key: Ed25519PublicKey | None) -> Iterator[Manifest]:
    """Yield the manifests of a store.

    With a key, each manifest must have its signature.

    Raises:
        MachineError: the store does not answer.
    """
    for entry in list(storage.list_files(MANIFEST_FOLDER)):
        if not entry.name.endswith(_SUFFIX):
            continue
        text = storage.read(entry.name) or b""
        is_signed: bool | None = None
        if key is not None:
            is_signed = _is_signed(key, storage.read(entry.name + _SIGNATURE_SUFFIX), text)
        lines = text.decode("utf-8", "replace").splitlines()
        digests = {
            line[_DIGEST_CHARS + 2 :]: line[:_DIGEST_CHARS]
            for line in lines
            if len(line) > _DIGEST_CHARS + 2
        }
        index_file = f"{INDEX}/{PurePosixPath(entry.name).stem}.parquet"
        yield Manifest(entry.name, index_file, digests, is_signed)


def _manifest_text(storage: Storage, index_file: str) -> bytes:
    """Return the manifest of an index file: a digest and a name per line."""
    with storage.local_copy(index_file) as path:
        lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {index_file}"]
        try:
            with duckdb.connect() as database:
                rows = database.execute(
                    "SELECT DISTINCT file, file_sha256, beside FROM read_parquet(?) "
                    "WHERE status = 'ok' ORDER BY file",
                    [str(path)],
                ).fetchall()
        except duckdb.Error as fault:
            raise InputError(
                f"the index {index_file} of the store {storage.location} cannot be read",
                "make the index again from the calibrations with `gyrorig store "
                f"rebuild-index {storage.location}`",
            ) from fault
    for file, digest, companions in rows:
        lines += _document_lines(file, digest, companions)
    return ("\n".join(lines) + "\n").encode()


def _is_signed(key: Ed25519PublicKey, signature: bytes | None, text: bytes) -> bool:
    try:
        key.verify(signature or b"", text)
    except InvalidSignature:
        return False
    return True


def _key_error(path: Path, kind: str, command: str) -> UsageError:
    return UsageError(
        f"the file {path} is not a {kind} Ed25519 key in PEM format",
        f"create such a key with `{command}`",
    )
