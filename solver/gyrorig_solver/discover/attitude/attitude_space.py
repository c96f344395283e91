"""The fit of a board to reference attitudes, as a space for the search.

Here the reference is the noisy side, and nobody knows its noise. Two rules follow. Scores are
judged by how much they vary from one stretch of time to the next. A cause gets no name if it does
not improve the prediction of held-out windows.

What to use when: `fit_attitude_space` for the base model of some recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.discover.attitude.attitude_terms import attitude_families, attitude_terms
from gyrorig_solver.discover.calibration_changes import (
    CALIBRATION_PARAMETERS,
    CalibrationValues,
    last_recording_part,
)
from gyrorig_solver.discover.candidate_objective import MIN_STEP_GAIN_NATS, CandidateObjective
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.checks.residual_dependence import dependences_on
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
from gyrorig_solver.discover.fit_space import FitSpace
from gyrorig_solver.estimate import (
    MAX_EVALUATIONS,
    Convergence,
    FittedTerm,
    GyroFit,
    NuisanceProjector,
    WhitenedSignals,
    total_effect,
)
from gyrorig_solver.estimate.attitude.attitude_fit import solve_attitude, summarize_attitude_fit
from gyrorig_solver.estimate.attitude.attitude_projector import AttitudeProjector
from gyrorig_solver.estimate.attitude.block_segments import AccelerometerReadings
from gyrorig_solver.estimate.cascade import fitted_derivatives
from gyrorig_solver.model import (
    RecordingContext,
    SignalState,
    factor_jacobian,
    factorise,
    value_parameters,
)
from gyrorig_solver.reference import AttitudeReference

CONVERGED = Convergence(True, 0, 0.0)
COARSE_DETAIL = 6.0  # half waves: most causes are as smooth


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeRecording:
    """One recording's samples with its reference attitudes."""

    name: str
    samples: GyroSamples
    reference: AttitudeReference
    context: RecordingContext


class CauseEffects(CandidateObjective):
    """Several causes at their most likely values, fitted as one candidate."""

    def __init__(
        self,
        projector: AttitudeProjector,
        fitted_terms: Sequence[FittedTerm],
        max_iterations: int,
    ) -> None:
        """Fit the causes; `projector`: at the base fit, without any cause."""
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
        """Return the derivatives by the free values and, last, the whole effect, whitened."""
        del free  # always those of the causes
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


class AttitudeFitSpace(FitSpace):
    """A fit to reference attitudes and the causes in it.

    It is linear in gain, biases and lags about the fit of the base model, so that no cause hides
    rates from the gain. The noise is the reference's: no cause of the board hides in it.
    """

    needs_held_out_gain = True

    def __init__(
        self,
        base: AttitudeProjector,
        fit: GyroFit,
        base_calibration: CalibrationValues,
        effects: CauseEffects | None = None,
    ) -> None:
        """Use `fit_attitude_space`, and `refit` for causes.

        Args:
            base: the projector at the fit of the base model.
            fit: of the base model.
            base_calibration: of that fit.
            effects: the fitted causes.
        """
        self.base, self.fit, self._base_calibration = base, fit, base_calibration
        self.terms, self.base_terms = attitude_terms(), fit.terms
        contexts = {state.context.recording_index: state.context for state in base.states}
        self.recording_names = tuple(contexts[k].recording_name for k in sorted(contexts))
        self.duration_s = float(sum(np.ptp(state.edges_s) for state in base.states))
        self.fitted_terms = () if effects is None else effects.fitted_terms
        self.convergence = CONVERGED if effects is None else effects.convergence
        self._cost = 0.0 if effects is None else effects.cost  # relative to the base model
        self._projector = base.with_terms(self.fitted_terms)
        self.observability = self._projector.analyse_observability()

    def projector(self, typical: bool = False) -> AttitudeProjector:
        """Return the nuisance projector; there is one noise only."""
        del typical
        return self._projector

    def projector_without(self, k: int) -> NuisanceProjector:
        """Return the projector with one cause taken out, its effect added back."""
        return self.base.with_terms([term for j, term in enumerate(self.fitted_terms) if j != k])

    def refit(
        self, fitted_terms: Sequence[FittedTerm], max_evaluations: int = MAX_EVALUATIONS
    ) -> Self:
        """Return the fit with these causes."""
        effects = CauseEffects(self.base, fitted_terms, max_evaluations)
        return type(self)(self.base, self.fit, self._base_calibration, effects)

    def negative_log_likelihood(self, noise_of: Self) -> float:
        """Return that of the fit, relative to the base model; there is one noise only."""
        del noise_of
        return self._cost

    def log_likelihoods(self, models: Sequence[Self]) -> list[float]:
        """Return that of each model, relative to the base model."""
        return [-model.negative_log_likelihood(self) for model in models]

    def reduced_chi2(self) -> float:
        """Return that of the base model: the noise is estimated from its residual."""
        return self.fit.reduced_chi2

    def calibration(self) -> CalibrationValues:
        """Return the calibration parameters of the fit, linear about the base model."""
        base, base_step = self._base_calibration, self.base.best_step()
        step = self._projector.best_step()[: base_step.size] - base_step
        shift = base.propagate(last_recording_part(step, len(self.recording_names)))
        return replace(base, values=base.values + shift)

    def parameter_shift(self, other: Self) -> FloatArray:
        """Return the change of G and each (b, tau) from this fit to another one, (board,)."""
        size = self.base.best_step().size
        before, after = (space._projector.best_step()[:size] for space in (self, other))
        return np.asarray(after - before, dtype=np.float64)

    def dependence_tests(self, projector: NuisanceProjector) -> list[DependenceTest]:
        """Test the residual for smooth functions; its scatter is the reference's own."""
        families = [*smooth_families(projector.states), *attitude_families()]
        return dependences_on(projector, families, len(families))


def fit_attitude_space(recordings: Sequence[AttitudeRecording]) -> AttitudeFitSpace:
    """Fit the base model; its scores are scaled to their scatter.

    Args:
        recordings: of one board; bias and lag are free in each of them.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    pairs = [(recording.samples, recording.reference) for recording in recordings]
    base_fit = solve_attitude(pairs)
    forces_read: list[tuple[FloatArray, FloatArray] | None] = []
    for samples, _ in pairs:
        force = samples.accel_m_s2
        forces_read.append(None if force is None else (samples.time_s, force))
    projector = AttitudeProjector.at_attitude_fit(
        base_fit,
        [recording.context for recording in recordings],
        AccelerometerReadings(tuple(forces_read)),
    )
    families = [*smooth_families(projector.states), *attitude_families()]
    inflation = projector.score_inflation(
        [family.whitened(projector).dense()[family.detail <= COARSE_DETAIL] for family in families]
    )
    fit = summarize_attitude_fit(base_fit, pairs)
    factors = factorise(base_fit.solver.gain)
    jacobian = np.eye(len(CALIBRATION_PARAMETERS))
    jacobian[:9, :9] = factor_jacobian(factors)
    calibration = CalibrationValues(
        np.concatenate([factors.as_vector(), base_fit.solver.estimate[9:]]),
        np.array([fit.std.get(name, np.nan) for name in CALIBRATION_PARAMETERS]),
        jacobian,
    )
    return AttitudeFitSpace(projector.widen(np.sqrt(inflation)), fit, calibration)
