"""Slow changes of the bias: means over windows of one recording, with their temperatures.

What to use when: `BiasSeries` for a recording with times, `BiasTable` for values without times;
`heating_state` for the state on which a bias with hysteresis depends.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model import BoardTemperature

PLAY_SHARE = 0.02  # of the span; smaller reversals are noise of the thermometer
LOOP_SHARES = (0.15, 0.05, 0.02)  # of the span, over which a loop reaches its other branch
MIN_LOOP_SHARE = 0.1  # of the span; without a reversal of this size, there is no loop


@dataclass(frozen=True, slots=True, eq=False)
class BiasSeries:
    """Means of the bias over successive windows of one recording."""

    name: str
    time_s: FloatArray  # (n,), centres of the windows
    bias: FloatArray  # (n, 3), rad/s; interpolated for windows without samples
    temperature: BoardTemperature
    origin_degc: float  # reference of `temperature`

    def die_degc(self, lag_s: float) -> FloatArray:
        """Return the temperature of the die at the windows, shape (n,)."""
        return self.temperature.die_temperature_rise(self.time_s, lag_s) + self.origin_degc

    @property
    def duration_s(self) -> float:
        """Duration from the first to the last window."""
        return float(self.time_s[-1] - self.time_s[0])


@dataclass(frozen=True, slots=True, eq=False)
class BiasTable:
    """Values at temperatures, without times; each row is a separate measurement."""

    temperature_degc: FloatArray  # (n,)
    value: FloatArray  # (n, 3)
    std: FloatArray  # (n, 3), zero if it is not known


def heating_state(
    degc: FloatArray, span_k: float, loop_share: float = LOOP_SHARES[0]
) -> FloatArray:
    """Return the position of a bias with hysteresis between its branches, (n,).

    The state is -1 on the branch of cooling and 1 on that of heating. It moves towards the branch
    of the present direction while the temperature changes, as dh/dT = (sign dT - h) / (loop share x
    span). It starts in the middle, because the history before the recording is not known. A play of
    some per cent of the span removes the thermometer's noise.

    Source: P. Dahl, A solid friction model, Aerospace Corporation TOR-0158(3107-18)-1 (1968), whose
    states approach the branches in the same way.
    """
    play, width = PLAY_SHARE * span_k, max(loop_share * span_k, 1e-6)
    state = np.zeros(degc.size)
    centre = float(degc[0])
    for k in range(1, degc.size):
        moved = min(max(centre, float(degc[k]) - play), float(degc[k]) + play)
        step, centre = moved - centre, moved
        state[k] = state[k - 1]
        if step:
            direction = 1.0 if step > 0.0 else -1.0
            state[k] = direction + (state[k - 1] - direction) * np.exp(-abs(step) / width)
    return state


def shows_loop(degc: FloatArray) -> bool:
    """Return whether the temperature goes up and returns by more than a tenth of its span."""
    limit = MIN_LOOP_SHARE * float(np.ptp(degc))
    fall = float(np.max(np.maximum.accumulate(degc) - degc))
    rise = float(np.max(degc - np.minimum.accumulate(degc)))
    return limit > 0.0 and min(fall, rise) > limit
