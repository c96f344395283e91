"""Digests of all that a store holds, in files that `sha256sum -c` checks, signed if asked.

    manifest/<index file>.sha256        one line a file: the index's, each document, each report
    manifest/<index file>.sha256.sig    Ed25519 over those bytes, 64 bytes

What to use when: `seal` at the end of a batch; `read_manifests` to verify. A manifest follows
from its file of the index alone, so that a seal that was cut off is made by the next batch,
and two batches that seal one file write the same.

Without a signature a manifest tells damage; with one it tells forgery too, to whoever has the
public key: that this key's holder sealed these bytes. What lies in a store unsealed is sealed
by the next batch, whoever wrote it: who may write to the store is trusted until then.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import duckdb
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_pem_public_key

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.fleet.index import FOLDER as INDEX
from gyrorig_solver.places.place import Place

FOLDER = "manifest"
_SUFFIX = ".sha256"
_SIGNATURE = ".sig"
_HEX = 64  # characters of a SHA-256


@dataclass(frozen=True, slots=True)
class Signer:
    """A private key."""

    key: Ed25519PrivateKey

    def sign(self, data: bytes) -> bytes:
        """Return the signature of `data`."""
        return self.key.sign(data)


@dataclass(frozen=True, slots=True)
class Manifest:
    """One manifest as it lies in a store."""

    name: str
    index_file: str
    digests: dict[str, str]  # by name below the store
    signed: bool | None = None  # None where no key was given to look with


def signer_of(path: Path) -> Signer:
    """Return the key in a PEM file, as `openssl genpkey -algorithm ed25519` writes it.

    Raises:
        UsageError: it holds no such key.
    """
    try:
        key = load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as fault:
        raise _no_key(path, "private", "openssl genpkey -algorithm ed25519 -out KEY.pem") from fault
    if not isinstance(key, Ed25519PrivateKey):
        raise _no_key(path, "private", "openssl genpkey -algorithm ed25519 -out KEY.pem")
    return Signer(key)


def public_key_of(path: Path) -> Ed25519PublicKey:
    """Return the public key in a PEM file.

    Raises:
        UsageError: it holds no such key.
    """
    try:
        key = load_pem_public_key(path.read_bytes())
    except (OSError, ValueError, UnsupportedAlgorithm) as fault:
        raise _no_key(path, "public", "openssl pkey -in KEY.pem -pubout -out PUB.pem") from fault
    if not isinstance(key, Ed25519PublicKey):
        raise _no_key(path, "public", "openssl pkey -in KEY.pem -pubout -out PUB.pem")
    return key


def seal(place: Place, signer: Signer | None) -> int:
    """Write the manifests that lack, and sign them; return how many.

    Args:
        place: the store.
        signer: signs what is written now, and nothing that was sealed before.

    Raises:
        MachineError: the store does not answer, or refuses.
        InputError: a file of the index is damaged.
    """
    sealed = {entry.name for entry in place.entries(FOLDER)}
    made = 0
    for file in index_files(place):
        name = manifest_of(file)
        if name not in sealed:
            text = _text(place, file)
            if signer is not None:  # first, so that no manifest is ever without it
                place.put(name + _SIGNATURE, signer.sign(text))
            made += place.put_new(name, text)
    return made


def unseal(place: Place) -> None:
    """Remove all manifests: the index is made anew.

    Raises:
        MachineError: the store does not answer, or refuses.
    """
    place.remove([entry.name for entry in place.entries(FOLDER)])


def index_files(place: Place) -> list[str]:
    """Return the names of the files of the index.

    Raises:
        MachineError: the store does not answer.
    """
    names = (PurePosixPath(entry.name) for entry in place.entries(INDEX))
    return [str(one) for one in names if one.suffix == ".parquet" and one.name[0] != "."]


def manifest_of(index_file: str) -> str:
    """Return the name of the manifest of a file of the index."""
    return f"{FOLDER}/{PurePosixPath(index_file).stem}{_SUFFIX}"


def read_manifests(place: Place, key: Ed25519PublicKey | None) -> Iterator[Manifest]:
    """Yield the manifests of a store.

    Args:
        place: the store.
        key: whose signature they shall have; None: it is not looked at.

    Raises:
        MachineError: the store does not answer.
    """
    for entry in list(place.entries(FOLDER)):
        if not entry.name.endswith(_SUFFIX):
            continue
        text = place.read(entry.name) or b""
        signed: bool | None = None
        if key is not None:
            signed = _is_signed(key, place.read(entry.name + _SIGNATURE), text)
        lines = text.decode("utf-8", "replace").splitlines()
        digests = {line[_HEX + 2 :]: line[:_HEX] for line in lines if len(line) > _HEX + 2}
        index_file = f"{INDEX}/{PurePosixPath(entry.name).stem}.parquet"
        yield Manifest(entry.name, index_file, digests, signed)


def _text(place: Place, index_file: str) -> bytes:
    """Return what follows from a file of the index: a digest and a name a line."""
    with place.local(index_file) as here:
        lines = [f"{hashlib.sha256(here.read_bytes()).hexdigest()}  {index_file}"]
        try:
            with duckdb.connect() as database:
                found = database.execute(
                    "SELECT DISTINCT file, file_sha256, beside FROM read_parquet(?) "
                    "WHERE status = 'ok' ORDER BY file",
                    [str(here)],
                ).fetchall()
        except duckdb.Error as fault:
            raise InputError(
                f"{index_file} of {place.text} cannot be read",
                f"`gyrorig store rebuild-index {place.text}` makes it anew from the calibrations",
            ) from fault
    for file, digest, beside in found:
        lines.append(f"{digest}  {file}")
        folder = PurePosixPath(file).parent
        for line in beside or ():
            lines.append(f"{line[:_HEX]}  {folder / line[_HEX + 2 :]}")
    return ("\n".join(lines) + "\n").encode()


def _is_signed(key: Ed25519PublicKey, signature: bytes | None, text: bytes) -> bool:
    try:
        key.verify(signature or b"", text)
    except InvalidSignature:
        return False
    return True


def _no_key(path: Path, kind: str, command: str) -> UsageError:
    return UsageError(f"{path} holds no {kind} Ed25519 key", f"make one: {command}")
