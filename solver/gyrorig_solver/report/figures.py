"""The calibration report's figures, each an SVG text to put into the page."""

from collections.abc import Mapping, Sequence

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.clocks.course import ClockCourse
from gyrorig_solver.estimate.result import FitDiagnostics
from gyrorig_solver.report import drift
from gyrorig_solver.report.drawing import AXIS_COLOURS, BEFORE, SOFT, envelope, stacked
from gyrorig_solver.report.drift import on_grid

_LEAST_RAD = 0.02  # 1 degree; less is one place


def rate_error(data: FitDiagnostics, error_after_rad_s: FloatArray) -> str:
    """Draw the rate error before and after, in deg/s, one panel an axis.

    Args:
        data: of the fit.
        error_after_rad_s: calibrated reading minus stage rate, shape (n, 3).
    """
    figure, panels = stacked(3, 5.4)
    before = data.rate_rad_s - data.reference_rad_s
    for axis, panel in enumerate(panels):
        envelope(panel, data.time_s, np.degrees(before[:, axis]), BEFORE)
        envelope(panel, data.time_s, np.degrees(error_after_rad_s[:, axis]), AXIS_COLOURS[axis])
        panel.ylabel = f"{'xyz'[axis]}  deg/s"
        panel.level(0.0, colour=SOFT, linewidth=0.5)
    panels[-1].xlabel = "seconds"
    return figure.svg()


def angle_error(data: FitDiagnostics, error_after_rad_s: FloatArray) -> str:
    """Draw by how much an integrated angle goes wrong in a time, as it is and calibrated.

    Args:
        data: of the fit.
        error_after_rad_s: calibrated reading minus stage rate, shape (n, 3).
    """
    figure, (panel,) = stacked(1, 3.4)
    before = data.rate_rad_s - data.reference_rad_s
    bias = np.nanmean(np.where(data.moving[:, None], np.nan, before), axis=0)
    lines = (
        (before, BEFORE, "-"),
        (before - bias, BEFORE, "--"),
        (error_after_rad_s, AXIS_COLOURS[2], "-"),
    )
    for error, colour, style in lines:
        if not np.isfinite(error).any():
            continue
        step_s, values = on_grid(data.time_s, error)
        length_s, angle = drift.angle_error(values, step_s)
        panel.plot(length_s, np.degrees(angle), colour=colour, linewidth=1.4, linestyle=style)
    panel.decades = True
    panel.xlabel = "seconds of integration"
    panel.ylabel = "angle error, deg rms"
    return figure.svg()


def allan(data: FitDiagnostics, noise: Mapping[str, Sequence[float | None]]) -> str:
    """Draw the residual's Allan deviation, and that of the noise that was fitted (dashed).

    Args:
        data: of the fit.
        noise: coefficients of the document by name, of each axis.
    """
    figure, (panel,) = stacked(1, 3.4)
    step_s, values = on_grid(data.time_s, data.residual_rad_s)
    tau_s, deviation = drift.allan_deviation(values, step_s)
    names = ("angle_random_walk", "bias_instability", "rate_random_walk")
    for axis in range(3):
        panel.plot(
            tau_s,
            np.degrees(deviation[:, axis]),
            colour=AXIS_COLOURS[axis],
            linewidth=1.1,
            markersize=2.5,
            label="xyz"[axis],
        )
    for axis in range(3):
        known = [noise[name][axis] if noise.get(name) else None for name in names]
        if known[0] is None:
            continue
        fitted = np.degrees(drift.noise_says(tau_s, *known))
        label = "noise fitted" if axis == 0 else ""
        panel.plot(tau_s, fitted, colour=SOFT, linewidth=1.0, linestyle="--", label=label)
    panel.decades = panel.key = True
    panel.xlabel = "averaged over, seconds"
    panel.ylabel = "Allan deviation, deg/s"
    return figure.svg()


def residual_against_angle(data: FitDiagnostics, axis: int) -> str:
    """Draw the mean residual in bins of pan (0) or tilt (1); empty where it hardly moved."""
    if data.angle_rad is None:
        return ""
    angle = data.angle_rad[axis]
    if not np.isfinite(angle).any() or float(np.nanmax(angle) - np.nanmin(angle)) < _LEAST_RAD:
        return ""
    figure, (panel,) = stacked(1, 2.8)
    for sensed in range(3):
        centre, mean, bar = _binned(angle, data.residual_rad_s[:, sensed], 24)
        panel.dots(
            np.degrees(centre),
            np.degrees(mean),
            np.degrees(bar),
            colour=AXIS_COLOURS[sensed],
            linewidth=0.9,
            markersize=3,
            label="xyz"[sensed],
        )
    panel.level(0.0, colour=SOFT, linewidth=0.5)
    panel.xlabel = f"{('pan', 'tilt')[axis]}, deg"
    panel.ylabel = "residual, deg/s"
    panel.key = True
    return figure.svg()


def clock(course: ClockCourse, bound_s: float) -> str:
    """Draw how late samples came, and how far their spacing is from a constant rate.

    Args:
        course: of the board's clock.
        bound_s: what the map is good to.
    """
    figure, panels = stacked(2, 4.0)
    late, wander = panels
    late.band(
        course.time_s, 1e3 * course.late_low_s, 1e3 * course.late_high_s, colour=AXIS_COLOURS[0]
    )
    late.ylabel = "late by, ms"
    wander.plot(course.time_s, 1e6 * course.wander_s, colour=AXIS_COLOURS[2], linewidth=1.2)
    for sign in (-1.0, 1.0):
        wander.level(sign * 1e6 * bound_s, colour=SOFT, linewidth=0.7, linestyle="--")
    wander.ylabel = "wander, µs"
    wander.xlabel = "seconds"
    return figure.svg()


def residual_over_time(data: FitDiagnostics) -> str:
    """Draw what the model left unexplained, in deg/s, one panel an axis."""
    figure, panels = stacked(3, 4.2)
    for axis, panel in enumerate(panels):
        residual = np.degrees(data.residual_rad_s[:, axis])
        envelope(panel, data.time_s, residual, AXIS_COLOURS[axis])
        panel.ylabel = f"{'xyz'[axis]}  deg/s"
        panel.level(0.0, colour=SOFT, linewidth=0.5)
    panels[-1].xlabel = "seconds"
    return figure.svg()


def residual_spectrum(data: FitDiagnostics) -> str:
    """Draw the density of the residual and of the noise assumed, in deg/s/sqrt(Hz)."""
    figure, (panel,) = stacked(1, 3.6)
    for axis in range(3):
        panel.plot(
            data.frequency_hz,
            np.degrees(np.sqrt(data.spectrum[:, axis])),
            colour=AXIS_COLOURS[axis],
            linewidth=0.9,
            label="xyz"[axis],
        )
    for axis in range(3):
        panel.plot(
            data.frequency_hz,
            np.degrees(np.sqrt(data.spectrum_model[:, axis])),
            colour=SOFT,
            linewidth=1.0,
            linestyle="--",
            label="noise assumed" if axis == 0 else "",
        )
    panel.decades = True
    panel.xlabel = "Hz"
    panel.ylabel = "deg/s/sqrt(Hz)"
    panel.key = True
    return figure.svg()


def residual_against_rate(data: FitDiagnostics) -> str:
    """Draw the mean residual in bins of the stage's rate, with 95 % bars: is it linear?"""
    figure, (panel,) = stacked(1, 3.2)
    for axis in range(3):
        centre, mean, bar = _binned(data.reference_rad_s[:, axis], data.residual_rad_s[:, axis])
        panel.dots(
            np.degrees(centre),
            np.degrees(mean),
            np.degrees(bar),
            colour=AXIS_COLOURS[axis],
            linewidth=0.9,
            markersize=3,
            label="xyz"[axis],
        )
    panel.level(0.0, colour=SOFT, linewidth=0.5)
    panel.xlabel = "stage rate about the same axis, deg/s"
    panel.ylabel = "residual, deg/s"
    panel.key = True
    return figure.svg()


def _binned(
    position: FloatArray, value: FloatArray, bins: int = 15
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres, means and 95 % half-widths of `value` in bins of `position`."""
    known = np.isfinite(position) & np.isfinite(value)
    position, value = position[known], value[known]
    edges = np.linspace(position.min() - 1e-9, position.max() + 1e-9, bins + 1)
    index = np.clip(np.digitize(position, edges) - 1, 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    filled = count >= 10  # fewer give no honest bar
    safe = np.maximum(count, 1)
    mean = np.bincount(index, value, bins) / safe
    variance = np.bincount(index, (value - mean[index]) ** 2, bins) / safe
    centre = 0.5 * (edges[1:] + edges[:-1])
    return centre[filled], mean[filled], 1.96 * np.sqrt(variance[filled] / safe[filled])
