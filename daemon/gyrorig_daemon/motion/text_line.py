"""The host's end of the line of a unit that answers each command with one reply.

After a missing reply, or one that does not fit, the line is out of step: a late reply could be
taken for the next one. Then the identity is asked for before the next command, and everything
before its reply is discarded.
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field

from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange
from gyrorig_daemon.motion.framing import decode_replies
from gyrorig_daemon.motion.pan_tilt_driver import DriverPort
from gyrorig_daemon.motion.ptu_exchange import Exchange, PtuLineCounts
from gyrorig_daemon.motion.text_language import TextLanguage
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.motion_orders import AxisOrder
from gyrorig_protocol.ptu import AnswerKind, PtuCommand, Reply

DRAIN_S = 0.3
RESYNC_TIMEOUT_S = 2.0
BITS_PER_BYTE = 10  # 8N1


@dataclass(frozen=True, slots=True)
class TextCommand(PtuCommand):
    """A command in words, with its bytes."""

    data: bytes = field(default=b"")

    def encode(self) -> bytes:
        """Return the bytes to write."""
        return self.data


class TextLine:
    """One command and its reply at a time."""

    def __init__(self, port: DriverPort, language: TextLanguage) -> None:
        """Attach to the port; nothing is sent yet."""
        self._pump, self._port = port.pump, port.port
        self._on_exchange = port.on_exchange
        self._baud, self._timeout_s = port.config.baud, port.config.poll.timeout_s
        self.location = port.location
        self.language = language
        self.counts = PtuLineCounts()
        self.min_interval_s = language.min_interval_s
        self.is_identified = False
        self.is_port_gone = not port.pump.is_up(port.port)
        self._framing = language.make_framing()
        self._received = bytearray()
        self._first_ns = 0
        self._reply: Reply | None = None
        self._is_awaited: Callable[[str], bool] | None = None
        self._in_flight = self._is_out_of_step = False
        self._last_request_ns: int | None = None
        port.pump.attach(port.port, self._handle_chunk)

    def exchange(
        self,
        text: str,
        orders: tuple[AxisOrder, ...] | None = None,
        is_poll: bool = False,
        timeout_s: float | None = None,
    ) -> Exchange:
        """Send one command and wait for its reply, which is None if it does not come in time.

        Args:
            text: the command or query.
            orders: what a command means, () for one that moves nothing; None for a query, whose
                reply is not an acknowledgement.
            is_poll: it is a request of the position.
            timeout_s: how long to wait; the time limit of the rig file by default.

        Raises:
            DeviceError: the port is gone.
        """
        self._check_port()
        language = self.language
        is_identity = text == language.identify
        if self._is_out_of_step and not is_identity:
            if text == language.halt:
                self._pump.write(self._port, language.halt_bytes)  # in step or not
            resync = self._send(language.identify, None, False, RESYNC_TIMEOUT_S, self._is_identity)
            if resync.reply is None:
                return resync
        awaited = self._is_identity if is_identity and self._is_out_of_step else None
        return self._send(text, orders, is_poll, timeout_s or self._timeout_s, awaited)

    def reject_reply(self) -> None:
        """Treat the last reply as that to another command: the right one may follow."""
        self._is_out_of_step = True

    def halt_in_flight(self) -> None:
        """Write the halt command at once if another command waits for its reply."""
        self._check_port()
        if self._in_flight:
            self._pump.write(self._port, self.language.halt_bytes)
            self._in_flight, self._is_out_of_step = False, True
            self.drain()
        self._last_request_ns = None

    def drain(self) -> None:
        """Discard what arrives for a moment."""
        self._pump.run_until(self._pump.now_ns() + int(DRAIN_S * 1e9))
        self._received.clear()
        self._check_port()

    def wire_ns(self, byte_count: int) -> int:
        """Return the transmission time of bytes."""
        return byte_count * BITS_PER_BYTE * 1_000_000_000 // self._baud

    def _send(
        self,
        text: str,
        orders: tuple[AxisOrder, ...] | None,
        is_poll: bool,
        wait_s: float,
        awaited: Callable[[str], bool] | None,
    ) -> Exchange:
        if self._last_request_ns is not None:
            self._pump.run_until(self._last_request_ns + int(self.min_interval_s * 1e9))
        command = TextCommand(text, AnswerKind.TEXT, data=self._framing.encode(text))
        self._received.clear()
        self._reply, self._in_flight, self._is_awaited = None, True, awaited
        times = self._pump.write(self._port, command.encode())
        self._last_request_ns = times.before_ns
        self._pump.run_until(
            times.after_ns + int(wait_s * 1e9), lambda: self._reply is not None or self.is_port_gone
        )
        self._in_flight = False
        reply, now_ns = self._reply, self._pump.now_ns()
        if reply is not None and orders is not None:
            reply = _judge(reply, self.language)
        exchange = Exchange(
            command,
            times.before_ns,
            times.after_ns,
            now_ns if reply is None else reply.first_byte_ns,
            now_ns if reply is None else reply.last_byte_ns,
            reply,
            b"" if reply is None else reply.raw,
            False,
            orders or (),
        )
        self._count(exchange, is_poll)
        if not is_poll or reply is None:
            self._on_exchange(exchange)
        self._is_out_of_step = reply is None
        self._check_port()
        return exchange

    def _count(self, exchange: Exchange, is_poll: bool) -> None:
        counts, wait_ns = self.counts, exchange.reply_ns - exchange.request_ns
        counts.exchanges += 1
        counts.polls += is_poll
        counts.timeouts += exchange.reply is None
        counts.refused += exchange.reply is not None and not exchange.reply.ok
        if exchange.reply is not None:
            counts.reply_wait_max_ns = max(counts.reply_wait_max_ns, wait_ns)
            if is_poll:
                counts.poll_wait_max_ns = max(counts.poll_wait_max_ns, wait_ns)

    def _is_identity(self, text: str) -> bool:
        return self.language.read_identity(text) is not None

    def _handle_chunk(self, chunk: Chunk) -> None:
        if chunk.change is not None:
            self._handle_change(chunk.change)
            return
        if not self._received:
            self._first_ns = chunk.received_ns
        self._received += chunk.data
        before = bytes(self._received)
        replies, damaged_count = decode_replies(self._framing, self._received)
        self.counts.frame_errors += damaged_count
        for text in replies:
            self._handle_reply(text, before[: len(before) - len(self._received)], chunk.received_ns)
        if len(self._received) < len(before):
            self._first_ns = chunk.received_ns  # of what is left, at the latest

    def _handle_reply(self, text: str, raw: bytes, received_ns: int) -> None:
        is_awaited = self._is_awaited is None or self._is_awaited(text)
        # Received before the command was written: a superfluous reply to the command before it.
        is_early = self._last_request_ns is not None and received_ns < self._last_request_ns
        if not self._in_flight or self._reply is not None or not is_awaited or is_early:
            self.counts.stale += 1
            return
        self._reply = Reply(True, text, "", raw, self._first_ns, received_ns)

    def _handle_change(self, change: PortChange) -> None:
        self._received.clear()
        if change is PortChange.GONE:
            self.counts.hung_up += not self.is_port_gone
            self.is_port_gone = True
            return
        self.is_port_gone = self.is_identified = False
        self._is_out_of_step = True
        with contextlib.suppress(DeviceError):  # a unit that was left turning stops sooner
            self._pump.write(self._port, self.language.halt_bytes)

    def _check_port(self) -> None:
        if self.is_port_gone:
            raise DeviceError(
                f"the pan-tilt unit on {self.location} was unplugged",
                "check the cable and the power of the unit",
            )


def _judge(reply: Reply, language: TextLanguage) -> Reply:
    ok = language.is_accepted(reply.text)
    return Reply(ok, reply.text, "", reply.raw, reply.first_byte_ns, reply.last_byte_ns)
