"""Tails and limits, against scipy.stats."""

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq

from gyrorig_solver.numerics import chi2_upper_tail, normal_quantile, normal_upper_tail
from gyrorig_solver.numerics.distributions import chi2_noncentrality, chi2_quantile


@pytest.mark.parametrize("degrees", [1, 2, 7, 120])
@pytest.mark.parametrize("statistic", [0.0, 0.3, 5.0, 80.0, 900.0])
def test_chi_squared_tail(statistic: float, degrees: int) -> None:
    assert chi2_upper_tail(statistic, degrees) == pytest.approx(
        float(stats.chi2.sf(statistic, degrees)), rel=1e-12, abs=1e-300
    )


@pytest.mark.parametrize("probability", [1e-12, 1e-4, 0.5, 0.99])
def test_quantiles(probability: float) -> None:
    assert chi2_quantile(probability, 5) == pytest.approx(float(stats.chi2.isf(probability, 5)))
    assert normal_quantile(probability) == pytest.approx(float(stats.norm.isf(probability)))
    assert normal_upper_tail(normal_quantile(probability)) == pytest.approx(probability, rel=1e-12)


@pytest.mark.parametrize("degrees", [1, 3, 24])
@pytest.mark.parametrize("limit", [26.0, 45.0])
def test_noncentrality_of_the_detectable_size(limit: float, degrees: int) -> None:
    wanted = brentq(lambda x: stats.ncx2.sf(limit, degrees, x) - 0.9, 1e-3, 1e3, xtol=1e-10)
    assert chi2_noncentrality(limit, degrees, 0.9) == pytest.approx(wanted, rel=1e-9)
    assert np.isfinite(wanted)
