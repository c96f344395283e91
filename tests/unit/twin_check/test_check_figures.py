"""The figures of the page of a check: labels that can be read, and the right axes."""

import re

import numpy as np
import pytest

from gyrorig_solver.report.svg_panels import FONT, LETTER_WIDTH_SHARE
from gyrorig_solver.twin_check.check_figures import draw_timing
from gyrorig_solver.twin_check.feature_comparison import FamilyComparison, compare_families
from gyrorig_solver.twin_check.session_features import Family

SIDE_LABEL = re.compile(r'translate\(12 ([\d.]+)\) rotate\(-90\)">([^<]*)</text>')
QUANTILES = np.array([0.05, 0.25, 0.5, 0.75, 0.95, 0.99])


def family(key: str, x: np.ndarray, seed: int) -> Family:
    values = np.random.default_rng(seed).normal(size=x.size)
    return Family(key, key, "ms", "x", x, ("",) * x.size, values, 0.01)


def compared(*keys: str) -> list[FamilyComparison]:
    """Return comparisons of a measurement with draws; the clock has a skew and three changes."""
    axes = {key: np.arange(4.0) if key == "clock" else QUANTILES for key in keys}
    sessions = [[family(key, x, seed) for key, x in axes.items()] for seed in range(8)]
    return compare_families(sessions[0], sessions[1:])


def test_labels_at_the_side_do_not_overlap() -> None:
    figures = draw_timing(compared("latency", "jitter", "answer_time", "clock"))
    assert len(figures) == 2
    for figure in figures:
        height = float(re.findall(r'viewBox="0 0 [\d.]+ ([\d.]+)"', figure["svg"])[0])
        ends = [0.0]
        for middle, label in SIDE_LABEL.findall(figure["svg"]):
            half = 0.5 * LETTER_WIDTH_SHARE * FONT * len(label)
            assert float(middle) - half > ends[-1]
            ends.append(float(middle) + half)
        assert len(ends) > 1
        assert ends[-1] < height


def test_quantiles_and_changes_of_the_clock_have_separate_axes() -> None:
    quantiles, clock = draw_timing(compared("latency", "clock"))
    assert ">quantile<" in quantiles["svg"]
    assert "log10" not in quantiles["svg"]
    assert ">log10 of the time between changes, s<" in clock["svg"]


@pytest.mark.parametrize(("keys", "count"), [((), 0), (("clock",), 1), (("jitter",), 1)])
def test_only_what_was_compared_is_drawn(keys: tuple[str, ...], count: int) -> None:
    assert len(draw_timing(compared(*keys))) == count
