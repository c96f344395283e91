"""One loop for everything that waits: chunks to whoever owns the port, timers when due.

Whatever a session waits for (an answer, the end of a move, a rest), it waits in
`Pump.run_until`, and every other port and timer goes on meanwhile. Nothing here knows
whether time is real.
"""

from collections import deque
from collections.abc import Callable
from typing import Protocol

from gyrorig_daemon.links.hub import Chunk, GatheringHub, PortHub, WriteStamp
from gyrorig_protocol.errors import GyrorigError

SLICE_NS = 50_000_000  # how long a request to stop may go unnoticed
STALL_NS = 700_000_000  # a turn of the loop takes so long only if the process stood still:
# the longest that it waits by itself is for a stuck port, half a second

AT_ONCE = 64  # chunks handed out between two looks at clock, timers and stop: a millisecond
NEVER_NS = 1 << 62

Sink = Callable[[Chunk], None]
StallSink = Callable[[str, int, int], None]  # who stood still, from when, until when


class StopRequestedError(GyrorigError):
    """A person or the system asked this process to stop (SIGINT, SIGTERM)."""


class Timer(Protocol):
    """Something due at times of its own; `fire` must set the next `due_ns`."""

    due_ns: int

    def fire(self, now_ns: int) -> None:
        """Do what is due. It may write to ports; it must not wait."""
        ...


class StopFlag:
    """Set by a signal handler, looked at between chunks."""

    def __init__(self) -> None:
        self.reason: str | None = None

    def request(self, reason: str) -> None:
        """Ask to stop."""
        self.reason = reason


class Pump:
    """The hub's chunks and the session's timers, one at a time, in one thread."""

    def __init__(self, hub: PortHub, stop: StopFlag | None = None) -> None:
        self._hub = hub
        self._at_hand: deque[Chunk] = hub.at_hand if isinstance(hub, GatheringHub) else deque()
        self._stop = stop or StopFlag()
        self._sinks: dict[str, Sink] = {}
        self._timers: list[Timer] = []
        self._heeds_stop = True
        self._next_due_ns = 0  # of all timers
        self._turn_ns: int | None = None
        self.served_ns = hub.now_ns()  # all that had come by then was handed out
        self._late_until_ns = 0
        self.stalls = 0  # of this process: commands came late, stamps did not
        self.late_stalls = 0  # of the acquisition process: the stamps after them are late
        self.on_stall: StallSink | None = None

    def attach(self, port: str, sink: Sink) -> None:
        """Give every chunk of `port` to `sink`."""
        self._sinks[port] = sink

    def add_timer(self, timer: Timer) -> None:
        """Fire `timer` whenever it is due."""
        self._timers.append(timer)
        self.hurry()

    def remove_timer(self, timer: Timer) -> None:
        """Fire `timer` no more; one that was never added is no fault."""
        self._timers = [other for other in self._timers if other is not timer]

    def ignore_stop(self) -> None:
        """From here on finish what is begun: the stop has been heard."""
        self._heeds_stop = False

    def heed_stop(self) -> None:
        """Raise again what the stop flag holds, or will hold: the next session may begin."""
        self._heeds_stop = True

    def now_ns(self) -> int:
        """Return the hub's time in ns."""
        return self._hub.now_ns()

    def write(self, port: str, data: bytes) -> WriteStamp:
        """Write to a port; see `PortHub.write`."""
        return self._hub.write(port, data)

    def is_up(self, port: str) -> bool:
        """Return whether a port is open; see `PortHub.is_up`."""
        return self._hub.is_up(port)

    def reopen(self, port: str) -> None:
        """Open a port anew; see `PortHub.reopen`."""
        self._hub.reopen(port)

    def run_until(self, deadline_ns: int, done: Callable[[], bool] | None = None) -> bool:
        """Serve ports and timers until `done()` or the deadline.

        Returns:
            True when `done()` came true, False at the deadline.

        Raises:
            StopRequestedError: the stop flag is set and heeded.
        """
        while True:
            if self._stop.reason is not None and self._heeds_stop:
                raise StopRequestedError(f"stopped by {self._stop.reason}")
            if done is not None and done():
                return True
            now_ns = self._hub.now_ns()
            self._watch_turn(now_ns)
            if now_ns >= deadline_ns:
                return self._catch_up(deadline_ns, done)
            if now_ns >= self._next_due_ns:
                self._fire(now_ns)
            until_ns = min(deadline_ns, now_ns + SLICE_NS, self._next_due_ns)
            chunk = self._hub.read(until_ns)
            if chunk is None:
                self.served_ns = self._hub.now_ns()
            else:
                self._deliver(chunk)
                if self._at_hand:
                    self._deliver_at_hand(done)

    def hurry(self) -> None:
        """Look at the timers at once: one of them is due sooner than it had said."""
        self._next_due_ns = 0

    def _fire(self, now_ns: int) -> None:
        for timer in self._timers:
            if timer.due_ns <= now_ns:
                timer.fire(now_ns)
        self._next_due_ns = min((timer.due_ns for timer in self._timers), default=NEVER_NS)

    def _catch_up(self, deadline_ns: int, done: Callable[[], bool] | None) -> bool:
        """Take what was there at the deadline: this process may have slept past it.

        An answer that came in time is no silence, however late it is looked at.
        """
        while (chunk := self._hub.read(deadline_ns)) is not None:
            self._deliver(chunk)
            if done is not None and done():
                return True
            if chunk.received_ns > deadline_ns:
                break
        return False

    def _deliver_at_hand(self, done: Callable[[], bool] | None) -> None:
        """Hand out what came together with the last chunk."""
        chunks = self._at_hand
        for _ in range(min(len(chunks), AT_ONCE)):
            if done is not None and done():
                return
            self._deliver(chunks.popleft())

    def _deliver(self, chunk: Chunk) -> None:
        self.served_ns = chunk.received_ns
        if chunk.late_ns and chunk.received_ns - chunk.late_ns > self._late_until_ns:
            self._late_until_ns = chunk.received_ns
            self.late_stalls += 1
            if self.on_stall is not None:
                begin_ns = chunk.received_ns - chunk.late_ns
                self.on_stall("the acquisition process", begin_ns, chunk.received_ns)
        sink = self._sinks.get(chunk.port)
        if sink is not None:
            sink(chunk)

    def _watch_turn(self, now_ns: int) -> None:
        """Note when this process stood still: stopped, suspended, or starved by others."""
        before_ns, self._turn_ns = self._turn_ns, now_ns
        if before_ns is not None and now_ns - before_ns > STALL_NS:
            self.stalls += 1
            if self.on_stall is not None:
                self.on_stall("the daemon", before_ns, now_ns)
