"""Asks where the axes are: BT where the dialect has it, else PP and TP in turn.

An answer was taken somewhere between the arrival of the command's last byte and the
first byte of the answer. Which moment in between, the recorder decides.
"""

from collections.abc import Callable, Mapping

from gyrorig_daemon.motion.exchange import Exchange, Position
from gyrorig_daemon.motion.ptu_client import PtuClient
from gyrorig_daemon.motion.unit import Unit
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import Axis, Motion, PtuCommand, Quantity, offers, query, read
from gyrorig_protocol.ptu.commands import QUERY_MOTION_AND_COUNTER

SILENT_POLLS = 5  # so many in a row without an answer mean that the unit is gone,
SILENT_S = 4.0  # or so long, with two at least


class Poller:
    """The unit's position, asked for at its own limit of rate or slower."""

    def __init__(
        self, unit: Unit, rate_hz: float | None, on_position: Callable[[Position], None]
    ) -> None:
        """Poll `unit`; each answer goes to `on_position`.

        Args:
            unit: an identified unit.
            rate_hz: commands a second; None for the vendor's limit of the dialect.
            on_position: called with every answered poll.
        """
        self._client: PtuClient = unit.client
        self._uses_motion = offers(unit.facts.dialect).motion_with_counter
        self._on_position = on_position
        if rate_hz is not None:
            self._client.min_interval_s = 1.0 / rate_hz
        self._next_axis = Axis.PAN
        self._steps: dict[Axis, int] = {}
        self._before: dict[Axis, int] = {}
        self._still: bool | None = None
        self._silent = 0
        self._answered_ns = 0

    def where(self) -> dict[Axis, int]:
        """Ask for both axes and return their steps.

        Raises:
            DeviceError: the unit does not answer.
        """
        self._steps.clear()
        while len(self._steps) < len(Axis):
            self.poll()
        return dict(self._steps)

    def poll(self, checked: bool = True) -> Position | None:
        """Ask once; None where no usable answer came.

        Args:
            checked: raise when the unit has lost synchrony, or was away.

        Raises:
            DeviceError: synchrony is lost, or the unit is silent or was away.
        """
        command = self._command()
        exchange = self._client.exchange(command, is_poll=True)
        position = self._read(command, exchange) if exchange.command == command else None
        if position is not None:
            self._silent, self._answered_ns = 0, exchange.reply_ns
            self._on_position(position)
        else:
            self._silent += 1
        if checked and not self._client.identified:
            raise self._client.unknown()
        if checked and self._client.lost_synchrony is not None:
            raise DeviceError(
                f"the unit no longer knows where it stands: {self._client.lost_synchrony}",
                "clear the rig, then start again with --home",
            )
        if self._is_silent(exchange.reply_ns):
            raise self._client.silence(command)
        return position

    def is_at(self, targets: Mapping[Axis, int]) -> bool:
        """Return whether the axes stand at their targets, still by two answers each."""
        for axis, target in targets.items():
            if self._steps.get(axis) != target or self._before.get(axis) != target:
                return False
        return self._still in (None, True)

    def _command(self) -> PtuCommand:
        if self._uses_motion:
            return QUERY_MOTION_AND_COUNTER
        axis = self._next_axis
        self._next_axis = Axis.TILT if axis is Axis.PAN else Axis.PAN
        return query(axis, Quantity.POSITION)

    def _read(self, command: PtuCommand, exchange: Exchange) -> Position | None:
        if exchange.reply is None:
            return None
        value = read(command, exchange.reply)
        counter: int | None = None
        if isinstance(value, Motion):
            self._see(Axis.PAN, value.pan_steps)
            self._see(Axis.TILT, value.tilt_steps)
            self._still = value.pan_speed_steps_s == 0 and value.tilt_speed_steps_s == 0
            counter = value.counter
            answered = {Axis.PAN, Axis.TILT}
        elif isinstance(value, int):
            axis = Axis(command.text[0])
            self._see(axis, value)
            answered = {axis}
        else:
            return None
        if len(self._steps) < len(Axis):
            return None  # the first of two single answers: the other axis is not known yet
        earliest_ns, latest_ns = self._interval_ns(command, exchange)
        return Position(
            exchange=exchange,
            pan_steps=self._steps[Axis.PAN],
            tilt_steps=self._steps[Axis.TILT],
            has_pan=Axis.PAN in answered,
            has_tilt=Axis.TILT in answered,
            still=self._still,
            counter=counter,
            earliest_ns=earliest_ns,
            latest_ns=latest_ns,
            synchrony_lost=self._client.lost_synchrony is not None or not self._client.identified,
        )

    def _is_silent(self, now_ns: int) -> bool:
        if self._silent >= SILENT_POLLS:
            return True
        lasts_s = (now_ns - self._answered_ns) * 1e-9 if self._answered_ns else 0.0
        return self._silent >= 2 and lasts_s > SILENT_S

    def _see(self, axis: Axis, steps: int) -> None:
        if axis in self._steps:
            self._before[axis] = self._steps[axis]
        self._steps[axis] = steps

    def _interval_ns(self, command: PtuCommand, exchange: Exchange) -> tuple[int, int]:
        """Return between when and when the unit looked at its counts."""
        wire_ns = self._client.wire_ns
        earliest_ns = exchange.request_ns + wire_ns(len(command.encode()))
        latest_ns = exchange.first_byte_ns - wire_ns(1)
        if latest_ns < earliest_ns:  # USB hands over faster than the nominal rate
            return exchange.request_ns, exchange.first_byte_ns
        return earliest_ns, latest_ns
