"""A typical board: the parameters for which a fit is predicted.

What to use when: `TYPICAL_MOUNT` for a predicted signal; `expected_estimate` for the expected
result of a fit of that board, which decides the observability of derived numbers.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.information import PARAMETER_NAMES
from gyrorig_solver.estimate.observability import ObservabilityAnalysis, prior_std
from gyrorig_solver.model.gain_matrix import rotation_matrix

# The gain of a board that was screwed on by hand. For a perfectly aligned board, some numbers do
# not depend on a column that was never excited; for every real board they do, and are unobservable.
TYPICAL_MOUNT = rotation_matrix(np.array([0.03, -0.03, 0.03]))
# Gain, bias and time offset of that board and of the nominal one, as in `PARAMETER_NAMES`.
TYPICAL_PARAMETERS = np.concatenate([TYPICAL_MOUNT.ravel(), np.zeros(4)])
NOMINAL_PARAMETERS = np.concatenate([np.eye(3).ravel(), np.zeros(4)])


def expected_estimate(analysis: ObservabilityAnalysis) -> FloatArray:
    """Return the expected estimate for a typical board; unobservable parameters stay nominal."""
    prior_pull = analysis.unobservable_covariance @ (
        (TYPICAL_PARAMETERS - NOMINAL_PARAMETERS) / prior_std(PARAMETER_NAMES) ** 2
    )
    return np.asarray(TYPICAL_PARAMETERS - prior_pull, dtype=np.float64)
