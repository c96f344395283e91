"""One command in flight: exchanges with a pan-tilt unit over a pump.

What to use when: `ask` for a question or an order that must succeed; `exchange` where
a silence is to be lived with; `halt` on every way out. There is no flow control on the
wire: the next command waits for the answer to the last, and for the vendor's rate.

Theory of operation. An answer does not say which command it answers, and one that comes
after its patience has ended would be taken for the next command's. So after a silence or an
answer that does not fit, the line is out of step: before the next command the unit is
asked for its version. It answers in order, and that answer fits no other question, so
what comes before it is stale. HALT alone is written first, in step or not.
"""

import contextlib
from collections.abc import Callable

from gyrorig_daemon.links.hub import Chunk, PortChange
from gyrorig_daemon.links.pump import Pump
from gyrorig_daemon.motion.exchange import Counts, Exchange
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import (
    Axis,
    Banner,
    CableFlag,
    FrameError,
    LimitFlag,
    PtuCommand,
    PtuReplyParser,
    Reply,
    Version,
    read,
    require_done,
)
from gyrorig_protocol.ptu.commands import HALT, QUERY_VERSION
from gyrorig_protocol.ptu.values import ValueFault

DRAIN_S = 0.5  # reference: ptu-e46.md section 9
ATTEMPTS = 3
HALT_ATTEMPTS = 4
MORE_PATIENCE_S = 1.0  # with each further attempt: the unit, or this host, may be slow
FENCE_S = 2.0  # for a late answer and the version's
RAW_LIMIT_BYTES = 4096  # what one exchange keeps of what was received
SETTLE_POLLS = 3  # equal answers in a row that count as stillness
BITS_PER_BYTE = 10  # 8N1 with start and stop bit

Accepts = Callable[[Reply], bool]


class PtuClient:
    """The host's end of one unit's serial line."""

    def __init__(
        self,
        pump: Pump,
        port: str,
        *,
        where: str,
        baud: int,
        on_exchange: Callable[[Exchange], None],
        timeout_s: float = 1.0,
    ) -> None:
        """Attach to the port.

        Args:
            pump: what serves the ports.
            port: the hub's name of the unit's port.
            where: what to call the port in an error, usually its path.
            baud: the line's rate, for the time that bytes take.
            on_exchange: called with every exchange but the polls.
            timeout_s: least patience with any answer.
        """
        self._pump = pump
        self._port = port
        self.where = where
        self.baud = baud
        self._on_exchange = on_exchange
        self._timeout_s = timeout_s
        self._parser = PtuReplyParser()
        self._raw = bytearray()
        self._reply: Reply | None = None
        self._in_flight: PtuCommand | None = None
        self._accepts: Accepts | None = None  # only such an answer; all others are stale
        self._is_out_of_step = False  # an answer is owed that may come yet
        self._garbled = False
        self._limit_hit = False
        self._last_request_ns: int | None = None
        self.counts = Counts()
        self.min_interval_s = 0.0
        self.resetting = False
        self.expects_banner = True
        self.identified = False  # what is on the port has said that it is a pan-tilt unit
        self.lost_synchrony: str | None = None
        self.gone = not pump.is_up(port)
        pump.attach(port, self._take)

    def exchange(
        self, command: PtuCommand, timeout_s: float | None = None, is_poll: bool = False
    ) -> Exchange:
        """Send one command and wait for its answer.

        Returns:
            The exchange; its reply is None when nothing came in time. Where an answer was
            owed before and the line did not get in step, it is the vain exchange with
            which that was tried, and the command was not sent (but HALT is, at once).

        Raises:
            DeviceError: the port hung up or does not take bytes.
        """
        self._check_port()
        accepts = None
        if command == QUERY_VERSION:
            accepts = _is_version if self._is_out_of_step else None
        elif self._is_out_of_step:
            if command == HALT:
                self._pump.write(self._port, b" " + HALT.encode())  # whatever is in step or not
            fence = self._send(QUERY_VERSION, FENCE_S, False, _is_version)
            if fence.reply is None:
                return fence
        wait_s = max(self._timeout_s, command.patience_s) if timeout_s is None else timeout_s
        return self._send(command, wait_s, is_poll, accepts)

    def _send(
        self, command: PtuCommand, wait_s: float, is_poll: bool, accepts: Accepts | None
    ) -> Exchange:
        self._wait_for_rate()
        self._parser.expect(command.text)
        self._reply, self._garbled, self._limit_hit = None, False, False
        self._raw.clear()
        self._in_flight, self._accepts = command, accepts
        stamp = self._pump.write(self._port, command.encode())
        self._last_request_ns = stamp.before_ns
        self._pump.run_until(stamp.after_ns + int(wait_s * 1e9), self._is_over)
        self._in_flight = None
        done = self._finish(command, stamp.before_ns, stamp.after_ns)
        self.counts.exchanges += 1
        self.counts.polls += is_poll
        if is_poll and done.reply is not None:
            wait_ns = done.reply_ns - done.request_ns
            self.counts.poll_wait_max_ns = max(self.counts.poll_wait_max_ns, wait_ns)
        if not is_poll or done.reply is None or not done.reply.ok or done.limit_hit:
            self._on_exchange(done)
        self._is_out_of_step = done.reply is None or not _fits(command, done.reply)
        if done.reply is None and not self.gone:
            self._resynchronise()
        self._check_port()
        return done

    def ask(self, command: PtuCommand, timeout_s: float | None = None) -> Reply:
        """Send a command that may be repeated until it is answered.

        An answer that does not fit the command is another's, or damaged: it is asked again.

        Raises:
            DeviceError: no answer to three attempts.
        """
        return self._insist(command, ATTEMPTS, timeout_s)

    def _insist(self, command: PtuCommand, attempts: int, timeout_s: float | None) -> Reply:
        odd: Reply | None = None
        least_s = max(self._timeout_s, command.patience_s) if timeout_s is None else timeout_s
        for attempt in range(attempts):
            done = self.exchange(command, least_s + attempt * MORE_PATIENCE_S)
            if done.reply is None or done.command != command:
                continue
            if _fits(command, done.reply):
                return done.reply
            odd = done.reply
        if odd is not None:
            return odd
        raise self.silence(command)

    def order(self, command: PtuCommand) -> None:
        """Send an order, repeatable, that must be carried out.

        Raises:
            DeviceError: refused, no answer to three attempts, or nobody has said yet that
                what is on the port is a pan-tilt unit.
        """
        if not self.identified and command != HALT:
            raise self.unknown()
        require_done(command, self.ask(command))

    def halt(self) -> None:
        """Tell both axes to stop, whatever else is going on.

        Raises:
            DeviceError: the unit does not acknowledge.
        """
        self._check_port()
        broken_off, self._in_flight = self._in_flight, None
        if broken_off is not None:
            # Halt at once, then let the answers go by, so that they are not taken for those
            # of the next order. A unit that homes or computes answers when it has done that.
            self._pump.write(self._port, f" {HALT.text} ".encode("ascii"))
            known, patience_ns = self.counts.stale, int(broken_off.patience_s * 1e9)
            self._pump.run_until(
                self._pump.now_ns() + patience_ns, lambda: self.counts.stale > known or self.gone
            )
            self._is_out_of_step = self.counts.stale == known
            self.drain()
        self._last_request_ns = None
        require_done(HALT, self._insist(HALT, HALT_ATTEMPTS, None))

    def drain(self, seconds: float = DRAIN_S) -> None:
        """Take and forget what the unit still sends."""
        self._pump.run_until(self._pump.now_ns() + int(seconds * 1e9))
        self._parser.reset()
        self._check_port()

    def send_spaces(self, count: int) -> None:
        """End whatever the unit believes to be in the middle of."""
        self._check_port()
        self._pump.write(self._port, b" " * count)

    def wire_ns(self, byte_count: int) -> int:
        """Return how long so many bytes are on the wire."""
        return byte_count * BITS_PER_BYTE * 1_000_000_000 // self.baud

    def unknown(self) -> DeviceError:
        """Return the error for a unit that has to say who it is before anything moves."""
        return DeviceError(
            f"the port of the pan-tilt unit on {self.where} was gone: where it stands is not known",
            "check its cable; it is asked anew before it moves again",
        )

    def silence(self, command: PtuCommand) -> DeviceError:
        """Return the error for a unit that does not answer."""
        return DeviceError(
            f"the pan-tilt unit on {self.where} does not answer {command.text!r}",
            "check its power, the cable and the baud rate",
        )

    def _take(self, chunk: Chunk) -> None:
        if chunk.change is not None:
            self._lose() if chunk.change is PortChange.GONE else self._come_back()
            return
        if len(self._raw) < RAW_LIMIT_BYTES:
            self._raw += chunk.data
        for event in self._parser.feed(chunk.data, chunk.received_ns):
            match event:
                case Reply():
                    if self._is_awaited(event):
                        self._reply = event
                    else:
                        self.counts.stale += 1
                case LimitFlag():
                    self._take_limit(event.axis)
                case CableFlag():
                    self.lost_synchrony = "its head's cable came off"
                case Banner():
                    if not self.expects_banner:
                        self.lost_synchrony = "it has restarted"
                case FrameError():
                    self.counts.frame_errors += 1
                    self._garbled = self._in_flight is not None and self._accepts is None

    def _lose(self) -> None:
        """The unit goes on with its last order, and nobody sees it any more."""
        if not self.gone:
            self.counts.hung_up += 1
        self.gone = True

    def _come_back(self) -> None:
        """The port is open again. Whoever is there is told to halt before anything is asked.

        No device is moved by it, and a unit that was left turning stops sooner.
        """
        self.gone = self.identified = False
        self._is_out_of_step = True
        self._parser.reset()
        self.expects_banner = True  # it may have been switched off, too
        with contextlib.suppress(DeviceError):
            self._pump.write(self._port, b"   " + HALT.encode())

    def _is_awaited(self, reply: Reply) -> bool:
        if self._in_flight is None or self._reply is not None:
            return False
        return self._accepts is None or self._accepts(reply)

    def _take_limit(self, axis: Axis) -> None:
        self.counts.limit_flags += 1
        self._limit_hit = True
        if not self.resetting:
            self.lost_synchrony = f"its {axis.word} axis met its limit"

    def _is_over(self) -> bool:
        return self._reply is not None or self._garbled or self.gone

    def _finish(self, command: PtuCommand, request_ns: int, sent_ns: int) -> Exchange:
        reply, now_ns = self._reply, self._pump.now_ns()
        if reply is None:
            self.counts.garbled += self._garbled
            self.counts.timeouts += not self._garbled
            first_ns = last_ns = now_ns
        else:
            self.counts.refused += not reply.ok
            first_ns, last_ns = reply.first_byte_ns, reply.last_byte_ns
            wait_ns = last_ns - request_ns
            self.counts.reply_wait_max_ns = max(self.counts.reply_wait_max_ns, wait_ns)
        return Exchange(
            command, request_ns, sent_ns, first_ns, last_ns, reply, bytes(self._raw),
            self._limit_hit,
        )  # fmt: skip

    def _resynchronise(self) -> None:
        """Begin to get back in step: a bare delimiter, then forget what was under way."""
        self._pump.write(self._port, b" ")
        self.drain(0.1)

    def _wait_for_rate(self) -> None:
        if self._last_request_ns is not None and self.min_interval_s:
            self._pump.run_until(self._last_request_ns + int(self.min_interval_s * 1e9))

    def _check_port(self) -> None:
        if self.gone:
            raise DeviceError(
                f"{self.where} (pan-tilt unit) hung up", "check the cable and its power"
            )


def _is_version(reply: Reply) -> bool:
    return isinstance(read(QUERY_VERSION, reply), Version)


def _fits(command: PtuCommand, reply: Reply) -> bool:
    """Return whether an answer is one to this command, a refusal included."""
    return not isinstance(read(command, reply), ValueFault)
