"""Is a name needed beside what has no name? One that a free function makes needless is not said.

Where something is left that no cause explains, it was there while the names were found, and a
name may be the part of it that its form allows, though what is odd is none of the name's own
covariates: a board that slips once is a little like rates that are multiplied. So the name is
put beside the free function of what is odd, both ways. It is outdone where the function leaves
nothing that the name would explain, and explains clearly more than the name does. A right name
beside something else that is odd explains what that function does not.

What to use when: `outdone` where a search has ended and something is left.

Source: each of two models that do not hold one another, tested beside the other; Davidson and
MacKinnon, Econometrica 49 (1981) 781.
"""

from collections.abc import Iterable

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.free_shapes import families
from gyrorig_solver.discover.result import Signature
from gyrorig_solver.discover.scores import Seen
from gyrorig_solver.discover.search import ALPHA, Found
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.projection import Projection


def outdone(found: Found, odd: Iterable[Signature], tests: int, share: float) -> list[bool]:
    """Return which names a free function of what is odd makes needless, of each standing.

    Args:
        found: where the search ended.
        odd: what is odd beside its fit.
        tests: how many share the false alarms.
        share: of what the free function explains that a name must explain.
    """
    covariates = {one.covariate for one in odd}
    asked = [one for one in families(found.last.scenes) if one.covariate in covariates]
    free = [one for one in found.solution.extensions if one.free.size]
    said = []
    for one, standing in zip(free, found.standings, strict=True):
        others = [other for other in found.solution.extensions if other is not one]
        without = Projection.of(found.solution, extensions=others, back=[one])
        chance = ALPHA / (standing.looks * tests)
        # One family at a time: the signals of all of them would be hundreds of megabytes.
        said.append(any(_needless(without, one, f.white(found.last), chance, share) for f in asked))
    return said


def _needless(
    without: Projection, one: Extension, white: FloatArray, chance: float, share: float
) -> bool:
    """Return whether a free function makes a cause needless, both beside a fit without it."""
    own = without.fitted(one.term, one.values, range(one.values.size))
    looked = without.look(np.concatenate([white, own]))
    shape = Seen.of(looked.part(np.arange(len(white))))
    name = Seen.of(looked.part(np.arange(len(white), len(white) + len(own))))
    both = Seen.of(looked)
    if _beyond(name) >= share * _beyond(shape):
        return False
    more = both.statistic - shape.statistic
    degrees = both.degrees_of_freedom - shape.degrees_of_freedom
    return degrees <= 0 or chi2_tail(max(more, 0.0), degrees) > chance


def _beyond(seen: Seen) -> float:
    return seen.statistic - seen.degrees_of_freedom
