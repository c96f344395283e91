"""Dead band: slow rates are not measured.

(G omega)_i counts as zero if its magnitude is below d_i. A threshold of the sensing element or a
dead band in the firmware causes it; 0.1 deg/s is large. One count (0.009 deg/s) is not a dead band,
because noise carries the mean across it. Within an interval the rate is treated as linear in time,
so that crossings are between grid points and the effect has a derivative.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.model.cause_categories import RATE_COVARIATES
from gyrorig_solver.model.signal_arrays import split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import NonlinearTerm, scan_grid
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

JUMP_RATIO = 3.0  # of a change over the adjacent changes: a stepper starts at its base speed
MIN_RELATIVE_CHANGE = 1e-6  # of the threshold: a smaller change over an interval counts as none
# Relative to the threshold. If the rate changes less over an interval, it stays on one side of the
# threshold and the effect has no derivative. A finite difference there would constrain the width
# relative to the gain a hundred times as tightly as the data do.
PLATEAU_RELATIVE_CHANGE = 1e-4


class DeadZone(NonlinearTerm):
    """The half width d for x, y, z."""

    cause = "dead_zone"
    title = "Slow rotation is not measured (dead band)"
    equation = "y_i = 0 where |(G omega)_i| < threshold_i"
    part = "sensor"
    stage = "threshold"
    depends_on_upstream = True
    parameters = (
        size_parameter(
            "threshold", "rad/s", XYZ, typical=0.1, lower=0.0, limit=5.0, prior_std=1.0, factor=DEG
        ),
    )
    confused_with = ("scale_cubic", "motor_coupling")
    remedy = (
        "check the board's firmware for a filter or a threshold, or let `gyrorig solve` fit this "
        "cause"
    )
    file_remedy = "let `gyrorig solve` fit this cause"
    covariates = RATE_COVARIATES
    picture = BinnedDependence("mean", "own_rate", 41)
    excitation = "moves slower than the suspected threshold, about every axis"
    derivative_step = 0.02
    effect_if_ignored = "slow rotation is lost; scale factors and biases hardly change"

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the lost rate, (blocks, 3)."""
        rate = state.sensor_rate_rad_s
        loss = np.zeros_like(rate)
        for axis in np.flatnonzero(values > 0.0):
            column = slice(int(axis), int(axis) + 1)
            loss[:, column] = _dead_zone_loss(np.ascontiguousarray(rate[:, column]), values[column])
        return state.measure_sensor_rate(loss)

    def local_jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivatives by each width at the crossings only, (3, blocks, 3)."""
        rate = state.sensor_rate_rad_s
        derivatives = np.zeros((3, *rate.shape))
        for axis in np.flatnonzero(values > 0.0):
            intervals = _RateIntervals.of(rate[:, axis], float(values[axis]))
            derivatives[axis, :, axis] = intervals.derivative_by_threshold()
        # At a width of zero, only the finite difference to a small width exists.
        derivatives = state.measure_sensor_rate(derivatives)
        if np.any(values <= 0.0):
            derivatives[values <= 0.0] = self.jacobian(state, values)[values <= 0.0]
        return derivatives

    def incremental_gain(self, state: SignalState, values: FloatArray) -> FloatArray | None:
        """Return d(output)/d(rate), (n, 3): zero below the threshold.

        At a crossing the change also moves the time of the crossing.
        """
        if not values.any():
            return None
        rate = state.sensor_rate_rad_s
        gain = np.ones_like(rate)
        for axis in np.flatnonzero(values > 0.0):
            gain[:, axis] += _RateIntervals.of(
                rate[:, axis], float(values[axis])
            ).derivative_by_rate()
        return gain

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the effect of each axis' width per unit of width, (3, blocks, 3)."""
        if np.any(values <= 0.0):
            return super().tangent_signals(state, values)
        return split_axes(self.effect(state, values) / values)

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan several widths; there is no derivative at zero."""
        return scan_grid(self, threshold=DEG * np.geomspace(0.05, 4.0, 16))

    def describe(self, values: FloatArray) -> str:
        return f"rates are not measured below {format_list(values / DEG, XYZ, 'deg/s')}"


def _dead_zone_loss(rate: FloatArray, threshold: FloatArray) -> FloatArray:
    """Return the mean of -r where |r| < d, else 0, over each interval, shape (n, 3).

    With r linear from r0 to r1 it is (F(r1) - F(r0)) / (r1 - r0), F(r) = -min(|r|, d)^2 / 2. If r
    jumps inside an interval, it is r0 before and r1 after the jump, for the shares of the time that
    give the interval's mean (Harten's subcell resolution, J. Comput. Phys. 83, 1989).
    """
    begin, end, jump = _interval_ends(rate, threshold)
    change = end - begin
    changes = np.abs(change) > MIN_RELATIVE_CHANGE * np.maximum(threshold, MIN_RELATIVE_CHANGE)
    width = np.where(changes, change, 1.0)
    integral = np.minimum(np.abs(begin), threshold) ** 2 - np.minimum(np.abs(end), threshold) ** 2
    linear_mean = np.where(changes, 0.5 * integral / width, _pointwise_loss(rate, threshold))
    share_at_end = np.clip((rate - begin) / width, 0.0, 1.0)
    split_mean = (1.0 - share_at_end) * _pointwise_loss(
        begin, threshold
    ) + share_at_end * _pointwise_loss(end, threshold)
    return np.asarray(np.where(jump & changes, split_mean, linear_mean), dtype=np.float64)


def _interval_ends(
    rate: FloatArray, threshold: FloatArray | float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the rate at the beginning and end of each interval, and whether it jumps inside."""
    padded = np.concatenate([rate[:1], rate[:1], rate, rate[-1:], rate[-1:]])
    rise = np.diff(padded, axis=0)
    before, after = rise[:-3], rise[3:]  # from interval to interval, before and after
    span = padded[3:-1] - padded[1:-3]
    jumps = (
        np.abs(span)
        > JUMP_RATIO * (np.abs(before) + np.abs(after)) + MIN_RELATIVE_CHANGE * threshold
    )
    begin = np.where(jumps, padded[1:-3] + 0.5 * before, padded[2:-2] - 0.25 * span)
    end = np.where(jumps, padded[3:-1] - 0.5 * after, padded[2:-2] + 0.25 * span)
    return begin, end, np.asarray(jumps, dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class _RateIntervals:
    """The rate of one axis over each interval, for derivatives of `_dead_zone_loss`; (n,) each."""

    begin: FloatArray
    end: FloatArray
    share_at_end: FloatArray  # share of the interval at its final rate; nan: the rate is linear
    threshold: float

    @classmethod
    def of(cls, rate: FloatArray, threshold: float) -> Self:
        begin, end, jump = _interval_ends(np.ascontiguousarray(rate), threshold)
        change = end - begin
        changes = np.abs(change) > PLATEAU_RELATIVE_CHANGE * threshold
        share_at_end = np.clip((rate - begin) / np.where(changes, change, 1.0), 0.0, 1.0)
        is_linear = changes & ~jump
        begin, end = np.where(changes, begin, rate), np.where(changes, end, rate)
        return cls(begin, end, np.where(is_linear, np.nan, share_at_end), threshold)

    def derivative_by_threshold(self) -> FloatArray:
        outside = (np.abs(self.begin) > self.threshold).astype(np.float64)
        outside -= np.abs(self.end) > self.threshold
        is_linear = np.isnan(self.share_at_end)
        width = np.where(is_linear, self.end - self.begin, 1.0)
        return np.where(is_linear, self.threshold * outside / width, 0.0)

    def derivative_by_rate(self) -> FloatArray:
        begins_inside = np.abs(self.begin) < self.threshold
        ends_inside = np.abs(self.end) < self.threshold
        is_linear = np.isnan(self.share_at_end)
        width = np.where(is_linear, self.end - self.begin, 1.0)
        crossing = (self.begin * begins_inside - self.end * ends_inside) / width
        return np.where(
            is_linear,
            crossing,
            -(1.0 - self.share_at_end) * begins_inside - self.share_at_end * ends_inside,
        )


def _pointwise_loss(rate: FloatArray, threshold: FloatArray) -> FloatArray:
    return np.where(np.abs(rate) < threshold, -rate, 0.0)


TERM = DeadZone()
