"""Tail probabilities and quantiles of the chi-squared, F, Student's t and normal distributions.

What to use when: for every p-value and every limit. `scipy.stats` has the same functions, based on
these, but takes half a second to import.

Source: scipy.special, i.e. Cephes and Boost; names as in Johnson, Kotz and Balakrishnan.
"""

import numpy as np
from scipy import special

from gyrorig_solver.data import FloatArray

_MIN_TAIL = 1e-280
_MAX_STUDENT_DEGREES = 1e9  # more make no difference to a normal distribution


def chi2_upper_tail(statistic: float, degrees: float) -> float:
    """Return the probability that a chi-squared variable exceeds a statistic."""
    return float(special.chdtrc(degrees, statistic))


def chi2_quantile(probability: float, degrees: float) -> float:
    """Return the value that a chi-squared variable exceeds with a probability."""
    return float(special.chdtri(degrees, probability))


def chi2_noncentrality(limit: float, degrees: float, power: float) -> float:
    """Return the non-centrality at which a chi-squared variable exceeds a limit with a power."""
    return float(special.chndtrinc(limit, degrees, 1.0 - power))


def f_quantile(probability: float, degrees: float, denominator_degrees: float) -> float:
    """Return the value that a variable with an F distribution exceeds with a probability."""
    return 1.0 / float(special.fdtri(denominator_degrees, degrees, probability))


def f_upper_tail(statistic: float, degrees: float, denominator_degrees: float) -> float:
    """Return the probability that a variable with an F distribution exceeds a statistic."""
    return float(special.fdtrc(degrees, denominator_degrees, statistic))


def normal_score(t: FloatArray, degrees: FloatArray | float) -> FloatArray:
    """Return the standard normal scores that have the tail probabilities of Student's t.

    Args:
        t: any shape.
        degrees: of freedom, above zero, at most infinity; a shape that broadcasts with `t`.

    Where the tail probability is too small for a float, the approximation by Wallace (1959,
    Annals of Mathematical Statistics 30) is returned.
    """
    finite_degrees = np.minimum(degrees, _MAX_STUDENT_DEGREES)
    tail = special.stdtr(finite_degrees, -np.abs(t))
    factor = (8.0 * finite_degrees + 1.0) / (8.0 * finite_degrees + 3.0)
    far_score = factor * np.sqrt(finite_degrees * np.log1p(t * t / finite_degrees))
    with np.errstate(divide="ignore"):
        score = np.where(tail > _MIN_TAIL, -special.ndtri(tail), far_score)
    signed_score: FloatArray = np.copysign(score, t)
    return signed_score


def student_factor(degrees: FloatArray | float, tail_probability: float = 0.05) -> FloatArray:
    """Return the quantile of Student's t divided by that of the normal distribution.

    Args:
        degrees: of freedom, any shape; NaN and zero give NaN.
        tail_probability: two-sided; 0.05 is the ratio of the half-widths of 95 % intervals.
    """
    normal_quantile = special.ndtri(0.5 * tail_probability)
    student_quantile = special.stdtrit(degrees, 0.5 * tail_probability)
    return np.asarray(student_quantile / normal_quantile, dtype=np.float64)


def normal_upper_tail(z: float) -> float:
    """Return the probability that a standard normal variable is larger."""
    return float(special.ndtr(-z))


def normal_quantile(probability: float) -> float:
    """Return the value that a standard normal variable exceeds with a probability."""
    return float(-special.ndtri(probability))
