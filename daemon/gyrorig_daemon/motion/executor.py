"""Run a planned program: moves and static intervals, with position polls all the time.

The unit replies with its commanded step count, not with the angle of the axis. A move is over
when the count is at its target and the unit is at standstill. If the count stops elsewhere, or
takes too long, the program ends with an error and the unit is halted.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from gyrorig_daemon.links.pump import Pump
from gyrorig_daemon.motion.motion_plan import PlannedMove, PlannedRest, PlannedStep
from gyrorig_daemon.motion.pan_tilt_driver import AxisTarget, PanTiltDriver
from gyrorig_daemon.motion.position_poller import PositionPoller
from gyrorig_daemon.motion.ptu_exchange import Position
from gyrorig_daemon.motion.unit import Unit
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import Axis

TIMEOUT_FACTOR = 1.5
TIMEOUT_MARGIN_S = 5.0
STALL_S = 3.0  # a count that does not change for this time, away from its target
STANDSTILL_S = 0.3
MIN_STILL_ANSWERS = 3  # they contain both axes of a unit that answers one axis per poll
HALT_TIMEOUT_S = 10.0  # from 149 deg/s at 103 deg/s^2 a unit stops in 1.5 s
MARGIN_STEPS = 16  # 0.8 deg at 185 arcsec per step; counts do not overshoot
MAX_IMPLAUSIBLE = 3
Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class PhaseSink:
    """Is called when a phase of the program begins and ends."""

    begin: Callable[[str, str], None]
    end: Callable[[str, str], None]


class Executor:
    """Runs programs on one unit, one at a time."""

    def __init__(self, pump: Pump, unit: Unit, poller: PositionPoller, phases: PhaseSink) -> None:
        self._pump = pump
        self._driver = unit.driver
        self._poller = poller
        self._phases = phases
        self._path_monitor = PathMonitor(unit.driver)
        self._positions_steps: dict[Axis, int] = {}  # last target that each axis has reached

    def run(self, steps: Sequence[PlannedStep], progress: Callable[[int], None]) -> None:
        """Run the steps in order; `progress` gets the number of finished steps.

        Raises:
            DeviceError: the unit refused a command, did not arrive, is at an implausible position,
                or lost synchrony.
            StopRequestedError: the process was asked to stop. The unit may be moving.
        """
        self._phases.begin("program", "")
        for number, step in enumerate(steps, start=1):
            if isinstance(step, PlannedRest):
                self._phases.begin(step.phase, "")
                self._poll_for(step.seconds)
                self._phases.end(step.phase, "")
            else:
                self._phases.begin(step.phase, step.text)
                self._move(step)
                self._poll_for(step.settle_s)
                self._phases.end(step.phase, "")
            progress(number)
        self._phases.end("program", "")

    def _move(self, step: PlannedMove) -> None:
        targets = {part.axis: part.target_steps for part in step.axes}
        self._path_monitor.expect(self._positions_steps, targets)
        self._driver.start_move(
            [AxisTarget(part.axis, part.target_steps, part.speed_steps_s) for part in step.axes]
        )
        self._wait_for_arrival(step, targets)
        self._positions_steps |= targets
        self._path_monitor.expect(self._positions_steps, {})

    def _wait_for_arrival(self, step: PlannedMove, targets: Mapping[Axis, int]) -> None:
        longest_s = max((part.duration_s for part in step.axes), default=0.0)
        start_ns = self._pump.now_ns()
        deadline_ns = start_ns + int((TIMEOUT_FACTOR * longest_s + TIMEOUT_MARGIN_S) * 1e9)
        last_steps: tuple[int, int] | None = None
        changed_ns = start_ns
        while True:
            position = self._poller.poll()
            now_ns = self._pump.now_ns()
            if position is not None and self._path_monitor.check(position):
                steps = (position.pan_steps, position.tilt_steps)
                if steps != last_steps:
                    last_steps, changed_ns = steps, now_ns
                if self._poller.is_at(targets):
                    return
            # the poller reports a unit that does not answer
            stalled = position is not None and now_ns - changed_ns > STALL_S * 1e9
            if stalled or now_ns > deadline_ns:
                raise DeviceError(
                    f"the pan-tilt unit stopped at the position {last_steps} instead of "
                    f"{', '.join(f'{axis.label} {at}' for axis, at in targets.items())} steps",
                    "remove obstacles and check the power of the unit, then start again "
                    "with --home",
                )

    def _poll_for(self, seconds: float) -> None:
        end_ns = self._pump.now_ns() + int(seconds * 1e9)
        while self._pump.now_ns() < end_ns:
            position = self._poller.poll()
            if position is not None:
                self._path_monitor.check(position)


class PathMonitor:
    """Checks reported positions against the commands of one step of a program.

    Replies have no checksum, and a line can lose a digit: a single implausible reply is only
    counted. Several of one axis in a row are not an accident: somebody else moves the unit, its
    count has jumped, or another device answers.
    """

    def __init__(self, driver: PanTiltDriver) -> None:
        """Check nothing yet; implausible replies are counted in `driver`."""
        self._driver = driver
        self._allowed_steps: dict[Axis, Span] = {}
        self._implausible_counts = dict.fromkeys(Axis, 0)  # in a row, of each axis

    def expect(self, start: Mapping[Axis, int], targets: Mapping[Axis, int]) -> None:
        """Expect each axis of `start` between there and its target, or at rest.

        An axis that has not reached a target yet can be anywhere: one reply alone is not certain.
        """
        self._implausible_counts = dict.fromkeys(Axis, 0)
        self._allowed_steps = {
            axis: (
                min(start_steps, targets.get(axis, start_steps)),
                max(start_steps, targets.get(axis, start_steps)),
            )
            for axis, start_steps in start.items()
        }

    def check(self, position: Position) -> bool:
        """Return whether the commands can explain the position.

        Raises:
            DeviceError: several consecutive positions of one axis are implausible.
        """
        for axis, steps in _answered_steps(position).items():
            low, high = self._allowed_steps.get(axis, (steps, steps))
            if low - MARGIN_STEPS <= steps <= high + MARGIN_STEPS:
                self._implausible_counts[axis] = 0
                continue
            self._implausible_counts[axis] += 1
            self._driver.counts.implausible += 1
            if self._implausible_counts[axis] >= MAX_IMPLAUSIBLE:
                raise DeviceError(
                    f"the pan-tilt unit reports the {axis.label} position {steps} steps, but "
                    f"its commands allow only {low} to {high} steps",
                    "stop the unit. Check whether another program moves it, and whether the "
                    "serial line is faulty",
                )
            return False
        return True


def _answered_steps(position: Position) -> dict[Axis, int]:
    """Return the positions of the axes that answered this poll."""
    answered = {}
    if position.has_pan:
        answered[Axis.PAN] = position.pan_steps
    if position.has_tilt:
        answered[Axis.TILT] = position.tilt_steps
    return answered


def halt_and_confirm(pump: Pump, unit: Unit, poller: PositionPoller) -> None:
    """Halt both axes and poll until the positions no longer change.

    Some units answer one axis per poll, in turn. Each axis must therefore give the same position
    twice, and three answers contain both axes.

    Raises:
        DeviceError: the unit does not acknowledge, or keeps moving.
    """
    unit.driver.halt()
    end_ns = pump.now_ns() + int(HALT_TIMEOUT_S * 1e9)
    since: dict[Axis, tuple[int, int]] = {}  # last position of each axis, and its first request
    still: set[Axis] = set()
    answers = 0
    while pump.now_ns() < end_ns:
        position = poller.poll(checked=False)
        if position is None:
            continue
        answers += 1
        for axis, steps in _answered_steps(position).items():
            last_steps, request_ns = since.get(axis, (None, 0))
            if steps != last_steps:
                since[axis] = (steps, position.exchange.request_ns)
                still.discard(axis)
            elif position.exchange.reply_ns - request_ns >= STANDSTILL_S * 1e9:
                still.add(axis)
        is_still = still == since.keys() and position.is_still in (None, True)
        if answers >= MIN_STILL_ANSWERS and is_still:
            return
    unit.driver.halt()
    raise DeviceError(
        "the pan-tilt unit acknowledged the halt command, but it still moves",
        "switch off the power of the unit",
    )
