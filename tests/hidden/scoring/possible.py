"""How many causes can be stated alone at all, by what the data bear.

A cause may be stated alone where it is believed to 95 %: where it is ahead of its best rival by
ln 19 nats, both believed alike before. With l the non-centrality between the two, the true one
is ahead by N(l / 2, l) nats, so that its chance is Phi((l / 2 - ln 19) / sqrt(l)). No finder
that keeps its word names more causes alone than the mean of the chances, by the data alone; one
that rivals more than one, or whose shape is to be found too, names fewer.

What to use when: `Bound` is one case; `possible` the share; scoring/bound.py measures them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

AHEAD = math.log(0.95 / 0.05)  # nats
_LEAST = 1e-12


@dataclass(frozen=True, slots=True)
class Bound:
    """How nearly the best rival looks like what is hidden in a case."""

    seed: int
    cause: str
    times: float
    soak: bool
    rival: str  # empty where none comes near
    left: float  # share of the effect that the rival leaves
    noncentrality: float  # of that rest

    @property
    def chance(self) -> float:
        """Of being stated alone."""
        root = math.sqrt(max(self.noncentrality, _LEAST))
        return NormalDist().cdf((0.5 * self.noncentrality - AHEAD) / root)


def possible(bounds: Sequence[Bound]) -> float:
    """Return the largest share of cases that can be stated alone, nan for none."""
    return sum(one.chance for one in bounds) / len(bounds) if bounds else math.nan
