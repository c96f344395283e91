"""The calibration report's figures, each an SVG text to put into the page."""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.result import FitDiagnostics
from gyrorig_solver.report.drawing import AXIS_COLOURS, BEFORE, SOFT, envelope, stacked


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
