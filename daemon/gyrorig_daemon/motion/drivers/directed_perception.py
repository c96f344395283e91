"""Driver of units with Directed Perception commands: FLIR PTU-E46, D46, D48 and D48E.

The unit reads its position between the arrival of the last byte of a request and the first byte of
the reply. A controller of the E series answers BT with both axes and its counter. A controller of
the D series answers PP and TP, which are sent in turn. A D48E is an E-series controller with motor
encoders; it is driven like an E46.
"""

from collections.abc import Mapping, Sequence

from gyrorig_daemon.config import PtuPort
from gyrorig_daemon.motion.directed_perception.ptu_client import PtuClient
from gyrorig_daemon.motion.directed_perception.unit_setup import identify_unit, set_up_unit
from gyrorig_daemon.motion.pan_tilt_driver import (
    AXES_OF_ORDERS,
    AxisTarget,
    DriverEntry,
    DriverPort,
    Poll,
    no_command_error,
)
from gyrorig_daemon.motion.ptu_exchange import Exchange, PtuLineCounts
from gyrorig_daemon.motion.unit_facts import Homing, UnitFacts
from gyrorig_protocol.motion_orders import AxisOrder, OrderKind
from gyrorig_protocol.program import PtuSettings
from gyrorig_protocol.ptu import (
    Axis,
    FirmwareVersion,
    MotionReading,
    PtuCommand,
    Quantity,
    assign_quantity,
    dialect_features,
    query_quantity,
)
from gyrorig_protocol.ptu.dialect import Dialect
from gyrorig_protocol.ptu.ptu_commands import (
    AWAIT_COMPLETION,
    HALT_BOTH_AXES,
    IMMEDIATE_EXECUTION,
    QUERY_MOTION_AND_COUNTER,
    SLAVED_EXECUTION,
    AnswerKind,
    halt_axis,
)

NAME = "directed_perception"
_QUANTITIES = {
    OrderKind.TARGET: Quantity.POSITION,
    OrderKind.OFFSET: Quantity.OFFSET,
    OrderKind.SPEED: Quantity.SPEED,
    OrderKind.SPEED_CHANGE: Quantity.SPEED_CHANGE,
    OrderKind.BASE_SPEED: Quantity.BASE_SPEED,
    OrderKind.ACCELERATION: Quantity.ACCELERATION,
}
_PLAIN_COMMANDS = {
    OrderKind.COLLECT: SLAVED_EXECUTION,
    OrderKind.START: AWAIT_COMPLETION,
    OrderKind.IMMEDIATE: IMMEDIATE_EXECUTION,
}
# spaces end a truncated command
HALT_BYTES = b"   " + HALT_BOTH_AXES.encode()


class DirectedPerceptionUnit:
    """Drives a unit through a `PtuClient`."""

    name = NAME
    axes = (Axis.PAN, Axis.TILT)
    halt_bytes = HALT_BYTES

    def __init__(self, client: PtuClient, config: PtuPort) -> None:
        """Drive the unit behind `client`; nothing is sent yet."""
        self.client = client
        self._config = config
        self._version: FirmwareVersion | None = None
        self._uses_motion = False
        self._next_axis = Axis.PAN

    @property
    def location(self) -> str:
        """See `PanTiltDriver`."""
        return self.client.location

    @property
    def counts(self) -> PtuLineCounts:
        """See `PanTiltDriver`."""
        return self.client.counts

    @property
    def is_port_gone(self) -> bool:
        """See `PanTiltDriver`."""
        return self.client.is_port_gone

    @property
    def is_identified(self) -> bool:
        """See `PanTiltDriver`."""
        return self.client.is_identified

    @property
    def lost_synchrony(self) -> str | None:
        """See `PanTiltDriver`."""
        return self.client.lost_synchrony

    def identify(self) -> None:
        """See `PanTiltDriver`."""
        self._uses_motion = False  # another unit may be connected
        self._version = identify_unit(self.client)

    def set_up(self, settings: PtuSettings, homing: Homing) -> UnitFacts:
        """See `PanTiltDriver`."""
        if self._version is None:
            self.identify()
        if self._version is None:
            raise AssertionError("identified without a version")  # a bug of this program
        facts = set_up_unit(self.client, self._config, settings, self._version, homing)
        self._uses_motion = dialect_features(Dialect(facts.dialect)).motion_with_counter
        return facts

    def set_poll_rate(self, rate_hz: float) -> None:
        """See `PanTiltDriver`."""
        self.client.min_interval_s = 1.0 / rate_hz

    def start_move(self, targets: Sequence[AxisTarget]) -> None:
        """See `PanTiltDriver`; the unit starts several axes at the command I."""
        send = self.client.send_command
        for axis in targets:
            send(assign_quantity(axis.axis, Quantity.SPEED, axis.speed_steps_s))
        together = len(targets) > 1
        if together:
            send(SLAVED_EXECUTION)
        for axis in targets:
            send(assign_quantity(axis.axis, Quantity.POSITION, axis.target_steps))
        if together:
            send(IMMEDIATE_EXECUTION)

    def send_orders(self, orders: Sequence[AxisOrder]) -> None:
        """See `PanTiltDriver`."""
        self.client.send_command(_command_of(orders))

    def poll(self) -> Poll:
        """See `PanTiltDriver`."""
        command = self._poll_command()
        exchange = self.client.exchange(command, is_poll=True)
        steps: Mapping[Axis, int] = {}
        is_still: bool | None = None
        counter: int | None = None
        if exchange.command == command:
            value = exchange.reading
            if isinstance(value, MotionReading):
                steps = {Axis.PAN: value.pan_steps, Axis.TILT: value.tilt_steps}
                is_still = value.pan_speed_steps_s == 0 and value.tilt_speed_steps_s == 0
                counter = value.counter
            elif isinstance(value, int):
                steps = {Axis(command.text[0]): value}
        earliest_ns, latest_ns = self._interval_ns(command, exchange)
        return Poll(command.text, exchange, steps, is_still, counter, earliest_ns, latest_ns)

    def halt(self) -> None:
        """See `PanTiltDriver`."""
        self.client.halt()

    def forget_losses(self) -> None:
        """See `PanTiltDriver`."""
        self.client.lost_synchrony = None

    def begin_session(self) -> None:
        """See `PanTiltDriver`; the unit may have been switched on before the session."""
        self.forget_losses()
        self.client.expects_banner = True

    def _poll_command(self) -> PtuCommand:
        if self._uses_motion:
            return QUERY_MOTION_AND_COUNTER
        axis = self._next_axis
        self._next_axis = Axis.TILT if axis is Axis.PAN else Axis.PAN
        return query_quantity(axis, Quantity.POSITION)

    def _interval_ns(self, command: PtuCommand, exchange: Exchange) -> tuple[int, int]:
        """Return the interval in which the unit read its position."""
        wire_ns = self.client.wire_ns
        earliest_ns = exchange.request_ns + wire_ns(len(command.encode()))
        latest_ns = exchange.first_byte_ns - wire_ns(1)
        if latest_ns < earliest_ns:  # USB can be faster than the nominal baud rate
            return exchange.request_ns, exchange.first_byte_ns
        return earliest_ns, latest_ns


def _command_of(orders: Sequence[AxisOrder]) -> PtuCommand:
    """Return the command that means these orders.

    Raises:
        UsageError: there is none.
    """
    order = orders[0]
    if len(orders) == len(Axis):  # both axes with their speeds
        numbers = [round(part.value) for part in orders]
        numbers += [round(part.speed_steps_s) for part in orders]
        return PtuCommand("B" + ",".join(map(str, numbers)), AnswerKind.DONE)
    axis = AXES_OF_ORDERS.get(order.axis)
    if axis is not None and order.kind in _QUANTITIES:
        return assign_quantity(axis, _QUANTITIES[order.kind], round(order.value))
    if order.kind is OrderKind.HALT:
        return HALT_BOTH_AXES if axis is None else halt_axis(axis)
    if axis is None and order.kind in _PLAIN_COMMANDS:
        return _PLAIN_COMMANDS[order.kind]
    raise no_command_error(order, NAME)


def _make(port: DriverPort) -> DirectedPerceptionUnit:
    client = PtuClient(
        port.pump,
        port.port,
        location=port.location,
        baud=port.config.baud,
        on_exchange=port.on_exchange,
        timeout_s=port.config.poll.timeout_s,
    )
    return DirectedPerceptionUnit(client, port.config)


DRIVER = DriverEntry(
    "FLIR and Directed Perception PTU-E46, D46, D48, D48E", _make, halt_bytes=HALT_BYTES
)
