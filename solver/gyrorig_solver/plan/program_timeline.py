"""Simulated execution of a program: commands, polls and axis positions.

The daemon sends one command or one poll at a time. A move is complete when two consecutive replies
show each of its axes at rest at its target. Times are in s from the start of the program.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis, OrderKind
from gyrorig_protocol.program import Home, MotionProgram, Move, Rest, unroll_steps
from gyrorig_solver.data import FloatArray
from gyrorig_solver.plan.unit_model import ARCSEC_PER_DEG, AxisModel, UnitModel
from gyrorig_solver.reference import MotionLimits, MotionProfile, plan_motion
from gyrorig_solver.reference.unit.motion_profile import ProfileCommand
from gyrorig_solver.reference.unit.move_fit import UnitPolls
from gyrorig_solver.reference.unit.unit_moves import AXES, UnitOrder

HALT_WATCH_S = 0.3  # after the program, the daemon halts the unit and polls it at rest
MAX_DURATION_S = 3600.0  # the effort of a prediction grows with the cube of the number of moves
ARRIVAL_POLLS = 2  # replies with the target position
# of a serial line; without it, the polls could be synchronous with the steps
POLL_JITTER_S = 2.5e-4
GOLDEN_RATIO = 0.6180339887498949


class ProgramTooLongError(UsageError):
    """A program lasts longer than a prediction permits."""


@dataclass(frozen=True, slots=True, eq=False)
class ProgramTimeline:
    """The simulated commands, motion profiles and polls of a program."""

    orders: tuple[UnitOrder, ...]
    profiles: tuple[tuple[MotionProfile, ...], tuple[MotionProfile, ...]]  # pan, tilt, in steps
    settings: dict[str, float]  # as in a recording's metadata
    poll_s: FloatArray  # times of the position polls
    program_s: float

    @property
    def duration_s(self) -> float:
        """Duration from the first command to the end of the recording."""
        return self.program_s + HALT_WATCH_S

    def position_steps(self, time_s: FloatArray) -> FloatArray:
        """Return pan and tilt at times, shape (n, 2)."""
        steps = np.zeros((time_s.size, 2))
        for axis in (0, 1):
            for profile in self.profiles[axis]:
                first, last = np.searchsorted(time_s, [profile.start_s[0], profile.end_s])
                steps[first:last, axis] = profile.position_steps(time_s[first:last])
                steps[last:, axis] = profile.start_steps[-1]
        return steps

    def simulate_polls(self, unit: UnitModel) -> UnitPolls:
        """Return the simulated position replies."""
        count = self.poll_s.size
        jitter = (np.arange(count) * GOLDEN_RATIO) % 1.0 - 0.5
        at_s = self.poll_s + unit.window_s / 2.0 + POLL_JITTER_S * jitter
        valid = np.ones((count, 2), dtype=np.bool_)
        if not unit.both_at_once:
            valid[0::2, 1] = valid[1::2, 0] = False
        counts = np.rint(self.position_steps(at_s))
        if unit.both_at_once:
            # With the controller's counter, all polls share one unknown constant within the window.
            return UnitPolls(at_s, at_s, counts, valid, unit.window_s)
        half_s = unit.window_s / 2.0
        return UnitPolls(at_s - half_s, at_s + half_s, counts, valid)


def simulate_program(program: MotionProgram, unit: UnitModel) -> ProgramTimeline:
    """Simulate how the daemon executes a program; the unit starts at home, steps (0, 0).

    Raises:
        UsageError: a step exceeds the unit's limits or speeds; the text has its number.
        ProgramTooLongError: the program lasts longer than an hour.
    """
    run = _ProgramRun(program, unit)
    for number, step in enumerate(unroll_steps(program.steps, program.name), start=1):
        if isinstance(step, Rest):
            run.rest(step.seconds)
        else:
            run.move(step, f"step {number} of {program.name}")
    return run.timeline()


@dataclass(slots=True)
class _ProgramRun:
    program: MotionProgram
    unit: UnitModel
    now_s: float = 0.0
    orders: list[UnitOrder] = field(default_factory=list)
    profiles: tuple[list[MotionProfile], list[MotionProfile]] = field(
        default_factory=lambda: ([], [])
    )
    blocks: list[tuple[float, int]] = field(default_factory=list)
    poll_count: int = 0
    position_steps: list[int] = field(default_factory=lambda: [0, 0])

    def rest(self, seconds: float) -> None:
        """Poll the position for a time."""
        interval_s = self.unit.poll_interval_s
        self._poll(int(np.ceil(max(0.0, seconds) / interval_s - 1e-9)))

    def move(self, step: Move | Home, where: str) -> None:
        """Send the commands of a move and poll until the move is complete."""
        targets = list(self._axis_targets(step, where))
        for axis, _, speed in targets:
            self._send(OrderKind.SPEED, _AXIS[axis], speed)
        if len(targets) > 1:
            self._send(OrderKind.COLLECT)
        start_s = []
        for axis, target, _ in targets:
            start_s.append(self._send(OrderKind.TARGET, _AXIS[axis], target))
        if len(targets) > 1:
            start_s = [self._send(OrderKind.IMMEDIATE)] * len(targets)
        end_s = self.now_s
        for (axis, target, speed), command_s in zip(targets, start_s, strict=True):
            profile = self._profile(axis, target, speed, command_s + self.unit.window_s / 2.0)
            if profile is not None:
                self.profiles[axis].append(profile)
                end_s = max(end_s, profile.end_s)
            self.position_steps[axis] = target
        self._poll_until_arrival(end_s, [axis for axis, _, _ in targets])
        if isinstance(step, Move):
            self.rest(step.settle_s)

    def timeline(self) -> ProgramTimeline:
        """Return the timeline of the run."""
        program_s = self.now_s
        self.rest(HALT_WATCH_S)
        interval_s = self.unit.poll_interval_s
        poll_times = [first + interval_s * np.arange(count) for first, count in self.blocks]
        settings = {}
        for k, name in enumerate(AXES):
            base, acceleration = self._speed_law(k)
            settings[f"{name}_base_speed"], settings[f"{name}_acceleration"] = base, acceleration
        return ProgramTimeline(
            tuple(self.orders),
            (tuple(self.profiles[0]), tuple(self.profiles[1])),
            settings,
            np.concatenate(poll_times),
            program_s,
        )

    def _speed_law(self, axis: int) -> tuple[float, float]:
        """Return base speed and acceleration of an axis, in steps."""
        settings, model = self.program.settings, self.unit.axes[axis]
        base = self.unit.base_speed_steps_s
        acceleration = self.unit.acceleration_steps_s2
        if settings.base_speed_deg_s is not None:
            base = float(model.to_step_rate(settings.base_speed_deg_s))
        if settings.acceleration_deg_s2 is not None:
            acceleration = float(model.to_step_rate(settings.acceleration_deg_s2))
        return base, acceleration

    def _profile(self, axis: int, target: int, speed: int, start_s: float) -> MotionProfile | None:
        if target == self.position_steps[axis]:
            return None
        base, acceleration = self._speed_law(axis)
        limits = MotionLimits(float(speed), acceleration, base)
        return plan_motion(
            float(self.position_steps[axis]), [ProfileCommand(start_s, "to", float(target), limits)]
        )

    def _send(self, kind: OrderKind, axis: OrderAxis = OrderAxis.BOTH, value: float = 0.0) -> float:
        sent_s = self.now_s
        order = AxisOrder(kind, axis, float(value))
        self.orders.append(UnitOrder(sent_s, sent_s + self.unit.window_s, True, order))
        self.now_s += self.unit.command_interval_s
        return sent_s

    def _poll(self, count: int) -> None:
        if self.now_s + count * self.unit.poll_interval_s > MAX_DURATION_S:
            raise ProgramTooLongError(
                f"the motion program {self.program.name} lasts longer than {MAX_DURATION_S:g} s, "
                "which is the limit for a prediction",
                "shorten the program",
            )
        if count > 0:
            self.blocks.append((self.now_s, count))
            self.now_s += count * self.unit.poll_interval_s
            self.poll_count += count

    def _poll_until_arrival(self, end_s: float, axes: list[int]) -> None:
        interval_s = self.unit.poll_interval_s
        self._poll(int(np.ceil(max(0.0, end_s - self.now_s) / interval_s)))
        polls_needed = ARRIVAL_POLLS
        if not self.unit.both_at_once:
            # The daemon polls pan and tilt in turn, pan first.
            polls_needed = 2 * ARRIVAL_POLLS
            if len(axes) == 1 and self.poll_count % 2 == axes[0]:
                polls_needed -= 1
        self._poll(polls_needed)

    def _axis_targets(self, step: Move | Home, where: str) -> Iterator[tuple[int, int, int]]:
        """Yield axis, target and speed in steps of each axis in a program step."""
        default = self.program.settings.default_speed_deg_s
        if isinstance(step, Home):
            step = Move(pan_deg=0.0, tilt_deg=0.0, speed_deg_s=step.speed_deg_s or default)
        default_speed = step.speed_deg_s or default
        targets = (
            (step.pan_deg, step.pan_speed_deg_s or default_speed),
            (step.tilt_deg, step.tilt_speed_deg_s or default_speed),
        )
        for axis, (angle_deg, speed_deg_s) in enumerate(targets):
            if angle_deg is not None:
                model = self.unit.axes[axis]
                fastest = self.program.settings.upper_speed_deg_s or model.fastest_deg_s
                _check_limits(model, fastest, AXES[axis], angle_deg, speed_deg_s, where)
                yield axis, model.to_steps(angle_deg), model.to_step_rate(speed_deg_s)


_AXIS = (OrderAxis.PAN, OrderAxis.TILT)


def _check_limits(
    model: AxisModel,
    fastest_deg_s: float,
    axis_name: str,
    angle_deg: float,
    speed: float,
    where: str,
) -> None:
    half_step_deg = model.resolution_arcsec / ARCSEC_PER_DEG / 2.0
    if not model.low_deg - half_step_deg <= angle_deg <= model.high_deg + half_step_deg:
        raise UsageError(
            f"{where} turns {axis_name} to {angle_deg:g} deg, but the unit allows only "
            f"{model.low_deg:.2f} to {model.high_deg:.2f} deg",
            f"choose a {axis_name} angle within these limits in the motion program",
        )
    if not model.slowest_deg_s - half_step_deg <= speed <= fastest_deg_s + half_step_deg:
        raise UsageError(
            f"{where} turns {axis_name} at {speed:g} deg/s, but the unit allows only "
            f"{model.slowest_deg_s:.2f} to {fastest_deg_s:.2f} deg/s",
            f"choose a {axis_name} speed within these limits in the motion program",
        )
