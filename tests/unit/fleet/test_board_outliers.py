"""Boards that are odd: their p values by simulation of healthy fleets, and what they show."""

import numpy as np
import pytest
from scipy.stats import kstest
from scipy.stats import t as student

from gyrorig_solver.fleet.drift.board_outliers import outlier_p_values
from gyrorig_solver.fleet.drift.ewma_charts import benjamini_hochberg
from gyrorig_solver.fleet.drift.population import fit_population


def fitted_z(rng: np.random.Generator, boards: int, parameters: int = 13) -> np.ndarray:
    std = np.full(boards, 0.05)
    columns = [
        fit_population("scale_x", rng.normal(0.0, 1.0, boards), std).z for _ in range(parameters)
    ]
    z: np.ndarray = np.stack(columns, axis=1)
    return z


def test_p_values_of_large_fleets_are_uniform() -> None:
    rng = np.random.default_rng(41)
    mixing = np.array([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0], [0.0, 0.5, 0.87]])
    z = rng.normal(size=(4000, 3)) @ mixing.T
    assert kstest(outlier_p_values(z), "uniform").pvalue > 0.01
    z[0] = [3.0, -3.0, 0.0]  # each alone is nothing; together, against their correlation
    assert outlier_p_values(z)[0] < 1e-6


def test_a_single_parameter_has_the_p_values_of_students_t() -> None:
    """Each board beside mean and variance of the others, one after the other."""
    z = np.random.default_rng(42).normal(size=(12, 1))
    expected = []
    for index in range(12):
        others = np.delete(z[:, 0], index)
        t = (z[index, 0] - others.mean()) / (np.std(others, ddof=1) * np.sqrt(1 + 1 / 11))
        expected.append(2 * student.sf(abs(t), 10))
    np.testing.assert_allclose(outlier_p_values(z), expected)


@pytest.mark.parametrize("correlation", [0.8, 0.95])
def test_a_missing_parameter_is_not_an_outlier(correlation: float) -> None:
    rng = np.random.default_rng(43)
    z = rng.multivariate_normal([0, 0], [[1, correlation], [correlation, 1]], 1000)
    z[:300, 1] = np.nan
    p_values = outlier_p_values(z)
    assert np.mean(p_values[:300] < 0.01) < 0.03
    assert kstest(p_values[:300], "uniform").pvalue > 0.01


@pytest.mark.parametrize(("boards", "fleets"), [(8, 100), (16, 60), (24, 40), (30, 40), (50, 25)])
def test_small_healthy_fleets_have_no_outlier(boards: int, fleets: int) -> None:
    """At most one fleet in a hundred; three of the hundred have a chance of 2 %."""
    rng = np.random.default_rng(44)
    with_outlier = sum(
        bool(benjamini_hochberg(outlier_p_values(fitted_z(rng, boards))).any())
        for _ in range(fleets)
    )
    assert with_outlier <= 2


@pytest.mark.parametrize("boards", [10, 30, 200])
def test_outliers_are_found_in_small_and_large_fleets(boards: int) -> None:
    rng = np.random.default_rng(45)
    values = rng.normal(0.0, 1.0, (boards, 13))
    values[3, 5] += 40.0
    std = np.full(boards, 0.05)
    z = np.stack([fit_population("scale_x", column, std).z for column in values.T], axis=1)
    assert list(np.flatnonzero(benjamini_hochberg(outlier_p_values(z)))) == [3]


def test_boards_without_values_are_not_tested() -> None:
    z = np.random.default_rng(46).normal(size=(20, 2))
    z[4] = np.nan
    z[5:, 1] = np.nan
    p_values = outlier_p_values(z)
    assert list(np.flatnonzero(np.isnan(p_values))) == [4]
    assert np.isfinite(outlier_p_values(np.zeros((20, 3)))).all()
