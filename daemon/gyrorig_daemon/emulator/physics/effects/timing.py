"""Samples that show the motion of another time than their stamps say.

A firmware that drains a queue of samples by its own timer stamps well and shows old ones: the
lag grows or shrinks as the sensor's clock runs fast or slow against the timer (skew), jumps
when samples are skipped or repeated (step), and scatters when a register is polled (jitter).
What is shown is never newer than now: a lag that shrinks begins as large as it has to be.
Source: time synchronisation survey, section 9 (lag patterns).
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Lag(Protocol):
    """How old the motion in a sample is, besides the board's own lag."""

    def at(self, time_s: float) -> tuple[float, float]:
        """Return the lag in s of a block that begins at a time, and its growth per s."""
        ...


@dataclass(frozen=True, slots=True)
class SkewLag:
    """A lag that grows all the time."""

    growth: float  # s of lag per s
    start_s: float  # lag at power-up

    def at(self, time_s: float) -> tuple[float, float]:
        """See `Lag`."""
        lag_s = self.start_s + self.growth * time_s
        return (lag_s, self.growth) if lag_s > 0.0 else (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class StepLag:
    """A lag that jumps once, with the first block after an instant."""

    step_s: float
    at_s: float

    def at(self, time_s: float) -> tuple[float, float]:
        """See `Lag`."""
        before_s = max(-self.step_s, 0.0)
        return before_s + (self.step_s if time_s >= self.at_s else 0.0), 0.0


class Jitter:
    """Each sample is somewhat too old, by a time of its own."""

    def __init__(self, rms_s: float, rng: np.random.Generator) -> None:
        """Scatter by `rms_s`, evenly from no lag to sqrt(12) times that."""
        self.longest_s = math.sqrt(12.0) * rms_s
        self._rng = rng

    def draw_s(self, count: int) -> FloatArray:
        """Return the lags of the next samples, (count,)."""
        return self.longest_s * self._rng.random(count)
