"""What an effect of the mechanics sees of an axis, and what it has to be.

A motor's train of steps goes through the gear to the stage. `StepEffect` stands between
motor and gear (play); `AngleEffect` adds an angle behind it. Both may have a history, so
they keep states at knots in a `Memory`, and an axis tells them to `forget` what lies after
a command that changed the motion.

Times are seconds since the rig's origin, steps are true ones of the motor.
"""

from bisect import bisect_left, bisect_right
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.motion_law import Segment

FloatArray = NDArray[np.float64]
State = TypeVar("State")


class Motor(Protocol):
    """The motor of an axis, as its effects see it."""

    @property
    def step_rad(self) -> float:
        """The angle of one step behind the gear, signed."""
        ...

    @property
    def s_curve_s(self) -> float:
        """The length of the window that smooths the planned motion, 0 without one."""
        ...

    def driven_steps(self, start_s: float, offsets_s: FloatArray) -> FloatArray:
        """Return where the controller drives the motor to, at ascending times, (n,)."""
        ...

    def rotor_steps(self, start_s: float, offsets_s: FloatArray) -> FloatArray:
        """Return where the rotor is: as driven, less the steps that it lost, (n,)."""
        ...

    def turning_times_s(self, after_s: float, until_s: float) -> list[float]:
        """Return times in (after, until] between which the rotor goes one way only."""
        ...

    def planned(self, after_s: float, until_s: float) -> list[tuple[Segment, float]]:
        """Return the segments that hold in [after, until], each with the speed before it."""
        ...


class StepEffect(Protocol):
    """Stands between motor and gear."""

    def passed_steps(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, steps: FloatArray
    ) -> FloatArray:
        """Return the steps that get through, (n,).

        Args:
            motor: what drives.
            start_s: where the offsets count from.
            offsets_s: ascending, not negative, (n,).
            steps: the rotor's position at these times, (n,).
        """
        ...

    def forget(self, time_s: float) -> None:
        """Drop what was remembered of `time_s` and later."""
        ...


class AngleEffect(Protocol):
    """Adds an angle behind the gear."""

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """Return the angle to add, (n,).

        Args:
            motor: what drives.
            start_s: where the offsets count from.
            offsets_s: ascending, not negative, (n,).
            angle_rad: the angle behind the gear at these times, (n,).
        """
        ...

    def forget(self, time_s: float) -> None:
        """Drop what was remembered of `time_s` and later."""
        ...


class Memory(Generic[State]):
    """States at knots in the order of time; the first one is never forgotten."""

    def __init__(self, initial: State) -> None:
        """Hold `initial` since ever."""
        self._times = [float("-inf")]
        self._states = [initial]

    def before(self, time_s: float) -> tuple[float, State]:
        """Return the last knot not after a time."""
        at = bisect_right(self._times, time_s) - 1
        return self._times[at], self._states[at]

    def keep(self, time_s: float, state: State) -> None:
        """Note a state not before the last knot; an earlier one is no news."""
        if time_s == self._times[-1]:
            self._states[-1] = state
        elif time_s > self._times[-1]:
            self._times.append(time_s)
            self._states.append(state)

    def forget(self, time_s: float) -> None:
        """Drop the knots of `time_s` and later."""
        keep = max(bisect_left(self._times, time_s), 1)
        del self._times[keep:], self._states[keep:]
