"""The body rate of a pan-tilt stage (contract: frames and signs).

Attitude R = Rz(pan) Rx(tilt), stage to base. In the stage frame
omega = (tilt_rate, pan_rate sin(tilt), pan_rate cos(tilt)).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray


def stage_rate(
    tilt_rad: FloatArray, pan_rate_rad_s: FloatArray, tilt_rate_rad_s: FloatArray
) -> FloatArray:
    """Return the stage's rate in its own frame, shape (n, 3), from arrays of shape (n,)."""
    return np.column_stack(
        [tilt_rate_rad_s, pan_rate_rad_s * np.sin(tilt_rad), pan_rate_rad_s * np.cos(tilt_rad)]
    )


@dataclass(frozen=True, eq=False)
class AxisTurn:
    """How a small change of one axis' position changes the stage rate."""

    rad_per_step: tuple[float, float]
    tilt_rad: FloatArray  # (n,), at the intervals' middles
    pan_rate_rad_s: FloatArray  # (n,)
    width_s: FloatArray  # (n,)

    @classmethod
    def along(
        cls, angle_rad: FloatArray, edges_s: FloatArray, rad_per_step: tuple[float, float]
    ) -> tuple[FloatArray, Self]:
        """Return the mean stage rate between edges, (n, 3), and how axes change it there.

        Args:
            angle_rad: pan and tilt at the edges, shape (2, n + 1).
            edges_s: shape (n + 1,).
            rad_per_step: of pan and tilt.
        """
        width = np.diff(edges_s)
        pan_rate, tilt_rate = np.diff(angle_rad, axis=1) / width
        tilt = (angle_rad[1, :-1] + angle_rad[1, 1:]) / 2.0
        turn = cls(rad_per_step, tilt, pan_rate, width)
        return np.column_stack([tilt_rate, pan_rate * turn.sine, pan_rate * turn.cosine]), turn

    @cached_property
    def sine(self) -> FloatArray:
        """Of the tilt, shape (n,)."""
        return self._of_tilt(np.sin)

    @cached_property
    def cosine(self) -> FloatArray:
        """Of the tilt, shape (n,)."""
        return self._of_tilt(np.cos)

    def rate(self, axis: int, change_steps: FloatArray, at: slice) -> FloatArray:
        """Return d(stage rate) over the intervals `at`, from the change at their edges."""
        angle = self.rad_per_step[axis] * change_steps
        speed = np.diff(angle)
        speed /= self.width_s[at]
        found = np.zeros((speed.size, 3))
        if axis == 0:
            np.multiply(speed, self.sine[at], out=found[:, 1])
            np.multiply(speed, self.cosine[at], out=found[:, 2])
            return found
        found[:, 0] = speed
        lean = 0.5 * self.pan_rate_rad_s[at] * (angle[:-1] + angle[1:])
        np.multiply(lean, self.cosine[at], out=found[:, 1])
        np.multiply(lean, -self.sine[at], out=found[:, 2])
        return found

    @cached_property
    def _runs(self) -> tuple[IntArray, IntArray]:
        """Where the tilt is another than just before, and for how many intervals it stays."""
        changed = np.flatnonzero(self.tilt_rad[1:] != self.tilt_rad[:-1]) + 1
        first = np.concatenate([[0], changed])[: self.tilt_rad.size]
        return first, np.diff(first, append=self.tilt_rad.size)

    def _of_tilt(self, function: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return a function of the tilt, which is at rest for most of the time."""
        first, count = self._runs
        if 2 * first.size > self.tilt_rad.size:
            return function(self.tilt_rad)
        return np.repeat(function(self.tilt_rad[first]), count)
