"""Position polls: BT if the dialect has it, otherwise PP and TP in turn.

The unit reads its position between the arrival of the command's last byte and the first byte
of the reply. The recorder decides which moment in between is used.
"""

from collections.abc import Callable, Mapping

from gyrorig_daemon.motion.ptu_client import PtuClient
from gyrorig_daemon.motion.ptu_exchange import Exchange, Position
from gyrorig_daemon.motion.unit_setup import Unit
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import (
    Axis,
    MotionReading,
    PtuCommand,
    Quantity,
    dialect_features,
    query_quantity,
    read_value,
)
from gyrorig_protocol.ptu.ptu_commands import QUERY_MOTION_AND_COUNTER

# The unit is gone after so many consecutive polls without a reply, or after this time and at
# least two polls.
MAX_UNANSWERED_POLLS = 5
MAX_SILENCE_S = 4.0


class PositionPoller:
    """Polls the position of the unit, at its limit of rate or slower."""

    def __init__(
        self, unit: Unit, rate_hz: float | None, on_position: Callable[[Position], None]
    ) -> None:
        """Poll `unit`; every position goes to `on_position`.

        Args:
            unit: an identified unit.
            rate_hz: polls per second; None for the vendor's limit of the dialect.
            on_position: called with every position.
        """
        self._client: PtuClient = unit.client
        self._uses_motion = dialect_features(unit.facts.dialect).motion_with_counter
        self._on_position = on_position
        if rate_hz is not None:
            self._client.min_interval_s = 1.0 / rate_hz
        self._next_axis = Axis.PAN
        self._steps: dict[Axis, int] = {}
        self._previous_steps: dict[Axis, int] = {}
        self._is_still: bool | None = None
        self._unanswered_polls = 0
        self._last_answer_ns = 0

    def read_positions(self) -> dict[Axis, int]:
        """Poll both axes and return their positions in steps.

        Raises:
            DeviceError: the unit does not answer.
        """
        self._steps.clear()
        while len(self._steps) < len(Axis):
            self.poll()
        return dict(self._steps)

    def poll(self, checked: bool = True) -> Position | None:
        """Poll once; None without a usable reply.

        Args:
            checked: raise an error if the unit has lost synchrony or was disconnected.

        Raises:
            DeviceError: synchrony is lost, or the unit is silent or was disconnected.
        """
        command = self._command()
        exchange = self._client.exchange(command, is_poll=True)
        position = self._parse_position(command, exchange) if exchange.command == command else None
        if position is not None:
            self._unanswered_polls, self._last_answer_ns = 0, exchange.reply_ns
            self._on_position(position)
        else:
            self._unanswered_polls += 1
        if checked and not self._client.is_identified:
            raise self._client.unidentified_error()
        if checked and self._client.lost_synchrony is not None:
            raise DeviceError(
                f"the pan-tilt unit no longer knows its position: {self._client.lost_synchrony}",
                "remove all objects from the unit's range of motion, then start again with --home",
            )
        if self._is_silent(exchange.reply_ns):
            raise self._client.no_answer_error(command)
        return position

    def is_at(self, targets: Mapping[Axis, int]) -> bool:
        """Return whether the axes are at rest at their targets, according to two replies each."""
        for axis, target in targets.items():
            if self._steps.get(axis) != target or self._previous_steps.get(axis) != target:
                return False
        return self._is_still in (None, True)

    def _command(self) -> PtuCommand:
        if self._uses_motion:
            return QUERY_MOTION_AND_COUNTER
        axis = self._next_axis
        self._next_axis = Axis.TILT if axis is Axis.PAN else Axis.PAN
        return query_quantity(axis, Quantity.POSITION)

    def _parse_position(self, command: PtuCommand, exchange: Exchange) -> Position | None:
        if exchange.reply is None:
            return None
        value = read_value(command, exchange.reply)
        counter: int | None = None
        if isinstance(value, MotionReading):
            self._store_steps(Axis.PAN, value.pan_steps)
            self._store_steps(Axis.TILT, value.tilt_steps)
            self._is_still = value.pan_speed_steps_s == 0 and value.tilt_speed_steps_s == 0
            counter = value.counter
            answered_axes = {Axis.PAN, Axis.TILT}
        elif isinstance(value, int):
            axis = Axis(command.text[0])
            self._store_steps(axis, value)
            answered_axes = {axis}
        else:
            return None
        if len(self._steps) < len(Axis):
            return None  # the position of the other axis is not known yet
        earliest_ns, latest_ns = self._interval_ns(command, exchange)
        return Position(
            exchange=exchange,
            pan_steps=self._steps[Axis.PAN],
            tilt_steps=self._steps[Axis.TILT],
            has_pan=Axis.PAN in answered_axes,
            has_tilt=Axis.TILT in answered_axes,
            is_still=self._is_still,
            counter=counter,
            earliest_ns=earliest_ns,
            latest_ns=latest_ns,
            synchrony_lost=self._client.lost_synchrony is not None
            or not self._client.is_identified,
        )

    def _is_silent(self, now_ns: int) -> bool:
        if self._unanswered_polls >= MAX_UNANSWERED_POLLS:
            return True
        silence_s = (now_ns - self._last_answer_ns) * 1e-9 if self._last_answer_ns else 0.0
        return self._unanswered_polls >= 2 and silence_s > MAX_SILENCE_S

    def _store_steps(self, axis: Axis, steps: int) -> None:
        if axis in self._steps:
            self._previous_steps[axis] = self._steps[axis]
        self._steps[axis] = steps

    def _interval_ns(self, command: PtuCommand, exchange: Exchange) -> tuple[int, int]:
        """Return the interval in which the unit read its position."""
        wire_ns = self._client.wire_ns
        earliest_ns = exchange.request_ns + wire_ns(len(command.encode()))
        latest_ns = exchange.first_byte_ns - wire_ns(1)
        if latest_ns < earliest_ns:  # USB can be faster than the nominal baud rate
            return exchange.request_ns, exchange.first_byte_ns
        return earliest_ns, latest_ns
