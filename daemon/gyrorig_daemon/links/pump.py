"""The event loop (message pump): chunks go to the owner of their port, timers fire when due.

Whatever a session waits for (a reply, the end of a move, a static interval), it waits in
`Pump.run_until`, and all other ports and timers are served meanwhile. Nothing here depends on
whether time is real or simulated.
"""

import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from gyrorig_daemon.links.ports.halt_pipe import HaltPipe
from gyrorig_daemon.links.ports.port_hub import (
    BufferedHub,
    Chunk,
    PortHub,
    UnitHaltedError,
    WriteTimes,
)
from gyrorig_protocol.errors import GyrorigError

STOP_CHECK_NS = 50_000_000  # longest delay until a request to stop is noticed
# A turn of the loop takes longer only if the process did not run: its longest wait
# is half a second, for a port that takes no bytes.
STALL_NS = 700_000_000
MAX_BURST_CHUNKS = 64  # chunks between two checks of clock, timers and stop: 1 ms
NEVER_NS = 1 << 62
HALT_RETRIES = 3  # of a write, while halts are ordered again and again
REASON_WAIT_S = 0.2  # an order to halt reaches the acquisition process before the stop flag

ChunkSink = Callable[[Chunk], None]
StallSink = Callable[[str, int, int], None]  # process name, start, end


class StopRequestedError(GyrorigError):
    """The process was asked to stop by SIGTERM or SIGHUP."""


class InterruptedByUserError(StopRequestedError):
    """The process was asked to stop by Ctrl-C (SIGINT)."""

    exit_code = 130  # 128 + SIGINT, as in shells


class Timer(Protocol):
    """Something that is due at a time; `fire` must set the next `due_ns`."""

    due_ns: int

    def fire(self, now_ns: int) -> None:
        """Do what is due. It can write to ports; it must not wait."""
        ...


class StopFlag:
    """Set by a signal handler or another thread, checked between chunks.

    With a `HaltPipe` the acquisition process halts the unit at once, whatever the loop does.
    """

    def __init__(self, halt_pipe: HaltPipe | None = None) -> None:
        self.halt_pipe = halt_pipe
        self.reason: str | None = None

    def request(self, reason: str) -> None:
        """Ask to stop; `reason` is the name of the signal."""
        if self.halt_pipe is not None:
            self.halt_pipe.order()  # first: the order precedes all that follows from the reason
        self.reason = reason


class Pump:
    """Hands out the hub's chunks and fires timers, one at a time, in one thread."""

    def __init__(self, hub: PortHub, stop: StopFlag | None = None) -> None:
        self._hub = hub
        self._buffered_chunks: deque[Chunk] = (
            hub.buffered_chunks if isinstance(hub, BufferedHub) else deque()
        )
        self._stop = stop or StopFlag()
        self._sinks: dict[str, ChunkSink] = {}
        self._timers: list[Timer] = []
        self._obeys_stop = True
        self._next_due_ns = 0  # the earliest of all timers
        self._last_turn_ns: int | None = None
        self.processed_until_ns = hub.now_ns()  # everything that arrived until then was handed out
        self._late_until_ns = 0
        self.stalls = 0  # of this process: commands were late, timestamps were not
        self.late_stalls = 0  # of the acquisition process: timestamps after them are late
        self.on_stall: StallSink | None = None

    def attach(self, port: str, sink: ChunkSink) -> None:
        """Send every chunk of `port` to `sink`."""
        self._sinks[port] = sink

    def add_timer(self, timer: Timer) -> None:
        """Fire `timer` whenever it is due."""
        self._timers.append(timer)
        self.check_timers_now()

    def remove_timer(self, timer: Timer) -> None:
        """Stop firing `timer`. Unknown timers are ignored."""
        self._timers = [other for other in self._timers if other is not timer]

    def ignore_stop(self) -> None:
        """Ignore the stop flag from now on, to finish what is in progress."""
        self._obeys_stop = False

    def obey_stop(self) -> None:
        """Obey the stop flag again, for the next session."""
        self._obeys_stop = True

    def now_ns(self) -> int:
        """Return the hub's time in ns."""
        return self._hub.now_ns()

    def write(self, port: str, data: bytes) -> WriteTimes:
        """Write to a port. See `PortHub.write`.

        While stop is ignored, a write is repeated that was refused because of another halt.

        Raises:
            StopRequestedError: the unit was halted on request.
            UnitHaltedError: the acquisition process has halted the unit for another reason.
        """
        for _ in range(HALT_RETRIES):
            try:
                return self._hub.write(port, data)
            except UnitHaltedError as fault:
                if self._obeys_stop:
                    raise self._explain_halt(fault) from fault
        return self._hub.write(port, data)

    def is_up(self, port: str) -> bool:
        """Return whether a port is open. See `PortHub.is_up`."""
        return self._hub.is_up(port)

    def reopen(self, port: str) -> None:
        """Close and open a port. See `PortHub.reopen`."""
        self._hub.reopen(port)

    def run_until(self, deadline_ns: int, is_done: Callable[[], bool] | None = None) -> bool:
        """Serve ports and timers until `is_done()` or the deadline.

        Returns:
            True if `is_done()` became true, False at the deadline.

        Raises:
            StopRequestedError: the stop flag is set and obeyed.
        """
        while True:
            if self._stop.reason is not None and self._obeys_stop:
                raise _stop_error(self._stop.reason)
            if is_done is not None and is_done():
                return True
            now_ns = self._hub.now_ns()
            self._check_for_stall(now_ns)
            if now_ns >= deadline_ns:
                return self._catch_up(deadline_ns, is_done)
            if now_ns >= self._next_due_ns:
                self._fire(now_ns)
            until_ns = min(deadline_ns, now_ns + STOP_CHECK_NS, self._next_due_ns)
            chunk = self._hub.read(until_ns)
            if chunk is None:
                self.processed_until_ns = self._hub.now_ns()
            else:
                self._deliver(chunk)
                if self._buffered_chunks:
                    self._deliver_buffered(is_done)

    def check_timers_now(self) -> None:
        """Check the timers at once, because one of them is due earlier than before."""
        self._next_due_ns = 0

    def _explain_halt(self, fault: UnitHaltedError) -> GyrorigError:
        end_s = time.monotonic() + REASON_WAIT_S
        while fault.was_ordered and self._stop.reason is None and time.monotonic() < end_s:
            time.sleep(0.001)
        return fault if self._stop.reason is None else _stop_error(self._stop.reason)

    def _fire(self, now_ns: int) -> None:
        for timer in self._timers:
            if timer.due_ns <= now_ns:
                timer.fire(now_ns)
        self._next_due_ns = min((timer.due_ns for timer in self._timers), default=NEVER_NS)

    def _catch_up(self, deadline_ns: int, is_done: Callable[[], bool] | None) -> bool:
        """Handle what had arrived at the deadline; this process may have slept past it.

        A reply that came in time is not a timeout, however late it is read.
        """
        while (chunk := self._hub.read(deadline_ns)) is not None:
            self._deliver(chunk)
            if is_done is not None and is_done():
                return True
            if chunk.received_ns > deadline_ns:
                break
        return False

    def _deliver_buffered(self, is_done: Callable[[], bool] | None) -> None:
        chunks = self._buffered_chunks
        for _ in range(min(len(chunks), MAX_BURST_CHUNKS)):
            if is_done is not None and is_done():
                return
            self._deliver(chunks.popleft())

    def _deliver(self, chunk: Chunk) -> None:
        if not chunk.is_early:
            self.processed_until_ns = chunk.received_ns
        if chunk.late_ns and chunk.received_ns - chunk.late_ns > self._late_until_ns:
            self._late_until_ns = chunk.received_ns
            self.late_stalls += 1
            if self.on_stall is not None:
                begin_ns = chunk.received_ns - chunk.late_ns
                self.on_stall("the acquisition process", begin_ns, chunk.received_ns)
        sink = self._sinks.get(chunk.port)
        if sink is not None:
            sink(chunk)

    def _check_for_stall(self, now_ns: int) -> None:
        """Detect that this process was stopped, suspended or starved."""
        before_ns, self._last_turn_ns = self._last_turn_ns, now_ns
        if before_ns is not None and now_ns - before_ns > STALL_NS:
            self.stalls += 1
            if self.on_stall is not None:
                self.on_stall("the daemon", before_ns, now_ns)


def _stop_error(reason: str) -> StopRequestedError:
    kind = InterruptedByUserError if reason == "SIGINT" else StopRequestedError
    return kind(f"stopped by {reason}")
