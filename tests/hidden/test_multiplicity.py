"""What looking in many places costs: against closed forms."""

from statistics import NormalDist

import numpy as np
import pytest
from tests.hidden.multiplicity import Bank, drawn
from tests.hidden.scoring.once import Multiplicity, borne, chance_once
from tests.hidden.truth.detectable import detectable_of

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.catalogue import catalogue

NORMAL = NormalDist()


@pytest.mark.parametrize("cause", ["backlash", "tilt_sag", "scale_cubic", "g_sensitivity"])
def test_one_of_36_tests_that_know_the_instant_finds_four_in_five(cause: str) -> None:
    assert chance_once(cause, tests=36.0, looks=1.0) == pytest.approx(0.8, abs=1e-9)


def test_of_one_size_it_is_the_normal_distributions_power() -> None:
    """Both tails: the far one has nothing to say."""
    bar = NORMAL.inv_cdf(1.0 - 0.5 * 0.01 / (60.0 * 12.0))
    power = NORMAL.cdf(np.sqrt(detectable_of("backlash")) - bar)
    assert chance_once("backlash", 60.0, 12.0) == pytest.approx(power, rel=1e-6)


def test_the_mean_is_over_cases_and_each_causes_own_looks() -> None:
    measured = [Multiplicity("survey-40", False, 79, 60.0, {"backlash": 12.0, "tilt_sag": 1.0})]
    each = [chance_once("backlash", 60.0, 12.0), chance_once("tilt_sag", 60.0, 1.0)]
    assert borne(measured, ["backlash", "tilt_sag"]) == pytest.approx(np.mean(each))
    assert np.isnan(borne(measured, []))


def looks_of(white: FloatArray, draws: int = 100_000) -> float:
    bank = Bank(catalogue()["clock_step"], white, 1)
    best = np.concatenate([bank.best(score, np.array([0]))[0] for score in drawn(white, draws, 3)])
    bar = float(np.quantile(best, 0.99))
    return 0.01 / (2.0 * NORMAL.cdf(-np.sqrt(bar)))


def test_rows_that_are_apart_are_as_many_looks_and_alike_ones_are_one() -> None:
    """The best of 8 independent ones passes a bar 1 - (1 - p)^8 of the time."""
    assert looks_of(np.eye(8, 20)) == pytest.approx(8.0, rel=0.15)
    assert looks_of(np.tile(np.eye(1, 20), (8, 1))) == pytest.approx(1.0, rel=0.15)
