"""Spikes and glitches: samples of no motion and no noise, found in a residual."""

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray

SPIKE_SIGMA = 6.0  # a sample this far off is no sample of the model's noise
ENOUGH = 8192  # samples to judge a deviation by
NEIGHBOURS = 4  # on each side: a glitch of up to four samples sticks out from nine
GROSS = 8.0  # times the limit: 48 deviations
FEWEST_CALM = 3


def spikes(left: FloatArray, use: BoolArray, quantum_rad_s: float) -> BoolArray:
    """Return which rows are spikes: far from all, and far from their neighbours.

    What a wrong start or a wrong model leaves is smooth over some samples: it is no spike,
    and to set it aside would hide it.
    """
    middle, deviation = spread(left, use, quantum_rad_s)
    limit = SPIKE_SIGMA * deviation
    odd = np.asarray((np.abs(left - middle) > limit).any(axis=1) & use, dtype=np.bool_)
    if not odd.any():
        return odd
    far = np.flatnonzero(odd)
    # At the ends the window is moved inwards, so that it holds as many.
    begin = np.clip(far - NEIGHBOURS, 0, max(0, left.shape[0] - 2 * NEIGHBOURS - 1))
    near = np.minimum(begin[:, None] + np.arange(2 * NEIGHBOURS + 1), left.shape[0] - 1)
    fit = use[near]
    # Judged by all neighbours, so that a transient of the rig stays; what is beyond any
    # transient by those that are not far themselves: glitches may come in twos.
    gross = (np.abs(left[far] - middle) > GROSS * limit).any(axis=1)
    calm = fit & ~odd[near]
    enough = calm.sum(axis=1) >= FEWEST_CALM
    by = np.where((gross & enough)[:, None], calm, fit)
    around = np.where(by[:, :, None], left[near], np.nan)
    alone = np.abs(left[far] - np.nanmedian(around, axis=1)) > limit
    odd[far] = alone.any(axis=1)
    return odd


def spread(left: FloatArray, use: BoolArray, quantum_rad_s: float) -> tuple[FloatArray, FloatArray]:
    """Return median and robust deviation of a residual's used rows, (3,) each."""
    own = (left if use.all() else left[use])[:: max(1, int(use.sum()) // ENOUGH)]
    middle = np.median(own, axis=0)
    deviation = 1.4826 * np.median(np.abs(own - middle), axis=0)
    return np.asarray(middle), np.maximum(deviation, quantum_rad_s)
