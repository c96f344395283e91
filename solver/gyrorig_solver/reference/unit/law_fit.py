"""Fit of the moves to the polled counts under a motion law that differs from the settings.

The counts follow the motion that the unit executes. Under another law they give other start times,
and they contain information about the law. The variance of the rests stays that of the recorded
settings, so that the likelihoods of two laws can be compared.

What to use when: `LawFits` for one recording; it keeps the fits of the last laws.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.reference.unit.law_information import LawInformation
from gyrorig_solver.reference.unit.motion_law import RECORDED_LAW, MotionLaw
from gyrorig_solver.reference.unit.move_fit import MoveFit, MoveFitIteration
from gyrorig_solver.reference.unit.poll_objective import PollObjective

KEPT_FITS = 4  # a rejected step returns to the previous law


@dataclass(frozen=True, slots=True, eq=False)
class LawFit:
    """The moves under one law, and the information of the counts about the law."""

    fit: MoveFit
    information: LawInformation  # about the law, in steps and seconds, at the fitted moves
    objective: PollObjective
    cost: float  # minus the log-likelihood of counts and priors at the fitted moves, nats


class LawFits:
    """The fits of one recording's moves under several laws."""

    def __init__(self, recorded: MoveFit) -> None:
        """Start from the fit with the recorded settings."""
        self._recorded = recorded
        self._fits: dict[MotionLaw, LawFit] = {}
        self._recorded_cost: float | None = None

    def at(self, law: MotionLaw) -> LawFit:
        """Return the fit under a law.

        Raises:
            ValueError: the law is that of the settings, or the recording has no replies.
        """
        if law not in self._fits:
            if len(self._fits) >= KEPT_FITS:
                del self._fits[next(iter(self._fits))]
            iteration = _iterate(self._recorded, law)
            objective = iteration.objective()
            fit = iteration.result()
            self._fits[law] = LawFit(
                fit, iteration.law_information, objective, _total_cost(objective, fit)
            )
        return self._fits[law]

    @property
    def recorded_cost(self) -> float:
        """The cost of counts and priors with the recorded settings, nats."""
        if self._recorded_cost is None:
            iteration = _iterate(self._recorded, RECORDED_LAW)
            self._recorded_cost = _total_cost(iteration.objective(), iteration.result())
        return self._recorded_cost


def compare_base_speeds(fitted: MoveFit, axis: int, added_steps_s: FloatArray) -> FloatArray:
    """Return log-likelihood ratios of higher base speeds against fitted ramps, nats, (k,).

    Args:
        fitted: the moves with the recorded settings.
        axis: the axis with the recorded acceleration and a higher base speed.
        added_steps_s: increases of the base speed, (k,).
    """
    if fitted.polls is None:
        return np.zeros(added_steps_s.size)
    free = _likelihood_of_counts(fitted, RECORDED_LAW)
    gains = np.empty(added_steps_s.size)
    for k, increase in enumerate(added_steps_s):
        base_steps_s = [0.0, 0.0]
        base_steps_s[axis] = float(increase)
        law = MotionLaw(
            base_speed_steps_s=(base_steps_s[0], base_steps_s[1]),
            has_known_acceleration=(axis == 0, axis == 1),
        )
        gains[k] = _likelihood_of_counts(fitted, law) - free
    return gains


def _iterate(recorded: MoveFit, law: MotionLaw) -> MoveFitIteration:
    if recorded.polls is None:
        raise ValueError("the moves were not fitted to replies")
    iteration = MoveFitIteration(recorded.table, recorded.polls, law, recorded.rest_variance)
    iteration.iterate()
    return iteration


def _total_cost(objective: PollObjective, fit: MoveFit) -> float:
    return objective.prior.cost(fit.count_values) - objective.log_likelihood


def _likelihood_of_counts(recorded: MoveFit, law: MotionLaw) -> float:
    """Return the log-likelihood of counts and rests under a law."""
    iteration = _iterate(recorded, law)
    rests = iteration.result().parameters.rest_offset_steps
    variance = recorded.rest_variance
    return iteration.objective().log_likelihood - 0.5 * float(np.sum(rests**2)) / variance
