"""The unit's exchanges and positions as a recording keeps them."""

from gyrorig_daemon.clocks import OnlineClock
from gyrorig_daemon.links.capture_clock import CaptureClock
from gyrorig_daemon.motion import Exchange, Position, UnitFacts
from gyrorig_daemon.recorder.recorder import Recorder
from gyrorig_protocol.recording.messages import (
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    CommandCode,
    PtuCommandRecord,
    PtuPosition,
    PtuStatus,
)

_COUNTER_BITS = 32  # unknown for the E46; a counter that exceeds it shows that it has 64
_POLLS_PER_BRACKET = 5  # each bracket looks at all others: not at every poll


class PtuLog:
    """Turns what the client and the poller see into messages."""

    def __init__(self, recorder: Recorder, capture: CaptureClock) -> None:
        self._recorder = recorder
        self._capture = capture
        self._facts: UnitFacts | None = None
        self._commands = 0
        self._positions = 0
        self.position: PtuPosition | None = None  # the last one
        self.controller_clock: OnlineClock | None = None

    def use_unit(self, facts: UnitFacts) -> None:
        """Say which unit it is; positions are only taken after that."""
        self._facts = facts
        if facts.counter_hz:
            self.controller_clock = OnlineClock(float(facts.counter_hz), _COUNTER_BITS)

    def take_exchange(self, exchange: Exchange) -> None:
        """Record an exchange verbatim."""
        code = CommandCode.OK
        if exchange.limit_hit:
            code = CommandCode.LIMIT
        elif exchange.reply is None:
            code = CommandCode.TIMEOUT
        elif not exchange.reply.ok:
            code = CommandCode.ERROR
        came = exchange.reply is not None
        utc_ns = self._capture.utc_ns
        self._recorder.hold(
            PTU_COMMAND_TOPIC,
            PtuCommandRecord(
                request_time_ns=utc_ns(exchange.request_ns),
                first_byte_time_ns=utc_ns(exchange.first_byte_ns) if came else 0,
                reply_time_ns=utc_ns(exchange.reply_ns) if came else 0,
                sequence=self._commands & 0xFFFF_FFFF,
                code=int(code),
                command=exchange.command.text,
                reply=verbatim(exchange.raw),
            ),
            utc_ns(exchange.reply_ns),
        )
        self._commands += 1

    def take_position(self, position: Position) -> None:
        """Record an answered poll.

        Its time is the middle of the interval in which it was taken. Where the unit sends
        its counter, all intervals together narrow each: a stall of the host widens its own
        only.
        """
        facts = self._facts
        if facts is None:
            return
        exchange, utc_ns = position.exchange, self._capture.utc_ns
        taken_ns = self._taken_ns(position)
        status = PtuStatus(0)
        if position.has_pan:
            status |= PtuStatus.PAN_ANSWERED
        if position.has_tilt:
            status |= PtuStatus.TILT_ANSWERED
        if position.synchrony_lost:
            status |= PtuStatus.SYNCHRONY_LOST
        pan, tilt = facts.pan, facts.tilt
        self.position = PtuPosition(
            request_time_ns=utc_ns(exchange.request_ns),
            first_byte_time_ns=utc_ns(exchange.first_byte_ns),
            reply_time_ns=utc_ns(exchange.reply_ns),
            pan_steps=position.pan_steps,
            tilt_steps=position.tilt_steps,
            pan_rad=pan.to_rad(position.pan_steps),
            tilt_rad=tilt.to_rad(position.tilt_steps),
            controller_time=position.counter or 0,
            sequence=self._positions & 0xFFFF_FFFF,
            status=int(status),
        )
        self._recorder.put(
            PTU_POSITION_TOPIC, self.position, utc_ns(exchange.reply_ns), utc_ns(taken_ns)
        )
        self._positions += 1

    def _taken_ns(self, position: Position) -> int:
        earliest_ns, latest_ns = position.earliest_ns, position.latest_ns
        middle_ns = (earliest_ns + latest_ns) // 2
        clock, facts, counter = self.controller_clock, self._facts, position.counter
        if clock is None or facts is None or facts.counter_hz is None or counter is None:
            return middle_ns
        if counter >> _COUNTER_BITS and clock.counter_bits == _COUNTER_BITS:
            clock = self.controller_clock = OnlineClock(float(facts.counter_hz), 64)
        mapped_ns = clock.observe(counter, latest_ns)
        if self._positions % _POLLS_PER_BRACKET == 0:
            clock.two_way(earliest_ns, counter, counter, latest_ns)
        if not clock.is_bracketed:
            return middle_ns
        return min(max(mapped_ns, earliest_ns), latest_ns)


def verbatim(raw: bytes) -> str:
    """Return a reply as text, its line end taken off, other bytes as escapes."""
    return raw.decode("ascii", errors="backslashreplace").strip("\r\n").replace("\0", "\\x00")
