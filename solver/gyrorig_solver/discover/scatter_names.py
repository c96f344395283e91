"""Causes that show in the scatter of a residual and not in its mean, as findings.

Jitter of the samples' instants is named where it is significant, where other shapes of a
growing scatter are clearly less likely, and where its slow and fast parts agree. The noise's
own levels hold a bias that wanders: what they are is said beside those of an ordinary part.

What to use when: `look_for_jitter` beside the last fit of a search; `wandering` for words.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.discover.growth import NONE, Growth
from gyrorig_solver.discover.jitter import Jitter, find_jitter
from gyrorig_solver.discover.name_tests import LEVEL, LITTLE
from gyrorig_solver.discover.result import Limit, NamedCause, Signature, Value
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.noise import ordinary_levels
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.sample_jitter import SampleJitter
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

SHOWS_IN = ("acceleration_scatter", "moving")  # nameless tests that show jitter
POWER = 0.8  # of what is called detectable


@dataclass(frozen=True, slots=True, eq=False)
class LookedAt:
    """What is said of jitter beside a fit: a name, or how large it may be unseen."""

    named: NamedCause | None
    absent: Limit | None
    beside: Growth  # whether the scatter grows with motion, and how fast, beside it
    fallen: tuple[Signature, ...] = ()  # what speaks against its name, where it would have one

    def of(self, left: Sequence[Signature]) -> list[Signature]:
        """Return the nameless tests without those that the jitter, where named, accounts for."""
        if self.named is None:
            return list(left)
        rest = [one for one in left if one.covariate not in SHOWS_IN]
        moving = [
            replace(
                one,
                statistic=self.beside.statistic,
                degrees_of_freedom=self.beside.degrees_of_freedom,
                p_value=min(1.0, self.beside.p_value * len(left)),
            )
            for one in left
            if one.covariate == "moving"
        ]
        return sorted([*rest, *moving], key=lambda one: (one.p_value, -one.statistic))


def look_for_jitter(projection: Projection, tests: int, alpha: float) -> LookedAt:
    """Return the jitter of the samples' instants as a cause, or how large it may be unseen.

    Args:
        projection: the space beside the last fit.
        tests: how many share the false alarms.
        alpha: rate of false alarms of all of them.
    """
    found = find_jitter(projection, tests, alpha, POWER)
    if found is None:
        return LookedAt(None, None, NONE)
    term = SampleJitter()
    own = term.parameters[0]
    p_value = min(1.0, found.p_value * tests)
    # What jitter does not explain of its own scatter, a free function of the speed may.
    more = found.beside.statistic - found.beside.degrees_of_freedom
    odd = found.beside.p_value < LEVEL and more > LITTLE * found.statistic
    if p_value < alpha and (against := _hangs_on(found)) is not None:
        return LookedAt(None, None, NONE, (against,))
    if p_value >= alpha or odd or not found.named:
        size = found.detectable_s
        absent = Limit(term.cause, None, size, own.unit, own.typical, "time_offset", 0.0)
        return LookedAt(None, absent if p_value >= alpha else None, NONE)
    values = np.array([found.deviation_s])
    named = NamedCause(
        term=term,
        where=(),
        extension=Extension(term, values, np.zeros(0, dtype=np.int64)),
        values=(Value(own.name, found.deviation_s, found.std_s, own.unit, own.typical),),
        statistic=found.statistic,
        degrees_of_freedom=1,
        p_value=p_value,
        posterior=1.0 / (1.0 + sum(float(np.exp(nats)) for _, nats in found.rivals)),
        one_of=(),
        rivals=(),
        changes=(),  # it moves no mean: what it spoils are the weights
        gain=None,
    )
    return LookedAt(named, None, found.beside)


def _hangs_on(found: Jitter) -> Signature | None:
    """Return what the scatter's size hangs on, which jitter's must not; None where nothing."""
    one = found.swell
    if one is None or one.p_value >= LEVEL:
        return None
    if one.statistic - one.degrees_of_freedom <= LITTLE * found.statistic:
        return None
    return Signature(one.covariate, one.words, one.statistic, one.degrees_of_freedom, one.p_value)


def wandering(projection: Projection) -> str:
    """Say how much each axis' bias wanders, and how that compares with an ordinary part's."""
    levels = np.mean([s.noise.levels for s in projection.stretches], axis=0)
    own = np.sqrt(levels[:, 2])
    usual = np.sqrt([ordinary_levels(float(white))[2] for white in levels[:, 0]])
    ratio = listed(own / usual, XYZ, "times an ordinary part's")
    return (
        "the noise levels hold it and all uncertainties allow for it: "
        f"{listed(own / DEG * 1e3, XYZ, 'mdeg/s after a second')}, {ratio}"
    )
