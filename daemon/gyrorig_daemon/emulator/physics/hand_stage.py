"""A board in the hands of a person, instead of the stage of a unit.

The person turns the board smoothly about an axis of the board, with the tremor of a hand, and
places it with another axis up. Between these motions the board lies on a table.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.stage_motion import Stage, StageMotion

FloatArray = NDArray[np.float64]

TREMOR_HZ = 8.0  # physiological tremor of a hand: 8 to 12 Hz


@dataclass(frozen=True, slots=True, eq=False)
class HandMove:
    """One motion, from rest to rest; the axis is one of the board."""

    start_s: float
    duration_s: float
    axis: FloatArray  # (3,), unit length
    angle_rad: float
    tremor_rad: FloatArray  # (3,), amplitude of the angles
    up_before: FloatArray  # (3,), direction of the vertical in the frame of the board

    def turned_rad(self, time_s: FloatArray) -> FloatArray:
        """Return the angle about the axis since the start, (n,): the jerk is minimal."""
        x = np.clip((time_s - self.start_s) / self.duration_s, 0.0, 1.0)
        return np.asarray(self.angle_rad * x**3 * (10.0 - 15.0 * x + 6.0 * x**2))

    def angles_rad(self, time_s: FloatArray) -> FloatArray:
        """Return the integral of the body rate since the start, (n, 3)."""
        x = np.clip((time_s - self.start_s) / self.duration_s, 0.0, 1.0)
        phases = 2.0 * np.pi * (TREMOR_HZ * time_s[:, None] + np.arange(3.0) / 3.0)
        tremor = np.sin(np.pi * x)[:, None] ** 2 * np.sin(phases) * self.tremor_rad
        return self.turned_rad(time_s)[:, None] * self.axis + tremor

    def up(self, time_s: FloatArray) -> FloatArray:
        """Return the direction of the vertical in the frame of the board, (n, 3)."""
        angle = -self.turned_rad(time_s)[:, None]  # the room turns backwards around the board
        across = np.cross(self.axis, self.up_before)
        along = self.axis * float(self.axis @ self.up_before)
        return np.asarray(along + np.cos(angle) * (self.up_before - along) + np.sin(angle) * across)


@dataclass(frozen=True, slots=True, eq=False)
class HandMotion(StageMotion):
    """Motion of the board, with the vertical."""

    up: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # (n, 3)


@dataclass(frozen=True, slots=True, eq=False)
class HandStage(Stage):
    """The board in the hands of a person. The two axes of a unit do not move."""

    moves: list[HandMove] = field(default_factory=list)

    @property
    def revision(self) -> int:
        """Increases with every motion that the person begins."""
        return len(self.moves)

    def up_at(self, time_s: FloatArray) -> FloatArray:
        """Return the direction of the vertical in the frame of the board, (n, 3)."""
        up = np.tile([0.0, 0.0, 1.0], (time_s.size, 1))
        for move in self.moves:
            later = time_s >= move.start_s
            up[later] = move.up(time_s[later])
        return up

    def motion(self, start_s: float, period_s: float, count: int) -> HandMotion:
        """Return the motion in each of `count` intervals; see `Stage.motion`."""
        edges_s: FloatArray = np.asarray(
            start_s + period_s * np.arange(count + 1), dtype=np.float64
        )
        angles = np.zeros((count + 1, 3))
        for move in self.moves:
            if move.start_s < edges_s[-1] and move.start_s + move.duration_s > edges_s[0]:
                angles += move.angles_rad(edges_s)
        rates = np.diff(angles, axis=0) / period_s
        still = np.zeros(count)
        middles_s: FloatArray = edges_s[:-1] + 0.5 * period_s
        up = self.up_at(middles_s)
        return HandMotion(still, still, still, still, rates, up)

    def gravity_during(self, motion: StageMotion) -> FloatArray:
        """Return the specific force at rest, (n, 3)."""
        if not isinstance(motion, HandMotion):
            raise TypeError("the motion of a unit, not of a person")
        return self.gravity_m_s2 * motion.up

    def gravity_stage_m_s2(self, start_s: float, period_s: float, count: int) -> FloatArray:
        """Return the specific force at rest in the frame of the board, (count, 3)."""
        time_s: FloatArray = start_s + period_s * np.arange(count, dtype=np.float64)
        return self.gravity_m_s2 * self.up_at(time_s)
