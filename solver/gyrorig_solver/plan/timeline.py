"""A program as the daemon will carry it out: orders, polls, and where the axes are.

The daemon gives one order or asks one question at a time; a move is over when two answers
in a row have each of its axes at its target, standing. All in s from the program's begin.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import Home, MotionProgram, Move, Rest, unrolled
from gyrorig_protocol.ptu import Axis, Quantity, assign
from gyrorig_protocol.ptu.commands import IMMEDIATE, SLAVED
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.plan.unit import ARCSEC_PER_DEG, AxisModel, UnitModel
from gyrorig_solver.reference.course import Course, Instruction, Limits, lay
from gyrorig_solver.reference.moves import AXES, Exchange
from gyrorig_solver.reference.polls import Polls

HALT_S = 0.3  # after the program the daemon halts the unit and watches it stand
LONGEST_S = 3600.0  # what a prediction needs grows with the cube of the moves
ARRIVED = 2  # answers at the target
JITTER_S = 2.5e-4  # of a serial line; without it polls and steps could beat
GOLDEN = 0.6180339887498949


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """What a recording of the program would hold, the boards apart."""

    exchanges: tuple[Exchange, ...]
    courses: tuple[tuple[Course, ...], tuple[Course, ...]]  # pan, tilt, in steps
    start_steps: tuple[int, int]
    end_steps: tuple[int, int]
    settings: dict[str, float]  # as a recording's metadata has them
    poll_s: FloatArray  # when a position was asked for
    program_s: float

    @property
    def duration_s(self) -> float:
        """From the first order to the end of the recording."""
        return self.program_s + HALT_S

    def steps(self, time_s: FloatArray) -> FloatArray:
        """Return pan and tilt at times, shape (n, 2)."""
        out = np.empty((time_s.size, 2))
        for axis in (0, 1):
            out[:, axis] = self.start_steps[axis]
            for course in self.courses[axis]:
                first, last = np.searchsorted(time_s, [course.start_s[0], course.end_s])
                out[first:last, axis] = course.position_steps(time_s[first:last])
                out[last:, axis] = course.steps[-1]
        return out

    def polls(self, unit: UnitModel) -> Polls:
        """Return the counts that would be answered."""
        count = self.poll_s.size
        shaken = (np.arange(count) * GOLDEN) % 1.0 - 0.5
        at_s = self.poll_s + unit.window_s / 2.0 + JITTER_S * shaken
        valid = np.ones((count, 2), dtype=np.bool_)
        if not unit.both_at_once:
            valid[0::2, 1] = valid[1::2, 0] = False
        counts = np.rint(self.steps(at_s))
        if unit.both_at_once:
            # The controller's counter leaves one constant of the window, see `counter`.
            return Polls(at_s, at_s, counts, valid, unit.window_s)
        half_s = unit.window_s / 2.0
        return Polls(at_s - half_s, at_s + half_s, counts, valid)


def lay_out(
    program: MotionProgram, unit: UnitModel, start_steps: tuple[int, int] = (0, 0)
) -> Timeline:
    """Return a program as the daemon will carry it out.

    Args:
        program: what shall be done.
        unit: what can do it.
        start_steps: where pan and tilt stand.

    Raises:
        UsageError: a step leaves the unit's limits or speeds; its number is in the text.
    """
    run = _Run(program, unit, start_steps)
    for number, step in enumerate(unrolled(program.steps, program.name), start=1):
        if isinstance(step, Rest):
            run.rest(step.seconds)
        else:
            run.move(step, f"step {number} of {program.name}")
    return run.timeline()


@dataclass(slots=True)
class _Run:
    """The daemon under way."""

    program: MotionProgram
    unit: UnitModel
    start_steps: tuple[int, int]
    now_s: float = 0.0
    exchanges: list[Exchange] = field(default_factory=list)
    courses: tuple[list[Course], list[Course]] = field(default_factory=lambda: ([], []))
    blocks: list[tuple[float, int]] = field(default_factory=list)
    polled: int = 0
    at: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.at = list(self.start_steps)

    def rest(self, seconds: float) -> None:
        """Ask for the position until so much time has gone."""
        interval_s = self.unit.poll_interval_s
        self._poll(int(np.ceil(max(0.0, seconds) / interval_s - 1e-9)))

    def move(self, step: Move | Home, where: str) -> None:
        """Give the orders of a move and ask until it is done."""
        parts = list(self._parts(step, where))
        for axis, _, speed in parts:
            self._order(assign(_AXIS[axis], Quantity.SPEED, speed).text)
        if len(parts) > 1:
            self._order(SLAVED.text)
        begun_s = []
        for axis, target, _ in parts:
            begun_s.append(self._order(assign(_AXIS[axis], Quantity.POSITION, target).text))
        if len(parts) > 1:
            begun_s = [self._order(IMMEDIATE.text)] * len(parts)
        end_s = self.now_s
        for (axis, target, speed), told_s in zip(parts, begun_s, strict=True):
            course = self._course(axis, target, speed, told_s + self.unit.window_s / 2.0)
            if course is not None:
                self.courses[axis].append(course)
                end_s = max(end_s, course.end_s)
            self.at[axis] = target
        self._arrive(end_s, [axis for axis, _, _ in parts])
        if isinstance(step, Move):
            self.rest(step.settle_s)

    def timeline(self) -> Timeline:
        """Return what came of it."""
        program_s = self.now_s
        self.rest(HALT_S)
        interval_s = self.unit.poll_interval_s
        asked = [first + interval_s * np.arange(count) for first, count in self.blocks]
        settings = {}
        for k, name in enumerate(AXES):
            base, acceleration = self._law(k)
            settings[f"{name}_base_speed"], settings[f"{name}_acceleration"] = base, acceleration
        return Timeline(
            tuple(self.exchanges),
            (tuple(self.courses[0]), tuple(self.courses[1])),
            self.start_steps,
            (self.at[0], self.at[1]),
            settings,
            np.concatenate(asked),
            program_s,
        )

    def _law(self, axis: int) -> tuple[float, float]:
        """Return base speed and acceleration of an axis, in steps."""
        told, model = self.program.settings, self.unit.axes[axis]
        base = self.unit.base_speed_steps_s
        acceleration = self.unit.acceleration_steps_s2
        if told.base_speed_deg_s is not None:
            base = float(model.steps(told.base_speed_deg_s))
        if told.acceleration_deg_s2 is not None:
            acceleration = float(model.steps(told.acceleration_deg_s2))
        return base, acceleration

    def _course(self, axis: int, target: int, speed: int, start_s: float) -> Course | None:
        if target == self.at[axis]:
            return None
        base, acceleration = self._law(axis)
        limits = Limits(float(speed), acceleration, base)
        return lay(float(self.at[axis]), [Instruction(start_s, "to", float(target), limits)])

    def _order(self, text: str) -> float:
        told_s = self.now_s
        self.exchanges.append(Exchange(told_s, told_s + self.unit.window_s, True, text))
        self.now_s += self.unit.order_interval_s
        return told_s

    def _poll(self, count: int) -> None:
        if self.now_s + count * self.unit.poll_interval_s > LONGEST_S:
            raise UsageError(
                f"{self.program.name} lasts longer than {LONGEST_S:g} s", "predict a part of it"
            )
        if count > 0:
            self.blocks.append((self.now_s, count))
            self.now_s += count * self.unit.poll_interval_s
            self.polled += count

    def _arrive(self, end_s: float, axes: list[int]) -> None:
        interval_s = self.unit.poll_interval_s
        self._poll(int(np.ceil(max(0.0, end_s - self.now_s) / interval_s)))
        wanted = ARRIVED
        if not self.unit.both_at_once:
            # Pan and tilt are asked in turn, pan first.
            wanted = 2 * ARRIVED
            if len(axes) == 1 and self.polled % 2 == axes[0]:
                wanted -= 1
        self._poll(wanted)

    def _parts(self, step: Move | Home, where: str) -> Iterator[tuple[int, int, int]]:
        """Yield axis, target and speed in steps of each axis that a step names."""
        default = self.program.settings.default_speed_deg_s
        if isinstance(step, Home):
            step = Move(pan_deg=0.0, tilt_deg=0.0, speed_deg_s=step.speed_deg_s or default)
        both = step.speed_deg_s or default
        told = (
            (step.pan_deg, step.pan_speed_deg_s or both),
            (step.tilt_deg, step.tilt_speed_deg_s or both),
        )
        for axis, (angle_deg, speed_deg_s) in enumerate(told):
            if angle_deg is not None:
                model = self.unit.axes[axis]
                fastest = self.program.settings.upper_speed_deg_s or model.fastest_deg_s
                _check(model, fastest, AXES[axis], angle_deg, speed_deg_s, where)
                yield axis, model.steps(angle_deg), model.steps(speed_deg_s)


_AXIS = (Axis.PAN, Axis.TILT)


def _check(
    model: AxisModel, fastest_deg_s: float, word: str, angle_deg: float, speed: float, where: str
) -> None:
    half_step_deg = model.resolution_arcsec / ARCSEC_PER_DEG / 2.0
    if not model.low_deg - half_step_deg <= angle_deg <= model.high_deg + half_step_deg:
        raise UsageError(
            f"{where} turns {word} to {angle_deg:g} deg, the limits are "
            f"{model.low_deg:.2f} to {model.high_deg:.2f} deg",
            "change the program",
        )
    if not model.slowest_deg_s - half_step_deg <= speed <= fastest_deg_s + half_step_deg:
        raise UsageError(
            f"{where} turns {word} at {speed:g} deg/s, the limits are "
            f"{model.slowest_deg_s:.2f} to {fastest_deg_s:.2f} deg/s",
            "change the program",
        )
