"""The variance of rests about their counts, by type-II maximum likelihood.

A controller that counts its steps rests exactly on a count. A controller that rounds a finer target
rests up to half a step away from it. The polls in motion show the difference: the variance of the
rests is the one with the largest likelihood of all polls. The offset of the detent is added,
because the gyro measures it and the counts do not.
"""

import numpy as np
from scipy.sparse import csc_array

from gyrorig_solver.data import FloatArray
from gyrorig_solver.numerics import ArrowheadMatrix
from gyrorig_solver.reference.unit.move_equations import BandedNormalEquations

# From exactly on the count to uniform over one step (1/12 steps^2).
VARIANCE_CANDIDATES = tuple(
    float(v) for v in np.array([0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0]) / 12.0
)
# Assumed offset of an open-loop stepper from its detent: 5 % of a full step, which is 0.1 of a
# half step. Counts do not contain it.
DETENT_VARIANCE = 0.1**2


def likeliest_rest_variance(
    equations: BandedNormalEquations, rests: slice, rest_steps: FloatArray
) -> float:
    """Return the variance of the rests with the largest likelihood of the data."""
    likelihood = [
        equations.log_evidence(rests, rest_steps, variance) for variance in VARIANCE_CANDIDATES
    ]
    return VARIANCE_CANDIDATES[int(np.argmax(likelihood))]


def add_detent_offsets(equations: BandedNormalEquations, starts: int) -> ArrowheadMatrix:
    """Return the information with the detent offset of each rest as an additional unknown.

    The rest of the stage is the rest of the count plus the detent offset.

    Args:
        equations: the whole system; of n local unknowns the first are starts, the others
            counted rests.
        starts: number of starts.

    Returns:
        Over starts, rests of the stage, rests of the count; then the shared unknowns.
    """
    n = equations.band_position.size
    row, column, value = equations.entries()
    stage = np.arange(starts, n)
    counted = stage + n - starts
    row, column = (np.where(index < starts, index, index + n - starts) for index in (row, column))
    detent_weight = np.full(n - starts, 1.0 / DETENT_VARIANCE)
    local = csc_array(
        (
            np.concatenate([value, detent_weight, detent_weight, -detent_weight, -detent_weight]),
            (
                np.concatenate([row, stage, counted, stage, counted]),
                np.concatenate([column, stage, counted, counted, stage]),
            ),
        ),
        shape=(2 * n - starts, 2 * n - starts),
    )
    cross = np.zeros((2 * n - starts, equations.cross.shape[1]))
    cross_terms = equations.cross[equations.band_position]
    cross[:starts], cross[n:] = cross_terms[:starts], cross_terms[starts:]
    return ArrowheadMatrix(local, cross, equations.shared)
