"""The figures of the page of a check: measured values over the band of simulated sessions.

What to use when: `draw_close_up` for the rates of a few moves; `draw_residuals` for those of the
whole recording; `draw_timing`, `draw_rest_positions` and `draw_family` for the statistics.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.report.figure_layout import (
    AXIS_COLOURS,
    BEFORE,
    INK,
    SOFT,
    draw_rates_over_time,
    stacked_panels,
)
from gyrorig_solver.report.svg_panels import Panel
from gyrorig_solver.twin_check.check_wording import by_key
from gyrorig_solver.twin_check.feature_comparison import FamilyComparison
from gyrorig_solver.twin_check.observed_session import AXES
from gyrorig_solver.twin_check.recording_check import BoardCheck
from gyrorig_solver.twin_check.session_features import CLOCK_S, SENSOR_AXES

OVERLAY_S = 3.0  # of a detail view of moves
BAND_SIGMA = 2.0
TIMING = {"latency": "latency, ms", "jitter": "interval, ms", "answer_time": "answer, ms"}
QUANTILES_CAPTION = (
    "Quantiles of the latency of the board's frames above the smallest one, without stalls of the "
    "host; of the interval between their arrivals; and of the unit's answer time."
)
CLOCK_CAPTION = "Change of the rate of the board's clock from one interval to the next."


def draw_close_up(board: BoardCheck) -> str:
    """Draw the rates in the window in which the default simulation has the largest error."""
    session = board.session
    window = max(2, round(OVERLAY_S * session.sampling.rate_hz))
    error = (board.before.residual_rad_s**2).sum(axis=1)
    moving = np.abs(np.gradient(session.stage_rate_rad_s, axis=0)).sum(axis=1) > 0.0
    summed = np.convolve(error * (1.0 + moving), np.ones(window), mode="valid")
    first = int(np.argmax(summed))
    rows = slice(first, first + window)
    figure, panels = stacked_panels(3, 5.2)
    for axis, panel in enumerate(panels):
        series: tuple[tuple[FloatArray, str, str], ...] = (
            (board.before.predicted_rad_s, BEFORE, "default simulation"),
            (board.after.predicted_rad_s, AXIS_COLOURS[axis], "twin"),
        )
        panel.plot(
            session.block_time_s[rows],
            np.degrees(session.rate_rad_s[rows, axis]),
            colour=INK,
            linewidth=0.0,
            markersize=2.2,
            label="measured",
        )
        for rates, colour, label in series:
            panel.plot(
                session.block_time_s[rows],
                np.degrees(rates[rows, axis]),
                colour=colour,
                linewidth=1.4,
                label=label,
            )
        panel.ylabel = f"{SENSOR_AXES[axis]}  deg/s"
        panel.has_key = axis == 0
    panels[-1].xlabel = "time, s"
    return figure.svg()


def draw_residuals(board: BoardCheck) -> str:
    """Draw the measured minus the simulated rates, of the default simulation and of the twin."""
    layers = [(board.before.residual_rad_s, BEFORE), (board.after.residual_rad_s, None)]
    return draw_rates_over_time(board.session.block_time_s, layers, 4.6)


def draw_timing(comparisons: Sequence[FamilyComparison]) -> list[dict[str, str]]:
    """Draw the distributions of times, and the changes of the board's clock: figures with texts."""
    known = by_key(comparisons)
    figures = []
    quantiles = [key for key in TIMING if key in known]
    if quantiles:
        figure, panels = stacked_panels(len(quantiles), 0.5 + 1.3 * len(quantiles))
        for key, panel in zip(quantiles, panels, strict=True):
            _draw_with_band(panel, known[key].family.x, known[key], slice(None))
            panel.ylabel = TIMING[key]
            panel.has_key = panel is panels[0]
        panels[-1].xlabel = "quantile"
        figures.append({"svg": figure.svg(), "words": QUANTILES_CAPTION})
    if "clock" in known:
        changes = slice(1, None)  # the first value is the skew, much larger than its changes
        time_s = np.array(CLOCK_S[: known["clock"].family.values[changes].size])
        if time_s.size:
            figure, (panel,) = stacked_panels(1, 1.8)
            _draw_with_band(panel, np.log10(time_s), known["clock"], changes)
            panel.name_axes("log10 of the time between changes, s", "change, ppm")
            figures.append({"svg": figure.svg(), "words": CLOCK_CAPTION})
    return figures


def _draw_with_band(panel: Panel, x: FloatArray, comparison: FamilyComparison, rows: slice) -> None:
    """Draw measured features over the mean and the band of the draws of the twin."""
    mean, spread = comparison.mean[rows], BAND_SIGMA * comparison.std[rows]
    panel.band(x, mean - spread, mean + spread, colour="var(--band)")
    panel.plot(x, mean, colour=SOFT, linewidth=1.0, linestyle="--", label="twin")
    values = comparison.family.values[rows]
    panel.plot(x, values, colour=INK, linewidth=0.0, markersize=5.0, label="measured")


def draw_rest_positions(comparison: FamilyComparison | None) -> str:
    """Draw the rest positions of the unit minus the commanded ones, over the draws of the twin."""
    if comparison is None:
        return ""
    family = comparison.family
    figure, panels = stacked_panels(len(AXES), 3.0)
    for name, panel in zip(AXES, panels, strict=True):
        rows = np.flatnonzero(
            [axis == name for axis in family.axis]
            & np.isfinite(family.values)
            & np.isfinite(comparison.mean)
        )
        x, mean = family.x[rows], comparison.mean[rows]
        spread = BAND_SIGMA * comparison.std[rows]
        panel.band(x, mean - spread, mean + spread, colour="var(--band)")
        panel.plot(x, mean, colour=SOFT, linewidth=1.0, linestyle="--", label="twin")
        panel.plot(
            x, family.values[rows], colour=INK, linewidth=0.0, markersize=4.0, label="measured"
        )
        panel.ylabel = f"{name}  {family.unit}"
        panel.has_key = name == AXES[0]
    panels[-1].xlabel = family.covariate
    return figure.svg()


def draw_family(comparison: FamilyComparison, earlier: FamilyComparison | None = None) -> str:
    """Draw the measured features over the band of the twin's draws.

    Args:
        comparison: with the draws of the twin.
        earlier: the same of an earlier simulation, to show what the twin has changed.
    """
    family = comparison.family
    figure, panels = stacked_panels(3, 4.2)
    for axis, panel in enumerate(panels):
        rows = np.flatnonzero(
            [name == SENSOR_AXES[axis] for name in family.axis]
            & np.isfinite(family.values)
            & np.isfinite(comparison.mean)
        )
        x = family.x[rows]
        scale = np.log10(x) if family.key in ("spectrum", "allan") else x
        mean, spread = comparison.mean[rows], BAND_SIGMA * comparison.std[rows]
        panel.band(scale, mean - spread, mean + spread, colour="var(--band)")
        panel.plot(scale, mean, colour=SOFT, linewidth=1.0, linestyle="--", label="twin")
        if earlier is not None and earlier.family.values.shape == family.values.shape:
            panel.plot(
                scale,
                earlier.family.values[rows],
                colour=BEFORE,
                linewidth=1.4,
                markersize=3.0,
                label="before",
            )
        panel.plot(
            scale,
            family.values[rows],
            colour=AXIS_COLOURS[axis],
            linewidth=0.0,
            markersize=5.0,
            label="measured",
        )
        panel.ylabel = f"{SENSOR_AXES[axis]}  {family.unit}"
        panel.has_key = axis == 0
    label = family.covariate
    panels[-1].xlabel = f"log10 of {label}" if family.key in ("spectrum", "allan") else label
    return figure.svg()
