"""Replay of recorded orders: the same orders at the same times, instead of a program.

What to use when: `RecordedMotion` for what a recording has; `plan_replay` checks it against a unit
before anything moves; `ReplayExecutor` runs it with position polls between the orders.

Only an emulated unit executes a replay. The daemon cannot check beforehand what the path of a
target that changes on the way will be, and nobody watches a unit that follows old orders.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from gyrorig_daemon.config import CommandLimits
from gyrorig_daemon.links.pump import Pump
from gyrorig_daemon.motion.executor import PhaseSink
from gyrorig_daemon.motion.position_poller import PositionPoller
from gyrorig_daemon.motion.unit import Unit
from gyrorig_daemon.motion.unit_facts import AxisFacts, UnitFacts
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis, OrderKind
from gyrorig_protocol.ptu import Axis

_AXES = {OrderAxis.PAN: Axis.PAN, OrderAxis.TILT: Axis.TILT}
_SPEEDS = (OrderKind.SPEED, OrderKind.RATE)
_UNSUPPORTED = (OrderKind.RATE, OrderKind.RATE_CHANGE, OrderKind.HOME, OrderKind.RESOLUTION)
_POLL_GUARD = 2.2  # polls that must fit between the last poll and an order
_LONGEST_POLL_NS = 30_000_000
_ANGLE_TOLERANCE_RAD = 1e-9


@dataclass(frozen=True, slots=True)
class RecordedExchange:
    """The orders of one exchange. Values are in rad, rad/s, rad/s^2, in the rig's sense."""

    time_ns: int  # of the request, since the begin of the program
    orders: tuple[AxisOrder, ...]


@dataclass(frozen=True, slots=True)
class RecordedPhase:
    """The begin or the end of a phase within the program."""

    time_ns: int  # since the begin of the program
    begins: bool
    phase: str
    text: str


@dataclass(frozen=True, slots=True)
class RecordedMotion:
    """What a recording has of the motion of its unit."""

    name: str  # of the recording
    settings: tuple[AxisOrder, ...]  # base speeds and accelerations from before the program
    exchanges: tuple[RecordedExchange, ...]
    phases: tuple[RecordedPhase, ...]
    duration_ns: int  # of the program
    lead_ns: int  # from the first sample to the begin of the program


def plan_replay(motion: RecordedMotion, facts: UnitFacts, limits: CommandLimits) -> RecordedMotion:
    """Return a motion with its values in steps of a unit.

    Raises:
        UsageError: an order is outside the limits of angle or speed, or of a kind that no driver
            can send; the text has its time.
    """
    exchanges = []
    for exchange in motion.exchanges:
        place = f"the order at {exchange.time_ns * 1e-9:.3f} s of {motion.name}"
        orders = tuple(_in_steps(order, facts) for order in exchange.orders)
        for order, steps in zip(exchange.orders, orders, strict=True):
            _check_order(order, steps, facts, limits, place)
        exchanges.append(replace(exchange, orders=orders))
    settings = tuple(_in_steps(order, facts) for order in motion.settings)
    return replace(motion, settings=settings, exchanges=tuple(exchanges))


class ReplayExecutor:
    """Runs replays on one unit."""

    def __init__(self, pump: Pump, unit: Unit, poller: PositionPoller, phases: PhaseSink) -> None:
        self._pump = pump
        self._driver = unit.driver
        self._poller = poller
        self._phases = phases
        self._poll_ns = _LONGEST_POLL_NS // 2

    @staticmethod
    def wait(pump: Pump, motion: RecordedMotion | None, begin_ns: int | None) -> None:
        """Wait until a recording must begin that has as much time before its program.

        Args:
            pump: of the session.
            motion: what will be replayed; None: do not wait.
            begin_ns: see `run`.
        """
        if motion is not None and begin_ns is not None:
            pump.run_until(begin_ns - motion.lead_ns)

    def run(self, motion: RecordedMotion, begin_ns: int | None = None) -> None:
        """Send the orders of `plan_replay` at their times.

        Args:
            motion: in steps of the unit.
            begin_ns: begin of the program, by the clock of the pump; None, or a time that has
                passed: now.

        Raises:
            DeviceError: the unit refused an order, or lost synchrony.
            StopRequestedError: the process was asked to stop. The unit may be moving.
        """
        for order in motion.settings:
            self._driver.send_orders((order,))
        if begin_ns is not None:
            self._poll_until(begin_ns)
        start_ns = max(begin_ns or 0, self._pump.now_ns())
        self._phases.begin("program", "")
        for item in _by_time(motion.phases, motion.exchanges):
            self._poll_until(start_ns + item.time_ns)
            if isinstance(item, RecordedExchange):
                self._driver.send_orders(item.orders)
            elif item.begins:
                self._phases.begin(item.phase, item.text)
            else:
                self._phases.end(item.phase, item.text)
        self._poll_until(start_ns + motion.duration_ns)
        self._phases.end("program", "")

    def _poll_until(self, due_ns: int) -> None:
        """Poll as long as a poll cannot delay what is due then; then wait."""
        while (begin_ns := self._pump.now_ns()) + _POLL_GUARD * self._poll_ns < due_ns:
            self._poller.poll()
            taken_ns = self._pump.now_ns() - begin_ns
            # A stall of the host lengthens one poll, not the next ones.
            self._poll_ns = min(max(taken_ns, round(0.9 * self._poll_ns)), _LONGEST_POLL_NS)
        if self._pump.now_ns() < due_ns:
            self._pump.run_until(due_ns)


def _by_time(
    phases: Sequence[RecordedPhase], exchanges: Sequence[RecordedExchange]
) -> list[RecordedPhase | RecordedExchange]:
    return sorted([*phases, *exchanges], key=lambda item: item.time_ns)


def _in_steps(order: AxisOrder, facts: UnitFacts) -> AxisOrder:
    """Return an order with its value in whole steps."""
    axis = _AXES.get(order.axis)
    if axis is None:
        return order
    steps_per_rad = facts.axis(axis).steps_per_deg * 180.0 / math.pi
    if order.kind in (OrderKind.SPEED, OrderKind.BASE_SPEED, OrderKind.ACCELERATION):
        steps_per_rad = abs(steps_per_rad)
    return replace(
        order,
        value=float(round(order.value * steps_per_rad)),
        speed_steps_s=order.speed_steps_s
        if math.isnan(order.speed_steps_s)
        else float(round(order.speed_steps_s * abs(steps_per_rad))),
    )


def _check_order(
    order: AxisOrder, steps: AxisOrder, facts: UnitFacts, limits: CommandLimits, place: str
) -> None:
    if order.kind in _UNSUPPORTED:
        raise UsageError(
            f"{place} is of the kind {order.kind.name.lower()}, which cannot be replayed",
            "replay a recording whose unit only got targets, speeds and halts",
        )
    axis = _AXES.get(order.axis)
    if axis is None:
        return
    axis_facts = facts.axis(axis)
    if order.kind is OrderKind.TARGET:
        low_rad, high_rad = _angle_limits_rad(axis, axis_facts, limits)
        is_inside = axis_facts.min_steps <= steps.value <= axis_facts.max_steps
        if not is_inside or not low_rad <= order.value <= high_rad:
            low_deg, high_deg = math.degrees(low_rad), math.degrees(high_rad)
            raise UsageError(
                f"{place} turns the {axis.label} axis to {math.degrees(order.value):g} deg, but "
                f"its limits are {low_deg:.2f} and {high_deg:.2f} deg",
                "replay the recording with a rig that has the same limits",
            )
    fastest = float(axis_facts.upper_speed)
    if limits.speed_deg_s is not None:
        fastest = min(fastest, float(axis_facts.to_speed(limits.speed_deg_s)))
    speed = steps.value if order.kind in _SPEEDS else steps.speed_steps_s
    if speed > fastest:
        per_deg = abs(axis_facts.steps_per_deg)
        raise UsageError(
            f"{place} turns the {axis.label} axis at {speed / per_deg:g} deg/s, but its limit is "
            f"{fastest / per_deg:.2f} deg/s",
            "replay the recording with a rig that has the same limits",
        )


def _angle_limits_rad(axis: Axis, facts: AxisFacts, limits: CommandLimits) -> tuple[float, float]:
    ends_deg = sorted(steps / facts.steps_per_deg for steps in (facts.min_steps, facts.max_steps))
    stated: Mapping[Axis, tuple[float | None, float | None]] = {
        Axis.PAN: (limits.pan_min_deg, limits.pan_max_deg),
        Axis.TILT: (limits.tilt_min_deg, limits.tilt_max_deg),
    }
    low_deg, high_deg = stated[axis]
    low_deg = max(ends_deg[0], -math.inf if low_deg is None else low_deg)
    high_deg = min(ends_deg[1], math.inf if high_deg is None else high_deg)
    return (
        math.radians(low_deg) - _ANGLE_TOLERANCE_RAD,
        math.radians(high_deg) + _ANGLE_TOLERANCE_RAD,
    )
