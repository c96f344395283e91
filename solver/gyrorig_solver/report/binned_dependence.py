"""Binned regression: mean, gain or delay of a residual in bins of a covariate.

A gain error that follows an angle has a mean of zero, as has a delay that grows. Therefore each
cause is drawn by the quantity on which it acts. Each bin is a regression with its own interval.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.model import BinnedDependence
from gyrorig_solver.model.cause_categories import Quantity
from gyrorig_solver.report.report_series import ReportSeries

MIN_BLOCKS_PER_BIN = 12  # fewer give no reliable interval
WORM_RAD = 2.0 * np.pi / 17.5  # one turn of the worm (PTU-E46-17.5)

# The covariates of the tests of residual dependence, see `discover.checks.residual_dependence`.
DEPENDENCE_OF_SIGNATURE = {
    "time": BinnedDependence("gain", "time"),
    "bias_time": BinnedDependence("mean", "time"),
    "wandering": BinnedDependence("mean", "time"),
    "motor_heat": BinnedDependence("mean", "time"),
    "speed": BinnedDependence("gain", "speed", 12),
    "own_rate": BinnedDependence("mean", "own_rate"),
    "moving_bias": BinnedDependence("mean", "speed", 16),
    "frequency": BinnedDependence("mean", "bend", 16, ranked=True),
    "turning_axis": BinnedDependence("mean", "across", 16, ranked=True),
    "pan_angle": BinnedDependence("gain", "pan"),
    "tilt_angle": BinnedDependence("gain", "tilt", 10),
    "bias_pan": BinnedDependence("mean", "pan"),
    "bias_tilt": BinnedDependence("mean", "tilt", 10),
    "move_gain": BinnedDependence("gain", "time", 40),
    "move_delay": BinnedDependence("lag", "time", 40),
}
COVARIATE_LABELS = {
    "time": "time, s",
    "pan": "pan, deg",
    "tilt": "tilt, deg",
    "worm": "pan within one turn of the worm, deg",
    "worm_tilt": "tilt within one turn of the worm, deg",
    "speed": "speed, deg/s",
    "own_rate": "rate about the same axis, deg/s",
    "bend": "second derivative of the rate about the same axis, deg/s³",
    "across": "rate across its own change, about the same axis, rad²/s³",
    "temperature": "temperature, °C",
}
QUANTITY_UNITS = {"mean": "deg/s", "gain": "% of the rate", "lag": "ms of delay"}


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """One sensor axis in bins; bins with too few blocks are omitted."""

    centre: FloatArray  # (m,), in the units of the label
    value: FloatArray  # (m,)
    bar: FloatArray  # (m,), half of the 95 % interval


def regress_in_bins(
    series: ReportSeries,
    residual_rad_s: FloatArray,
    dependence: BinnedDependence,
    axis: int,
    motor_axis: int = 0,
) -> Bins:
    """Return the regression of one sensor axis' residual in bins of a covariate.

    Args:
        series: rates, angles and temperature.
        residual_rad_s: the residual, shape (n, 3), nan where unused.
        dependence: which quantity against what.
        axis: of the sensor.
        motor_axis: 0 pan or 1 tilt; a gain is relative to the rate of this axis.
    """
    position = covariate(series, dependence.covariate, axis, motor_axis)
    residual = residual_rad_s[:, axis]
    regressor = _regressor(series, dependence.quantity, axis, motor_axis)
    known: BoolArray = np.isfinite(position) & np.isfinite(residual) & np.isfinite(regressor)
    if dependence.quantity != "mean":
        known &= np.abs(regressor) > 0.05 * _largest(regressor)
    if known.sum() < MIN_BLOCKS_PER_BIN:
        return Bins(np.zeros(0), np.zeros(0), np.zeros(0))
    position, residual, regressor = position[known], residual[known], regressor[known]
    share = (position - position.min()) / max(float(np.ptp(position)), 1e-12)
    if dependence.ranked:
        share = np.argsort(np.argsort(position)) / position.size
    index = np.minimum((share * dependence.bins).astype(np.int64), dependence.bins - 1)
    count = np.bincount(index, minlength=dependence.bins)
    energy = np.bincount(index, regressor * regressor, dependence.bins)
    slope = np.bincount(index, regressor * residual, dependence.bins) / np.maximum(energy, 1e-30)
    squared_error = np.bincount(index, (residual - slope[index] * regressor) ** 2, dependence.bins)
    std = np.sqrt(squared_error / np.maximum(count - 1, 1) / np.maximum(energy, 1e-30))
    centre = np.bincount(index, position, dependence.bins) / np.maximum(count, 1)
    is_filled = count >= MIN_BLOCKS_PER_BIN
    factor = {"mean": np.degrees(1.0), "gain": 100.0, "lag": -1e3}[dependence.quantity]
    return Bins(centre[is_filled], factor * slope[is_filled], 1.96 * abs(factor) * std[is_filled])


def covariate(series: ReportSeries, name: str, axis: int, motor_axis: int = 0) -> FloatArray:
    """Return a covariate in the unit of its label, shape (n,)."""
    covariates: dict[str, Callable[[], FloatArray]] = {
        "time": lambda: series.time_s,
        "pan": lambda: np.degrees(series.angle_rad[0]),
        "tilt": lambda: np.degrees(series.angle_rad[1]),
        "worm": lambda: np.degrees(np.mod(series.angle_rad[motor_axis], WORM_RAD)),
        "speed": lambda: np.degrees(np.linalg.norm(series.rate_rad_s, axis=1)),
        "temperature": lambda: series.temperature_degc,
        "bend": lambda: np.degrees(
            _time_derivative(series, _time_derivative(series, series.base_rad_s))
        )[:, axis],
        "across": lambda: np.cross(series.base_rad_s, _time_derivative(series, series.base_rad_s))[
            :, axis
        ],
        "own_rate": lambda: np.degrees(series.base_rad_s[:, axis]),
    }
    return np.asarray(covariates[name](), dtype=np.float64)


def covariate_label(name: str, motor_axis: int = 0) -> str:
    """Return the label of the x-axis."""
    return COVARIATE_LABELS["worm_tilt" if name == "worm" and motor_axis == 1 else name]


def motor_rate_rad_s(series: ReportSeries, motor_axis: int) -> FloatArray:
    """Return the rate of pan (0) or tilt (1), shape (n,), from the stage's."""
    if motor_axis == 1:
        return series.rate_rad_s[:, 0]
    tilt = np.nan_to_num(series.angle_rad[1])
    rate = series.rate_rad_s
    return np.asarray(rate[:, 1] * np.sin(tilt) + rate[:, 2] * np.cos(tilt))


def _regressor(series: ReportSeries, quantity: Quantity, axis: int, motor_axis: int) -> FloatArray:
    if quantity == "mean":
        return np.ones(series.time_s.size)
    if quantity == "gain":
        if np.isnan(series.angle_rad).all():  # no motors: of the axis' own rate
            return series.base_rad_s[:, axis]
        return motor_rate_rad_s(series, motor_axis)
    return _time_derivative(series, series.base_rad_s)[:, axis]


def _time_derivative(series: ReportSeries, values: FloatArray) -> FloatArray:
    step_s = float(np.median(np.diff(series.time_s)))
    return np.asarray(np.gradient(values, step_s, axis=0), dtype=np.float64)


def _largest(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.abs(known).max()) if known.size else 0.0
