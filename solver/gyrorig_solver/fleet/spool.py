"""What there is to do: the recordings below a folder, put together by session.

A spool is a folder or a bucket; a recording of a bucket is fetched for as long as it is read.

What to use when: `look` once, at the beginning of a batch; `sessions` for what is new.
The parts of one session are solved together, so they are one piece of work. Files still
being written (`.mcap.part`) are counted and left alone: the daemon finishes or recovers
them; until then, or for a day, the parts before them wait too. Names and sizes are of no
use as identity: the digest is what a recording is.
"""

import hashlib
import json
import re
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath

from gyrorig_protocol.errors import GyrorigError, MachineError, UsageError
from gyrorig_protocol.recording.reader import read_head
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Entry, Place

UNREAD = "unread:"  # instead of a digest
SET_ASIDE = "unclean"  # where the daemon keeps what it has recovered a recording from
READERS = 4  # digests are computed outside of Python's lock
_PART = re.compile(r"(_p\d{3,})?\.mcap(\.part)?$")  # as the daemon's recorder names them
LEFT_AFTER_S = 86_400.0  # a part of a recording is an hour at most: nobody writes this one any more


@dataclass(frozen=True, slots=True)
class Spooled:
    """One recording as it lies there."""

    path: PurePosixPath  # below the spool
    sha256: str
    session: str  # rig, name and beginning; "" where its head cannot be read
    part: str = ""
    size: int = 0
    stamp: str = ""  # another one where the file was changed
    trouble: str = ""  # why the place did not give it; it may tomorrow


@dataclass(frozen=True, slots=True)
class Session:
    """The recordings that are solved together: the parts of one session."""

    recordings: tuple[Spooled, ...]
    refused: str = ""  # why they must not be solved

    @property
    def trouble(self) -> str:
        """Why they cannot be solved now; "" where they can."""
        return next((one.trouble for one in self.recordings if one.trouble), "")

    @property
    def digests(self) -> tuple[str, ...]:
        """Sorted, so that the order of names does not matter."""
        return tuple(sorted(one.sha256 for one in self.recordings))


@dataclass(frozen=True, slots=True)
class Spool:
    """The files of a spool."""

    place: Place
    recordings: tuple[Entry, ...]
    unfinished: int = 0
    waiting: int = 0  # of recordings: whole parts of sessions that are still being written
    left: int = 0  # of them, not touched for a day: their writer is gone


def look(spool: Path | Place) -> Spool:
    """Return the recordings of a spool, sorted by name.

    Raises:
        UsageError: there is no such folder.
        MachineError: the bucket does not answer.
    """
    place = place_at(spool)
    if isinstance(place, Folder) and not place.path.is_dir():
        raise UsageError(
            f"there is no folder {place.text}", "name a folder of recordings with --spool"
        )
    found: list[Entry] = []
    going_on: set[str] = set()
    unfinished = left = 0
    for entry in place.entries():
        if SET_ASIDE in entry.name.split("/")[:-1]:
            continue
        if entry.name.endswith(".mcap.part"):
            unfinished += 1
            if 0.0 < entry.changed_s < time.time() - LEFT_AFTER_S:
                left += 1
            else:
                going_on.add(_stem(entry.name))
        elif entry.name.endswith(".mcap"):
            found.append(entry)
    whole = [entry for entry in found if _stem(entry.name) not in going_on]
    whole.sort(key=lambda entry: PurePosixPath(entry.name))
    return Spool(place, tuple(whole), unfinished, len(found) - len(whole), left)


def _stem(name: str) -> str:
    """Return what the names of all parts of a session have in common."""
    return _PART.sub("", name)


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


def _by_path(one: Spooled) -> PurePosixPath:
    return one.path


def read_all(place: Place, entries: Sequence[Entry]) -> Iterator[Spooled]:
    """Yield what each recording is, in the order of entries, several being read at a time."""
    with ThreadPoolExecutor(READERS, "digest") as readers:
        yield from readers.map(partial(spooled, place), entries)


def spooled(place: Place, entry: Entry) -> Spooled:
    """Return what a recording is. Never raises: what is wrong with it its worker says."""
    name = PurePosixPath(entry.name)
    try:
        with place.local(entry.name) as path:
            digest, size = _digest(path), path.stat().st_size
            try:
                own = read_head(path).get("gyrorig", {})
            except GyrorigError:
                return Spooled(name, digest, "", size=size, stamp=entry.stamp)
    except MachineError as fault:
        return Spooled(name, f"{UNREAD}{entry.name}", "", trouble=str(fault))
    except (OSError, GyrorigError):
        return Spooled(name, f"{UNREAD}{entry.name}", "")
    names = [own.get(key, "") for key in ("rig", "session", "anchor_utc_ns")]
    session = json.dumps(names) if any(names) else ""
    return Spooled(name, digest, session, own.get("part", ""), size, entry.stamp)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
