"""Panels of figures: tick labels, positions of marks, valid SVG."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_solver.report.axis_ticks import Axis
from gyrorig_solver.report.svg_panels import Figure, Panel

SVG = "{http://www.w3.org/2000/svg}"


def value(text: str) -> float:
    return float(text.replace("\N{MINUS SIGN}", "-"))


def paths(figure: Figure) -> list[str]:
    text = figure.svg().replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
    root = ElementTree.fromstring(text)  # noqa: S314 - our own text
    return [str(path.get("d")) for path in root.iter(f"{SVG}path")]


def points(path: str) -> np.ndarray:
    return np.array(
        [[float(v) for v in pair.split()] for pair in re.findall(r"[ML]([-\d.]+ [-\d.]+)", path)]
    )


@given(
    low=st.floats(-1e7, 1e7),
    span=st.floats(1e-6, 1e7),
    most=st.integers(2, 12),
)
def test_tick_labels_match_their_positions(low: float, span: float, most: int) -> None:
    axis = Axis.linear(np.array([low, low + span]), most)
    assert 1 <= len(axis.ticks) <= most + 1
    width = axis.high - axis.low
    shares = [share for share, _ in axis.ticks]
    assert shares == sorted(shares)
    for share, text in axis.ticks:
        assert -1e-6 <= share <= 1.0 + 1e-6
        assert value(text) == pytest.approx(axis.low + share * width, abs=1e-3 * width)
    assert len({text for _, text in axis.ticks}) == len(axis.ticks)


@given(low=st.floats(-12.0, 6.0), decades=st.floats(0.01, 14.0))
def test_decade_labels_match_their_positions(low: float, decades: float) -> None:
    axis = Axis.decades(10.0 ** np.array([low, low + decades]))
    width = axis.high - axis.low
    for share, text in axis.ticks:
        assert np.log10(value(text)) == pytest.approx(axis.low + share * width, abs=1e-6)


@pytest.mark.parametrize("values", [[], [np.nan], [3.0], [0.0, 0.0], [-1e-9, 1e-9]])
def test_axis_of_one_value_has_a_width(values: list[float]) -> None:
    axis = Axis.linear(np.array(values), 5)
    assert axis.high > axis.low
    assert axis.ticks


def test_line_is_at_its_values() -> None:
    x, y = np.linspace(-3.0, 8.0, 40), np.random.default_rng(1).normal(size=40)
    panel = Panel()
    panel.plot(x, y, colour="var(--x)")
    drawn = points(paths(Figure((panel,), 200.0))[-1])
    for got, wanted, sign in ((drawn[:, 0], x, 1.0), (drawn[:, 1], y, -1.0)):
        slope, _ = np.polyfit(wanted, got, 1)
        assert np.sign(slope) == sign
        assert got == pytest.approx(np.polyval(np.polyfit(wanted, got, 1), wanted), abs=0.02)


def test_gap_in_values_is_a_gap_in_line_and_band() -> None:
    x, y = np.arange(9.0), np.ones(9)
    y[4] = np.nan
    panel = Panel()
    panel.plot(x, y, colour="var(--x)")
    panel.band(x, y - 1.0, y + 1.0, colour="var(--y)")
    line, *bands = paths(Figure((panel,), 200.0))[3:]
    assert line.count("M") == 2
    assert len(bands) == 2


def test_all_marks_together_are_valid_escaped_svg() -> None:
    above, below = Panel(), Panel()
    x = np.geomspace(0.01, 50.0, 30)
    for panel in (above, below):
        panel.dots(x, 0.1 * x, 0.01 * x, colour="var(--x)", label="a < b & c")
        panel.level(0.2, colour="var(--soft)", linewidth=1.0, linestyle="--", label="level")
        panel.ylabel = panel.xlabel = "<deg/s>"
        panel.has_key = panel.is_logarithmic = True
    text = Figure((above, below), 300.0).svg()
    assert "a &lt; b &amp; c" in text
    assert "nan" not in text
    assert len(paths(Figure((above, below), 300.0))) > 10
