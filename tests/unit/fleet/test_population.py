"""Means, spreads and odd boards, beside a likelihood that somebody else maximises."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from gyrorig_solver.fleet.drift.common_offsets import common_offset
from gyrorig_solver.fleet.drift.population import (
    cochran_q_test,
    fit_population,
    fit_spread,
)

RNG = np.random.default_rng(20261121)


def fleet(n: int, spread: float, *, mean: float = 1.0, rng=RNG) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    std = rng.uniform(0.5e-3, 2e-3, n)
    return mean + rng.normal(0.0, spread, n) + rng.normal(0.0, std), std


def restricted(tau2: float, y: np.ndarray, v: np.ndarray) -> float:
    """Minus twice the restricted log-likelihood, as in Patterson and Thompson (1971)."""
    w = 1.0 / (tau2 + v)
    mean = (w * y).sum() / w.sum()
    return float(-np.log(w).sum() + np.log(w.sum()) + (w * (y - mean) ** 2).sum())


@pytest.mark.parametrize("spread", [0.0, 0.3e-3, 2e-3, 20e-3])
def test_the_spread_maximises_the_restricted_likelihood(spread: float) -> None:
    y, s = fleet(40, spread)
    result = fit_population("scale_x", y, s)
    best = minimize_scalar(
        restricted, args=(y, s * s), bounds=(0.0, 1e-3), method="bounded", options={"xatol": 1e-13}
    )
    assert restricted(result.spread**2, y, s * s) <= best.fun + 1e-6


def test_means_and_spreads_have_the_stated_coverage() -> None:
    """400 fleets: 95 % intervals of the mean, and the spread's own deviation."""
    inside, off = 0, []
    for _ in range(400):
        y, s = fleet(60, 2e-3)
        result = fit_population("scale_x", y, s)
        inside += abs(result.mean - 1.0) < 1.96 * result.mean_std
        off.append((result.spread - 2e-3) / result.spread_std)
    assert 0.92 <= inside / 400 <= 0.98
    assert abs(np.mean(off)) < 0.25
    assert 0.85 < np.std(off) < 1.15


def test_shrinkage_estimates_are_closer_with_correct_uncertainty() -> None:
    rng = np.random.default_rng(5)
    raw, shrunk, z = [], [], []
    for _ in range(200):
        truth = rng.normal(0.0, 1.0, 50)
        s = rng.uniform(0.5, 3.0, 50)
        y = truth + rng.normal(0.0, s)
        result = fit_population("bias_x", y, s)
        raw.append(np.mean((y - truth) ** 2))
        shrunk.append(np.mean((result.shrunk - truth) ** 2))
        z.append((result.shrunk - truth) / result.shrunk_std)
    assert np.mean(shrunk) < 0.4 * np.mean(raw)
    assert 0.95 < np.std(z) < 1.1


def test_one_outlier_does_not_increase_the_spread() -> None:
    y, s = fleet(50, 2e-3)
    alone = fit_population("scale_x", y, s)
    y[7] += 0.1
    result = fit_population("scale_x", y, s)
    assert list(np.flatnonzero(result.is_outlier)) == [7]
    assert result.spread < 1.2 * alone.spread


@pytest.mark.parametrize("boards", [8, 10, 16])
def test_no_board_of_small_healthy_fleets_is_excluded(boards: int) -> None:
    rng = np.random.default_rng(14)
    std = np.full(boards, 0.02)
    with_outlier = 0
    for _ in range(500):
        y = rng.normal(0.0, 1.0, boards)
        with_outlier += int(fit_spread(y, std).spread ** 2 < 0.99 * np.var(y, ddof=1) - 4e-4)
    assert with_outlier <= 3
    y[0] = 100.0
    assert fit_population("scale_x", y, std).is_outlier[0]


def test_a_common_offset_of_few_boards_has_the_p_value_of_students_t() -> None:
    """Eight boards whose mean is 3.5 spreads off: one healthy fleet in 50 000 has this."""
    y = np.random.default_rng(15).normal(0.0, 1.0, 8)
    y = 1.0 + 3.5e-3 + 1e-3 * (y - y.mean()) / y.std(ddof=1)
    result = common_offset(fit_population("scale_x", y, np.full(8, 1e-6)), 1.0)
    expected = 2.0 * student.sf(3.5 * np.sqrt(8.0), 7)
    assert result.p_value == pytest.approx(expected, rel=1e-3)
    assert result.answer != "same"


def test_uncertain_boards_are_prior_dominated() -> None:
    y, s = fleet(30, 1e-3)
    s[3], y[3] = 0.1, 1.2
    result = fit_population("scale_x", y, s)
    assert result.prior_dominated[3]
    assert abs(result.shrunk[3] - 1.0) < 2e-3


def test_a_bad_lot_is_found_and_equal_lots_are_not() -> None:
    lots = ["a"] * 20 + ["b"] * 20 + ["c"] * 20
    p_values = []
    for _ in range(200):
        y, s = fleet(60, 2e-3)
        result = cochran_q_test(fit_population("scale_x", y, s), y, s, lots)
        assert result is not None
        p_values.append(result.p_value)
    assert 0.01 < np.mean(np.array(p_values) < 0.05) < 0.1
    y, s = fleet(60, 2e-3)
    y[20:40] += 5e-3
    bad = cochran_q_test(fit_population("scale_x", y, s), y, s, lots)
    assert bad is not None
    assert (bad.extreme_group, bad.p_value < 1e-5) == ("b", True)
    assert bad.extreme_offset == pytest.approx(5e-3 * 2 / 3, rel=0.4)


@pytest.mark.parametrize("sizes", [(2, 1, 1, 1, 1, 1, 1), (2, 2, 2, 2), (4, 4), (8, 8)])
def test_equal_small_groups_have_the_stated_false_alarm_rate(sizes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(13)
    groups = [str(number) for number, size in enumerate(sizes) for _ in range(size)]
    std = np.full(len(groups), 0.02)
    p_values = []
    for _ in range(400):
        y = rng.normal(0.0, 1.0, len(groups))
        result = cochran_q_test(fit_population("scale_x", y, std), y, std, groups)
        if result is not None:  # else all pairs are outliers
            p_values.append(result.p_value)
    assert len(p_values) > 350
    assert np.mean(np.array(p_values) < 0.05) < 0.08
    assert np.mean(np.array(p_values) < 1e-3) < 0.01


def test_groups_of_single_boards_are_not_tested() -> None:
    y, s = fleet(10, 2e-3)
    assert cochran_q_test(fit_population("scale_x", y, s), y, s, list("abcdefghij")) is None


def test_one_group_is_not_tested() -> None:
    y, s = fleet(20, 2e-3)
    assert cochran_q_test(fit_population("scale_x", y, s), y, s, ["a"] * 20) is None


def test_a_common_offset_is_distinguished_from_spread() -> None:
    # a program that has the constant 16 in place of 900 pi / 180 = 15.71
    y, s = fleet(100, 2e-3, mean=16.0 / (900.0 * np.pi / 180.0))
    assert common_offset(fit_population("scale_x", y, s), 1.0).is_common
    y, s = fleet(100, 20e-3)
    assert not common_offset(fit_population("scale_x", y, s), 1.0).is_common


def test_too_few_boards_are_refused() -> None:
    with pytest.raises(ValueError, match="too few"):
        fit_population("scale_x", np.ones(3), np.ones(3))


def test_with_equal_uncertainties_mean_and_spread_are_the_plain_ones() -> None:
    y = np.random.default_rng(8).normal(1.0, 2e-3, 40)
    result = fit_spread(y, np.full(40, 1e-3))
    assert result.mean == pytest.approx(np.mean(y), rel=1e-12)
    assert result.spread == pytest.approx(np.sqrt(np.var(y, ddof=1) - 1e-6), rel=1e-6)
    assert result.mean_std == pytest.approx(np.std(y, ddof=1) / np.sqrt(40), rel=1e-6)


def test_equal_boards_are_not_different() -> None:
    rng = np.random.default_rng(9)
    p = [
        fit_population("scale_x", *fleet(60, 0.0, rng=rng)).homogeneity_p_value for _ in range(200)
    ]
    assert 0.01 < np.mean(np.array(p) < 0.05) < 0.1
    assert fit_population("scale_x", *fleet(60, 3e-3, rng=rng)).homogeneity_p_value < 1e-6


def test_a_lot_that_is_off_as_a_whole_is_a_bad_lot() -> None:
    """One of five: each of its boards is odd beside the others, and together they are a lot."""
    rng = np.random.default_rng(10)
    lots = [lot for lot in "abcde" for _ in range(20)]
    y, s = fleet(100, 2e-3, rng=rng)
    y[20:40] += 0.2
    result = fit_population("scale_x", y, s)
    assert result.is_outlier[20:40].all()
    reported = cochran_q_test(result, y, s, lots)
    assert reported is not None
    assert (reported.extreme_group, reported.p_value < 1e-6) == ("b", True)
    assert reported.extreme_offset == pytest.approx(0.2 * 4 / 5, rel=0.05)


def test_an_outlier_is_not_attributed_to_its_lot() -> None:
    rng = np.random.default_rng(11)
    lots = [lot for lot in "abcde" for _ in range(20)]
    y, s = fleet(100, 2e-3, rng=rng)
    y[25] += 0.2
    reported = cochran_q_test(fit_population("scale_x", y, s), y, s, lots)
    assert reported is not None
    assert reported.p_value > 1e-3
