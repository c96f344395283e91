"""The fit of several causes together to the residual of a fit to reference attitudes.

What to use when: `CauseEffects` for the most likely values of causes, with gain, biases and time
offsets eliminated.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover.candidate_objective import MIN_STEP_GAIN_NATS, CandidateObjective
from gyrorig_solver.estimate import (
    AttitudeProjector,
    Convergence,
    FittedTerm,
    WhitenedSignals,
    total_effect,
)
from gyrorig_solver.estimate.cascade import fitted_derivatives
from gyrorig_solver.model import SignalState, value_parameters

CONVERGED = Convergence(True, 0, 0.0)


class CauseEffects(CandidateObjective):
    """Several causes at their most likely values, fitted as one candidate."""

    def __init__(
        self,
        projector: AttitudeProjector,
        fitted_terms: Sequence[FittedTerm],
        max_iterations: int,
    ) -> None:
        """Fit the causes; `projector`: at the base fit, without causes."""
        self.projector, self.fitted_terms = projector, tuple(fitted_terms)
        self.convergence, self.cost = CONVERGED, 0.0  # nats, relative to the fit without causes
        self.max_iterations, self.events = max_iterations, []
        parameters = (value_parameters(term.term) for term in fitted_terms)
        self.parameters = tuple(p for each in parameters for p in each)
        counts = [term.values.size for term in fitted_terms]
        self._first = np.cumsum([0, *counts], dtype=np.int64)
        free = [at + t.free_indices for at, t in zip(self._first, fitted_terms, strict=False)]
        self.free: IntArray = np.concatenate([np.zeros(0, np.int64), *free])
        if self.free.size:
            start = np.concatenate([term.values for term in fitted_terms])
            best = self.minimize(start)
            self.fitted_terms, self.cost = self._terms_at(best.values), best.cost
            step, remaining_nats = self.step_from(best, self.free, 0.0)
            sigmas = np.abs(step) * np.sqrt(np.clip(np.diag(best.curvature), 0.0, None))
            names = [name for term in fitted_terms for name in term.names]
            moving = int(np.argmax(sigmas))
            self.convergence = Convergence(
                remaining_nats < MIN_STEP_GAIN_NATS,
                max_iterations,
                remaining_nats,
                names[moving],
                float(sigmas[moving]),
            )

    def derivatives(self, values: FloatArray, free: IntArray) -> WhitenedSignals:
        """Return the whitened derivatives by the free values; the last signal is the effect."""
        del free  # always the free values of the causes
        terms = self._terms_at(values)

        def signals(state: SignalState) -> FloatArray:
            return np.concatenate(
                [fitted_derivatives(terms, state), total_effect(terms, state)[None]]
            )

        return self.projector.evaluate_signals(signals)

    def _terms_at(self, values: FloatArray) -> tuple[FittedTerm, ...]:
        parts = np.split(values, self._first[1:-1])
        pairs = zip(self.fitted_terms, parts, strict=True)
        return tuple(replace(term, values=part) for term, part in pairs)
