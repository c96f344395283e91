"""Backward elimination: each cause is removed in turn and everything else is refitted.

While the search compares candidates, the other parameters follow to first order. That is not always
accurate, for example for a gain with a threshold, for ramps that the reference fits, or for a wrong
low-pass. A cause can then show a gain that one more step of the fit would give without it. If the
refit without a cause is as good as the fit with it, the cause is removed.

Source: likelihood ratio test; Wilks, Ann. Math. Statist. 9 (1938) 60.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic

from gyrorig_solver.discover.fit_space import Space
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE
from gyrorig_solver.estimate import FittedTerm
from gyrorig_solver.model import term_label
from gyrorig_solver.numerics import chi2_upper_tail

# If the fit without a cause is clearly worse after this many evaluations, the cause is kept.
# Without a large cause, the fit would need many more evaluations to converge.
FIRST_EVALUATIONS = 4


@dataclass(frozen=True, slots=True, eq=False)
class EliminationResult(Generic[Space]):
    """The result of backward elimination."""

    space: Space
    eliminated: frozenset[str]  # labels of the removed causes
    delta_log_likelihood: Mapping[str, float]  # gain of each other cause by label, nats


def eliminate_backward(
    space: Space, known_terms: Sequence[FittedTerm], tests: int
) -> EliminationResult[Space]:
    """Remove causes whose removal, with a full refit, does not reduce the likelihood significantly.

    A cause stays if the fit without it does not converge.

    Args:
        space: the fit at the end of a search.
        known_terms: causes of the base model, which stay.
        tests: how many share the false alarms.
    """
    eliminated: set[str] = set()
    while True:
        least_significant: tuple[float, str, Space] | None = None
        gain_by_label: dict[str, float] = {}
        cost: float | None = None
        for k, extension in enumerate(space.fitted_terms):
            sizes = len(extension.free_sizes)
            if extension in known_terms or not sizes:
                continue
            others = space.terms_without(k)
            cost = space.negative_log_likelihood(space) if cost is None else cost
            reduced = space.refit(others, FIRST_EVALUATIONS)
            gain = reduced.negative_log_likelihood(space) - cost
            end = reduced.convergence
            remaining = 0.0 if end.converged else end.remaining_nats
            if not end.converged and _p_value(gain - remaining, sizes) * tests > FALSE_ALARM_RATE:
                reduced = reduced.refit(others)
                gain = reduced.negative_log_likelihood(space) - cost
            gain_by_label[term_label(extension.term)] = gain
            p_value = _p_value(gain, sizes) * tests
            if not reduced.convergence.converged:
                continue
            highest = FALSE_ALARM_RATE if least_significant is None else least_significant[0]
            if p_value > highest:
                least_significant = p_value, term_label(extension.term), reduced
        if least_significant is None:
            return EliminationResult(space, frozenset(eliminated), gain_by_label)
        eliminated.add(least_significant[1])
        space = least_significant[2]


def _p_value(gain_nats: float, sizes: int) -> float:
    """Return the p-value of a likelihood ratio test."""
    return chi2_upper_tail(2.0 * max(gain_nats, 0.0), sizes)
