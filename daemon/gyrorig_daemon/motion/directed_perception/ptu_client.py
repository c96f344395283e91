"""Client of a pan-tilt unit: one command at a time over the event loop.

What to use when: `ask` for a query that must succeed; `send_command` for a command that must be
carried out; `exchange` if a missing reply is acceptable; `halt` whenever a session ends. The
line has no flow control: the next command waits for the reply to the last one, and for the
vendor's limit of the command rate.

Theory of operation. A reply does not say which command it belongs to. One that arrives after
its timeout would be taken for the reply to the next command. Therefore, after a timeout, a reply
that does not fit or a refused poll, the line is out of step: before the next command the unit is
asked for its version. It replies in order, and that reply fits no other query, so everything
before it is stale. Only HALT is written first, in step or not. A reply that was received before
the command was written is stale, too. A superfluous reply that arrives between a command and its
reply is taken for its reply, if it fits: nothing in it shows the command that it belongs to. The
reply itself is then stale, because it arrives when none is expected or before the next command.
"""

import contextlib
from collections.abc import Callable

from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange, WriteTimes
from gyrorig_daemon.links.pump import Pump
from gyrorig_daemon.motion.pan_tilt_driver import no_answer_error, unidentified_error
from gyrorig_daemon.motion.ptu_exchange import Exchange, PtuLineCounts, is_accepted
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import (
    Axis,
    Banner,
    CableFlag,
    FirmwareVersion,
    InvalidLine,
    LimitFlag,
    MotionTranslator,
    PtuCommand,
    PtuReplyParser,
    Reply,
    read_value,
    require_done,
)
from gyrorig_protocol.ptu.ptu_commands import HALT_BOTH_AXES, QUERY_VERSION
from gyrorig_protocol.ptu.reply_values import ValueFault

DRAIN_S = 0.5  # for the rest of a reply that is still being sent
ATTEMPTS = 3
HALT_ATTEMPTS = 4
EXTRA_TIMEOUT_S = 1.0  # more for each further attempt: the unit or this host may be slow
RESYNC_TIMEOUT_S = 2.0  # for a late reply and the version
RAW_LIMIT_BYTES = 4096  # limit of the received bytes that one exchange keeps
BITS_PER_BYTE = 10  # 8N1 with start and stop bit

ReplyFilter = Callable[[Reply], bool]


class PtuClient:
    """The host's end of the unit's serial line."""

    def __init__(
        self,
        pump: Pump,
        port: str,
        *,
        location: str,
        baud: int,
        on_exchange: Callable[[Exchange], None],
        timeout_s: float = 1.0,
    ) -> None:
        """Attach to the port.

        Args:
            pump: the event loop that serves the ports.
            port: the hub's name of the unit's port.
            location: name of the port in errors, usually its path.
            baud: baud rate of the line, for the transmission time of bytes.
            on_exchange: called with every exchange except polls.
            timeout_s: shortest timeout of a reply.
        """
        self._pump = pump
        self._port = port
        self.location = location
        self.baud = baud
        self._on_exchange = on_exchange
        self._timeout_s = timeout_s
        self._parser = PtuReplyParser()
        self._translator = MotionTranslator()
        self._raw = bytearray()
        self._reply: Reply | None = None
        self._in_flight: PtuCommand | None = None
        self._reply_filter: ReplyFilter | None = (
            None  # accepts the awaited reply; all others are stale
        )
        self._is_out_of_step = False  # a reply is missing that may still arrive
        self._is_garbled = False
        self._limit_hit = False
        self._last_request_ns: int | None = None
        self._request_ns = 0  # of the last command; what was received before is no reply to it
        self.counts = PtuLineCounts()
        self.min_interval_s = 0.0
        self.is_resetting = False
        self.expects_banner = True
        self.is_identified = False  # the device has identified itself as a pan-tilt unit
        self.lost_synchrony: str | None = None
        self.is_port_gone = not pump.is_up(port)
        pump.attach(port, self._handle_chunk)

    def exchange(
        self, command: PtuCommand, timeout_s: float | None = None, is_poll: bool = False
    ) -> Exchange:
        """Send one command and wait for its reply.

        Returns:
            The exchange; its reply is None if nothing came in time. If a reply was missing before
            and the line could not be brought in step, it is the exchange of that attempt, and the
            command was not sent (except HALT, which is sent at once).

        Raises:
            DeviceError: the port is gone or takes no bytes.
        """
        self._check_port()
        reply_filter = None
        if command == QUERY_VERSION:
            reply_filter = _is_version if self._is_out_of_step else None
        elif self._is_out_of_step:
            if command == HALT_BOTH_AXES:
                self._pump.write(self._port, b" " + HALT_BOTH_AXES.encode())  # in step or not
            resync = self._send(QUERY_VERSION, RESYNC_TIMEOUT_S, False, _is_version)
            if resync.reply is None:
                return resync
        wait_s = max(self._timeout_s, command.timeout_s) if timeout_s is None else timeout_s
        return self._send(command, wait_s, is_poll, reply_filter)

    def _send(
        self, command: PtuCommand, wait_s: float, is_poll: bool, reply_filter: ReplyFilter | None
    ) -> Exchange:
        self._wait_for_rate()
        self._parser.expect(command.text)
        self._reply, self._is_garbled, self._limit_hit = None, False, False
        self._raw.clear()
        self._in_flight, self._reply_filter = command, reply_filter
        write_times = self._pump.write(self._port, command.encode())
        self._last_request_ns = self._request_ns = write_times.before_ns
        self._pump.run_until(write_times.after_ns + int(wait_s * 1e9), self._is_exchange_over)
        self._in_flight = None
        exchange = self._make_exchange(command, write_times, is_poll)
        self.counts.exchanges += 1
        self.counts.polls += is_poll
        if is_poll and exchange.reply is not None:
            wait_ns = exchange.reply_ns - exchange.request_ns
            self.counts.poll_wait_max_ns = max(self.counts.poll_wait_max_ns, wait_ns)
        if not is_poll or exchange.reply is None or not exchange.reply.ok or exchange.limit_hit:
            self._on_exchange(exchange)
        # A unit refuses no poll: the refusal answers a byte that it received in error, and the
        # reply to the poll may follow.
        self._is_out_of_step = (
            exchange.reply is None
            or isinstance(exchange.reading, ValueFault)
            or (is_poll and not exchange.reply.ok)
        )
        if exchange.reply is None and not self.is_port_gone:
            self._resynchronise()
        self._check_port()
        return exchange

    def ask(self, command: PtuCommand, timeout_s: float | None = None) -> Reply:
        """Send a command that may be repeated until it is answered.

        A reply that does not fit belongs to another command or is damaged: the command is repeated.

        Raises:
            DeviceError: no reply after three attempts.
        """
        return self._ask_repeatedly(command, ATTEMPTS, timeout_s)

    def _ask_repeatedly(self, command: PtuCommand, attempts: int, timeout_s: float | None) -> Reply:
        unexpected: Reply | None = None
        min_timeout_s = max(self._timeout_s, command.timeout_s) if timeout_s is None else timeout_s
        for attempt in range(attempts):
            exchange = self.exchange(command, min_timeout_s + attempt * EXTRA_TIMEOUT_S)
            if exchange.reply is None or exchange.command != command:
                continue
            if not isinstance(exchange.reading, ValueFault):
                return exchange.reply
            unexpected = exchange.reply
        if unexpected is not None:
            return unexpected
        raise self.no_answer_error(command)

    def send_command(self, command: PtuCommand) -> None:
        """Send a repeatable command that must be carried out.

        Raises:
            DeviceError: it was refused, there is no reply after three attempts, or the device has
                not identified itself as a pan-tilt unit.
        """
        if not self.is_identified and command != HALT_BOTH_AXES:
            raise unidentified_error(self.location)
        require_done(command, self.ask(command))

    def halt(self) -> None:
        """Halt both axes, whatever else is in progress.

        Raises:
            DeviceError: the unit does not acknowledge.
        """
        self._check_port()
        interrupted, self._in_flight = self._in_flight, None
        if interrupted is not None:
            # Halt at once, then discard replies, so that they are not taken for those of the
            # next command. A unit that is homing or computing replies when it has finished.
            self._pump.write(self._port, f" {HALT_BOTH_AXES.text} ".encode("ascii"))
            stale_before, timeout_ns = self.counts.stale, int(interrupted.timeout_s * 1e9)
            self._pump.run_until(
                self._pump.now_ns() + timeout_ns,
                lambda: self.counts.stale > stale_before or self.is_port_gone,
            )
            self._is_out_of_step = self.counts.stale == stale_before
            self.drain()
        self._last_request_ns = None
        require_done(HALT_BOTH_AXES, self._ask_repeatedly(HALT_BOTH_AXES, HALT_ATTEMPTS, None))

    def drain(self, seconds: float = DRAIN_S) -> None:
        """Receive and discard what the unit still sends."""
        self._pump.run_until(self._pump.now_ns() + int(seconds * 1e9))
        self._parser.reset()
        self._check_port()

    def send_spaces(self, count: int) -> None:
        """End a command that the unit may have received in part."""
        self._check_port()
        self._pump.write(self._port, b" " * count)

    def wire_ns(self, byte_count: int) -> int:
        """Return the transmission time of bytes."""
        return byte_count * BITS_PER_BYTE * 1_000_000_000 // self.baud

    def no_answer_error(self, command: PtuCommand) -> DeviceError:
        """Return the error for a unit that does not answer."""
        return no_answer_error(self.location, command.text)

    def _handle_chunk(self, chunk: Chunk) -> None:
        if chunk.change is not None:
            is_gone = chunk.change is PortChange.GONE
            self._handle_port_gone() if is_gone else self._handle_port_back()
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
                    self._handle_limit(event.axis)
                case CableFlag():
                    self.lost_synchrony = "the cable of its head was disconnected"
                case Banner():
                    if not self.expects_banner:
                        self.lost_synchrony = "it has restarted"
                case InvalidLine():
                    self.counts.frame_errors += 1
                    is_awaited = self._in_flight is not None and self._reply_filter is None
                    self._is_garbled |= is_awaited and chunk.received_ns >= self._request_ns

    def _handle_port_gone(self) -> None:
        """The unit keeps executing its last command, and nobody observes it."""
        if not self.is_port_gone:
            self.counts.hung_up += 1
        self.is_port_gone = True

    def _handle_port_back(self) -> None:
        """Halt the device on the reopened port before anything is asked.

        The command moves no device, and a unit that was left turning stops sooner.
        """
        self.is_port_gone = self.is_identified = False
        self._is_out_of_step = True
        self._parser.reset()
        self.expects_banner = True  # it may have been switched off, too
        with contextlib.suppress(DeviceError):
            self._pump.write(self._port, b"   " + HALT_BOTH_AXES.encode())

    def _is_awaited(self, reply: Reply) -> bool:
        if self._in_flight is None or self._reply is not None:
            return False
        if reply.last_byte_ns < self._request_ns:
            return False
        return self._reply_filter is None or self._reply_filter(reply)

    def _handle_limit(self, axis: Axis) -> None:
        self.counts.limit_flags += 1
        self._limit_hit = True
        if not self.is_resetting:
            self.lost_synchrony = f"its {axis.label} axis reached a limit"

    def _is_exchange_over(self) -> bool:
        return self._reply is not None or self._is_garbled or self.is_port_gone

    def _make_exchange(
        self, command: PtuCommand, write_times: WriteTimes, is_poll: bool
    ) -> Exchange:
        reply, now_ns = self._reply, self._pump.now_ns()
        if reply is None:
            self.counts.garbled += self._is_garbled
            self.counts.timeouts += not self._is_garbled
            first_ns = last_ns = now_ns
        else:
            self.counts.refused += not reply.ok
            first_ns, last_ns = reply.first_byte_ns, reply.last_byte_ns
            wait_ns = last_ns - write_times.before_ns
            self.counts.reply_wait_max_ns = max(self.counts.reply_wait_max_ns, wait_ns)
        accepted = is_accepted(reply, self._limit_hit)
        return Exchange(
            command=command,
            request_ns=write_times.before_ns,
            sent_ns=write_times.after_ns,
            first_byte_ns=first_ns,
            reply_ns=last_ns,
            reply=reply,
            raw=bytes(self._raw),
            limit_hit=self._limit_hit,
            orders=() if is_poll else self._translator.translate(command.text, accepted),
            reading=None if reply is None else read_value(command, reply),
        )

    def _resynchronise(self) -> None:
        """Send a bare delimiter and discard what is being received."""
        self._pump.write(self._port, b" ")
        self.drain(0.1)

    def _wait_for_rate(self) -> None:
        if self._last_request_ns is not None and self.min_interval_s:
            self._pump.run_until(self._last_request_ns + int(self.min_interval_s * 1e9))

    def _check_port(self) -> None:
        if self.is_port_gone:
            raise DeviceError(
                f"the pan-tilt unit on {self.location} was unplugged",
                "check the cable and the power of the unit",
            )


def _is_version(reply: Reply) -> bool:
    return isinstance(read_value(QUERY_VERSION, reply), FirmwareVersion)
