"""The p-values of a twin check: uniform without a difference, small with one."""

from dataclasses import replace

import numpy as np
import pytest

from gyrorig_solver.data import FloatArray
from gyrorig_solver.twin_check.feature_comparison import compare_families, upper_tail
from gyrorig_solver.twin_check.session_features import Family

FEATURES, DRAWS = 30, 20


def family_of(values: FloatArray) -> Family:
    """Return a family with these values."""
    x = np.arange(values.size, dtype=np.float64)
    return Family("pan", "gain error", "%", "pan, deg", x, ("x",) * values.size, values, 1e-9)


def test_p_values_are_uniform_without_a_difference() -> None:
    """Measurement and draws of one distribution: Kolmogorov-Smirnov over 300 sessions."""
    random = np.random.default_rng(1)
    p_values = []
    for _ in range(300):
        rows = random.normal(size=(DRAWS + 1, FEATURES))
        draws = [[family_of(row)] for row in rows[1:]]
        p_values.append(compare_families([family_of(rows[0])], draws)[0].p_value)
    ordered = np.sort(p_values)
    steps = np.arange(1, ordered.size + 1) / ordered.size
    assert np.abs(ordered - steps).max() < 1.63 / np.sqrt(ordered.size)  # 1 % limit


def test_p_values_are_uniform_with_correlated_heavy_tails() -> None:
    """A common error of all bins, and Student's t with 4 degrees of freedom."""
    random = np.random.default_rng(4)
    p_values = []
    for _ in range(300):
        rows = random.standard_t(4, size=(DRAWS + 1, FEATURES))
        rows = rows + 2.0 * random.standard_t(4, size=(DRAWS + 1, 1))
        draws = [[family_of(row)] for row in rows[1:]]
        p_values.append(compare_families([family_of(rows[0])], draws)[0].p_value)
    ordered = np.sort(p_values)
    steps = np.arange(1, ordered.size + 1) / ordered.size
    assert np.abs(ordered - steps).max() < 1.63 / np.sqrt(ordered.size)  # 1 % limit


def test_equal_values_show_no_difference() -> None:
    """Rest positions that are the targets in every session."""
    draws = [[family_of(np.zeros(FEATURES))] for _ in range(DRAWS)]
    assert compare_families([family_of(np.zeros(FEATURES))], draws)[0].p_value == 1.0
    moved = family_of(np.full(FEATURES, 1e-3))
    assert compare_families([moved], draws)[0].p_value < 1e-12


def test_a_rare_event_is_no_difference() -> None:
    """One stall of the host in the measurement, and none in any draw."""
    draws = [[replace(family_of(np.zeros(2)), is_of_rare_events=True)] for _ in range(DRAWS)]
    measured = replace(family_of(np.array([12.0, 12.0])), is_of_rare_events=True)
    assert compare_families([measured], draws)[0].p_value == pytest.approx(1.0 / (DRAWS + 1))


def test_a_difference_is_found_and_sized() -> None:
    """A shift of one bin by 1 unit with a scatter of 0.1."""
    random = np.random.default_rng(2)
    draws = [[family_of(random.normal(scale=0.1, size=FEATURES))] for _ in range(DRAWS)]
    values = random.normal(scale=0.1, size=FEATURES)
    values[7] += 1.0
    comparison = compare_families([family_of(values)], draws)[0]
    assert comparison.p_value < 1e-3
    assert comparison.worst == 7
    assert comparison.size == pytest.approx(1.0 / np.sqrt(FEATURES), rel=0.3)


def test_bins_without_data_are_left_out() -> None:
    """A bin that one session does not fill decides nothing."""
    random = np.random.default_rng(3)
    draws = [[family_of(random.normal(size=FEATURES))] for _ in range(DRAWS)]
    values = random.normal(size=FEATURES)
    values[0] = np.nan
    comparison = compare_families([family_of(values)], draws)[0]
    assert np.isnan(comparison.z[0])
    assert np.isfinite(comparison.p_value)


def test_families_that_no_draw_has_are_left_out() -> None:
    """A family of another size cannot be compared."""
    draws = [[family_of(np.zeros(3))] for _ in range(DRAWS)]
    assert compare_families([family_of(np.zeros(4))], draws) == []


def test_upper_tail_of_the_mean_is_one_half() -> None:
    """Student's t is symmetric."""
    sample = np.array([1.0, 2.0, 3.0, 4.0])
    assert upper_tail(2.5, sample) == pytest.approx(0.5)
    assert upper_tail(40.0, sample) < 1e-3
