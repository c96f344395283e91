"""How far rests lie off their counts, chosen by likelihood, not by assumption.

A controller that counts the steps it makes stands on a count exactly; one that rounds a
target it keeps in finer units stands up to half a step off it. Which of the two a unit
is shows in the polls on the way: the variance of the rests is the one under which all
polls together are likeliest (type-II likelihood), never less than what a detent allows.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray

# From exactly on the count to anywhere within it (1/12 steps^2: uniform over one step).
VARIANCES = tuple(float(v) for v in np.array([0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0]) / 12.0)
# An open-loop stepper rests off its detent by up to 5 % of a full step (unit's notes,
# section 7): 0.1 of a half step. Counts cannot show it.
DETENT_VARIANCE = 0.1**2


def likeliest_variance(
    information: FloatArray, score: FloatArray, rests: slice, at: FloatArray
) -> float:
    """Return the rests' variance about zero under which the data are likeliest.

    Args:
        information: of all parameters, without the rests' own prior.
        score: of the same, at the current parameters.
        rests: which parameters the rests are.
        at: where the rests are now, steps.
    """
    size = at.size
    if size == 0:
        return VARIANCES[-1]
    others = np.ones(score.size, dtype=np.bool_)
    others[rests] = False
    carry = np.linalg.solve(
        information[np.ix_(others, others)],
        np.column_stack([information[others, rests], score[others]]),
    )
    inner = information[rests, others]
    own = information[rests, rests] - inner @ carry[:, :-1]
    # The data alone say own (r - at) = pull; the prior says r ~ N(0, v).
    pull = score[rests] - inner @ carry[:, -1] + own @ at
    values, vectors = np.linalg.eigh(own)
    values = np.clip(values, 0.0, None)
    pull = vectors.T @ pull
    likelihood = [
        float(np.sum(pull**2 / (values + 1.0 / v)) - np.sum(np.log1p(v * values)))
        for v in VARIANCES
    ]
    return VARIANCES[int(np.argmax(likelihood))]


def loosened_rests(information: FloatArray, rests: slice) -> FloatArray:
    """Return the information after each rest was given a detent's own variance."""
    if rests.stop == rests.start:
        return information
    # Woodbury, I - I E (1/f + E' I E)^-1 E' I, E the rests' columns.
    columns = information[:, rests]
    inner = information[rests, rests] + np.eye(columns.shape[1]) / DETENT_VARIANCE
    return np.asarray(information - columns @ np.linalg.solve(inner, columns.T), dtype=np.float64)
