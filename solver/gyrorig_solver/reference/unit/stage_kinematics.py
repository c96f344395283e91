"""Kinematics of a pan-tilt stage: its body rate (docs/conventions.md, frames and signs).

Attitude R = Rz(pan) Rx(tilt), stage to base. In the stage frame
omega = (tilt_rate, pan_rate sin(tilt), pan_rate cos(tilt)).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray


def stage_rate(
    tilt_rad: FloatArray, pan_rate_rad_s: FloatArray, tilt_rate_rad_s: FloatArray
) -> FloatArray:
    """Return the body rate of the stage, shape (n, 3), from arrays of shape (n,)."""
    return np.column_stack(
        [tilt_rate_rad_s, pan_rate_rad_s * np.sin(tilt_rad), pan_rate_rad_s * np.cos(tilt_rad)]
    )


@dataclass(frozen=True, eq=False)
class StageRateJacobian:
    """Derivative of the stage rate by the position of one axis."""

    rad_per_step: tuple[float, float]
    tilt_rad: FloatArray  # (n,), in the middle of the intervals
    pan_rate_rad_s: FloatArray  # (n,)
    width_s: FloatArray  # (n,)

    @classmethod
    def of_angles(
        cls, angle_rad: FloatArray, edges_s: FloatArray, rad_per_step: tuple[float, float]
    ) -> tuple[FloatArray, Self]:
        """Return the mean stage rate between edges, (n, 3), and its derivative.

        Args:
            angle_rad: pan and tilt at the edges, shape (2, n + 1).
            edges_s: shape (n + 1,).
            rad_per_step: of pan and tilt.
        """
        width = np.diff(edges_s)
        pan_rate, tilt_rate = np.diff(angle_rad, axis=1) / width
        tilt = (angle_rad[1, :-1] + angle_rad[1, 1:]) / 2.0
        jacobian = cls(rad_per_step, tilt, pan_rate, width)
        rate = np.stack([tilt_rate, pan_rate * jacobian.sine, pan_rate * jacobian.cosine])
        return rate.T, jacobian

    @cached_property
    def sine(self) -> FloatArray:
        """Sine of the tilt, shape (n,)."""
        return self._of_tilt(np.sin)

    @cached_property
    def cosine(self) -> FloatArray:
        """Cosine of the tilt, shape (n,)."""
        return self._of_tilt(np.cos)

    def rate(self, axis: int, change_steps: FloatArray, intervals: slice) -> FloatArray:
        """Return the change of the stage rate in `intervals`, from the changes at their edges."""
        angle = self.rad_per_step[axis] * change_steps
        speed = np.diff(angle)
        speed /= self.width_s[intervals]
        # The values of one axis are contiguous, because filters run along the time axis.
        derivative = np.zeros((3, speed.size)).T
        if axis == 0:
            np.multiply(speed, self.sine[intervals], out=derivative[:, 1])
            np.multiply(speed, self.cosine[intervals], out=derivative[:, 2])
            return derivative
        derivative[:, 0] = speed
        angle_term = 0.5 * self.pan_rate_rad_s[intervals] * (angle[:-1] + angle[1:])
        np.multiply(angle_term, self.cosine[intervals], out=derivative[:, 1])
        np.multiply(angle_term, -self.sine[intervals], out=derivative[:, 2])
        return derivative

    @cached_property
    def _constant_runs(self) -> tuple[IntArray, IntArray]:
        """First interval and length of each run of constant tilt."""
        changed = np.flatnonzero(self.tilt_rad[1:] != self.tilt_rad[:-1]) + 1
        first = np.concatenate([[0], changed])[: self.tilt_rad.size]
        return first, np.diff(first, append=self.tilt_rad.size)

    def _of_tilt(self, function: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return a function of the tilt, computed once per run of constant tilt."""
        first, count = self._constant_runs
        if 2 * first.size > self.tilt_rad.size:
            return function(self.tilt_rad)
        return np.repeat(function(self.tilt_rad[first]), count)
