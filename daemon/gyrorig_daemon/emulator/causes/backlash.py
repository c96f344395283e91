"""Backlash: the play operator between motor and gear.

The gap of a worm gear lets the wheel lag behind the worm by at most its width g. With x the
position of the motor and y that of the wheel, y = clip(previous y, x - g, x): in the positive
direction the wheel lags by the whole gap, in the negative direction by nothing, and after a
reversal it stands until the gap is crossed. Between two reversals x is monotonic, so that one
clip from the state at the last reversal is exact.

Homing ends in the negative direction, from the upper stop. At the homed zero the wheel is
therefore on the lower flank, y = x, which is the initial state.
"""

import math
from bisect import bisect_left

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    FloatArray,
    InjectedCause,
    Quantity,
    StatedCause,
    UnitCause,
)
from gyrorig_daemon.emulator.physics.effects.axis_effects import Motor, StateHistory
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

_NO_OFFSET = np.zeros(1)
_SEARCH_S = 60.0  # a gap that the motor has not crossed by then counts as crossed
_BISECTIONS = 50
_ROUNDING_STEPS = 1e-9


class Backlash(UnitCause):
    """The gap of one gear."""

    name = "backlash"
    size_meaning = "gap between motor and gear"
    unit = "rad"
    typical = 9e-4
    sampled_min, sampled_max = 2e-4, 2.5e-3
    max_size = 0.05
    parameter = "gap"
    is_signed = False

    def __init__(self, gap_steps: float, begin: float = -1.0, shift_steps: float = 0.0) -> None:
        """Start at rest.

        Args:
            gap_steps: width of the gap in steps of the motor, not negative.
            begin: the face at power-up: 1 has pushed upwards in steps, -1 downwards.
            shift_steps: constant part of the position behind the gap.
        """
        self._gap = gap_steps
        self._begin = begin
        self._shift_steps = shift_steps
        self._history: StateHistory[float | None] = StateHistory(None)
        self._rests_s: list[tuple[float, float]] = []  # of the wheel while the rotor moves
        self._searched_s = -1.0  # rests that begin until then are known

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; findings centre the wheel in the gap, and their faces are of the angle."""
        return tuple(
            CarriedCause(
                {
                    "gap": Quantity(gap_rad, "rad"),
                    "begin": Quantity(_face(stated, axis), "1"),
                    "shift": Quantity(0.5 * gap_rad, "rad"),
                },
                axis,
            )
            for axis, gap_rad in stated.by_unit_axis("gap")
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`; the rig knows the angle of a step."""
        gap_rad = injected.number("gap")
        begin, shift_rad = injected.number_or("begin", -1.0), injected.number_or("shift", 0.0)
        if gap_rad > 0.0:
            for axis in injected.axis_hooks(hooks):
                axis.step_effect_makers.append(
                    lambda step_rad: cls(gap_rad / step_rad, begin, shift_rad / step_rad)
                )

    def passed_steps(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, steps: FloatArray
    ) -> FloatArray:
        """See `axis_effects.StepEffect`."""
        wheel = self._wheel_before(motor, start_s)
        reversals = motor.reversal_times_s(start_s, start_s + float(offsets_s[-1]))
        edges = np.searchsorted(offsets_s, np.array(reversals) - start_s).tolist()
        edges = [0, *edges, len(offsets_s)]
        passed = np.empty_like(steps)
        for k in range(len(edges) - 1):
            interval = slice(edges[k], edges[k + 1])
            passed[interval] = np.clip(wheel, steps[interval] - self._gap, steps[interval])
            if k < len(reversals):
                wheel = self._clipped(motor, reversals[k], wheel)
        return passed + self._shift_steps if self._shift_steps else passed

    def standing_s(self, motor: Motor, after_s: float, until_s: float) -> list[tuple[float, float]]:
        """See `axis_effects.StepEffect`."""
        if self._searched_s < until_s:
            starts = motor.reversal_times_s(self._searched_s, until_s)
            for k, start_s in enumerate(starts):
                end_s = starts[k + 1] if k + 1 < len(starts) else _next_reversal_s(motor, start_s)
                crossed_s = self._crossed_s(motor, start_s, end_s)
                if crossed_s > start_s:
                    self._rests_s.append((start_s, crossed_s))
            self._searched_s = until_s
        first = bisect_left(self._rests_s, after_s, key=lambda rest: rest[1])
        return [rest for rest in self._rests_s[first:] if rest[0] <= until_s]

    def forget(self, time_s: float) -> None:
        """See `axis_effects.StepEffect`."""
        self._history.forget(time_s)
        while self._rests_s and self._rests_s[-1][1] >= time_s:
            time_s = min(time_s, self._rests_s.pop()[0])
        self._searched_s = min(self._searched_s, math.nextafter(time_s, -math.inf))

    def _crossed_s(self, motor: Motor, start_s: float, end_s: float) -> float:
        """Return when the wheel begins to follow a rotor that is monotonic in an interval."""
        wheel = self._wheel_before(motor, start_s)
        rotor_start, rotor_end = self._rotor(motor, start_s), self._rotor(motor, end_s)
        direction = math.copysign(1.0, rotor_end - rotor_start)
        face = wheel + self._gap if direction > 0.0 else wheel  # where the rotor pushes the wheel
        if abs(rotor_end - rotor_start) < _ROUNDING_STEPS:
            return start_s
        if direction * (face - rotor_start) < _ROUNDING_STEPS:
            return start_s
        if direction * (face - rotor_end) >= 0.0:
            return end_s
        low_s, high_s = start_s, end_s
        for _ in range(_BISECTIONS):
            middle_s = 0.5 * (low_s + high_s)
            if direction * (face - self._rotor(motor, middle_s)) > 0.0:
                low_s = middle_s
            else:
                high_s = middle_s
        return high_s

    def _wheel_before(self, motor: Motor, time_s: float) -> float:
        known_s, known = self._history.last_before(time_s)
        wheel = known
        if wheel is None:
            wheel = self._rotor(motor, 0.0) - 0.5 * (1.0 + self._begin) * self._gap
        for reversal_s in motor.reversal_times_s(known_s, time_s):
            wheel = self._clipped(motor, reversal_s, wheel)
            self._history.keep(reversal_s, wheel)
        return wheel

    def _clipped(self, motor: Motor, time_s: float, wheel: float) -> float:
        rotor = self._rotor(motor, time_s)
        return min(max(wheel, rotor - self._gap), rotor)

    @staticmethod
    def _rotor(motor: Motor, time_s: float) -> float:
        return float(motor.rotor_steps(time_s, _NO_OFFSET)[0])


def _next_reversal_s(motor: Motor, after_s: float) -> float:
    return next(iter(motor.reversal_times_s(after_s, after_s + _SEARCH_S)), after_s + _SEARCH_S)


def _face(stated: StatedCause, axis: str) -> float:
    """Return the face at the begin of the recording, by the direction in steps."""
    begin = stated.number(f"begin.{axis}", -1.0)
    return math.copysign(1.0, stated.step_rad[axis]) * min(max(begin, -1.0), 1.0)
