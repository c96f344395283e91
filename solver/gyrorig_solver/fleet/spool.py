"""What there is to do: the recordings below a folder, put together by session.

What to use when: `look` once, at the beginning of a batch; `sessions` for what is new.
The parts of one session are solved together, so they are one piece of work. Files still
being written (`.mcap.part`) are counted and left alone: the daemon finishes or recovers
them. Names and sizes are of no use as identity: the digest is what a recording is.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.recording.reader import read_head

SET_ASIDE = "unclean"  # where the daemon keeps what it has recovered a recording from
READERS = 4  # digests are computed outside of Python's lock


@dataclass(frozen=True, slots=True)
class Spooled:
    """One recording as it lies there."""

    path: Path
    sha256: str
    session: str  # rig, name and beginning; "" where its head cannot be read
    part: str = ""
    size: int = 0


@dataclass(frozen=True, slots=True)
class Session:
    """The recordings that are solved together: the parts of one session."""

    recordings: tuple[Spooled, ...]
    refused: str = ""  # why they must not be solved

    @property
    def digests(self) -> tuple[str, ...]:
        """Sorted, so that the order of names does not matter."""
        return tuple(sorted(one.sha256 for one in self.recordings))


@dataclass(frozen=True, slots=True)
class Spool:
    """The files of a spool."""

    recordings: tuple[Path, ...]
    unfinished: int = 0


def look(folder: Path) -> Spool:
    """Return the recordings below `folder`, sorted by path.

    Symbolic links to folders are not followed: a loop of them has no end.

    Raises:
        UsageError: there is no such folder.
    """
    if not folder.is_dir():
        raise UsageError(f"there is no folder {folder}", "name a folder of recordings with --spool")
    found: list[Path] = []
    unfinished = 0
    for path in _below(folder):
        if path.name.endswith(".mcap.part"):
            unfinished += 1
        elif path.name.endswith(".mcap"):
            found.append(path)
    return Spool(tuple(sorted(found)), unfinished)


def sessions(found: Iterable[Spooled]) -> list[Session]:
    """Return the sessions of these recordings, each with its parts in the order of names.

    A recording whose bytes are there twice counts once. One whose head cannot be read is
    a session of its own, so that it can be rejected with its reason.
    """
    together: dict[str, dict[str, Spooled]] = {}
    alone: list[Session] = []
    seen: set[str] = set()
    for one in sorted(found, key=lambda one: (-one.size, one.path)):
        if one.sha256 in seen:
            continue
        seen.add(one.sha256)
        parts = together.setdefault(one.session, {}) if one.session else {}
        if one.part in parts:
            # Half of a copy beside the whole would count its samples twice.
            whole = parts[one.part].path.name
            alone.append(Session((one,), f"{one.path.name} is a shorter copy of {whole}"))
        elif one.session:
            parts[one.part] = one
        else:
            alone.append(Session((one,)))
    whole_sessions = (sorted(parts.values(), key=_by_path) for parts in together.values())
    made = [Session(tuple(parts)) for parts in whole_sessions]
    return sorted([*made, *alone], key=lambda session: session.recordings[0].path)


def _by_path(one: Spooled) -> Path:
    return one.path


def read_all(paths: Sequence[Path]) -> Iterator[Spooled]:
    """Yield what each recording is, in the order of paths, several being read at a time."""
    with ThreadPoolExecutor(READERS, "digest") as readers:
        yield from readers.map(spooled, paths)


def spooled(path: Path) -> Spooled:
    """Return what a recording is. Never raises: what is wrong with it its worker says."""
    try:
        digest, size = _digest(path), path.stat().st_size
    except OSError:
        return Spooled(path, f"unread:{path}", "")
    try:
        own = read_head(path).get("gyrorig", {})
    except GyrorigError:
        return Spooled(path, digest, "", size=size)
    names = [own.get(key, "") for key in ("rig", "session", "anchor_utc_ns")]
    session = json.dumps(names) if any(names) else ""
    return Spooled(path, digest, session, own.get("part", ""), size)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _below(folder: Path) -> Iterator[Path]:
    for root, folders, names in os.walk(folder):
        if SET_ASIDE in folders:
            folders.remove(SET_ASIDE)
        for name in names:
            yield Path(root) / name
