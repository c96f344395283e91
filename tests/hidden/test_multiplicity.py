"""Test the power of a search with many trials against closed forms."""

from statistics import NormalDist

import numpy as np
import pytest
from tests.hidden.multiplicity import Bank, draw_scores
from tests.hidden.scoring.once import Multiplicity, compute_mean_power, compute_power
from tests.hidden.truth.detectable import compute_detectable

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.catalogue import catalogue

NORMAL = NormalDist()


@pytest.mark.parametrize("cause", ["backlash", "tilt_sag", "scale_cubic", "g_sensitivity"])
def test_the_power_of_one_of_36_tests_with_a_known_instant_is_80_percent(cause: str) -> None:
    assert compute_power(cause, tests=36.0, looks=1.0) == pytest.approx(0.8, abs=1e-9)


def test_the_power_for_one_size_is_that_of_a_normal_distribution() -> None:
    """The test has two tails, but the far tail is negligible."""
    threshold = NORMAL.inv_cdf(1.0 - 0.5 * 0.01 / (60.0 * 12.0))
    power = NORMAL.cdf(np.sqrt(compute_detectable("backlash")) - threshold)
    assert compute_power("backlash", 60.0, 12.0) == pytest.approx(power, rel=1e-6)


def test_the_mean_power_uses_the_trials_of_each_cause() -> None:
    measured = [Multiplicity("survey-40", False, 79, 60.0, {"backlash": 12.0, "tilt_sag": 1.0})]
    each = [compute_power("backlash", 60.0, 12.0), compute_power("tilt_sag", 60.0, 1.0)]
    assert compute_mean_power(measured, ["backlash", "tilt_sag"]) == pytest.approx(np.mean(each))
    assert np.isnan(compute_mean_power(measured, []))


def count_trials(white: FloatArray, draws: int = 100_000) -> float:
    bank = Bank(catalogue()["clock_step"], white, 1)
    best = np.concatenate(
        [bank.find_best(score, np.array([0]))[0] for score in draw_scores(white, draws, 3)]
    )
    threshold = float(np.quantile(best, 0.99))
    return 0.01 / (2.0 * NORMAL.cdf(-np.sqrt(threshold)))


def test_independent_rows_count_separately_and_equal_rows_count_once() -> None:
    """The best of 8 independent rows passes a threshold with probability 1 - (1 - p)^8."""
    assert count_trials(np.eye(8, 20)) == pytest.approx(8.0, rel=0.15)
    assert count_trials(np.tile(np.eye(1, 20), (8, 1))) == pytest.approx(1.0, rel=0.15)
