"""One night: a spool looked at, what is new solved, the store and its index carried on.

What to use when: `run_batch`. It may be killed at any moment and started again: work whose
key is in the index is done, a version without a row is found again, a row without a fold
is folded at the next start. Two batches on one store share the work by claims.
"""

import os
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from gyrorig_protocol.errors import MachineError
from gyrorig_solver.calibration.store import make_sharded
from gyrorig_solver.fleet.claims import Claims
from gyrorig_solver.fleet.heads import Heads
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.journal import Journal
from gyrorig_solver.fleet.lanes import Lane, PutOff, through
from gyrorig_solver.fleet.rows import Row
from gyrorig_solver.fleet.spool import Session, Spool, look, read_all, sessions
from gyrorig_solver.fleet.task import Order, Outcome, Settings, key_of

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
    put_off: int = 0
    put_off_why: str = ""
    wrong: list[Row] = field(default_factory=list)
    gave_up: bool = False

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
        return bool(self.put_off or sum(self.ended.values()) > self.ended["ok"])


def run_batch(
    spool: Path,
    store: Path,
    settings: Settings,
    lanes: list[Lane],
    *,
    shard: Shard | None = None,
    retry: Sequence[str] = (),
    progress: Progress = lambda _summary: None,
) -> Summary:
    """Solve what is new in a spool.

    Args:
        spool: a folder of recordings, looked at with all below it.
        store: a fleet's store; made if it is not there.
        settings: how to solve.
        lanes: where to.
        shard: only this part of the work.
        retry: statuses whose work is to be done again: failed, quarantined, rejected.
        progress: told after each session.

    Raises:
        UsageError: no such spool, or the store's folder holds something else.
        MachineError: the store cannot be begun.
        InputError: its index is damaged, or it is of a newer schema.
    """
    found = look(spool)
    make_sharded(store)
    batch = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}-{secrets.token_hex(3)}"
    index, claims = Index(store), Claims(store, batch)
    summary = Summary(found)
    with claims.begin(index) as journal:
        work = _new_work(found, store, settings, index, shard or Shard(), retry, summary)
        progress(summary)
        orders = _orders(work, store, batch, settings, claims, summary)
        _carry_on(orders, lanes, journal, index, claims, summary, progress)
    index.fold_left_behind()
    return summary


def _new_work(
    found: Spool,
    store: Path,
    settings: Settings,
    index: Index,
    shard: Shard,
    retry: Sequence[str],
    summary: Summary,
) -> list[tuple[str, Session]]:
    with Heads(store / HEADS_FILE) as heads:
        remembered, unread = heads.split(found.recordings)
        all_sessions = sessions([*remembered, *heads.keep(read_all(unread))])
    done = index.done(retry)
    work: list[tuple[str, Session]] = []
    for session in all_sessions:
        key = key_of(session.digests, settings.solver_version, settings.config_sha256)
        summary.sessions += 1
        if key in done:
            summary.done_before += 1
        elif not shard.holds(key):
            summary.others += 1
        else:
            work.append((key, session))
    summary.to_do = len(work)
    return work


def _orders(
    work: Sequence[tuple[str, Session]],
    store: Path,
    batch: str,
    settings: Settings,
    claims: Claims,
    summary: Summary,
) -> Iterator[Order]:
    for key, session in work:
        if summary.gave_up:
            return
        if not claims.take(key):
            summary.others += 1
            summary.to_do -= 1
            continue
        paths = tuple(one.path for one in session.recordings)
        yield Order(key, batch, store, paths, session.digests, settings, session.refused)


def _carry_on(
    orders: Iterator[Order],
    lanes: list[Lane],
    journal: Journal,
    index: Index,
    claims: Claims,
    summary: Summary,
    progress: Progress,
) -> None:
    in_a_row = 0
    for told in through(orders, lanes):
        try:
            if isinstance(told, PutOff):
                raise told.fault
            journal.add(told.rows)
            claims.done(told.key)
            _count(told, summary)
            in_a_row = 0
        except MachineError as fault:  # nothing of it is recorded: the next batch does it
            in_a_row += 1
            summary.put_off += 1
            summary.put_off_why = str(fault)
            summary.gave_up = in_a_row >= GIVE_UP_AFTER
        progress(summary)
        if journal.is_full:
            index.fold(journal.next_part())


def _count(told: Outcome, summary: Summary) -> None:
    statuses = [row.status for row in told.rows]
    summary.ended[min(statuses, key=_WORST_FIRST.index)] += 1
    summary.boards.update(statuses)
    summary.wrong += [row for row in told.rows if row.status != "ok"]
