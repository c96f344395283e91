"""Carries out a planned program: moves, rests, and positions asked for all the while.

The unit's answer is the count it was told to go to, not the axis: a move is over when
the count is at its target and the unit is still. It must come there: a count that stops
elsewhere, or takes too long, ends the program with the unit halted.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from gyrorig_daemon.links.pump import Pump
from gyrorig_daemon.motion.exchange import Position
from gyrorig_daemon.motion.path_watch import PathWatch
from gyrorig_daemon.motion.plan import PlannedMove, PlannedRest, PlannedStep
from gyrorig_daemon.motion.poller import Poller
from gyrorig_daemon.motion.unit import Unit
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import Axis, Quantity, assign
from gyrorig_protocol.ptu.commands import HALT, IMMEDIATE, SLAVED

PATIENCE_FACTOR = 1.5
PATIENCE_S = 5.0
STALL_S = 3.0  # a count that does not change for so long, away from its target
STILL_FOR_S = 0.3
HALT_PATIENCE_S = 10.0  # 149 deg/s at 103 deg/s^2 stops in 1.5 s


@dataclass(frozen=True, slots=True)
class PhaseSink:
    """Where the executor tells what phase begins and ends."""

    begin: Callable[[str, str], None]
    end: Callable[[str, str], None]


class Executor:
    """One unit, one program at a time."""

    def __init__(self, pump: Pump, unit: Unit, poller: Poller, phases: PhaseSink) -> None:
        self._pump = pump
        self._client = unit.client
        self._poller = poller
        self._phases = phases
        self._watch = PathWatch(unit.client)
        self._at: dict[Axis, int] = {}  # where orders have brought each axis, once it was there

    def run(self, steps: Sequence[PlannedStep], progress: Callable[[int], None]) -> None:
        """Carry out the steps in order; `progress` is told how many are done.

        Raises:
            DeviceError: the unit refused, did not arrive, is where it cannot be, or lost
                synchrony.
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
        client = self._client
        targets = {part.axis: part.target_steps for part in step.axes}
        self._watch.expect(self._at, targets)
        for part in step.axes:
            client.order(assign(part.axis, Quantity.SPEED, part.speed_steps_s))
        together = len(step.axes) > 1
        if together:
            client.order(SLAVED)  # targets wait until the unit is set to immediate again
        for part in step.axes:
            client.order(assign(part.axis, Quantity.POSITION, part.target_steps))
        if together:
            client.order(IMMEDIATE)
        self._arrive(step, targets)
        self._at |= targets
        self._watch.expect(self._at, {})

    def _arrive(self, step: PlannedMove, targets: Mapping[Axis, int]) -> None:
        longest_s = max(part.duration_s for part in step.axes)
        begun_ns = self._pump.now_ns()
        deadline_ns = begun_ns + int((PATIENCE_FACTOR * longest_s + PATIENCE_S) * 1e9)
        last: tuple[int, int] | None = None
        changed_ns = begun_ns
        while True:
            position = self._poller.poll()
            now_ns = self._pump.now_ns()
            if position is not None and self._watch.look(position):
                here = (position.pan_steps, position.tilt_steps)
                if here != last:
                    last, changed_ns = here, now_ns
                if self._poller.is_at(targets):
                    return
            # a unit that does not answer is the poller's to complain of
            stalled = position is not None and now_ns - changed_ns > STALL_S * 1e9
            if stalled or now_ns > deadline_ns:
                raise DeviceError(
                    f"the unit stands at {last} instead of "
                    f"{', '.join(f'{axis.word} {at}' for axis, at in targets.items())} steps",
                    "clear what is in its way, check its power, then start again with --home",
                )

    def _poll_for(self, seconds: float) -> None:
        end_ns = self._pump.now_ns() + int(seconds * 1e9)
        while self._pump.now_ns() < end_ns:
            position = self._poller.poll()
            if position is not None:
                self._watch.look(position)


def halt_and_confirm(pump: Pump, unit: Unit, poller: Poller) -> None:
    """Halt both axes and watch until the counts stand still.

    Raises:
        DeviceError: the unit does not acknowledge, or goes on moving.
    """
    client = unit.client
    client.halt()
    end_ns = pump.now_ns() + int(HALT_PATIENCE_S * 1e9)
    still_since_ns: int | None = None
    last: tuple[int, int] | None = None
    seen: Position | None
    while pump.now_ns() < end_ns:
        seen = poller.poll(checked=False)
        if seen is None:
            continue
        here = (seen.pan_steps, seen.tilt_steps)
        if here != last or still_since_ns is None:
            last, still_since_ns = here, seen.exchange.request_ns
        elif seen.exchange.reply_ns - still_since_ns >= STILL_FOR_S * 1e9 and seen.still in (
            None,
            True,
        ):
            return
    client.order(HALT)
    raise DeviceError("the unit was told to halt and still moves", "switch it off")
