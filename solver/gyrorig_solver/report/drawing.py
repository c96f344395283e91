"""How every figure of a page is drawn: style, panels, dense lines, and the SVG itself.

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
    "#c00008": "var(--ink)",
}
AXIS_COLOURS = ("#c00001", "#c00002", "#c00003")
BEFORE = "#c00007"
SOFT = "#c00004"
INK = "#c00008"
_COLUMNS = 700  # points across a figure: more cannot be seen and only makes the file large


def stacked(rows: int, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure of some panels above each other, with one common abscissa."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(7.4, height), layout="constrained")
        grid = figure.subplots(rows, 1, sharex=True, squeeze=False)
    return figure, list(grid[:, 0])


def envelope(panel: Axes, time_s: FloatArray, values: FloatArray, colour: str) -> None:
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


def svg(figure: Figure, name: str) -> str:
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


_ALONE = (
    "<style>:root{--ink:#1f2328;--soft:#5c6470;--line:#c9ccd1;--grid:#e6e7e9;--x:#c2410c;"
    "--y:#0f766e;--z:#4f46e5;--before:#b4b8bf;background:#fff}"
    "@media(prefers-color-scheme:dark){:root{--ink:#e7e9ec;--soft:#a0a7b2;--line:#4a505a;"
    "--grid:#2b2f37;--x:#fb923c;--y:#2dd4bf;--z:#a5b4fc;--before:#646b76;background:#1c1f25}}"
    "</style>"
)


def alone(text: str) -> str:
    """Return a page's figure as a file of its own, with the page's colours in it."""
    end = text.index(">", text.index("<svg")) + 1
    head = text[:end]
    if "xmlns=" not in head:
        head = head.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + head + _ALONE + text[end:]
