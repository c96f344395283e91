"""Time requests to a board that wait for a reply, identified by their nonce.

A late reply must not be matched with a later request: that would shift the clock by half a
request interval.
"""

from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.links.ports.port_hub import WriteTimes
from gyrorig_protocol.board import TimeReply
from gyrorig_protocol.recording.clock_messages import ClockPing

MAX_PENDING_PINGS = 32


class PendingPings:
    """Requests to one board that are not answered or forgotten."""

    def __init__(self, capture: CaptureClock, first_nonce: int) -> None:
        self._capture = capture
        self._next_nonce = first_nonce
        self._pending: dict[int, tuple[int, int]] = {}  # nonce -> time of writing, earliest arrival

    def next_request(self, now_ns: int) -> tuple[int, int]:
        """Return the nonce of a new request, and the time of the host in it, ns."""
        return self._next_nonce, self._capture.utc_ns(now_ns)

    def record_sent(self, write_times: WriteTimes, wire_ns: int) -> None:
        """Store when the new request was written and how long it is on the wire."""
        if len(self._pending) >= MAX_PENDING_PINGS:
            del self._pending[next(iter(self._pending))]
        self._pending[self._next_nonce] = (write_times.before_ns, write_times.before_ns + wire_ns)
        self._next_nonce = (self._next_nonce + 1) & 0xFFFF_FFFF

    def match_reply(self, reply: TimeReply, received_ns: int) -> tuple[int, ClockPing] | None:
        """Return the earliest arrival of the request at the board, and the message to record.

        None if there was no such request, or it was forgotten.
        """
        times_ns = self._pending.pop(reply.nonce, None)
        if times_ns is None:
            return None
        written_ns, earliest_arrival_ns = times_ns
        return earliest_arrival_ns, ClockPing(
            host_send_ns=self._capture.utc_ns(written_ns),
            host_receive_ns=self._capture.utc_ns(received_ns),
            device_receive=reply.device_receive,
            device_send=reply.device_send,
            nonce=reply.nonce,
            status=0,
        )

    def clear(self) -> None:
        """Forget all requests, because the board has restarted."""
        self._pending.clear()
