"""One night: a spool looked at, what is new solved, the store and its index carried on.

What to use when: `run_batch`. It may be killed at any moment and started again: work whose
key is in the index is done, a version without a row is found again, a row without a fold
is folded at the next start. Two batches on one store share the work by claims.
"""

import contextlib
import os
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.bucket_index import kept_folder
from gyrorig_solver.fleet.bucket_store import make_store
from gyrorig_solver.fleet.heads import Heads
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.lanes import Lane, PutOff, through
from gyrorig_solver.fleet.ledger import ClaimsLike, JournalLike, ledger_at
from gyrorig_solver.fleet.manifest import Signer, seal
from gyrorig_solver.fleet.rows import Row
from gyrorig_solver.fleet.spool import Session, Spool, look, read_all, sessions
from gyrorig_solver.fleet.task import Order, Outcome, Settings, key_of
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Place

HEADS_FILE = "spool-heads.sqlite"
GIVE_UP_AFTER = 20  # pieces put off one after another: the store is full, or gone
_WORST_FIRST = ("quarantined", "failed", "rejected", "ok")

Progress = Callable[["Summary"], None]


@dataclass(frozen=True, slots=True)
class Shard:
    """One of several batches that share a spool without talking to each other."""

    number: int = 1
    of: int = 1

    def holds(self, key: str) -> bool:
        """Return whether the work of that key is this shard's."""
        return int(key[:8], 16) % self.of == self.number - 1


@dataclass(slots=True)
class Summary:
    """What a batch has done so far."""

    spool: Spool
    sessions: int = 0  # in the spool
    done_before: int = 0
    others: int = 0  # another batch's or another shard's
    to_do: int = 0
    begun_s: float = field(default_factory=time.monotonic)
    ended: Counter[str] = field(default_factory=Counter)  # sessions by their worst status
    boards: Counter[str] = field(default_factory=Counter)  # rows by status
    later: set[str] = field(default_factory=set)  # keys of what was put off
    put_off_why: str = ""
    wrong: list[Row] = field(default_factory=list)
    put_off_in_a_row: int = 0
    gave_up: bool = False
    unfolded_why: str = ""  # the index was not carried on; the next batch does it

    @property
    def put_off(self) -> int:
        """How many sessions the machine or the store refused."""
        return len(self.later)

    @property
    def finished(self) -> int:
        """How many sessions have come to an end, now."""
        return sum(self.ended.values())

    @property
    def not_begun(self) -> int:
        """How many sessions nothing was done about: the batch was given up."""
        return self.to_do - self.finished - self.put_off

    @property
    def elapsed_s(self) -> float:
        """Since the batch began."""
        return time.monotonic() - self.begun_s

    @property
    def sessions_a_second(self) -> float:
        """The rate so far."""
        return self.finished / max(self.elapsed_s, 1e-9)

    @property
    def left_s(self) -> float | None:
        """How long it will take yet; None before the first session."""
        return self.not_begun / self.sessions_a_second if self.finished else None

    @property
    def in_part(self) -> bool:
        """Whether something did not end well."""
        return bool(
            self.put_off or self.unfolded_why or sum(self.ended.values()) > self.ended["ok"]
        )


def run_batch(
    spool: Path | Place,
    store: Path | Place,
    settings: Settings,
    lanes: list[Lane],
    *,
    shard: Shard | None = None,
    retry: Sequence[str] = (),
    signer: Signer | None = None,
    progress: Progress = lambda _summary: None,
) -> Summary:
    """Solve what is new in a spool.

    Args:
        spool: a folder or bucket of recordings, looked at with all below it.
        store: a fleet's store; made if it is not there.
        settings: how to solve.
        lanes: where to.
        shard: only this part of the work.
        retry: statuses whose work is to be done again: failed, quarantined, rejected.
        signer: signs the manifests of what is written.
        progress: told after each session.

    Raises:
        UsageError: no such spool, or the store's folder holds something else.
        MachineError: the store cannot be begun.
        InputError: its index is damaged, or it is of a newer schema.
    """
    found, place = look(spool), place_at(store)
    make_store(place)
    batch = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}-{secrets.token_hex(3)}"
    index, claims = ledger_at(place, batch)
    summary = Summary(found)
    with claims.begin(index) as journal:
        work = _new_work(found, place, settings, index, shard or Shard(), retry, summary)
        progress(summary)
        for one_more in (False, True):
            orders = _orders(work, found.place, place, batch, settings, claims, summary)
            _carry_on(orders, lanes, journal, index, claims, summary, progress)
            gone = any(lane.is_gone() for lane in lanes)
            if one_more or not summary.put_off or summary.gave_up or gone:
                break
            work = _once_more(work, claims, summary)
    _close(place, index, claims, signer, summary)
    return summary


def _once_more(
    work: list[tuple[str, Session]], claims: ClaimsLike, summary: Summary
) -> list[tuple[str, Session]]:
    """Return what the machine or the store refused: it may have been for a moment only."""
    again = [(key, session) for key, session in work if key in summary.later]
    summary.later -= {key for key, _ in again}
    summary.put_off_in_a_row = 0
    with contextlib.suppress(MachineError):
        for key, _ in again:
            claims.give_back(key)
    return again


def _close(
    place: Place, index: Index, claims: ClaimsLike, signer: Signer | None, summary: Summary
) -> None:
    """Fold what was written into the index and seal it; the next batch does what is not."""
    try:
        claims.end(index)
        seal(place, signer)
    except MachineError as fault:
        summary.unfolded_why = str(fault)


def _new_work(
    found: Spool,
    store: Place,
    settings: Settings,
    index: Index,
    shard: Shard,
    retry: Sequence[str],
    summary: Summary,
) -> list[tuple[str, Session]]:
    kept = store.path if isinstance(store, Folder) else kept_folder(store)
    with Heads(kept / HEADS_FILE, found.place.text) as heads:
        remembered, unread = heads.split(found)
        all_sessions = sessions([*remembered, *heads.keep(read_all(found.place, unread))])
    done = index.done(retry)
    work: list[tuple[str, Session]] = []
    for session in all_sessions:
        key = key_of(session.digests, settings.solver_version, settings.config_sha256)
        summary.sessions += 1
        if key in done:
            summary.done_before += 1
        elif not shard.holds(key):
            summary.others += 1
        elif session.trouble:  # a bucket's; its digest is not known, so nothing is recorded
            summary.later.add(key)
            summary.put_off_why = session.trouble
        else:
            work.append((key, session))
    summary.to_do = len(work) + len(summary.later)
    return work


def _orders(
    work: Sequence[tuple[str, Session]],
    spool: Place,
    store: Place,
    batch: str,
    settings: Settings,
    claims: ClaimsLike,
    summary: Summary,
) -> Iterator[Order]:
    for key, session in work:
        if summary.gave_up:
            return
        try:
            taken = claims.take(key)
        except MachineError as fault:
            _put_off(summary, key, fault)
            continue
        if not taken:
            summary.others += 1
            summary.to_do -= 1
            continue
        paths = tuple(one.path for one in session.recordings)
        yield Order(key, batch, store, spool, paths, session.digests, settings, session.refused)


def _carry_on(
    orders: Iterator[Order],
    lanes: list[Lane],
    journal: JournalLike,
    index: Index,
    claims: ClaimsLike,
    summary: Summary,
    progress: Progress,
) -> None:
    for told in through(orders, lanes):
        try:
            if isinstance(told, PutOff):
                raise told.fault
            journal.add(told.rows)
            _count(told, summary)
            summary.put_off_in_a_row = 0
            with contextlib.suppress(MachineError):  # it has its rows: that is what counts
                claims.done(told.key)
            if journal.is_full:
                with contextlib.suppress(MachineError):  # the next batch folds it
                    index.fold(journal.next_part())
        except MachineError as fault:
            key = told.order.key if isinstance(told, PutOff) else told.key
            _put_off(summary, key, fault)  # nothing of it is recorded
        progress(summary)


def _put_off(summary: Summary, key: str, fault: MachineError) -> None:
    summary.later.add(key)
    summary.put_off_in_a_row += 1
    summary.put_off_why = str(fault)
    summary.gave_up |= summary.put_off_in_a_row >= GIVE_UP_AFTER


def _count(told: Outcome, summary: Summary) -> None:
    statuses = [row.status for row in told.rows]
    summary.ended[min(statuses, key=_WORST_FIRST.index)] += 1
    summary.boards.update(statuses)
    summary.wrong += [row for row in told.rows if row.status != "ok"]
