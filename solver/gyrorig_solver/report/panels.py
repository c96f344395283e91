"""Panels of a figure, from marks to SVG: lines, dots with bars, bands, and a key to them.

What to use when: `Figure` for panels above each other over one abscissa; `Panel` to put
marks into one. Only what the pages' figures need: a plotting library takes longer to be
loaded and to draw seven of them than the search for causes that they show.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from html import escape

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.report.ticks import Axis

WIDTH = 532.8  # of a figure, points of 1/72 inch
LEFT, RIGHT, TOP, KEY, BOTTOM, GAP = 62.0, 7.0, 7.0, 18.0, 36.0, 9.0
FONT, KEY_FONT = 10.0, 9.0
LETTER = 0.56  # width of a letter on average, of its height
KEY_ROOM = 12.5  # letters of the key have on a phone, see page.css
SAMPLE = 18.0  # length of a line in the key
SOFT, LINE, GRID = "var(--soft)", "var(--line)", "var(--grid)"
TICK_EACH_X, TICK_EACH_Y = 62.0, 18.0  # points between ticks, at least
DASHES = {"--": "4.5 2.5", "-": ""}


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """One line, row of dots with bars, or band."""

    x: FloatArray  # (n,)
    y: FloatArray  # (n,)
    colour: str
    linewidth: float = 0.0  # 0: no line
    linestyle: str = "-"
    markersize: float = 0.0  # 0: no dots
    bar: FloatArray | None = None  # (n,), half its length
    bar_colour: str = ""
    to: FloatArray | None = None  # (n,), a band's other edge
    label: str = ""


@dataclass(slots=True, eq=False)
class Panel:
    """One pair of axes and what is drawn there."""

    marks: list[Mark] = field(default_factory=list)
    levels: list[Mark] = field(default_factory=list)  # from side to side
    decades: bool = False
    xlabel: str = ""
    ylabel: str = ""
    key: bool = False

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
        over = bar_colour or colour
        self.marks.append(Mark(x, y, colour, linewidth, "-", markersize, bar, over, label=label))

    def band(self, x: FloatArray, low: FloatArray, high: FloatArray, *, colour: str) -> None:
        """Fill what lies between two lines."""
        self.marks.append(Mark(x, low, colour, 0.4, to=high))

    def level(
        self, y: float, *, colour: str, linewidth: float, linestyle: str = "-", label: str = ""
    ) -> None:
        """Add a straight line from side to side."""
        at = np.array([y])
        self.levels.append(Mark(at, at, colour, linewidth, linestyle, label=label))


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """Panels above each other, over one abscissa."""

    panels: tuple[Panel, ...]
    height: float  # points

    def svg(self) -> str:
        """Return the SVG element."""
        last = self.panels[-1]
        every = np.concatenate([m.x for p in self.panels for m in p.marks] or [np.zeros(1)])
        wide = WIDTH - LEFT - RIGHT
        across = Axis.decades(every) if last.decades else Axis.linear(every, _most(wide, False))
        tops = [KEY if panel.key else TOP for panel in self.panels]
        free = self.height - BOTTOM - sum(tops) - GAP * (len(self.panels) - 1)
        tall = free / len(self.panels)
        parts: list[str] = []
        y = 0.0
        for panel, top in zip(self.panels, tops, strict=True):
            y += top
            parts += _drawn(panel, across, _Box(LEFT, y, wide, tall), panel is last)
            y += tall + GAP
        return (
            f'<svg viewBox="0 0 {WIDTH} {self.height:.1f}" version="1.1">'
            f'<g style="fill:none;stroke-linejoin:round;font-size:{FONT:.0f}px">'
            f"{''.join(parts)}</g></svg>"
        )


@dataclass(frozen=True, slots=True)
class _Box:
    left: float
    top: float
    wide: float
    tall: float

    def x(self, share: FloatArray) -> FloatArray:
        return self.left + self.wide * share

    def y(self, share: FloatArray) -> FloatArray:
        return self.top + self.tall * (1.0 - share)


def _most(length: float, upright: bool) -> int:
    return max(2, int(length / (TICK_EACH_Y if upright else TICK_EACH_X)))


def _drawn(panel: Panel, across: Axis, box: _Box, last: bool) -> Iterator[str]:
    edges = [m.y for m in (*panel.marks, *panel.levels)]
    edges += [m.y + sign * m.bar for m in panel.marks if m.bar is not None for sign in (-1, 1)]
    edges += [m.to for m in panel.marks if m.to is not None]
    values = np.concatenate(edges or [np.zeros(1)])
    up = Axis.decades(values) if panel.decades else Axis.linear(values, _most(box.tall, True))
    yield from _frame(panel, across, up, box, last)
    for mark in panel.marks:
        yield from _mark(mark, box.x(across.share(mark.x)), up, box)
    for mark in panel.levels:
        height = float(box.y(up.share(mark.y))[0])
        yield _path(f"M{box.left:.2f} {height:.2f}h{box.wide:.2f}", mark)
    if panel.key:
        yield from _key([m for m in (*panel.marks, *panel.levels) if m.label], box)


def _frame(panel: Panel, across: Axis, up: Axis, box: _Box, last: bool) -> Iterator[str]:
    """Draw grid, ticks, the two axes and what they are called."""
    low, right = box.top + box.tall, box.left + box.wide
    xs = [(float(box.left + box.wide * share), text) for share, text in across.ticks]
    ys = [(float(low - box.tall * share), text) for share, text in up.ticks]
    grid = "".join(f"M{x:.2f} {box.top:.2f}V{low:.2f}" for x, _ in xs)
    grid += "".join(f"M{box.left:.2f} {y:.2f}H{right:.2f}" for y, _ in ys)
    yield f'<path d="{grid}" style="stroke:{GRID};stroke-width:.5"/>'
    ticks = "".join(f"M{x:.2f} {low:.2f}v3.5" for x, _ in xs)
    ticks += "".join(f"M{box.left:.2f} {y:.2f}h-3.5" for y, _ in ys)
    yield f'<path d="{ticks}" style="stroke:{SOFT};stroke-width:.8"/>'
    corner = f"M{box.left:.2f} {box.top:.2f}V{low:.2f}H{right:.2f}"
    yield f'<path d="{corner}" style="stroke:{LINE};stroke-width:.6"/>'
    yield f'<g style="fill:{SOFT};text-anchor:end">'
    yield from (f'<text x="{box.left - 6:.2f}" y="{y + 3.5:.2f}">{text}</text>' for y, text in ys)
    yield f'</g><g style="fill:{SOFT};text-anchor:middle">'
    if last:
        yield from (f'<text x="{x:.2f}" y="{low + 14:.2f}">{text}</text>' for x, text in xs)
        middle = box.left + box.wide / 2.0
        yield f'<text x="{middle:.2f}" y="{low + 29:.2f}">{escape(panel.xlabel)}</text>'
    middle = box.top + box.tall / 2.0
    turned = f"translate(12 {middle:.2f}) rotate(-90)"
    yield f'<text transform="{turned}">{escape(panel.ylabel)}</text></g>'


def _mark(mark: Mark, x: FloatArray, up: Axis, box: _Box) -> Iterator[str]:
    y = box.y(up.share(mark.y))
    if mark.to is not None:
        for run in _runs(np.isfinite(x + y)):
            back = box.y(up.share(mark.to))[run][::-1]
            edge = _line(np.concatenate([x[run], x[run][::-1]]), np.concatenate([y[run], back]))
            style = f"fill:{mark.colour};stroke:{mark.colour};stroke-width:.4;opacity:.85"
            yield f'<path d="{edge}z" style="{style}"/>'
        return
    some = np.isfinite(x + y)
    if mark.bar is not None:
        tops, feet = (box.y(up.share(mark.y + sign * mark.bar)) for sign in (1, -1))
        bars = "".join(
            f"M{a:.2f} {b:.2f}V{c:.2f}"
            for a, b, c in zip(x[some], tops[some], feet[some], strict=True)
        )
        yield f'<path d="{bars}" style="stroke:{mark.bar_colour};stroke-width:1"/>'
    if mark.linewidth > 0.0:
        yield _path("".join(_line(x[run], y[run]) for run in _runs(some)), mark)
    if mark.markersize > 0.0:
        dots = "".join(f"M{a:.2f} {b:.2f}h0" for a, b in zip(x[some], y[some], strict=True))
        width = f"stroke-width:{mark.markersize:g};stroke-linecap:round"
        yield f'<path d="{dots}" style="stroke:{mark.colour};{width}"/>'


def _path(edge: str, mark: Mark) -> str:
    dashes = DASHES[mark.linestyle]
    style = f"stroke:{mark.colour};stroke-width:{mark.linewidth:g}"
    return f'<path d="{edge}" style="{style}{f";stroke-dasharray:{dashes}" if dashes else ""}"/>'


def _line(x: FloatArray, y: FloatArray) -> str:
    return "M" + "L".join(f"{a:.2f} {b:.2f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))


def _runs(some: FloatArray) -> list[slice]:
    """Return the stretches in which all is there."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], some, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _key(marks: list[Mark], box: _Box) -> Iterator[str]:
    """Name the marks above the panel, from the right."""
    y, x = box.top - 6.5, box.left + box.wide
    for mark in reversed(marks):
        x -= LETTER * KEY_ROOM * len(mark.label)
        words = escape(mark.label)
        yield (
            f'<text x="{x:.2f}" y="{y + 3.0:.2f}" '
            f'style="fill:{SOFT};font-size:{KEY_FONT:.0f}px">{words}</text>'
        )
        x -= SAMPLE + 5.0
        if mark.linewidth > 0.0:
            yield _path(f"M{x:.2f} {y:.2f}h{SAMPLE}", mark)
        if mark.markersize > 0.0:
            width = f"stroke-width:{mark.markersize:g};stroke-linecap:round"
            middle = x + SAMPLE / 2.0
            yield f'<path d="M{middle:.2f} {y:.2f}h0" style="stroke:{mark.colour};{width}"/>'
        x -= 12.0
