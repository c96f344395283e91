"""Messages of the pan-tilt unit: exchanges, orders and positions as a recording keeps them."""

import math

from gyrorig_daemon.clocks import OnlineClock
from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.motion import Exchange, Position, UnitFacts
from gyrorig_daemon.recorder.recorder import Recorder
from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis, OrderKind
from gyrorig_protocol.ptu import Axis
from gyrorig_protocol.recording.messages import (
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    CommandCode,
    PtuCommandRecord,
    PtuPosition,
    PtuStatus,
)
from gyrorig_protocol.recording.motion_messages import MOTION_ORDER_TOPIC, MotionOrder

_COUNTER_BITS = 32  # unknown for the E46; a larger value shows that it has 64
UNSIGNED_KINDS = (OrderKind.SPEED, OrderKind.BASE_SPEED, OrderKind.ACCELERATION)
_PAN_ANSWERED = int(PtuStatus.PAN_ANSWERED)  # combining enum flags takes 1 us each
_TILT_ANSWERED = int(PtuStatus.TILT_ANSWERED)
_SYNCHRONY_LOST = int(PtuStatus.SYNCHRONY_LOST)
_POLLS_PER_BRACKET = 5  # a bracket is expensive: not for every poll


class PtuLog:
    """Converts exchanges and positions to messages."""

    def __init__(self, recorder: Recorder, capture: CaptureClock) -> None:
        self._recorder = recorder
        self._capture = capture
        self._facts: UnitFacts | None = None
        self._command_count = 0
        self._position_count = 0
        self._order_count = 0
        self.position: PtuPosition | None = None  # the last one
        self.controller_clock: OnlineClock | None = None

    def set_unit(self, facts: UnitFacts) -> None:
        """Set the unit; positions are recorded only after that."""
        self._facts = facts
        if facts.counter_hz:
            self.controller_clock = OnlineClock(float(facts.counter_hz), _COUNTER_BITS)

    def record_exchange(self, exchange: Exchange) -> None:
        """Record an exchange verbatim, and the orders in it."""
        code = CommandCode.OK
        if exchange.limit_hit:
            code = CommandCode.LIMIT
        elif exchange.reply is None:
            code = CommandCode.TIMEOUT
        elif not exchange.reply.ok:
            code = CommandCode.ERROR
        has_reply = exchange.reply is not None
        utc_ns = self._capture.utc_ns
        self._recorder.put_or_hold(
            PTU_COMMAND_TOPIC,
            PtuCommandRecord(
                request_time_ns=utc_ns(exchange.request_ns),
                first_byte_time_ns=utc_ns(exchange.first_byte_ns) if has_reply else 0,
                reply_time_ns=utc_ns(exchange.reply_ns) if has_reply else 0,
                sequence=self._command_count & 0xFFFF_FFFF,
                code=int(code),
                command=exchange.command.text,
                reply=verbatim(exchange.raw),
            ),
            utc_ns(exchange.reply_ns),
        )
        self._command_count += 1
        for order in exchange.orders:
            self._record_order(exchange, order)

    def _record_order(self, exchange: Exchange, order: AxisOrder) -> None:
        has_reply, utc_ns = exchange.reply is not None, self._capture.utc_ns
        self._recorder.put_or_hold(
            MOTION_ORDER_TOPIC,
            MotionOrder(
                request_time_ns=utc_ns(exchange.request_ns),
                first_byte_time_ns=utc_ns(exchange.first_byte_ns) if has_reply else 0,
                reply_time_ns=utc_ns(exchange.reply_ns) if has_reply else 0,
                value=self._si_value(order),
                steps=order.value,
                speed_steps_s=order.speed_steps_s,
                sequence=self._order_count & 0xFFFF_FFFF,
                command_bytes=len(exchange.command.encode()),
                axis=int(order.axis),
                kind=int(order.kind),
                accepted=int(exchange.accepted),
            ),
            utc_ns(exchange.reply_ns),
        )
        self._order_count += 1

    def _si_value(self, order: AxisOrder) -> float:
        """Return the value in rad, rad/s or rad/s^2; NaN while the step size is not known."""
        if self._facts is None or order.axis is OrderAxis.BOTH:
            return math.nan
        axis = Axis.PAN if order.axis is OrderAxis.PAN else Axis.TILT
        rad = self._facts.axis(axis).to_rad(1) * order.value
        return abs(rad) if order.kind in UNSIGNED_KINDS else rad

    def record_position(self, position: Position) -> None:
        """Record an answered poll.

        Its time is the midpoint of the interval in which the unit read its position. If the unit
        sends its counter, all intervals together narrow each one: a stall of the host widens only
        its own interval.
        """
        facts = self._facts
        if facts is None:
            return
        exchange, utc_ns = position.exchange, self._capture.utc_ns
        taken_ns = self._position_time_ns(position)
        reply_time_ns = utc_ns(exchange.reply_ns)
        status = _PAN_ANSWERED if position.has_pan else 0
        if position.has_tilt:
            status |= _TILT_ANSWERED
        if position.synchrony_lost:
            status |= _SYNCHRONY_LOST
        self.position = PtuPosition(
            request_time_ns=utc_ns(exchange.request_ns),
            first_byte_time_ns=utc_ns(exchange.first_byte_ns),
            reply_time_ns=reply_time_ns,
            pan_steps=position.pan_steps,
            tilt_steps=position.tilt_steps,
            pan_rad=facts.pan.to_rad(position.pan_steps),
            tilt_rad=facts.tilt.to_rad(position.tilt_steps),
            controller_time=position.counter or 0,
            sequence=self._position_count & 0xFFFF_FFFF,
            status=status,
        )
        self._recorder.put(PTU_POSITION_TOPIC, self.position, reply_time_ns, utc_ns(taken_ns))
        self._position_count += 1

    def _position_time_ns(self, position: Position) -> int:
        earliest_ns, latest_ns = position.earliest_ns, position.latest_ns
        middle_ns = (earliest_ns + latest_ns) // 2
        clock, facts, counter = self.controller_clock, self._facts, position.counter
        if clock is None or facts is None or facts.counter_hz is None or counter is None:
            return middle_ns
        if counter >> _COUNTER_BITS and clock.counter_bits == _COUNTER_BITS:
            clock = self.controller_clock = OnlineClock(float(facts.counter_hz), 64)
        mapped_ns = clock.observe(counter, latest_ns)
        if self._position_count % _POLLS_PER_BRACKET == 0:
            clock.observe_two_way(earliest_ns, counter, counter, latest_ns)
        if not clock.is_bracketed:
            return middle_ns
        return min(max(mapped_ns, earliest_ns), latest_ns)


def verbatim(raw: bytes) -> str:
    """Return a reply as text without line end; other bytes are escaped."""
    return raw.decode("ascii", errors="backslashreplace").strip("\r\n").replace("\0", "\\x00")
