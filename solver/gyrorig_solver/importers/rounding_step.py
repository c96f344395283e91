"""Detection of the step to which a source rounded its rates.

A table in deg/s or rad/s hides the counts of the sensor and the digits of the program that wrote
it. The recording contains such rates in counts of 1e-7 rad/s, which is much finer. The fit needs
the real step, because the mean of rounded samples at rest can be wrong by half a step.

What to use when: `find_rounding_step` for the rates of one board.
"""

import numpy as np

from gyrorig_solver.data import FloatArray

MIN_STEP_RAD_S = 1e-6  # the finest digit that a logger writes; smaller steps are rounding of floats
MIN_SAMPLES = 16  # as many as the solver needs
MIN_REPEATS = 2  # a value that occurs once can be a knock
# The differences between neighbouring values are one step, or two if a value does not occur. If a
# source rounded twice, they alternate, and their mean is the step.
MAX_STEP_RATIO = 2.5


def find_rounding_step(rate_rad_s: FloatArray) -> float | None:
    """Return the step in rad/s, None if the rates show none.

    Args:
        rate_rad_s: shape (n, 3), finite.

    Most rates of a rounded source at rest are equal to other rates. Without this, the noise is
    larger than the step, and the step does not matter.
    """
    steps = [step for axis in rate_rad_s.T if (step := _find_step(axis)) is not None]
    return float(np.median(steps)) if steps else None


def _find_step(rate_rad_s: FloatArray) -> float | None:
    levels, repeats = np.unique(rate_rad_s, return_counts=True)
    is_repeated = repeats >= MIN_REPEATS
    if rate_rad_s.size < MIN_SAMPLES or 2 * repeats[is_repeated].sum() < rate_rad_s.size:
        return None
    levels, repeats = levels[is_repeated], repeats[is_repeated]
    gaps, weights = np.diff(levels), np.minimum(repeats[1:], repeats[:-1])
    is_real = gaps >= MIN_STEP_RAD_S
    if not is_real.any():
        return None
    # A rest has the most samples per level and no missing level.
    is_near = is_real & (gaps <= MAX_STEP_RATIO * gaps[is_real].min())
    return float(np.average(gaps[is_near], weights=weights[is_near]))
