"""How far rests lie off their counts, chosen by likelihood, not by assumption.

A controller that counts the steps it makes stands on a count exactly; one that rounds a
target it keeps in finer units stands up to half a step off it. Which of the two a unit
is shows in the polls on the way: the variance of the rests is the one under which all
polls together are likeliest (type-II likelihood). What a detent allows comes on top: the
counts cannot show it, so the gyro sees another rest than they do.
"""

import numpy as np
from scipy.sparse import csc_array

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.arrow import Arrow
from gyrorig_solver.reference.chain import Chain

# From exactly on the count to anywhere within it (1/12 steps^2: uniform over one step).
VARIANCES = tuple(float(v) for v in np.array([0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0]) / 12.0)
# An open-loop stepper rests off its detent by up to 5 % of a full step (unit's notes,
# section 7): 0.1 of a half step. Counts cannot show it.
DETENT_VARIANCE = 0.1**2


def likeliest_variance(chain: Chain, rests: slice, at: FloatArray) -> float:
    """Return the rests' variance about zero under which the data are likeliest.

    Args:
        chain: the system of all unknowns, without the rests' own prior.
        rests: which unknowns the rests are.
        at: where the rests are now, steps.
    """
    likelihood = [chain.likelihood(rests, at, variance) for variance in VARIANCES]
    return VARIANCES[int(np.argmax(likelihood))]


def with_detents(chain: Chain, starts: int) -> Arrow:
    """Return the information with each rest's detent as an unknown of its own.

    The rest that turns the stage is the one that was counted, plus the detent's offset.

    Args:
        chain: the whole system; of n local unknowns the first are starts, the others
            counted rests.
        starts: how many.

    Returns:
        Over starts, rests as the stage has them, rests as counted; then the shared ones.
    """
    n = chain.place.size
    row, column, value = chain.entries()
    stage = np.arange(starts, n)
    counted = stage + n - starts
    row, column = (np.where(at < starts, at, at + n - starts) for at in (row, column))
    tie = np.full(n - starts, 1.0 / DETENT_VARIANCE)
    local = csc_array(
        (
            np.concatenate([value, tie, tie, -tie, -tie]),
            (
                np.concatenate([row, stage, counted, stage, counted]),
                np.concatenate([column, stage, counted, counted, stage]),
            ),
        ),
        shape=(2 * n - starts, 2 * n - starts),
    )
    cross = np.zeros((2 * n - starts, chain.cross.shape[1]))
    beside = chain.cross[chain.place]
    cross[:starts], cross[n:] = beside[:starts], beside[starts:]
    return Arrow(local, cross, chain.shared)
