"""Tests whether a variance grows with given shapes, from squares of a whitened residual.

What to use when: `fit_variance_trend` for any shapes; `speed_shapes` for motion and speed.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.cause_findings import SignificanceTest
from gyrorig_solver.numerics import chi2_upper_tail, normal_upper_tail, score_statistic

SPEED_WAVES = 3  # half waves over the speeds
MOVING_RAD_S = 1e-3
# Relative to the strongest; shapes that are sums of others add no information.
MIN_RELATIVE_STRENGTH = 1e-7


NO_TREND = SignificanceTest(0.0, 0, 1.0)


def speed_shapes(speed_rad_s: FloatArray, fastest_rad_s: float) -> FloatArray:
    """Return shapes of a variance: in motion, then half waves of the speed, (k, n)."""
    share = speed_rad_s / max(fastest_rad_s, MOVING_RAD_S)
    waves = np.cos(np.pi * np.arange(SPEED_WAVES + 1)[:, None] * share)
    return np.where(speed_rad_s > MOVING_RAD_S, waves, 0.0)


def fit_variance_trend(
    shapes: FloatArray, excess: FloatArray, two_sided: bool = False
) -> SignificanceTest:
    """Test whether a variance grows with given shapes: with the first, or with all together.

    Let w be a shape minus its mean, and e the squares minus 1. In noise, z = w e / sqrt(2 w w) is
    standard normal, because it is a sum of many terms with variance 2. All shapes together give the
    chi-squared statistic s' (2 W W')^-1 s with s = W e. An effect that the model lacks increases
    the scatter and never decreases it, so only z > 0 counts. The smaller p-value of the two tests
    is doubled.

    Args:
        shapes: (k, n); the first is the overall shape, and the others divide it.
        excess: squares of a whitened residual, minus 1, (n,).
        two_sided: less scatter counts too, for example after a cause that absorbed too much.
    """
    weights = shapes - shapes.mean(axis=1, keepdims=True)
    first_norm = float(np.sqrt(2.0 * np.sum(weights[0] ** 2)))
    if first_norm <= 0.0:
        return NO_TREND
    z = float(weights[0] @ excess) / first_norm
    first_shape_test = SignificanceTest(max(z, 0.0) ** 2, 1, normal_upper_tail(z))
    if len(shapes) == 1 or (z <= 0.0 and not two_sided):
        return first_shape_test
    statistic, degrees = score_statistic(
        2.0 * weights @ weights.T, weights @ excess, MIN_RELATIVE_STRENGTH
    )
    joint_test = SignificanceTest(statistic, degrees, chi2_upper_tail(statistic, degrees))
    best = min(first_shape_test, joint_test, key=lambda test: test.p_value)
    return SignificanceTest(best.statistic, best.degrees_of_freedom, min(1.0, 2.0 * best.p_value))
