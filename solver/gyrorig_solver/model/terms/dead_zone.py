"""Slow rates are not felt.

(G omega)_i counts as zero where its size is below d_i. A threshold of the sensing element,
or a firmware's dead band; 0.1 deg/s is much. One count (0.009 deg/s) is no dead zone: noise
carries the mean across it. In an interval the rate is taken as straight, so that crossings
lie between grid points and the effect has a derivative.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.model.terms.bases import CurvedTerm, scanned
from gyrorig_solver.model.terms.protocol import Link, Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

SHARP = 3.0  # times the changes on either side: a jump (steppers start at a base speed)
STRAIGHT = 1e-6  # of the threshold: a rate that changes less over an interval does not
# Of the threshold: where a rate changes less over an interval it stays on its side of it. A
# fit's step is no derivative there; taken for one, a plateau near the threshold would hold the
# width and the gain to each other a hundred times as tightly as the data do.
PLATEAU = 1e-4


class DeadZone(CurvedTerm):
    """Half width d for x, y, z."""

    cause = "dead_zone"
    part: Part = "sensor"
    link: Link = "threshold"
    reshapes: bool = True
    parameters = (
        TermParameter(
            name="threshold",
            unit="rad/s",
            typical=0.1 * DEG,
            lower=0.0,
            upper=5.0 * DEG,
            prior_std=1.0 * DEG,
            parts=XYZ,
        ),
    )
    confused_with = ("scale_cubic", "motor_coupling")
    excitation = "moves slower than the suspected threshold, about every axis"
    derivative_step = 0.02
    harm = "slow rotation is lost; scale and bias hardly move"

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return what is not felt, (blocks, 3)."""
        rate = scene.sensor_rate_rad_s
        lost = np.zeros_like(rate)
        for axis in np.flatnonzero(values > 0.0):
            own = slice(int(axis), int(axis) + 1)
            lost[:, own] = _not_felt(np.ascontiguousarray(rate[:, own]), values[own])
        return scene.seen(lost)

    def slopes(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative by each width, from the moments alone at which it is passed."""
        rate = scene.sensor_rate_rad_s
        found = np.zeros((3, *rate.shape))
        for axis in np.flatnonzero(values > 0.0):
            here = _Intervals.of(rate[:, axis], float(values[axis]))
            found[axis, :, axis] = here.by_threshold()
        # Where there is none yet the step to a small one is all that there is.
        found = scene.seen(found)
        if np.any(values <= 0.0):
            found[values <= 0.0] = self.columns(scene, values)[values <= 0.0]
        return found

    def passes(self, scene: Scene, values: FloatArray) -> FloatArray | None:
        """Return what shows of a small change of the rate: nothing below the threshold.

        Where the threshold is passed the change also moves the moment of that.
        """
        if not values.any():
            return None
        rate = scene.sensor_rate_rad_s
        found = np.ones_like(rate)
        for axis in np.flatnonzero(values > 0.0):
            found[:, axis] += _Intervals.of(rate[:, axis], float(values[axis])).by_rate()
        return found

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the effect of each axis' width per unit of it, (3, blocks, 3)."""
        if np.any(values <= 0.0):
            return super().directions(scene, values)
        return by_axis(self.effect(scene, values) / values)

    def bank(self, scene: Scene) -> FloatArray:
        """Look from several widths; there is no derivative at zero."""
        return scanned(self, threshold=DEG * np.geomspace(0.05, 4.0, 16))

    def sentence(self, values: FloatArray) -> str:
        """Say the thresholds."""
        return f"rates are not felt below {listed(values / DEG, XYZ, 'deg/s')}"


def _not_felt(rate: FloatArray, threshold: FloatArray) -> FloatArray:
    """Return the mean of -r where |r| < d, else 0, over each interval, shape (n, 3).

    With r straight from r0 to r1 it is (F(r1) - F(r0)) / (r1 - r0), F(r) = -min(|r|, d)^2 / 2.
    Where r jumps inside an interval it is r0 before and r1 after, for the shares of the time
    that give the interval's mean (Harten's subcell resolution, J. Comput. Phys. 83, 1989).
    """
    begin, end, jump = _ends(rate, threshold)
    change = end - begin
    some = np.abs(change) > STRAIGHT * np.maximum(threshold, STRAIGHT)
    width = np.where(some, change, 1.0)
    integral = np.minimum(np.abs(begin), threshold) ** 2 - np.minimum(np.abs(end), threshold) ** 2
    straight = np.where(some, 0.5 * integral / width, _lost(rate, threshold))
    later = np.clip((rate - begin) / width, 0.0, 1.0)
    parted = (1.0 - later) * _lost(begin, threshold) + later * _lost(end, threshold)
    return np.asarray(np.where(jump & some, parted, straight), dtype=np.float64)


def _ends(
    rate: FloatArray, threshold: FloatArray | float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the rate at each interval's begin and end, and whether it jumps inside."""
    padded = np.concatenate([rate[:1], rate[:1], rate, rate[-1:], rate[-1:]])
    rise = np.diff(padded, axis=0)
    before, after = rise[:-3], rise[3:]  # from interval to interval, on either side
    across = padded[3:-1] - padded[1:-3]
    jump = np.abs(across) > SHARP * (np.abs(before) + np.abs(after)) + STRAIGHT * threshold
    begin = np.where(jump, padded[1:-3] + 0.5 * before, padded[2:-2] - 0.25 * across)
    end = np.where(jump, padded[3:-1] - 0.5 * after, padded[2:-2] + 0.25 * across)
    return begin, end, np.asarray(jump, dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class _Intervals:
    """One axis' rate over each interval, for derivatives of `_not_felt`; (n,) each."""

    begin: FloatArray
    end: FloatArray
    later: FloatArray  # share of the interval at its end's rate; nan: it is passed straight
    threshold: float

    @classmethod
    def of(cls, rate: FloatArray, threshold: float) -> Self:
        begin, end, jump = _ends(np.ascontiguousarray(rate), threshold)
        change = end - begin
        some = np.abs(change) > PLATEAU * threshold
        later = np.clip((rate - begin) / np.where(some, change, 1.0), 0.0, 1.0)
        straight = some & ~jump
        begin, end = np.where(some, begin, rate), np.where(some, end, rate)
        return cls(begin, end, np.where(straight, np.nan, later), threshold)

    def by_threshold(self) -> FloatArray:
        """Return the derivative of what is not felt by the threshold, F' / (r1 - r0)."""
        outside = (np.abs(self.begin) > self.threshold).astype(np.float64)
        outside -= np.abs(self.end) > self.threshold
        straight = np.isnan(self.later)
        width = np.where(straight, self.end - self.begin, 1.0)
        return np.where(straight, self.threshold * outside / width, 0.0)

    def by_rate(self) -> FloatArray:
        """Return the derivative of what is not felt by the rate."""
        before = np.abs(self.begin) < self.threshold
        after = np.abs(self.end) < self.threshold
        straight = np.isnan(self.later)
        width = np.where(straight, self.end - self.begin, 1.0)
        passed = (self.begin * before - self.end * after) / width
        return np.where(straight, passed, -(1.0 - self.later) * before - self.later * after)


def _lost(rate: FloatArray, threshold: FloatArray) -> FloatArray:
    return np.where(np.abs(rate) < threshold, -rate, 0.0)


TERM = DeadZone()
