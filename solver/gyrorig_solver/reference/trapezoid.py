"""Many moves of one order each at once: the trapezoid's legs and derivatives in closed form.

A move of one order starts at the base speed, ramps to its upper speed, cruises, ramps
down and stands; a short one turns at its peak, a slow one has no ramps (command reference
manual v3.00D, section 5). Every quantity is a polynomial of the time since its leg began:
the way, and its derivatives by log speed and log acceleration at a given time since the
start. `course` lays what this cannot: moves with orders on the way.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray

LEGS = 4  # up, cruise, down, and the standstill after it


@dataclass(frozen=True, slots=True, eq=False)
class Trapezoids:
    """m moves; steps and seconds since the start of each, unsigned."""

    way: FloatArray  # (m,), whole
    speed: FloatArray  # (m,), wanted
    acceleration: FloatArray  # (m,)
    base: FloatArray  # (m,), base speed, at most the wanted one
    peak: FloatArray  # (m,), speed that is reached
    ramp_s: FloatArray  # (m,), from base to peak
    ramp_steps: FloatArray  # (m,)
    end_s: FloatArray  # (m,)

    @classmethod
    def of(
        cls, way: FloatArray, speed: FloatArray, acceleration: FloatArray, base: FloatArray
    ) -> Self:
        """Return the moves over `way` steps with these limits, all of shape (m,)."""
        base = np.minimum(base, speed)
        peak = np.minimum(speed, np.sqrt(acceleration * way + base**2))
        ramp_s = (peak - base) / acceleration
        ramp_steps = 0.5 * (peak + base) * ramp_s
        cruise_s = np.maximum(way - 2.0 * ramp_steps, 0.0) / peak
        return cls(
            way, speed, acceleration, base, peak, ramp_s, ramp_steps, 2.0 * ramp_s + cruise_s
        )

    @property
    def leg_s(self) -> FloatArray:
        """When each leg begins, shape (4, m)."""
        return np.stack(
            [np.zeros_like(self.way), self.ramp_s, self.end_s - self.ramp_s, self.end_s]
        )

    @property
    def gone(self) -> FloatArray:
        """Steps gone on each leg: constant, by s, by s^2, s since it began; shape (3, 4, m)."""
        none, half = np.zeros_like(self.way), 0.5 * self.acceleration
        return np.stack(
            [
                [none, self.ramp_steps, self.way - self.ramp_steps, self.way],
                [self.base, self.peak, self.peak, none],
                [half, none, -half, none],
            ]
        )

    @property
    def by_speed(self) -> FloatArray:
        """The derivative of `gone` by log speed, as `gone`.

        Cruising, x = v t - (v - b)^2 / 2a. Down, x = W - b q - a q^2 / 2 with q the time
        that is left, and the end moves: T = W/v + (v - b)^2 / (a v). A triangle never
        reaches its speed.
        """
        v, b, a = self.speed, self.base, self.acceleration
        none = np.zeros_like(v)
        reached = self.peak >= v
        later = np.where(reached, (v**2 - b**2) / (a * v) - self.way / v, 0.0)
        return np.stack(
            [
                [none, none, -self.peak * later, none],
                [none, np.where(reached, v, 0.0), a * later, none],
                [none, none, none, none],
            ]
        )

    @property
    def by_acceleration(self) -> FloatArray:
        """The derivative of `gone` by log acceleration, as `gone`; see `by_speed`.

        A triangle ends at T = 2 (p - b) / a, its peak p^2 = a W + b^2.
        """
        v, b, a, peak = self.speed, self.base, self.acceleration, self.peak
        none, half = np.zeros_like(v), 0.5 * a
        gained = (v - b) ** 2 / a
        later = np.where(peak >= v, -gained / v, self.way / peak - 2.0 * self.ramp_s)
        lost = peak * later + half * self.ramp_s**2
        return np.stack(
            [
                [none, 0.5 * gained, -lost, none],
                [none, none, a * (later + self.ramp_s), none],
                [half, none, -half, none],
            ]
        )

    def passed_s(self, gone: FloatArray, move: IntArray) -> FloatArray:
        """Return how long after its start each move has gone so far.

        Args:
            gone: steps, shape (n,), between nothing and the whole way.
            move: which move, shape (n,).
        """
        way, base, a = self.way[move], self.base[move], self.acceleration[move]
        peak, ramp = self.peak[move], self.ramp_steps[move]
        near = np.minimum(gone, way - gone)  # from the nearer end, which is the same by symmetry
        up = (np.sqrt(base**2 + 2.0 * a * np.minimum(near, ramp)) - base) / a
        since = up + np.maximum(near - ramp, 0.0) / peak
        return np.where(gone <= 0.5 * way, since, self.end_s[move] - since)
