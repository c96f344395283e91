"""Heads of a store: its newest versions and its manifests, to detect a roll-back.

A store that somebody replaced by an older copy of itself is consistent: every digest, link and
signature is right. Only a list that was kept in another place shows what is missing.

What to use when: `heads_text` for the list, in the format of `sha256sum`; `find_rolled_back` to
compare a store with such a list.
"""

import hashlib
import re
from itertools import groupby
from pathlib import Path, PurePosixPath

from gyrorig_protocol.errors import InputError
from gyrorig_solver.fleet.store.manifest import MANIFEST_FOLDER
from gyrorig_solver.fleet.store.store_queries import is_version_file, list_documents
from gyrorig_solver.storage import Storage

_LINE = re.compile(r"([0-9a-f]{64})  ([^\x00-\x1f]{1,1000})")


def heads_text(storage: Storage) -> str:
    """Return a line `<sha256>  <name>` for the newest version of each board and each manifest.

    Raises:
        MachineError: the store does not answer.
    """
    names = [entry.name for entry in storage.list_files(MANIFEST_FOLDER)]
    by_board = groupby(list_documents(storage), lambda entry: PurePosixPath(entry.name).parent)
    for _, entries in by_board:
        versions = [entry.name for entry in entries if is_version_file(entry.name)]
        if versions:
            names.append(max(versions, key=lambda name: int(PurePosixPath(name).stem[1:])))
    return "".join(f"{_digest(storage, name)}  {name}\n" for name in sorted(names))


def find_rolled_back(storage: Storage, heads: Path) -> list[tuple[str, str]]:
    """Return the files of a list that the store no longer has as they were, with what is wrong.

    Raises:
        InputError: the list cannot be read, or is not such a list.
        MachineError: the store does not answer.
    """
    try:
        lines = heads.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as fault:
        raise InputError(
            f"the list of heads {heads} cannot be read",
            "give a file that `gyrorig store verify --write-heads` wrote",
        ) from fault
    matches = [_LINE.fullmatch(line) for line in lines]
    if not lines or None in matches:
        raise InputError(
            f"the file {heads} is not a list of heads",
            "give a file that `gyrorig store verify --write-heads` wrote",
        )
    faults = []
    for match in filter(None, matches):
        digest = _digest(storage, match[2])
        if digest is None:
            faults.append((match[2], "the store contained it before, but no longer"))
        elif digest != match[1]:
            faults.append((match[2], "the store contained it before with another SHA-256"))
    return faults


def _digest(storage: Storage, name: str) -> str | None:
    data = None if ".." in name.split("/") or name.startswith("/") else storage.read(name)
    return None if data is None else hashlib.sha256(data).hexdigest()
