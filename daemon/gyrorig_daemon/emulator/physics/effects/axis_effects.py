"""Interfaces of effects on an axis, and the state history that they need.

The step train of a motor passes through the gear to the stage. A `StepEffect` is between motor and
gear (backlash), an `AngleEffect` adds an angle behind the gear, and a `StepLoss` shifts the rotor
against the commanded steps. Effects with a history keep their states in a `StateHistory`; an axis
calls `forget` for the time after a command that changed the motion.

Times are seconds since the rig's origin, steps are true steps of the motor.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.motion_law import Segment

FloatArray = NDArray[np.float64]
State = TypeVar("State")


class Motor(Protocol):
    """The motor of an axis, as seen by its effects."""

    @property
    def step_rad(self) -> float:
        """The angle of one step behind the gear, signed."""
        ...

    @property
    def s_curve_s(self) -> float:
        """The length of the averaging window of the planned motion, 0 without one."""
        ...

    def wheel_acceleration_steps_s2(
        self, start_s: float, offsets_s: FloatArray, rise_s: float
    ) -> FloatArray:
        """Return the acceleration behind the gear at ascending times, (n,).

        By backward differences over `rise_s`, so that it is causal. A loss of steps is none.
        """
        ...

    def rotor_steps(self, start_s: float, offsets_s: FloatArray) -> FloatArray:
        """Return the rotor's position: the commanded one minus lost steps, (n,)."""
        ...

    def reversal_times_s(self, after_s: float, until_s: float) -> list[float]:
        """Return times in (after, until] between which the rotor's motion is monotonic."""
        ...

    def planned(self, after_s: float, until_s: float) -> list[tuple[Segment, float]]:
        """Return the segments in [after, until], each with the speed before it."""
        ...

    def wheel_planned(self, after_s: float, until_s: float) -> list[tuple[Segment, float]]:
        """Return the segments of the wheel behind the gear, as `planned` does those of the motor.

        The wheel stands where the motor crosses a gap. The positions are those of the motor.
        """
        ...


class StepEffect(Protocol):
    """An effect between motor and gear."""

    def passed_steps(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, steps: FloatArray
    ) -> FloatArray:
        """Return the steps behind the effect, (n,).

        Args:
            motor: the motor of the axis.
            start_s: origin of the offsets.
            offsets_s: ascending, not negative, (n,).
            steps: the rotor's position at these times, (n,).
        """
        ...

    def standing_s(self, motor: Motor, after_s: float, until_s: float) -> list[tuple[float, float]]:
        """Return the intervals in which only the rotor moves, in order.

        Those that end after `after_s` and begin until `until_s`, each with its true end.
        """
        ...

    def forget(self, time_s: float) -> None:
        """Drop what was remembered of `time_s` and later."""
        ...


class AngleEffect(Protocol):
    """An effect that adds an angle behind the gear."""

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """Return the angle to add, (n,).

        Args:
            motor: the motor of the axis.
            start_s: origin of the offsets.
            offsets_s: ascending, not negative, (n,).
            angle_rad: the angle behind the gear at these times, (n,).
        """
        ...

    def forget(self, time_s: float) -> None:
        """Drop what was remembered of `time_s` and later."""
        ...


class StepLoss(Protocol):
    """An effect that loses steps, once."""

    happened_s: float | None

    def on_move(self, segments: Sequence[Segment]) -> tuple[float, float] | None:
        """Return when and by how much the rotor shifts in a move, None if it does not."""
        ...


class StateHistory(Generic[State]):
    """States at knots in order of time; the first one is never forgotten."""

    def __init__(self, initial: State) -> None:
        """Start with a state that has no beginning."""
        self._times = [float("-inf")]
        self._states = [initial]

    def last_before(self, time_s: float) -> tuple[float, State]:
        """Return the last knot not after a time."""
        at = bisect_right(self._times, time_s) - 1
        return self._times[at], self._states[at]

    def keep(self, time_s: float, state: State) -> None:
        """Store a state at or after the last knot; an earlier one is ignored."""
        if time_s == self._times[-1]:
            self._states[-1] = state
        elif time_s > self._times[-1]:
            self._times.append(time_s)
            self._states.append(state)

    def forget(self, time_s: float) -> None:
        """Drop the knots of `time_s` and later."""
        keep = max(bisect_left(self._times, time_s), 1)
        del self._times[keep:], self._states[keep:]
