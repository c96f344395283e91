"""Driver of any unit that answers each command with one reply, in lines of text or in frames.

What to use when: `text_driver` makes the entry of a driver from a `TextLanguage`. A unit needs a
separate driver only if one reply does not answer one command.
"""

import math
from collections.abc import Callable, Sequence

from gyrorig_daemon.config import PtuPort
from gyrorig_daemon.motion.pan_tilt_driver import (
    AXES_OF_ORDERS,
    AxisTarget,
    DriverEntry,
    DriverPort,
    Poll,
    no_answer_error,
    no_command_error,
    unidentified_error,
)
from gyrorig_daemon.motion.ptu_exchange import PtuLineCounts
from gyrorig_daemon.motion.text_language import TextLanguage
from gyrorig_daemon.motion.text_line import TextLine
from gyrorig_daemon.motion.unit_facts import (
    ARCSEC_PER_DEG,
    AxisFacts,
    Homing,
    UnitFacts,
    fixed_axis,
)
from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis, OrderKind
from gyrorig_protocol.program import PtuSettings
from gyrorig_protocol.ptu import Axis

ATTEMPTS = 3
HALT_ATTEMPTS = 4
HOME_TIMEOUT_S = 90.0
_AXES = {Axis.PAN: OrderAxis.PAN, Axis.TILT: OrderAxis.TILT}


class TextUnit:
    """Drives a unit through a `TextLine`; see `PanTiltDriver` for the attributes."""

    def __init__(self, port: DriverPort, language: TextLanguage) -> None:
        """Attach to the port; nothing is sent yet."""
        self.name = language.name
        self.axes = tuple(axis for axis in Axis if axis in language.axes)
        self.halt_bytes = language.halt_bytes
        self.lost_synchrony: str | None = None
        self._line = TextLine(port, language)
        self._language = language
        self._config = port.config
        self._identity: dict[str, str] = {}
        self._next_axis = 0

    @property
    def location(self) -> str:
        """See `PanTiltDriver`."""
        return self._line.location

    @property
    def counts(self) -> PtuLineCounts:
        """See `PanTiltDriver`."""
        return self._line.counts

    @property
    def is_port_gone(self) -> bool:
        """See `PanTiltDriver`."""
        return self._line.is_port_gone

    @property
    def is_identified(self) -> bool:
        """See `PanTiltDriver`."""
        return self._line.is_identified

    def identify(self) -> None:
        """See `PanTiltDriver`."""
        self._line.drain()
        received = ""
        for _ in range(ATTEMPTS):
            reply = self._line.exchange(self._language.identify).reply
            identity = None if reply is None else self._language.read_identity(reply.text)
            if identity is not None:
                self._identity = identity
                self._line.is_identified = True
                self.halt()
                return
            received = received or ("" if reply is None else reply.text)
        if received:
            raise DeviceError(
                f"the device on {self.location} is not a unit of the driver {self.name}, because "
                f"it answers {received[:40]!r}",
                "check the ports and ptu.driver in the rig file. The daemon did not move the "
                "device",
            )
        raise DeviceError(
            f"no pan-tilt unit answers on {self.location} at {self._config.baud} baud",
            "check the power of the unit, its cable, its port and its baud rate",
        )

    def set_up(self, settings: PtuSettings, homing: Homing) -> UnitFacts:
        """See `PanTiltDriver`. The unit accelerates from standstill, so it has no base speed."""
        if not self.is_identified:
            raise unidentified_error(self.location)
        self._check_serial()
        for command in filter(None, self._language.ready.split("|")):
            self._order(command, ())
        if homing is Homing.ALWAYS:
            self._home()
        axes = {axis: self._set_up_axis(axis, settings) for axis in self.axes}
        return UnitFacts(
            model=self._identity.get("model") or self.name,
            firmware=self._identity.get("firmware", ""),
            serial=self._identity.get("serial", ""),
            dialect="",
            counter_hz=None,
            pan=axes.get(Axis.PAN) or fixed_axis(),
            tilt=axes.get(Axis.TILT) or fixed_axis(),
            baud=self._config.baud,
            driver=self.name,
            poll_bytes=len(self._language.make_framing().encode(self._poll_text(self.axes[0]))),
            axes=self.axes,
        )

    def set_poll_rate(self, rate_hz: float) -> None:
        """See `PanTiltDriver`."""
        self._line.min_interval_s = 1.0 / rate_hz

    def start_move(self, targets: Sequence[AxisTarget]) -> None:
        """See `PanTiltDriver`; several axes start one after the other."""
        if not self.is_identified:
            raise unidentified_error(self.location)
        for part in targets:
            speed = self._with_value(self._language.speed, part.axis, part.speed_steps_s)
            self._order(speed, self._orders(OrderKind.SPEED, part.axis, part.speed_steps_s))
        for part in targets:
            target = self._with_value(self._language.target, part.axis, part.target_steps)
            self._order(target, self._orders(OrderKind.TARGET, part.axis, part.target_steps))

    def send_orders(self, orders: Sequence[AxisOrder]) -> None:
        """See `PanTiltDriver`."""
        if not self.is_identified:
            raise unidentified_error(self.location)
        words = {
            OrderKind.SPEED: self._language.speed,
            OrderKind.TARGET: self._language.target,
            OrderKind.ACCELERATION: self._language.acceleration,
        }
        for order in orders:
            axis = AXES_OF_ORDERS.get(order.axis)
            if order.kind is OrderKind.HALT:
                self.halt()
            elif axis is not None and words.get(order.kind):
                text = self._with_value(words[order.kind], axis, round(order.value))
                self._order(text, (order,))
            else:
                raise no_command_error(order, self.name)

    def poll(self) -> Poll:
        """See `PanTiltDriver`."""
        axis = self.axes[self._next_axis % len(self.axes)]
        self._next_axis += 1
        text = self._poll_text(axis)
        exchange = self._line.exchange(text, is_poll=True)
        steps: dict[Axis, int] = {}
        is_still: bool | None = None
        if exchange.reply is not None and exchange.command.text == text:
            steps, is_still = self._language.read_positions(exchange.reply.text, axis)
            if not steps:
                self._line.reject_reply()
        earliest_ns = exchange.request_ns + self._line.wire_ns(len(exchange.command.encode()))
        latest_ns = exchange.first_byte_ns - self._line.wire_ns(1)
        if latest_ns < earliest_ns:  # USB can be faster than the nominal baud rate
            earliest_ns, latest_ns = exchange.request_ns, exchange.first_byte_ns
        return Poll(text, exchange, steps, is_still, None, earliest_ns, latest_ns)

    def halt(self) -> None:
        """See `PanTiltDriver`."""
        self._line.halt_in_flight()
        halt = AxisOrder(OrderKind.HALT, OrderAxis.BOTH)
        for _ in range(HALT_ATTEMPTS):
            exchange = self._line.exchange(self._language.halt, (halt,))
            if exchange.accepted and exchange.command.text == self._language.halt:
                return
        raise no_answer_error(self.location, self._language.halt)

    def forget_losses(self) -> None:
        """See `PanTiltDriver`; the unit reports no losses."""

    def begin_session(self) -> None:
        """See `PanTiltDriver`."""

    def _order(
        self, text: str, orders: tuple[AxisOrder, ...], timeout_s: float | None = None
    ) -> None:
        """Send a command until it is acknowledged.

        Raises:
            DeviceError: the unit refuses it, or does not answer.
        """
        for _ in range(ATTEMPTS):
            exchange = self._line.exchange(text, orders, timeout_s=timeout_s)
            if exchange.reply is None or exchange.command.text != text:
                continue
            if exchange.accepted:
                return
            raise DeviceError(
                f"the pan-tilt unit refuses the command {text!r}: {exchange.reply.text[:60]}",
                "check the motion program and the limits of the unit",
            )
        raise no_answer_error(self.location, text)

    def _home(self) -> None:
        if not self._language.home:
            raise UsageError(
                f"the driver {self.name} cannot home its unit", "remove the option --home"
            )
        home = AxisOrder(OrderKind.HOME, OrderAxis.BOTH)
        self._order(self._language.home, (home,), HOME_TIMEOUT_S)

    def _check_serial(self) -> None:
        serial = self._identity.get("serial", "")
        if self._config.serial is not None and serial != self._config.serial:
            raise DeviceError(
                f"the pan-tilt unit on {self.location} has the serial number {serial!r} instead of "
                f"{self._config.serial!r}",
                "check the ports, or correct ptu.serial in the rig file. The daemon did not "
                "move the unit",
            )

    def _set_up_axis(self, axis: Axis, settings: PtuSettings) -> AxisFacts:
        language, step_deg = self._language, self._language.resolution_deg
        ordered: int | None = None
        if settings.acceleration_deg_s2 is not None and language.acceleration:
            ordered = round(settings.acceleration_deg_s2 / step_deg)
            text = self._with_value(language.acceleration, axis, ordered)
            self._order(text, self._orders(OrderKind.ACCELERATION, axis, ordered))

        def steps_of(words: str, rounded: Callable[[float], int] = round) -> int:
            return rounded(self._number(words, axis) / step_deg)

        fastest = steps_of(language.fastest)
        if settings.upper_speed_deg_s is not None:
            fastest = min(fastest, round(settings.upper_speed_deg_s / step_deg))
        return AxisFacts(
            resolution_arcsec=step_deg * ARCSEC_PER_DEG,
            min_steps=steps_of(language.lowest),
            max_steps=steps_of(language.highest),
            lower_speed=steps_of(language.slowest),
            upper_speed=fastest,
            base_speed=0,
            acceleration=ordered
            if ordered is not None and _is_number(language.rate_change)
            else steps_of(language.rate_change),
            sign=self._config.pan_sign if axis is Axis.PAN else self._config.tilt_sign,
        )

    def _number(self, words: str, axis: Axis) -> float:
        """Return what the language states, or the reply to its query, received twice; in deg."""
        if _is_number(words):
            return float(words)
        query = self._language.format(words, axis)
        previous: float | None = None
        for _ in range(2 * ATTEMPTS):
            reply = self._line.exchange(query).reply
            value = None if reply is None else self._language.read_value_deg(reply.text)
            if value is not None and value == previous:
                return value
            previous = value
        raise no_answer_error(self.location, query)

    def _with_value(self, command: str, axis: Axis, steps: int) -> str:
        return self._language.format(command, axis, steps * self._language.resolution_deg)

    def _poll_text(self, axis: Axis) -> str:
        return self._language.format(self._language.position, axis)

    def _orders(self, kind: OrderKind, axis: Axis, steps: int) -> tuple[AxisOrder, ...]:
        return (AxisOrder(kind, _AXES[axis], float(steps)),)


def _is_number(words: str) -> bool:
    try:
        return math.isfinite(float(words))
    except ValueError:
        return False


def text_driver(title: str, language: TextLanguage) -> DriverEntry:
    """Return the entry of a driver for a unit that answers each command with one reply."""

    def words(config: PtuPort) -> TextLanguage:
        return language.with_commands(config.commands)

    return DriverEntry(title, lambda port: TextUnit(port, words(port.config)), words)
