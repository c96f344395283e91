"""Backlash: the play operator between motor and gear.

The gap of a worm gear lets the wheel lag the worm by up to its width g. With x the motor's
and y the wheel's position, y follows x by y = clip(y before, x - g, x): going up the wheel
lags by the whole gap, going down by none, and after a reversal it stands until the gap is
crossed. Between two turning points x goes one way only, so one clip from the state at the
last turning point is exact.

Homing ends by turning down from the upper stop; at the homed zero the wheel lies at the
lower flank, y = x, which is where this begins. Source: pan-tilt survey, section 7.
"""

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.motor import Memory, Motor

FloatArray = NDArray[np.float64]

_NOW = np.zeros(1)


class Play:
    """The gap of one gear."""

    def __init__(self, gap_steps: float) -> None:
        """Take the gap's width in steps of the motor, not negative."""
        self._gap = gap_steps
        self._memory: Memory[float | None] = Memory(None)

    def passed_steps(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, steps: FloatArray
    ) -> FloatArray:
        """See `motor.StepEffect`."""
        out = self._state_before(motor, start_s)
        turns = motor.turning_times_s(start_s, start_s + float(offsets_s[-1]))
        cuts = [0, *np.searchsorted(offsets_s, np.array(turns) - start_s).tolist(), len(offsets_s)]
        passed = np.empty_like(steps)
        for k in range(len(cuts) - 1):
            piece = slice(cuts[k], cuts[k + 1])
            passed[piece] = np.clip(out, steps[piece] - self._gap, steps[piece])
            if k < len(turns):
                out = self._clipped(motor, turns[k], out)
        return passed

    def forget(self, time_s: float) -> None:
        """See `motor.StepEffect`."""
        self._memory.forget(time_s)

    def _state_before(self, motor: Motor, time_s: float) -> float:
        known_s, known = self._memory.before(time_s)
        out = self._rotor(motor, 0.0) if known is None else known
        for turn_s in motor.turning_times_s(known_s, time_s):
            out = self._clipped(motor, turn_s, out)
            self._memory.keep(turn_s, out)
        return out

    def _clipped(self, motor: Motor, time_s: float, out: float) -> float:
        rotor = self._rotor(motor, time_s)
        return min(max(out, rotor - self._gap), rotor)

    @staticmethod
    def _rotor(motor: Motor, time_s: float) -> float:
        return float(motor.rotor_steps(time_s, _NOW)[0])
