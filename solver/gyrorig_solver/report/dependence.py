"""On what a residual depends: its mean, gain or lag in bins of an angle, a rate, the time.

A gain error that follows an angle has no mean, and a lag that grows has neither: each cause is
looked at by the quantity that it acts on. Every bin is a small regression with its own bar.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.report.course import Course

Quantity = Literal["mean", "gain", "lag"]
LEAST_BLOCKS = 12  # in a bin: fewer give no honest bar
WORM_RAD = 2.0 * np.pi / 17.5  # one turn of the worm (PTU-E46-17.5)


@dataclass(frozen=True, slots=True)
class Dependence:
    """Which quantity against what."""

    quantity: Quantity
    covariate: str
    bins: int = 24
    ranked: bool = False  # as many blocks in each bin: what is seldom large has few bins else


# What shows each cause; those that are not here show in time, close by (see `cause_figures`).
OF_CAUSE = {
    "clock_offset": Dependence("lag", "time"),
    "clock_skew": Dependence("lag", "time"),
    "clock_step": Dependence("lag", "time"),
    "lost_samples": Dependence("lag", "time"),
    "scale_quadratic": Dependence("mean", "own_rate"),
    "scale_cubic": Dependence("mean", "own_rate"),
    "scale_asymmetry": Dependence("mean", "own_rate"),
    "saturation": Dependence("mean", "own_rate"),
    "dead_zone": Dependence("mean", "own_rate", 41),
    "g_sensitivity": Dependence("mean", "tilt"),
    "vibration_rectification": Dependence("mean", "speed"),
    "thermal_bias": Dependence("mean", "temperature"),
    "thermal_scale": Dependence("gain", "temperature", 10),
    "warm_up": Dependence("mean", "time"),
    "bias_ramp": Dependence("mean", "time"),
    "bias_step": Dependence("mean", "time"),
    "bias_random_walk": Dependence("mean", "time"),
    "motor_coupling": Dependence("mean", "speed"),
    "eccentricity": Dependence("gain", "pan"),
    "worm_error": Dependence("gain", "worm"),
    "axis_nonorthogonality": Dependence("gain", "tilt", 10),
    "tilt_zero": Dependence("gain", "tilt", 10),
    "tilt_sag": Dependence("gain", "tilt", 10),
    "step_resolution": Dependence("gain", "tilt", 10),
    "board_slip": Dependence("gain", "time", 12),
    "earth_rotation": Dependence("mean", "pan"),
}
# The covariates of the nameless tests, see `discover.groups`.
OF_SIGNATURE = {
    "time": Dependence("gain", "time"),
    "bias_time": Dependence("mean", "time"),
    "wandering": Dependence("mean", "time"),
    "speed": Dependence("gain", "speed", 12),
    "own_rate": Dependence("mean", "own_rate"),
    "moving_bias": Dependence("mean", "speed", 16),
    "frequency": Dependence("mean", "bend", 16, ranked=True),
    "turning_axis": Dependence("mean", "across", 16, ranked=True),
    "pan_angle": Dependence("gain", "pan"),
    "tilt_angle": Dependence("gain", "tilt", 10),
    "bias_pan": Dependence("mean", "pan"),
    "bias_tilt": Dependence("mean", "tilt", 10),
    "move_gain": Dependence("gain", "time", 40),
    "move_delay": Dependence("lag", "time", 40),
}
LABELS = {
    "time": "seconds",
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
UNITS = {"mean": "deg/s", "gain": "% of the rate", "lag": "ms late"}


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """One sensor axis in bins; those with too little in them are left out."""

    centre: FloatArray  # (m,), in the units of the label
    value: FloatArray  # (m,)
    bar: FloatArray  # (m,), half of the 95 % interval


def in_bins(
    course: Course, left_rad_s: FloatArray, dependence: Dependence, axis: int, motor: int = 0
) -> Bins:
    """Return what a residual of one sensor axis is like along a covariate.

    Args:
        course: rates, angles and temperature.
        left_rad_s: the residual, shape (n, 3), nan where unused.
        dependence: which quantity against what.
        axis: of the sensor.
        motor: 0 pan or 1 tilt: whose rate a gain is measured by.
    """
    at = covariate(course, dependence.covariate, axis, motor)
    left = left_rad_s[:, axis]
    by = _by(course, dependence.quantity, axis, motor)
    known: BoolArray = np.isfinite(at) & np.isfinite(left) & np.isfinite(by)
    if dependence.quantity != "mean":
        known &= np.abs(by) > 0.05 * _largest(by)
    if known.sum() < LEAST_BLOCKS:
        return Bins(np.zeros(0), np.zeros(0), np.zeros(0))
    at, left, by = at[known], left[known], by[known]
    along = (at - at.min()) / max(float(np.ptp(at)), 1e-12)
    if dependence.ranked:
        along = np.argsort(np.argsort(at)) / at.size
    index = np.minimum((along * dependence.bins).astype(np.int64), dependence.bins - 1)
    count = np.bincount(index, minlength=dependence.bins)
    energy = np.bincount(index, by * by, dependence.bins)
    slope = np.bincount(index, by * left, dependence.bins) / np.maximum(energy, 1e-30)
    rest = np.bincount(index, (left - slope[index] * by) ** 2, dependence.bins)
    std = np.sqrt(rest / np.maximum(count - 1, 1) / np.maximum(energy, 1e-30))
    centre = np.bincount(index, at, dependence.bins) / np.maximum(count, 1)
    some = count >= LEAST_BLOCKS
    factor = {"mean": np.degrees(1.0), "gain": 100.0, "lag": -1e3}[dependence.quantity]
    return Bins(centre[some], factor * slope[some], 1.96 * abs(factor) * std[some])


def covariate(course: Course, name: str, axis: int, motor: int = 0) -> FloatArray:
    """Return a covariate in the unit that its label says, shape (n,)."""
    made: dict[str, Callable[[], FloatArray]] = {
        "time": lambda: course.time_s,
        "pan": lambda: np.degrees(course.angle_rad[0]),
        "tilt": lambda: np.degrees(course.angle_rad[1]),
        "worm": lambda: np.degrees(np.mod(course.angle_rad[motor], WORM_RAD)),
        "speed": lambda: np.degrees(np.linalg.norm(course.rate_rad_s, axis=1)),
        "temperature": lambda: course.temperature_degc,
        "bend": lambda: np.degrees(_slope(course, _slope(course, course.base_rad_s)))[:, axis],
        "across": lambda: np.cross(course.base_rad_s, _slope(course, course.base_rad_s))[:, axis],
        "own_rate": lambda: np.degrees(course.base_rad_s[:, axis]),
    }
    return np.asarray(made[name](), dtype=np.float64)


def label(name: str, motor: int = 0) -> str:
    """Return what stands at the abscissa."""
    return LABELS["worm_tilt" if name == "worm" and motor == 1 else name]


def motor_rate_rad_s(course: Course, motor: int) -> FloatArray:
    """Return the rate of pan (0) or tilt (1), shape (n,), from the stage's."""
    if motor == 1:
        return course.rate_rad_s[:, 0]
    tilt = np.nan_to_num(course.angle_rad[1])
    rate = course.rate_rad_s
    return np.asarray(rate[:, 1] * np.sin(tilt) + rate[:, 2] * np.cos(tilt))


def _by(course: Course, quantity: Quantity, axis: int, motor: int) -> FloatArray:
    if quantity == "mean":
        return np.ones(course.time_s.size)
    if quantity == "gain":
        if np.isnan(course.angle_rad).all():  # no motors: of the axis' own rate
            return course.base_rad_s[:, axis]
        return motor_rate_rad_s(course, motor)
    return _slope(course, course.base_rad_s)[:, axis]


def _slope(course: Course, values: FloatArray) -> FloatArray:
    step_s = float(np.median(np.diff(course.time_s)))
    return np.asarray(np.gradient(values, step_s, axis=0), dtype=np.float64)


def _largest(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.abs(known).max()) if known.size else 0.0
