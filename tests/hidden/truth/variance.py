"""How visible an effect is that only makes a residual scatter more.

With S the variance that it adds, in units of the noise's, the score of its size is a test of
the variance; its non-centrality is tr(S^2) / 2 (half the Fisher information of covariance
parameters), less what unknown levels of the noise absorb.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.support.noncentrality import NuisanceProjector, coefficient_variances

from gyrorig_daemon.emulator.noise_free_rates import NoiseFreeRates
from gyrorig_daemon.emulator.rig_truth import DEG

FloatArray = NDArray[np.float64]

_DRAWS = 120  # pairs of them: 7140, so that a trace is known to 2 %

# The noisiest board that the spread of the parts allows: more is an effect, less is a board.
_MOST_FLICKER_RAD_S = 40.0 * DEG / 3600.0
_MOST_WALK = 0.45e-3 * DEG


def jitter_noncentrality(space: NuisanceProjector, rates: NoiseFreeRates) -> float:
    """Return the non-centrality of jitter of 1 s, by pairs of random draws.

    (a . b)^2 of two independent draws has the mean tr(S^2); what each axis' white level
    absorbs is (tr S)^2 / n of it.
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


def walk_noncentrality(board: Mapping[str, Any], walk: FloatArray, count: int) -> float:
    """Return the non-centrality of more random walk than the noisiest board has.

    Args:
        board: its truth document.
        walk: what is added, rad/s per sqrt(s), (3,).
        count: samples.
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
