"""Non-centrality of an effect that only increases the scatter of a residual.

Let S be the added variance in units of the variance of the noise. The score of the size is then a
test of the variance. Its non-centrality is tr(S^2) / 2 (half the Fisher information of covariance
parameters), minus the part that the unknown noise levels absorb.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.support.noncentrality import NuisanceProjector, coefficient_variances

from gyrorig_daemon.emulator.noise_free_rates import NoiseFreeRates
from gyrorig_daemon.emulator.rig_truth import DEG

FloatArray = NDArray[np.float64]

_DRAWS = 120  # with 7140 pairs, the error of a trace is 2 %

# Noise of the noisiest board that the spread of the parts allows. Only more noise is an effect.
_MOST_FLICKER_RAD_S = 40.0 * DEG / 3600.0
_MOST_WALK = 0.45e-3 * DEG


def compute_jitter_noncentrality(space: NuisanceProjector, rates: NoiseFreeRates) -> float:
    """Return the non-centrality of jitter of 1 s, from pairs of random draws.

    The mean of (a . b)^2 over pairs of independent draws is tr(S^2). The white level of each axis
    absorbs (tr S)^2 / n of it.
    """
    rng = np.random.default_rng(0)
    slope = rates.slope_rad_s2[space.inside]
    draws = np.stack(
        [space.project(slope * rng.standard_normal((len(slope), 1))) for _ in range(_DRAWS)]
    )
    products = (draws @ draws.T) ** 2
    pairs = _DRAWS * (_DRAWS - 1)
    whole = float(products.sum() - np.trace(products)) / pairs
    by_axis = (draws**2).reshape(_DRAWS, -1, 3).sum(axis=1).mean(axis=0)
    level = float((by_axis**2).sum()) / (draws.shape[1] / 3.0)
    return float(0.5 * max(whole - level, 0.0))


def compute_walk_noncentrality(board: Mapping[str, Any], walk: FloatArray, count: int) -> float:
    """Return the non-centrality of random walk beyond that of the noisiest board.

    Args:
        board: its truth document.
        walk: added random walk, rad/s per sqrt(s), (3,).
        count: number of samples.
    """
    odr_hz = float(board["odr_hz"])
    noisy = {
        **board,
        "bias_instability_rad_s": [_MOST_FLICKER_RAD_S] * 3,
        "rate_random_walk_rad_s_rts": [_MOST_WALK] * 3,
    }
    f = np.arange(1, count) * odr_hz / (2.0 * count)
    added = 0.5 * odr_hz * np.outer(1.0 / (2.0 * (np.pi * f) ** 2), walk**2)
    share = added / coefficient_variances(noisy, count)
    return float(np.sum(share - np.log1p(share)))
