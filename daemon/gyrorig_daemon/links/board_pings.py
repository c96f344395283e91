"""Questions for a board's clock that are under way, known by their nonce.

A late answer must not be taken for that to a later question: it would shift the clock by half a
period of asking for good (reference: boards.md section 2).
"""

from gyrorig_daemon.links.capture_clock import CaptureClock
from gyrorig_daemon.links.hub import WriteStamp
from gyrorig_protocol.board import TimeReply, TimeRequest
from gyrorig_protocol.recording.messages import ClockPing

PINGS_HELD = 32


class PingBook:
    """What was asked of one board, until it is answered or forgotten."""

    def __init__(self, capture: CaptureClock, first_nonce: int) -> None:
        self._capture = capture
        self._nonce = first_nonce
        self._sent: dict[int, tuple[int, int]] = {}  # nonce -> written at, there at the earliest

    def question(self, now_ns: int) -> bytes:
        """Return the frame of a new question."""
        return TimeRequest(self._nonce, self._capture.utc_ns(now_ns)).encode()

    def sent(self, stamp: WriteStamp, wire_ns: int) -> None:
        """Note when the new question was written, and how long it is on the wire."""
        if len(self._sent) >= PINGS_HELD:
            del self._sent[next(iter(self._sent))]
        self._sent[self._nonce] = (stamp.before_ns, stamp.before_ns + wire_ns)
        self._nonce = (self._nonce + 1) & 0xFFFF_FFFF

    def answer(self, reply: TimeReply, received_ns: int) -> tuple[int, ClockPing] | None:
        """Return when the question can first have been there, and the exchange for the file.

        None where nobody asked, or it was forgotten.
        """
        sent = self._sent.pop(reply.nonce, None)
        if sent is None:
            return None
        written_ns, there_ns = sent
        return there_ns, ClockPing(
            host_send_ns=self._capture.utc_ns(written_ns),
            host_receive_ns=self._capture.utc_ns(received_ns),
            device_receive=reply.device_receive,
            device_send=reply.device_send,
            nonce=reply.nonce,
            status=0,
        )

    def clear(self) -> None:
        """Forget all that is under way: another start of the board answers from here on."""
        self._sent.clear()
