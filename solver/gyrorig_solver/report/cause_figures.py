"""Figures of the explain report: causes with the data, residuals before and after.

What to use when: `cause_figure` for a named cause, `unexplained_figure` for the unexplained
residual, `residual_over_time`, `residual_spectrum` and `dependence_figures` for all of it.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model import XYZ, BinnedDependence
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.report.binned_dependence import (
    DEPENDENCE_OF_SIGNATURE,
    MIN_BLOCKS_PER_BIN,
    QUANTITY_UNITS,
    Bins,
    covariate_label,
    regress_in_bins,
)
from gyrorig_solver.report.figure_layout import (
    AXIS_COLOURS,
    BEFORE,
    INK,
    SOFT,
    draw_rates_over_time,
    finish_spectrum,
    stacked_panels,
)
from gyrorig_solver.report.report_series import ReportSeries

WITHOUT_CAUSE, WITH_CAUSE = "without the cause", "with the cause"
EFFECT_GROUPS = 14  # groups of equal size in `residual_by_effect`
CLOSE_UP_S, EVENT_S = 1.4, 0.3  # of a close-up, and of the event in its middle


def cause_figure(series: ReportSeries, cause: str, key: str, components: Sequence[str]) -> str:
    """Draw one cause: data, and the models without and with it, against its covariate."""
    term = catalogue().get(cause)
    dependence = term.picture if term is not None else None
    effect = series.effects[key]
    axis = strongest_axis(effect)
    motor_axis = 1 if "tilt" in components and "pan" not in components else 0
    if dependence == BinnedDependence("gain", "pan") and motor_axis == 1:
        dependence = BinnedDependence("gain", "tilt")
    if dependence is None:
        return _figure_without_dependence(series, effect, key, axis)
    data = regress_in_bins(series, series.residual_without(key), dependence, axis, motor_axis)
    model = regress_in_bins(series, effect, dependence, axis, motor_axis)
    if data.centre.size < 3:
        return _figure_without_dependence(series, effect, key, axis)
    return _draw_two_models(
        data,
        model,
        axis,
        covariate_label(dependence.covariate, motor_axis),
        f"residual {XYZ[axis]}, {QUANTITY_UNITS[dependence.quantity]}",
    )


def _draw_two_models(data: Bins, model: Bins, axis: int, xlabel: str, ylabel: str) -> str:
    """Draw data with their intervals, and the models without and with a cause."""
    figure, (panel,) = stacked_panels(1, 3.4)
    panel.dots(
        data.centre,
        data.value,
        data.bar,
        colour=INK,
        bar_colour=BEFORE,
        linewidth=0.0,
        markersize=4,
        label="data",
    )
    panel.level(0.0, colour=SOFT, linewidth=1.1, linestyle="--", label=WITHOUT_CAUSE)
    panel.plot(
        model.centre, model.value, colour=AXIS_COLOURS[axis], linewidth=1.8, label=WITH_CAUSE
    )
    panel.name_axes(xlabel, ylabel)
    return figure.svg()


def _figure_without_dependence(
    series: ReportSeries, effect: FloatArray, key: str, axis: int
) -> str:
    """Draw a cause that has no covariate, or too little data against it."""
    if np.isfinite(series.angle_rad).any():
        return close_up_figure(series, effect, axis)
    return residual_by_effect(series, effect, key, axis)


def residual_by_effect(series: ReportSeries, effect: FloatArray, key: str, axis: int) -> str:
    """Draw the residual without a cause against the effect that the cause predicts.

    For motion by hand, where an effect is visible only on average.
    """
    predicted = np.degrees(effect[:, axis])
    residual = np.degrees(series.residual_without(key)[:, axis])
    known = np.isfinite(predicted) & np.isfinite(residual)
    order = np.argsort(predicted[known])
    groups = np.array_split(order, min(EFFECT_GROUPS, max(1, order.size // MIN_BLOCKS_PER_BIN)))
    centre = np.array([predicted[known][rows].mean() for rows in groups])
    value = np.array([residual[known][rows].mean() for rows in groups])
    bar = np.array([1.96 * residual[known][rows].std() / np.sqrt(rows.size) for rows in groups])
    return _draw_two_models(
        Bins(centre, value, bar),
        Bins(centre, centre, bar),
        axis,
        f"predicted effect {XYZ[axis]}, deg/s",
        f"residual {XYZ[axis]} without the cause, deg/s",
    )


def close_up_figure(series: ReportSeries, effect: FloatArray, axis: int) -> str:
    """Draw the time around the largest effect of a cause: rates and residuals.

    All other causes are in both models.
    """
    rows = _rows_around_event(series, effect[:, axis])
    time_s = series.time_s[rows]
    figure, (above, below) = stacked_panels(2, 4.6)
    above.plot(
        time_s,
        np.degrees(series.measured_rad_s[rows, axis]),
        colour=INK,
        linewidth=0.0,
        markersize=2.4,
        label="data",
    )
    for values, colour, style, words in (
        (series.extended_rad_s - effect, SOFT, "--", WITHOUT_CAUSE),
        (series.extended_rad_s, AXIS_COLOURS[axis], "-", WITH_CAUSE),
    ):
        above.plot(
            time_s,
            np.degrees(values[rows, axis]),
            colour=colour,
            linewidth=1.3,
            linestyle=style,
            label=words,
        )
    above.ylabel = f"{XYZ[axis]}  deg/s"
    above.has_key = True
    below.plot(
        time_s,
        np.degrees((series.extended_residual_rad_s + effect)[rows, axis]),
        colour=BEFORE,
        linewidth=1.2,
        markersize=2.2,
        label=f"residual {WITHOUT_CAUSE}",
    )
    below.plot(
        time_s,
        np.degrees(series.extended_residual_rad_s[rows, axis]),
        colour=AXIS_COLOURS[axis],
        linewidth=1.2,
        markersize=2.2,
        label=f"residual {WITH_CAUSE}",
    )
    below.level(0.0, colour=SOFT, linewidth=0.5)
    below.name_axes("time, s", "residual, deg/s")
    return figure.svg()


def unexplained_figure(series: ReportSeries, signature: str, axis: int | None) -> str:
    """Draw the unexplained residual against the covariate on which it depends most."""
    residual = series.unexplained_residual_rad_s
    if signature == "line":
        return residual_spectrum(series)
    dependence = DEPENDENCE_OF_SIGNATURE.get(signature)
    if dependence is None:
        return residual_over_time(series)
    motor_axis = 1 if signature.startswith("tilt") else 0
    figure, (panel,) = stacked_panels(1, 3.4)
    axes = range(3) if axis is None else (axis,)
    for sensor_axis in axes:
        bins = regress_in_bins(series, residual, dependence, sensor_axis, motor_axis)
        panel.dots(
            bins.centre,
            bins.value,
            bins.bar,
            colour=AXIS_COLOURS[sensor_axis],
            linewidth=1.0,
            markersize=3.5,
            label=XYZ[sensor_axis],
        )
    panel.level(0.0, colour=SOFT, linewidth=0.8)
    panel.name_axes(
        covariate_label(dependence.covariate, motor_axis),
        f"residual, {QUANTITY_UNITS[dependence.quantity]}",
    )
    return figure.svg()


def residual_over_time(series: ReportSeries) -> str:
    """Draw the residuals of both models, in deg/s, one panel per axis."""
    before = [(series.base_residual_rad_s, BEFORE)] if series.effects else []
    layers = [*before, (series.extended_residual_rad_s, None)]
    return draw_rates_over_time(series.time_s, layers, 5.0)


def residual_spectrum(series: ReportSeries) -> str:
    """Draw the spectral densities of both models' residuals, and of the noise model."""
    figure, (panel,) = stacked_panels(1, 3.6)
    for axis in range(3):
        before = [(series.spectrum_base, BEFORE, 1.4)] if series.effects else []
        for density, colour, width in (
            *before,
            (series.spectrum_extended, AXIS_COLOURS[axis], 1.0),
        ):
            panel.plot(
                series.frequency_hz,
                np.degrees(np.sqrt(density[:, axis])),
                colour=colour,
                linewidth=width,
                label=XYZ[axis] if colour != BEFORE else "base model" * (axis == 0),
            )
    finish_spectrum(panel, series.frequency_hz, series.spectrum_model, 0.9)
    return figure.svg()


def dependence_figures(series: ReportSeries) -> dict[str, str]:
    """Draw the residuals of both models against every covariate, by name."""
    figures = {}
    for name, dependence in (
        ("own_rate", BinnedDependence("mean", "own_rate")),
        ("pan", BinnedDependence("gain", "pan")),
        ("tilt", BinnedDependence("gain", "tilt", 10)),
        ("time", BinnedDependence("lag", "time", 16)),
        ("temperature", BinnedDependence("mean", "temperature", 12)),
    ):
        # The axis of most motion, or of the largest residual.
        is_mean = dependence.quantity == "mean"
        rate_rad_s = series.base_residual_rad_s if is_mean else series.base_rad_s
        axis = int(np.argmax(np.nanvar(rate_rad_s, axis=0)))
        before = regress_in_bins(series, series.base_residual_rad_s, dependence, axis)
        after = regress_in_bins(series, series.extended_residual_rad_s, dependence, axis)
        if before.centre.size < 3:
            continue
        figure, (panel,) = stacked_panels(1, 2.7)
        # Without a cause there is only one model.
        pairs = [(before, BEFORE, "base model")] if series.effects else []
        final_label = "extended model" if series.effects else "base model"
        for bins, colour, words in (*pairs, (after, AXIS_COLOURS[axis], final_label)):
            panel.dots(
                bins.centre,
                bins.value,
                bins.bar,
                colour=colour,
                linewidth=1.0,
                markersize=3,
                label=words,
            )
        panel.level(0.0, colour=SOFT, linewidth=0.6)
        panel.name_axes(
            covariate_label(dependence.covariate),
            f"residual {XYZ[axis]}, {QUANTITY_UNITS[dependence.quantity]}",
        )
        figures[name] = figure.svg()
    return figures


def strongest_axis(effect: FloatArray) -> int:
    """Return the sensor axis on which an effect (n, 3) has most energy about its mean."""
    known = effect[np.isfinite(effect).all(axis=1)]
    return int(np.argmax(np.var(known, axis=0))) if known.size else 2


def _rows_around_event(series: ReportSeries, change: FloatArray) -> slice:
    """Return the rows around the moment where a change (n,) has most energy."""
    step_s = float(np.median(np.diff(series.time_s)))
    event_blocks = max(4, min(change.size, round(EVENT_S / step_s)))
    power = np.nan_to_num(change - np.nanmedian(change)) ** 2
    cumulative_power = np.concatenate([[0.0], np.cumsum(power)])
    event = int(np.argmax(cumulative_power[event_blocks:] - cumulative_power[:-event_blocks]))
    margin = round((CLOSE_UP_S - EVENT_S) / 2.0 / step_s)
    return slice(max(0, event - margin), min(change.size, event + event_blocks + margin))
