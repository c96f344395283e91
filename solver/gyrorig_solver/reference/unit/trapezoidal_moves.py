"""Trapezoidal moves of a single command each, with derivatives in closed form.

A move starts at the base speed, ramps to its upper speed, cruises, ramps down and stops. A short
move has a triangular profile, a slow one has no ramps (FLIR PTU command reference manual v3.00D,
section 5). The position and its derivatives by log speed and log acceleration are polynomials of
the time since the start of a segment. `motion_profile` plans moves with several commands.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray

SEGMENTS = 4  # ramp up, cruise, ramp down, standstill


@dataclass(frozen=True, slots=True, eq=False)
class TrapezoidalMoves:
    """m moves; steps and seconds since their starts, unsigned."""

    distance: FloatArray  # (m,), of the whole move
    speed: FloatArray  # (m,), commanded
    acceleration: FloatArray  # (m,)
    base_speed: FloatArray  # (m,), at most the commanded speed
    peak_speed: FloatArray  # (m,), largest speed reached
    ramp_s: FloatArray  # (m,), from base to peak
    ramp_steps: FloatArray  # (m,)
    end_s: FloatArray  # (m,)

    @classmethod
    def of(
        cls,
        distance: FloatArray,
        speed: FloatArray,
        acceleration: FloatArray,
        base_speed: FloatArray,
    ) -> Self:
        """Return the moves over `distance` steps with these limits, all of shape (m,)."""
        base_speed = np.minimum(base_speed, speed)
        peak_speed = np.minimum(speed, np.sqrt(acceleration * distance + base_speed**2))
        ramp_s = (peak_speed - base_speed) / acceleration
        ramp_steps = 0.5 * (peak_speed + base_speed) * ramp_s
        cruise_s = np.maximum(distance - 2.0 * ramp_steps, 0.0) / peak_speed
        return cls(
            distance,
            speed,
            acceleration,
            base_speed,
            peak_speed,
            ramp_s,
            ramp_steps,
            2.0 * ramp_s + cruise_s,
        )

    @property
    def segment_start_s(self) -> FloatArray:
        """Start of each segment, shape (4, m)."""
        return np.stack(
            [np.zeros_like(self.distance), self.ramp_s, self.end_s - self.ramp_s, self.end_s]
        )

    @property
    def position(self) -> FloatArray:
        """Polynomials of the position in each segment, shape (3, 4, m)."""
        zeros, half_acceleration = np.zeros_like(self.distance), 0.5 * self.acceleration
        return np.stack(
            [
                [zeros, self.ramp_steps, self.distance - self.ramp_steps, self.distance],
                [self.base_speed, self.peak_speed, self.peak_speed, zeros],
                [half_acceleration, zeros, -half_acceleration, zeros],
            ]
        )

    @property
    def by_speed(self) -> FloatArray:
        """The derivative of `position` by log speed, as `position`.

        While cruising, x = v t - (v - b)^2 / 2a. On the ramp down, x = W - b q - a q^2 / 2 with q
        the remaining time, and the end changes: T = W/v + (v - b)^2 / (a v). A triangular
        profile does not depend on the speed.
        """
        v, b, a = self.speed, self.base_speed, self.acceleration
        zeros = np.zeros_like(v)
        reached = self.peak_speed >= v
        later = np.where(reached, (v**2 - b**2) / (a * v) - self.distance / v, 0.0)
        return np.stack(
            [
                [zeros, zeros, -self.peak_speed * later, zeros],
                [zeros, np.where(reached, v, 0.0), a * later, zeros],
                [zeros, zeros, zeros, zeros],
            ]
        )

    @property
    def by_acceleration(self) -> FloatArray:
        """The derivative of `position` by log acceleration, as `position`; see `by_speed`.

        A triangular profile ends at T = 2 (p - b) / a, its peak p^2 = a W + b^2.
        """
        v, b, a, peak = self.speed, self.base_speed, self.acceleration, self.peak_speed
        zeros, half = np.zeros_like(v), 0.5 * a
        gained = (v - b) ** 2 / a
        later = np.where(peak >= v, -gained / v, self.distance / peak - 2.0 * self.ramp_s)
        lost = peak * later + half * self.ramp_s**2
        return np.stack(
            [
                [zeros, 0.5 * gained, -lost, zeros],
                [zeros, zeros, a * (later + self.ramp_s), zeros],
                [half, zeros, -half, zeros],
            ]
        )

    @property
    def by_base_speed(self) -> FloatArray:
        """The derivative of `position` by the base speed, as `position`; see `by_speed`.

        The end of a trapezoid changes by -2 (v - b) / (a v), that of a triangle by 2 (b / p - 1) /
        a. A move without ramps does not depend on the base speed.
        """
        b, a, peak = self.base_speed, self.acceleration, self.peak_speed
        zeros = np.zeros_like(b)
        later = np.where(
            peak >= self.speed, -2.0 * (peak - b) / (a * peak), 2.0 * (b / peak - 1.0) / a
        )
        has_ramps = self.ramp_s > 0.0
        linear = np.where(has_ramps, 1.0 + a * later, 0.0)
        return np.stack(
            [
                [zeros, self.ramp_s, np.where(has_ramps, -self.ramp_s - peak * later, 0.0), zeros],
                [has_ramps.astype(np.float64), zeros, linear, zeros],
                [zeros, zeros, zeros, zeros],
            ]
        )

    def time_at(self, travelled: FloatArray, move: IntArray) -> FloatArray:
        """Return the time since the start at which each move has covered a distance.

        Args:
            travelled: steps, shape (n,), from 0 to the distance of the move.
            move: index of the move, shape (n,).
        """
        distance = self.distance[move]
        base_speed = self.base_speed[move]
        a = self.acceleration[move]
        peak_speed, ramp = self.peak_speed[move], self.ramp_steps[move]
        from_nearer_end = np.minimum(
            travelled, distance - travelled
        )  # from the nearer end, by symmetry
        up = (np.sqrt(base_speed**2 + 2.0 * a * np.minimum(from_nearer_end, ramp)) - base_speed) / a
        since = up + np.maximum(from_nearer_end - ramp, 0.0) / peak_speed
        return np.where(travelled <= 0.5 * distance, since, self.end_s[move] - since)
