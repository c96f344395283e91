"""Upper bound on the share of causes that can be stated alone.

A cause can be stated alone if its posterior probability is 95 %. With equal priors its
log-likelihood must then exceed that of its best rival by ln 19 nats. If l is the non-centrality
between the two, the difference has the distribution N(l / 2, l), and the probability is
Phi((l / 2 - ln 19) / sqrt(l)). The mean of these probabilities is an upper bound for every method
with correct probabilities. More rivals, or an unknown shape, reduce the share further.

What to use when: `Bound` for one case; `compute_largest_share` for the share; scoring/bound.py
measures the bounds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

LEAD_NATS = math.log(0.95 / 0.05)  # nats
_LEAST = 1e-12


@dataclass(frozen=True, slots=True)
class Bound:
    """Similarity of the best rival to the hidden cause of a case."""

    seed: int
    cause: str
    times: float
    soak: bool
    rival: str  # empty if there is none
    left: float  # share of the effect that the rival leaves
    noncentrality: float  # of that residual

    @property
    def chance(self) -> float:
        """Probability that the cause can be stated alone."""
        root = math.sqrt(max(self.noncentrality, _LEAST))
        return NormalDist().cdf((0.5 * self.noncentrality - LEAD_NATS) / root)


def compute_largest_share(bounds: Sequence[Bound]) -> float:
    """Return the largest share of cases that can be stated alone, NaN for none."""
    return sum(bound.chance for bound in bounds) / len(bounds) if bounds else math.nan
