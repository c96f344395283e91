"""Figures of the calibration report, each as an SVG text.

What to use when: `draw_figures` for all figures of a fit. The page omits empty ones.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.calibration import TemperatureRecord, bias_curve
from gyrorig_solver.data import FloatArray, TemperatureCurve
from gyrorig_solver.data.clocks.clock_trace import ClockTrace
from gyrorig_solver.estimate import FitDiagnostics
from gyrorig_solver.report import integration_error
from gyrorig_solver.report.figure_layout import (
    AXIS_COLOURS,
    BEFORE,
    SOFT,
    draw_rates_over_time,
    finish_spectrum,
    stacked_panels,
)
from gyrorig_solver.report.integration_error import to_uniform_grid
from gyrorig_solver.report.report_data import ReportData

_MIN_RANGE_RAD = 0.02  # 1 degree; an axis that turned less is not drawn
_MOTION_RAD_S = 0.01  # slower is rest
CURVE_POINTS = 120
COVERAGE_FACTOR = 1.96
HEIGHT_INCH = 6.4
BRANCHES = ((True, "heating"), (False, "cooling"), (None, "value"))


@dataclass(frozen=True, slots=True)
class FigureSet:
    """SVG texts; empty where there are no data."""

    angle_error: str = ""
    rate_error: str = ""
    residual: str = ""
    spectrum: str = ""
    allan: str = ""
    linearity: str = ""
    pan: str = ""
    tilt: str = ""
    clock: str = ""


def draw_figures(data: ReportData, inverse_gain: FloatArray) -> FigureSet | None:
    """Return the figures of one fit, None if it has no arrays.

    Args:
        data: of the report.
        inverse_gain: shape (3, 3), the identity if the sensor matrix is not known.
    """
    fit = data.diagnostics
    if fit is None:
        return None
    has_motion = float(np.nanmax(np.abs(fit.reference_rad_s))) > _MOTION_RAD_S
    error_after_rad_s = fit.residual_rad_s @ inverse_gain.T
    clock_course = None if data.clock is None else data.clock.course
    noise = {name: figure.value for name, figure in data.calibration.noise.items()}
    return FigureSet(
        angle_error=angle_error_figure(fit, error_after_rad_s),
        rate_error=rate_error_figure(fit, error_after_rad_s),
        residual=residual_figure(fit),
        spectrum=spectrum_figure(fit),
        allan=allan_figure(fit, noise),
        linearity=residual_by_rate_figure(fit) if has_motion else "",
        pan=residual_by_angle_figure(fit, 0) if has_motion else "",
        tilt=residual_by_angle_figure(fit, 1) if has_motion else "",
        clock=""
        if clock_course is None or data.clock is None
        else clock_figure(clock_course, data.clock.wander_bound_s),
    )


def rate_error_figure(data: FitDiagnostics, error_after_rad_s: FloatArray) -> str:
    """Draw the rate error before and after calibration, in deg/s, one panel per axis.

    Args:
        data: of the fit.
        error_after_rad_s: calibrated reading minus stage rate, shape (n, 3).
    """
    before = data.rate_rad_s - data.reference_rad_s
    return draw_rates_over_time(data.time_s, [(before, BEFORE), (error_after_rad_s, None)], 5.4)


def angle_error_figure(data: FitDiagnostics, error_after_rad_s: FloatArray) -> str:
    """Draw the rms angle error against the integration time, uncalibrated and calibrated.

    Args:
        data: of the fit.
        error_after_rad_s: calibrated reading minus stage rate, shape (n, 3).
    """
    figure, (panel,) = stacked_panels(1, 3.4)
    before = data.rate_rad_s - data.reference_rad_s
    at_rest = before[~data.moving]
    has_rest = np.isfinite(at_rest).any(axis=0).all()
    bias = np.nanmean(at_rest, axis=0) if has_rest else np.full(3, np.nan)
    lines = (
        (before, BEFORE, "-"),
        (before - bias, BEFORE, "--"),
        (error_after_rad_s, AXIS_COLOURS[2], "-"),
    )
    for error, colour, style in lines:
        if not np.isfinite(error).any():
            continue
        step_s, values = to_uniform_grid(data.time_s, error)
        length_s, angle = integration_error.angle_error(values, step_s)
        panel.plot(length_s, np.degrees(angle), colour=colour, linewidth=1.4, linestyle=style)
    panel.is_logarithmic = True
    panel.xlabel = "integration time, s"
    panel.ylabel = "angle error, deg rms"
    return figure.svg()


def allan_figure(data: FitDiagnostics, noise: Mapping[str, Sequence[float | None]]) -> str:
    """Draw the Allan deviation of the residual, and that of the fitted noise model (dashed)."""
    figure, (panel,) = stacked_panels(1, 3.4)
    step_s, values = to_uniform_grid(data.time_s, data.residual_rad_s)
    tau_s, deviation = integration_error.allan_deviation(values, step_s)
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
        coefficients = [noise[name][axis] if noise.get(name) else None for name in names]
        if coefficients[0] is None:
            continue
        floor = noise["noise_floor"][axis] if noise.get("noise_floor") else None
        coefficients[0] = math.hypot(coefficients[0], floor or 0.0)
        modelled = np.degrees(integration_error.modelled_allan_deviation(tau_s, *coefficients))
        label = "noise model" if axis == 0 else ""
        panel.plot(tau_s, modelled, colour=SOFT, linewidth=1.0, linestyle="--", label=label)
    panel.is_logarithmic = True
    panel.name_axes("averaging time, s", "Allan deviation, deg/s")
    return figure.svg()


def residual_by_angle_figure(data: FitDiagnostics, axis: int) -> str:
    """Draw the mean residual in bins of pan (0) or tilt (1); empty if the axis did not turn."""
    if data.angle_rad is None:
        return ""
    angle = data.angle_rad[axis]
    if not np.isfinite(angle).any() or float(np.nanmax(angle) - np.nanmin(angle)) < _MIN_RANGE_RAD:
        return ""
    label = f"{('pan', 'tilt')[axis]}, deg"
    return _residual_in_bins(data, [angle] * 3, 24, 2.8, label)


def clock_figure(course: ClockTrace, bound_s: float) -> str:
    """Draw the latency of the samples, and the wander of their times from a constant rate."""
    figure, panels = stacked_panels(2, 4.0)
    late_panel, wander_panel = panels
    late_panel.band(
        course.time_s,
        1e3 * course.min_latency_s,
        1e3 * course.max_latency_s,
        colour=AXIS_COLOURS[0],
    )
    late_panel.ylabel = "latency, ms"
    wander_panel.plot(course.time_s, 1e6 * course.wander_s, colour=AXIS_COLOURS[2], linewidth=1.2)
    for sign in (-1.0, 1.0):
        wander_panel.level(sign * 1e6 * bound_s, colour=SOFT, linewidth=0.7, linestyle="--")
    wander_panel.ylabel = "wander, µs"
    wander_panel.xlabel = "time, s"
    return figure.svg()


def residual_figure(data: FitDiagnostics) -> str:
    """Draw the residual over time, in deg/s, one panel per axis."""
    return draw_rates_over_time(data.time_s, [(data.residual_rad_s, None)], 4.2)


def spectrum_figure(data: FitDiagnostics) -> str:
    """Draw the amplitude spectral density of the residual and the noise model, deg/s/sqrt(Hz)."""
    figure, (panel,) = stacked_panels(1, 3.6)
    for axis in range(3):
        panel.plot(
            data.frequency_hz,
            np.degrees(np.sqrt(data.spectrum[:, axis])),
            colour=AXIS_COLOURS[axis],
            linewidth=0.9,
            label="xyz"[axis],
        )
    finish_spectrum(panel, data.frequency_hz, data.spectrum_model, 1.0)
    return figure.svg()


def residual_by_rate_figure(data: FitDiagnostics) -> str:
    """Draw the mean residual in bins of the stage's rate, with 95 % intervals."""
    label = "reference rate about the axis, deg/s"
    return _residual_in_bins(data, list(data.reference_rad_s.T), 15, 3.2, label)


def _residual_in_bins(
    data: FitDiagnostics, position: Sequence[FloatArray], bins: int, height_inch: float, label: str
) -> str:
    """Draw the mean residual of each axis in bins of its `position`, (n,), in rad or rad/s."""
    figure, (panel,) = stacked_panels(1, height_inch)
    for axis in range(3):
        centre, mean, bar = _binned(position[axis], data.residual_rad_s[:, axis], bins)
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
    panel.name_axes(label, "residual, deg/s")
    return figure.svg()


def _binned(
    position: FloatArray, value: FloatArray, bins: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres, means and 95 % half-widths of `value` in bins of `position`."""
    known = np.isfinite(position) & np.isfinite(value)
    position, value = position[known], value[known]
    edges = np.linspace(position.min() - 1e-9, position.max() + 1e-9, bins + 1)
    index = np.clip(np.digitize(position, edges) - 1, 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    filled = count >= 10  # fewer give no reliable interval
    safe = np.maximum(count, 1)
    mean = np.bincount(index, value, bins) / safe
    variance = np.bincount(index, (value - mean[index]) ** 2, bins) / safe
    centre = 0.5 * (edges[1:] + edges[:-1])
    return centre[filled], mean[filled], 1.96 * np.sqrt(variance[filled] / safe[filled])


def temperature_figure(record: TemperatureRecord, bias_rad_s: FloatArray) -> str:
    """Draw the bias of each axis against the temperature; empty without a curve.

    Args:
        record: of the calibration.
        bias_rad_s: at the reference temperature, shape (3,).
    """
    curve = bias_curve(record)
    if curve is None or record.bias is None:
        return ""
    low, high = record.range_degc
    degc = np.linspace(low, high, CURVE_POINTS)
    value = np.degrees(bias_rad_s + curve.change(degc))
    half = COVERAGE_FACTOR * np.degrees(curve_std(curve, np.array(record.bias.covariance), degc))
    figure, panels = stacked_panels(3, HEIGHT_INCH)
    for axis, panel in enumerate(panels):
        panel.band(
            degc, value[:, axis] - half[:, axis], value[:, axis] + half[:, axis], colour=BEFORE
        )
        panel.plot(degc, value[:, axis], colour=BEFORE, linewidth=1.4, label="curve")
        for branch, label in BRANCHES:
            points = [point for point in record.points if point.heating is branch]
            if points:
                panel.plot(
                    np.array([point.temperature_degc for point in points]),
                    np.degrees(np.array([point.bias[axis] for point in points])),
                    colour=AXIS_COLOURS[0 if branch else 2],
                    linewidth=0.0,
                    linestyle="",
                    markersize=4.0,
                    label=label,
                )
        panel.name_axes("temperature, °C", f"bias {'xyz'[axis]}, deg/s")
    return figure.svg()


def curve_std(curve: TemperatureCurve, covariance: FloatArray, degc: FloatArray) -> FloatArray:
    """Return the standard uncertainty of a curve with its value at the reference, (n, 3).

    Args:
        curve: of the section.
        covariance: of the coefficients, the knots' ones and the value, (3, q + 1, q + 1).
        degc: temperatures, (n,).
    """
    rise = degc - curve.reference_degc
    powers = rise[:, None] ** np.arange(1, len(curve.coefficients) + 1)
    bends = np.maximum(degc[:, None] - curve.knots_degc, 0.0) ** 3
    bends -= np.maximum(curve.reference_degc - curve.knots_degc, 0.0) ** 3
    design = np.concatenate([powers, bends, np.ones((degc.size, 1))], axis=1)
    variance = np.einsum("ni,aij,nj->na", design, covariance, design)
    return np.asarray(np.sqrt(np.clip(variance, 0.0, None)), dtype=np.float64)
