"""Is a cause worth as much to the real fit as beside a fit it seemed to be?

While causes are weighed, all else follows to first order. Where that is not enough (a gain
beside a threshold, ramps that the reference fits as well, a filter that is another one) a
cause can seem to win what a step of the fit itself would win, and once it is in, all look
as if they needed each other. So in the end each is left out in turn and all else is fitted
anew, from where it is: what the fit can do without it, it does not explain.

What to use when: `confirmed` where a search has come to its end.

Source: likelihood ratio test; Wilks, Ann. Math. Statist. 9 (1938) 60.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.regain import regained
from gyrorig_solver.discover.wandering import calmed
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution, solve_again
from gyrorig_solver.estimate.noise import NoiseModel
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.model.terms.protocol import indices

# A fit that has gone so far without a cause and is no better does not do without it; where
# it lacks a large one it would not settle for long.
STEPS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Confirmed:
    """A fit without what it can do without."""

    solution: Solution
    refused: frozenset[str]  # labels of what it can do without
    won: Mapping[str, float]  # nats, by label, of what it cannot


def confirmed(
    solution: Solution, known: Sequence[Extension], tests: int, alpha: float
) -> Confirmed:
    """Leave out what a fit can do without.

    Args:
        solution: where a search ended.
        known: causes of the base model, which stay.
        tests: how many share the false alarms.
        alpha: share of recordings without any cause that may get a name.
    """
    refused: set[str] = set()
    while True:
        worst: tuple[float, str, Solution] | None = None
        each: dict[str, float] = {}
        noises = [calmed(one) for one in solution.noises]
        cost = _cost(solution, noises)
        for k, one in enumerate(solution.extensions):
            sizes = sum(1 for j in one.free if j in indices(one.term, role="size"))
            if one in known or not sizes:
                continue
            left = [other for j, other in enumerate(solution.extensions) if j != k]
            without = regained(solve_again(solution, left, STEPS))
            won = each[label(one.term)] = _cost(without, noises) - cost
            p_value = chi2_tail(2.0 * max(won, 0.0), sizes) * tests
            if p_value > alpha and (worst is None or p_value > worst[0]):
                worst = p_value, label(one.term), without
        if worst is None:
            return Confirmed(solution, frozenset(refused), each)
        refused.add(worst[1])
        solution = worst[2]


def _cost(solution: Solution, noises: Sequence[NoiseModel]) -> float:
    """Return minus the log likelihood of a fit by given levels, but for what all share."""
    beside = Projection.of(solution, noises=noises)
    apart = beside.apart()
    away = apart.motion_away
    held = float(away @ apart.motion_known @ away) if away.size else 0.0
    return 0.5 * (float(np.sum(beside.residual**2)) + held)
