"""The report's figures, each an SVG text to put into the page.

Colours are written as marks that the page's style sheet gives meaning to, so that one
figure serves light and dark; letters stay letters. No text from outside gets into a
figure: names stand in the captions, where they are escaped.
"""

import io
import re
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.result import FitDiagnostics

_STYLE: Any = {  # matplotlib types each key by name
    "svg.fonttype": "none",
    "svg.hashsalt": "gyrorig",
    "font.size": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.linewidth": 0.5,
    "axes.edgecolor": "#c00005",
    "axes.labelcolor": "#c00004",
    "xtick.color": "#c00004",
    "ytick.color": "#c00004",
    "grid.color": "#c00006",
    "text.color": "#c00004",
    "path.simplify_threshold": 0.5,
}
_MARKS = {
    "#c00001": "var(--x)",
    "#c00002": "var(--y)",
    "#c00003": "var(--z)",
    "#c00004": "var(--soft)",
    "#c00005": "var(--line)",
    "#c00006": "var(--grid)",
    "#c00007": "var(--before)",
}
_AXIS_COLOURS = ("#c00001", "#c00002", "#c00003")
_BEFORE = "#c00007"
_SOFT = "#c00004"
_COLUMNS = 700  # points across a figure: more cannot be seen and only makes the file large


def rate_error(data: FitDiagnostics, error_after_rad_s: FloatArray) -> str:
    """Draw the rate error before and after, in deg/s, one panel an axis.

    Args:
        data: of the fit.
        error_after_rad_s: calibrated reading minus stage rate, shape (n, 3).
    """
    figure, panels = _panels(3, 5.4)
    before = data.rate_rad_s - data.reference_rad_s
    for axis, panel in enumerate(panels):
        _envelope(panel, data.time_s, np.degrees(before[:, axis]), _BEFORE)
        _envelope(panel, data.time_s, np.degrees(error_after_rad_s[:, axis]), _AXIS_COLOURS[axis])
        panel.set_ylabel(f"{'xyz'[axis]}  deg/s")
        panel.axhline(0.0, color=_SOFT, linewidth=0.5)
    panels[-1].set_xlabel("seconds")
    return _svg(figure, "error")


def residual_over_time(data: FitDiagnostics) -> str:
    """Draw what the model left unexplained, in deg/s, one panel an axis."""
    figure, panels = _panels(3, 4.2)
    for axis, panel in enumerate(panels):
        residual = np.degrees(data.residual_rad_s[:, axis])
        _envelope(panel, data.time_s, residual, _AXIS_COLOURS[axis])
        panel.set_ylabel(f"{'xyz'[axis]}  deg/s")
        panel.axhline(0.0, color=_SOFT, linewidth=0.5)
    panels[-1].set_xlabel("seconds")
    return _svg(figure, "residual")


def residual_spectrum(data: FitDiagnostics) -> str:
    """Draw the density of the residual and of the noise assumed, in deg/s/sqrt(Hz)."""
    figure, (panel,) = _panels(1, 3.6)
    for axis in range(3):
        panel.loglog(
            data.frequency_hz,
            np.degrees(np.sqrt(data.spectrum[:, axis])),
            color=_AXIS_COLOURS[axis],
            linewidth=0.9,
            label="xyz"[axis],
        )
    for axis in range(3):
        panel.loglog(
            data.frequency_hz,
            np.degrees(np.sqrt(data.spectrum_model[:, axis])),
            color=_SOFT,
            linewidth=1.0,
            linestyle="--",
            label="noise assumed" if axis == 0 else None,
        )
    panel.set_xlabel("Hz")
    panel.set_ylabel("deg/s/sqrt(Hz)")
    panel.legend(frameon=False, ncols=4, loc="upper right", labelcolor=_SOFT)
    return _svg(figure, "spectrum")


def residual_against_rate(data: FitDiagnostics) -> str:
    """Draw the mean residual in bins of the stage's rate, with 95 % bars: is it linear?"""
    figure, (panel,) = _panels(1, 3.2)
    for axis in range(3):
        centre, mean, bar = _binned(data.reference_rad_s[:, axis], data.residual_rad_s[:, axis])
        panel.errorbar(
            np.degrees(centre),
            np.degrees(mean),
            yerr=np.degrees(bar),
            color=_AXIS_COLOURS[axis],
            linewidth=0.9,
            marker="o",
            markersize=3,
            label="xyz"[axis],
        )
    panel.axhline(0.0, color=_SOFT, linewidth=0.5)
    panel.set_xlabel("stage rate about the same axis, deg/s")
    panel.set_ylabel("residual, deg/s")
    panel.legend(frameon=False, ncols=3, loc="upper right", labelcolor=_SOFT)
    return _svg(figure, "linearity")


def _panels(rows: int, height: float) -> tuple[Figure, list[Axes]]:
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(7.4, height), layout="constrained")
        grid = figure.subplots(rows, 1, sharex=True, squeeze=False)
    return figure, list(grid[:, 0])


def _envelope(panel: Axes, time_s: FloatArray, values: FloatArray, colour: str) -> None:
    """Draw a line, or where it is too dense, the band between its least and greatest."""
    if len(values) <= 2 * _COLUMNS:
        panel.plot(time_s, values, color=colour, linewidth=0.7)
        return
    size = -(-len(values) // _COLUMNS)
    rows = len(values) // size
    blocks = values[: rows * size].reshape(rows, size)
    filled = ~np.all(np.isnan(blocks), axis=1)
    low, high = np.full(rows, np.nan), np.full(rows, np.nan)
    low[filled], high[filled] = np.nanmin(blocks[filled], axis=1), np.nanmax(blocks[filled], axis=1)
    middle = time_s[: rows * size].reshape(rows, size).mean(axis=1)
    panel.fill_between(middle, low, high, color=colour, linewidth=0.4, alpha=0.85)


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


def _svg(figure: Figure, name: str) -> str:
    """Return the figure's SVG element, its marks and names made fit for the page."""
    out = io.StringIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(
            out, format="svg", transparent=True, metadata={"Date": None, "Creator": None}
        )
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r' height="[^"]*pt"| width="[^"]*pt"', "", text, count=2)
    text = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font-size: \1px", text)
    text = re.sub(r"(\d\.\d{2})\d+", r"\1", text)
    for mark in ('id="', 'href="#', "url(#"):
        text = text.replace(mark, f"{mark}{name}-")
    for mark, meaning in _MARKS.items():
        text = text.replace(mark, meaning)
    return text
