"""How every figure of a page is drawn: its colours, dense lines, and the SVG itself.

Colours are names that the page's style sheet gives meaning to, so that one figure serves
light and dark; letters stay letters. No text from outside gets into a figure: names stand
in the captions, where they are escaped.

What to use when: `stacked` for panels to draw in, `envelope` for what is too dense for a
line, `alone` for a figure that is to lie in a file of its own.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.report.panels import Figure, Panel

AXIS_COLOURS = ("var(--x)", "var(--y)", "var(--z)")
BEFORE, SOFT, INK = "var(--before)", "var(--soft)", "var(--ink)"
POINTS = 72.0  # an inch
_COLUMNS = 700  # points across a figure: more cannot be seen and only makes the file large


def stacked(rows: int, height: float) -> tuple[Figure, tuple[Panel, ...]]:
    """Return a figure of some panels above each other, so many inches high."""
    panels = tuple(Panel() for _ in range(rows))
    return Figure(panels, height * POINTS), panels


def envelope(panel: Panel, time_s: FloatArray, values: FloatArray, colour: str) -> None:
    """Draw a line, or where it is too dense, the band between its least and greatest."""
    if len(values) <= 2 * _COLUMNS:
        panel.plot(time_s, values, colour=colour, linewidth=0.7)
        return
    size = -(-len(values) // _COLUMNS)
    rows = len(values) // size
    blocks = values[: rows * size].reshape(rows, size)
    filled = ~np.all(np.isnan(blocks), axis=1)
    low, high = np.full(rows, np.nan), np.full(rows, np.nan)
    low[filled], high[filled] = np.nanmin(blocks[filled], axis=1), np.nanmax(blocks[filled], axis=1)
    middle = time_s[: rows * size].reshape(rows, size).mean(axis=1)
    panel.band(middle, low, high, colour=colour)


_ALONE = (
    "<style>:root{font-family:sans-serif;--ink:#1f2328;--soft:#5c6470;--line:#c9ccd1;--grid:#e6e7e9;--x:#c2410c;"
    "--y:#0f766e;--z:#4f46e5;--before:#868d98;background:#fff}"
    "@media(prefers-color-scheme:dark){:root{--ink:#e7e9ec;--soft:#a0a7b2;--line:#4a505a;"
    "--grid:#2b2f37;--x:#fb923c;--y:#2dd4bf;--z:#a5b4fc;--before:#8b93a0;background:#1c1f25}}"
    "</style>"
)


def alone(text: str) -> str:
    """Return a page's figure as a file of its own, with the page's colours in it."""
    end = text.index(">", text.index("<svg")) + 1
    head = text[:end]
    if "xmlns=" not in head:
        head = head.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + head + _ALONE + text[end:]
