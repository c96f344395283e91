"""A batch's claims and journal in a bucket, where there are no locks.

What to use when: through `ledger.ledger_at`.

    alive/<batch>                       a sign of life, written anew every 20 s
    claims/<k2>/<key>.0000              who works on it; `.0001` after that one has died
    journal/<batch>-<part>/000017.jsonl the rows of one piece of work

Theory of operation: a batch is running while its sign of life is younger than two minutes
by the store's own clock: the age is the difference to a sign that was written just now, so
that no two clocks are compared. A claim is taken by a put that replaces nothing, and taken
over from a dead batch by the next number, again such a put: one of several wins.

A batch that was only asleep (a laptop's lid) may wake up to find its work taken over. Then
two work on one thing. Before a version is written the store is asked once more whether that
work has one (`task`), and a row that is there twice counts once (`index`): the work is done
twice, the result is there once.

Claims of finished work go when a batch starts while no other runs. It writes its own sign of
life, lists the claims, then looks for others: whoever begins later writes its claims later
than that list.
"""

import contextlib
import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec

from gyrorig_protocol.errors import GyrorigError, MachineError
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.journal import ROWS_A_PART, SUFFIX
from gyrorig_solver.fleet.rows import Row, flat
from gyrorig_solver.places.place import Place

ALIVE, CLAIMS, JOURNAL = "alive", "claims", "journal"
SIGN_EVERY_S = 20.0
DEAD_AFTER_S = 120.0  # six signs missed: longer than a bucket's usual outages
_DONE = " done"


class SignOfLife:
    """Says that a batch runs, from its own thread, until it is ended."""

    def __init__(self, place: Place, batch: str) -> None:
        """Write the first sign.

        Raises:
            MachineError: the bucket refuses.
        """
        self._place, self._name = place, f"{ALIVE}/{batch}"
        place.put(self._name, batch.encode())
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sign-of-life", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Say no more, and take the sign away."""
        self._end.set()
        self._thread.join()
        with contextlib.suppress(MachineError):  # then it dies of age
            self._place.remove([self._name])

    def _run(self) -> None:
        while not self._end.wait(SIGN_EVERY_S):
            with contextlib.suppress(GyrorigError):  # the next one may come through
                self._place.put(self._name, self._name.encode())


def living(place: Place, probe: str) -> set[str]:
    """Return the batches whose sign of life is young.

    Args:
        place: the store.
        probe: a name of one's own; a sign of that name is written to have the store's time.

    Raises:
        MachineError: the bucket does not answer.
    """
    place.put(f"{ALIVE}/{probe}", probe.encode())
    signs = {entry.name.rpartition("/")[2]: entry.changed_s for entry in place.entries(ALIVE)}
    now_s = signs.get(probe, 0.0)
    return {batch for batch, then_s in signs.items() if now_s - then_s < DEAD_AFTER_S}


def others_live(place: Place, probe: str) -> set[str]:
    """Return the batches of other names that run; the probe's own sign goes again.

    Raises:
        MachineError: the bucket does not answer.
    """
    try:
        return {batch for batch in living(place, probe) if batch != probe}
    finally:
        place.remove([f"{ALIVE}/{probe}"])


class BucketJournal:
    """The rows of one running batch, an object for each piece of work. Used by one thread."""

    def __init__(self, place: Place, batch: str, sign: SignOfLife) -> None:
        self._place, self._batch, self._sign = place, batch, sign
        self._part = 0
        self._pieces = 0
        self.rows = 0

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Let go; what is in it stays for the next fold."""
        self._sign.end()

    def add(self, rows: Sequence[Row]) -> None:
        """Write the rows of one piece of work.

        Raises:
            MachineError: the bucket refuses; nothing of them is in it.
        """
        text = b"".join(msgspec.json.encode(flat(row)) + b"\n" for row in rows)
        name = f"{JOURNAL}/{self._named()}/{self._pieces:06d}{SUFFIX}"
        if not self._place.put_new(name, text):
            # A put whose answer was lost, of a piece that was then put off.
            self._pieces += 1
            self.add(rows)
            return
        self._pieces += 1
        self.rows += len(rows)

    @property
    def is_full(self) -> bool:
        """Whether it is time to fold."""
        return self.rows >= ROWS_A_PART

    def next_part(self) -> Path:
        """Begin another part and return the name of the one before, which may be folded now."""
        done = Path(f"{self._named()}{SUFFIX}")
        self._part += 1
        self._pieces = self.rows = 0
        return done

    def _named(self) -> str:
        return f"{self._batch}-{self._part:04d}"


class BucketClaims:
    """The claims of one batch. Used by one thread."""

    def __init__(self, place: Place, batch: str) -> None:
        self._place, self._batch = place, batch
        self._mine: dict[str, str] = {}

    def begin(self, index: Index) -> BucketJournal:
        """Begin the batch: its sign of life, what others left behind, old claims.

        Raises:
            MachineError: the bucket refuses.
            InputError: a journal left behind is damaged.
        """
        sign = SignOfLife(self._place, self._batch)
        try:
            old = [entry.name for entry in self._place.entries(CLAIMS)]
            index.fold_left_behind()
            mine = f"{ALIVE}/{self._batch}"
            old += [entry.name for entry in self._place.entries(ALIVE) if entry.name != mine]
            # What is listed by now is of batches that are seen here, or have ended.
            if living(self._place, self._batch) == {self._batch}:
                index.sweep()
                self._place.remove(old)
        except BaseException:
            sign.end()
            raise
        return BucketJournal(self._place, self._batch, sign)

    def end(self, index: Index) -> None:
        """Fold what this batch has written, and others left behind; its sign of life is gone.

        Raises:
            MachineError: the bucket refuses.
            InputError: a journal left behind is damaged.
        """
        index.fold_left_behind()

    def take(self, key: str) -> bool:
        """Return True if the work of that key is now this batch's.

        Raises:
            MachineError: the bucket refuses.
        """
        number = 0
        while True:
            name = f"{CLAIMS}/{key[:2]}/{key}.{number:04d}"
            if self._place.put_new(name, self._batch.encode()):
                self._mine[key] = name
                return True
            holder = (self._place.read(name) or b"").decode("utf-8", "replace")
            if holder.endswith(_DONE) or holder in living(self._place, self._batch):
                return False
            number += 1

    def done(self, key: str) -> None:
        """Say that the work of that key has its rows."""
        self._place.put(self._mine[key], (self._batch + _DONE).encode())

    def give_back(self, key: str) -> None:
        """Let the work of that key be taken again: it was not done."""
        name = self._mine.pop(key, None)
        if name is not None:
            self._place.remove([name])
