"""How likely chance alone is: tails of the chi-squared and the normal distribution.

What to use when: everywhere a p-value or a limit is wanted. `scipy.stats` has them too,
on top of these same functions, but takes half a second to import.

Source: scipy.special, i.e. Cephes and Boost; names as in Johnson, Kotz and Balakrishnan.
"""

from scipy import special


def chi2_tail(statistic: float, degrees: float) -> float:
    """Return the probability that a chi-squared of so many degrees is larger."""
    return float(special.chdtrc(degrees, statistic))


def chi2_limit(probability: float, degrees: float) -> float:
    """Return what a chi-squared exceeds with a probability."""
    return float(special.chdtri(degrees, probability))


def chi2_noncentrality(limit: float, degrees: float, power: float) -> float:
    """Return the non-centrality at which a chi-squared exceeds a limit with a probability."""
    return float(special.chndtrinc(limit, degrees, 1.0 - power))


def normal_tail(z: float) -> float:
    """Return the probability that a standard normal is larger."""
    return float(special.ndtr(-z))


def normal_limit(probability: float) -> float:
    """Return what a standard normal exceeds with a probability."""
    return float(-special.ndtri(probability))
