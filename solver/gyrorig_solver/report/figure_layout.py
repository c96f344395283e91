"""Layout of figures: colours, stacked panels, envelopes, stand-alone SVG files.

Colours are variables of the page's style sheet, therefore a figure works in light and dark mode.
No text from files is drawn in a figure: names are in the captions, where they are escaped.

What to use when: `stacked_panels` for panels to draw in, `draw_envelope` for data too dense for a
line, `draw_rates_over_time` and `finish_spectrum` for figures that both reports have,
`standalone_svg` for a figure in a separate file.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.report.svg_panels import Figure, Panel

AXIS_COLOURS = ("var(--x)", "var(--y)", "var(--z)")
BEFORE, SOFT, INK = "var(--before)", "var(--soft)", "var(--ink)"
POINTS_PER_INCH = 72.0
_MAX_COLUMNS = 700  # points across a figure; more are not visible


def stacked_panels(rows: int, height_inch: float) -> tuple[Figure, tuple[Panel, ...]]:
    """Return a figure of stacked panels, `height_inch` high."""
    panels = tuple(Panel() for _ in range(rows))
    return Figure(panels, height_inch * POINTS_PER_INCH), panels


def draw_envelope(panel: Panel, time_s: FloatArray, values: FloatArray, colour: str) -> None:
    """Draw a line, or the band between minimum and maximum where it is too dense."""
    if len(values) <= 2 * _MAX_COLUMNS:
        panel.plot(time_s, values, colour=colour, linewidth=0.7)
        return
    size = -(-len(values) // _MAX_COLUMNS)
    rows = len(values) // size
    blocks = values[: rows * size].reshape(rows, size)
    filled = ~np.all(np.isnan(blocks), axis=1)
    low, high = np.full(rows, np.nan), np.full(rows, np.nan)
    low[filled], high[filled] = np.nanmin(blocks[filled], axis=1), np.nanmax(blocks[filled], axis=1)
    middle = time_s[: rows * size].reshape(rows, size).mean(axis=1)
    panel.band(middle, low, high, colour=colour)


def draw_rates_over_time(
    time_s: FloatArray, layers: Sequence[tuple[FloatArray, str | None]], height_inch: float
) -> str:
    """Draw rates over time, in deg/s, one panel per axis.

    Args:
        time_s: shape (n,).
        layers: rates in rad/s, (n, 3), and their colour; None: that of the axis. The first is
            behind the others.
        height_inch: of the figure.
    """
    figure, panels = stacked_panels(3, height_inch)
    for axis, panel in enumerate(panels):
        for rate_rad_s, colour in layers:
            draw_envelope(
                panel, time_s, np.degrees(rate_rad_s[:, axis]), colour or AXIS_COLOURS[axis]
            )
        panel.level(0.0, colour=SOFT, linewidth=0.5)
        panel.ylabel = f"{'xyz'[axis]}  deg/s"
    panels[-1].xlabel = "time, s"
    return figure.svg()


def finish_spectrum(
    panel: Panel, frequency_hz: FloatArray, noise_model: FloatArray, linewidth: float
) -> None:
    """Draw a noise model's densities, (k, 3), over those in the panel, and name the axes."""
    for axis in range(3):
        panel.plot(
            frequency_hz,
            np.degrees(np.sqrt(noise_model[:, axis])),
            colour=SOFT,
            linewidth=linewidth,
            linestyle="--",
            label="noise model" if axis == 0 else "",
        )
    panel.is_logarithmic = True
    panel.name_axes("frequency, Hz", "deg/s/√Hz")


_STANDALONE_STYLE = (
    "<style>:root{font-family:sans-serif;--ink:#1f2328;--soft:#5c6470;--line:#c9ccd1;--grid:#e6e7e9;--x:#c2410c;"
    "--y:#0f766e;--z:#4f46e5;--before:#868d98;background:#fff}"
    "@media(prefers-color-scheme:dark){:root{--ink:#e7e9ec;--soft:#a0a7b2;--line:#4a505a;"
    "--grid:#2b2f37;--x:#fb923c;--y:#2dd4bf;--z:#a5b4fc;--before:#8b93a0;background:#1c1f25}}"
    "</style>"
)


def standalone_svg(text: str) -> str:
    """Return a page's figure as a stand-alone SVG file with the page's colours."""
    end = text.index(">", text.index("<svg")) + 1
    opening_tag = text[:end]
    if "xmlns=" not in opening_tag:
        opening_tag = opening_tag.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + opening_tag + _STANDALONE_STYLE + text[end:]
