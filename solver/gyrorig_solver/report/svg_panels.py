"""SVG figures of stacked panels: lines, dots with error bars, bands, and a key.

What to use when: `Figure` for stacked panels with a common x-axis, `Panel` to add marks to one.
A plotting library would need more time to load and draw seven figures than the search for causes.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from html import escape

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.report.axis_ticks import Axis

WIDTH = 532.8  # of a figure, points of 1/72 inch
LEFT, RIGHT, TOP, KEY, BOTTOM, GAP = 62.0, 7.0, 7.0, 18.0, 36.0, 9.0
FONT, KEY_FONT = 10.0, 9.0
LETTER_WIDTH_SHARE = 0.56  # width of a letter on average, of its height
KEY_LETTER_PX = 12.5  # font size of the key on a phone, see page.css
KEY_SAMPLE_WIDTH = 18.0  # length of a line in the key
SOFT, LINE, GRID = "var(--soft)", "var(--line)", "var(--grid)"
TICK_SPACING_X, TICK_SPACING_Y = 62.0, 18.0  # points between ticks, at least
DASHES = {"--": "4.5 2.5", "-": ""}


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """One line, row of dots with error bars, or band."""

    x: FloatArray  # (n,)
    y: FloatArray  # (n,)
    colour: str
    linewidth: float = 0.0  # 0: no line
    linestyle: str = "-"
    markersize: float = 0.0  # 0: no dots
    bar: FloatArray | None = None  # (n,), half its length
    bar_colour: str = ""
    band_edge: FloatArray | None = None  # (n,), a band's other edge
    label: str = ""


@dataclass(slots=True, eq=False)
class Panel:
    """One pair of axes and its marks."""

    marks: list[Mark] = field(default_factory=list)
    levels: list[Mark] = field(default_factory=list)  # from side to side
    is_logarithmic: bool = False
    xlabel: str = ""
    ylabel: str = ""
    has_key: bool = False

    def plot(
        self,
        x: FloatArray,
        y: FloatArray,
        *,
        colour: str,
        linewidth: float = 1.0,
        linestyle: str = "-",
        markersize: float = 0.0,
        label: str = "",
    ) -> None:
        """Add a line, dots, or both; interrupted where a value is not finite."""
        self.marks.append(Mark(x, y, colour, linewidth, linestyle, markersize, label=label))

    def dots(
        self,
        x: FloatArray,
        y: FloatArray,
        bar: FloatArray,
        *,
        colour: str,
        bar_colour: str = "",
        linewidth: float = 1.0,
        markersize: float = 3.0,
        label: str = "",
    ) -> None:
        """Add dots with bars of half-length `bar`, and a line through them."""
        shown_bar_colour = bar_colour or colour
        self.marks.append(
            Mark(x, y, colour, linewidth, "-", markersize, bar, shown_bar_colour, label=label)
        )

    def name_axes(self, xlabel: str, ylabel: str) -> None:
        """Name both axes, and show the key of the labels."""
        self.xlabel, self.ylabel, self.has_key = xlabel, ylabel, True

    def band(self, x: FloatArray, low: FloatArray, high: FloatArray, *, colour: str) -> None:
        """Add a band between two lines."""
        self.marks.append(Mark(x, low, colour, 0.4, band_edge=high))

    def level(
        self, y: float, *, colour: str, linewidth: float, linestyle: str = "-", label: str = ""
    ) -> None:
        """Add a horizontal line."""
        value = np.array([y])
        self.levels.append(Mark(value, value, colour, linewidth, linestyle, label=label))


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """Stacked panels with a common x-axis."""

    panels: tuple[Panel, ...]
    height: float  # points

    def svg(self) -> str:
        """Return the SVG element."""
        last_panel = self.panels[-1]
        all_x = np.concatenate([m.x for p in self.panels for m in p.marks] or [np.zeros(1)])
        width = WIDTH - LEFT - RIGHT
        x_axis = (
            Axis.decades(all_x)
            if last_panel.is_logarithmic
            else Axis.linear(all_x, _max_ticks(width, False))
        )
        tops = [KEY if panel.has_key else TOP for panel in self.panels]
        free_height = self.height - BOTTOM - sum(tops) - GAP * (len(self.panels) - 1)
        panel_height = free_height / len(self.panels)
        parts: list[str] = []
        y = 0.0
        for panel, top in zip(self.panels, tops, strict=True):
            y += top
            parts += _panel_svg(
                panel, x_axis, _PlotBox(LEFT, y, width, panel_height), panel is last_panel
            )
            y += panel_height + GAP
        return (
            f'<svg viewBox="0 0 {WIDTH} {self.height:.1f}" version="1.1">'
            f'<g style="fill:none;stroke-linejoin:round;font-size:{FONT:.0f}px">'
            f"{''.join(parts)}</g></svg>"
        )


@dataclass(frozen=True, slots=True)
class _PlotBox:
    left: float
    top: float
    wide: float
    tall: float

    def x(self, share: FloatArray) -> FloatArray:
        return self.left + self.wide * share

    def y(self, share: FloatArray) -> FloatArray:
        return self.top + self.tall * (1.0 - share)


def _max_ticks(length: float, upright: bool) -> int:
    return max(2, int(length / (TICK_SPACING_Y if upright else TICK_SPACING_X)))


def _panel_svg(panel: Panel, x_axis: Axis, box: _PlotBox, is_last: bool) -> Iterator[str]:
    value_arrays = [mark_item.y for mark_item in (*panel.marks, *panel.levels)]
    value_arrays += [
        mark_item.y + sign * mark_item.bar
        for mark_item in panel.marks
        if mark_item.bar is not None
        for sign in (-1, 1)
    ]
    value_arrays += [
        mark_item.band_edge for mark_item in panel.marks if mark_item.band_edge is not None
    ]
    values = np.concatenate(value_arrays or [np.zeros(1)])
    y_axis = (
        Axis.decades(values)
        if panel.is_logarithmic
        else Axis.linear(values, _max_ticks(box.tall, True))
    )
    yield from _frame_svg(panel, x_axis, y_axis, box, is_last)
    for mark in panel.marks:
        yield from _mark_svg(mark, box.x(x_axis.share(mark.x)), y_axis, box)
    for mark in panel.levels:
        height = float(box.y(y_axis.share(mark.y))[0])
        yield _path_svg(f"M{box.left:.2f} {height:.2f}h{box.wide:.2f}", mark)
    if panel.has_key:
        yield from _key_svg(
            [mark_item for mark_item in (*panel.marks, *panel.levels) if mark_item.label], box
        )


def _frame_svg(
    panel: Panel, x_axis: Axis, y_axis: Axis, box: _PlotBox, is_last: bool
) -> Iterator[str]:
    """Draw grid, ticks, axes and labels."""
    bottom, right = box.top + box.tall, box.left + box.wide
    xs = [(float(box.left + box.wide * share), text) for share, text in x_axis.ticks]
    ys = [(float(bottom - box.tall * share), text) for share, text in y_axis.ticks]
    grid = "".join(f"M{x:.2f} {box.top:.2f}V{bottom:.2f}" for x, _ in xs)
    grid += "".join(f"M{box.left:.2f} {y:.2f}H{right:.2f}" for y, _ in ys)
    yield f'<path d="{grid}" style="stroke:{GRID};stroke-width:.5"/>'
    ticks = "".join(f"M{x:.2f} {bottom:.2f}v3.5" for x, _ in xs)
    ticks += "".join(f"M{box.left:.2f} {y:.2f}h-3.5" for y, _ in ys)
    yield f'<path d="{ticks}" style="stroke:{SOFT};stroke-width:.8"/>'
    corner = f"M{box.left:.2f} {box.top:.2f}V{bottom:.2f}H{right:.2f}"
    yield f'<path d="{corner}" style="stroke:{LINE};stroke-width:.6"/>'
    yield f'<g style="fill:{SOFT};text-anchor:end">'
    yield from (f'<text x="{box.left - 6:.2f}" y="{y + 3.5:.2f}">{text}</text>' for y, text in ys)
    yield f'</g><g style="fill:{SOFT};text-anchor:middle">'
    if is_last:
        yield from (f'<text x="{x:.2f}" y="{bottom + 14:.2f}">{text}</text>' for x, text in xs)
        middle = box.left + box.wide / 2.0
        yield f'<text x="{middle:.2f}" y="{bottom + 29:.2f}">{escape(panel.xlabel)}</text>'
    middle = box.top + box.tall / 2.0
    rotation = f"translate(12 {middle:.2f}) rotate(-90)"
    yield f'<text transform="{rotation}">{escape(panel.ylabel)}</text></g>'


def _mark_svg(mark: Mark, x: FloatArray, y_axis: Axis, box: _PlotBox) -> Iterator[str]:
    y = box.y(y_axis.share(mark.y))
    if mark.band_edge is not None:
        for run in _finite_runs(np.isfinite(x + y)):
            far_edge = box.y(y_axis.share(mark.band_edge))[run][::-1]
            edge = _line_path(
                np.concatenate([x[run], x[run][::-1]]), np.concatenate([y[run], far_edge])
            )
            style = f"fill:{mark.colour};stroke:{mark.colour};stroke-width:.4;opacity:.85"
            yield f'<path d="{edge}z" style="{style}"/>'
        return
    is_finite = np.isfinite(x + y)
    if mark.bar is not None:
        tops, bottoms = (box.y(y_axis.share(mark.y + sign * mark.bar)) for sign in (1, -1))
        bars = "".join(
            f"M{a:.2f} {b:.2f}V{c:.2f}"
            for a, b, c in zip(x[is_finite], tops[is_finite], bottoms[is_finite], strict=True)
        )
        yield f'<path d="{bars}" style="stroke:{mark.bar_colour};stroke-width:1"/>'
    if mark.linewidth > 0.0:
        yield _path_svg(
            "".join(_line_path(x[run], y[run]) for run in _finite_runs(is_finite)), mark
        )
    if mark.markersize > 0.0:
        dots = "".join(
            f"M{a:.2f} {b:.2f}h0" for a, b in zip(x[is_finite], y[is_finite], strict=True)
        )
        width = f"stroke-width:{mark.markersize:g};stroke-linecap:round"
        yield f'<path d="{dots}" style="stroke:{mark.colour};{width}"/>'


def _path_svg(edge: str, mark: Mark) -> str:
    dashes = DASHES[mark.linestyle]
    style = f"stroke:{mark.colour};stroke-width:{mark.linewidth:g}"
    return f'<path d="{edge}" style="{style}{f";stroke-dasharray:{dashes}" if dashes else ""}"/>'


def _line_path(x: FloatArray, y: FloatArray) -> str:
    return "M" + "L".join(f"{a:.2f} {b:.2f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))


def _finite_runs(is_finite: FloatArray) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_finite, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _key_svg(marks: list[Mark], box: _PlotBox) -> Iterator[str]:
    """Draw the key above the panel, from the right."""
    y, x = box.top - 6.5, box.left + box.wide
    for mark in reversed(marks):
        x -= LETTER_WIDTH_SHARE * KEY_LETTER_PX * len(mark.label)
        words = escape(mark.label)
        yield (
            f'<text x="{x:.2f}" y="{y + 3.0:.2f}" '
            f'style="fill:{SOFT};font-size:{KEY_FONT:.0f}px">{words}</text>'
        )
        x -= KEY_SAMPLE_WIDTH + 5.0
        if mark.linewidth > 0.0:
            yield _path_svg(f"M{x:.2f} {y:.2f}h{KEY_SAMPLE_WIDTH}", mark)
        if mark.markersize > 0.0:
            width = f"stroke-width:{mark.markersize:g};stroke-linecap:round"
            middle = x + KEY_SAMPLE_WIDTH / 2.0
            yield f'<path d="M{middle:.2f} {y:.2f}h0" style="stroke:{mark.colour};{width}"/>'
        x -= 12.0
