"""The fit of a board to reference attitudes, as a space for the search.

The reference is noisier than the gyroscope, and its noise is unknown. Two rules follow. The scores
are scaled by their variation between chunks of time. A cause is not named if it does not improve
the prediction of held-out windows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.discover.attitude.attitude_terms import attitude_families, attitude_terms
from gyrorig_solver.discover.attitude.cause_effects import CONVERGED, CauseEffects
from gyrorig_solver.discover.calibration_changes import (
    CALIBRATION_PARAMETERS,
    CalibrationValues,
)
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.checks.residual_dependence import dependences_on
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
from gyrorig_solver.discover.fit_space import FitSpace, SearchEffort
from gyrorig_solver.estimate import (
    MAX_EVALUATIONS,
    AttitudeProjector,
    FittedTerm,
    GyroFit,
    NuisanceProjector,
    ObservabilityAnalysis,
    ParameterLayout,
    total_effect,
)
from gyrorig_solver.estimate.attitude.attitude_fit import (
    AttitudeFit,
    solve_attitude,
    solve_without_effects,
)
from gyrorig_solver.estimate.attitude.attitude_summary import (
    build_outcome,
    summarize_attitude_fit,
    widened_observability,
)
from gyrorig_solver.estimate.attitude.block_segments import AccelerometerReadings
from gyrorig_solver.estimate.fit_summary import build_gyro_fit
from gyrorig_solver.estimate.trust_region import NotConvergedError
from gyrorig_solver.model import (
    RecordingContext,
    factor_jacobian,
    factorise,
)
from gyrorig_solver.reference import AttitudeReference

COARSE_DETAIL = 6.0  # half waves of the signals that scale the scores; most causes are as smooth
MAX_LINEARISATIONS = 8
CONVERGED_SIGMA = 0.01  # largest change of a parameter at convergence
SMALL_CHANGE_SIGMA = 0.5  # if changes grow again after this one, the smallest change counts
MAX_CHANGE_SIGMA = 1.0  # largest change of a fit that is stated
REMEDY_WITHOUT_CONVERGENCE = (
    "leave out a cause, or run `gyrorig explain` to find the causes that the recording shows"
)


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeRecording:
    """One recording's samples with its reference attitudes."""

    name: str
    samples: GyroSamples
    reference: AttitudeReference
    context: RecordingContext


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeLinearisation:
    """A fit of gain, biases and lags, and the projector there; the rates are without the causes.

    The model is linear about this fit. Without causes it is the base model.
    """

    recordings: tuple[AttitudeRecording, ...]
    solved: AttitudeFit
    projector: AttitudeProjector
    fit: GyroFit  # without the uncertainty of the causes
    calibration: CalibrationValues
    covariance: FloatArray  # (13, 13), of G, the last bias and the stated lag, without causes
    step: FloatArray  # from the fit to the optimum of the projector with the causes

    @classmethod
    def of(
        cls,
        recordings: Sequence[AttitudeRecording],
        solved: AttitudeFit,
        fitted_terms: Sequence[FittedTerm] = (),
    ) -> Self:
        """Return the linearisation at a fit.

        Args:
            recordings: recordings of one board.
            solved: the fit to rates without the effects of the causes.
            fitted_terms: these causes.
        """
        pairs = [(recording.samples, recording.reference) for recording in recordings]
        forces = [samples.accel_m_s2 for samples, _ in pairs]
        projector = AttitudeProjector.at_attitude_fit(
            solved,
            [recording.context for recording in recordings],
            AccelerometerReadings(
                tuple(
                    None if force is None else (samples.time_s, force)
                    for (samples, _), force in zip(pairs, forces, strict=True)
                )
            ),
        )
        with_terms = projector.with_terms(fitted_terms)
        families = [*smooth_families(projector.states), *attitude_families()]
        inflation = with_terms.score_inflation(
            [
                family.whitened(projector).dense()[family.detail <= COARSE_DETAIL]
                for family in families
            ]
        )
        projector = projector.widen(np.sqrt(inflation))
        fit = summarize_attitude_fit(solved, pairs)
        factors = factorise(solved.solver.gain)
        jacobian = np.eye(len(CALIBRATION_PARAMETERS))
        jacobian[:9, :9] = factor_jacobian(factors)
        calibration = CalibrationValues(
            np.concatenate([factors.as_vector(), solved.estimate[9:]]),
            np.array([fit.std.get(name, np.nan) for name in CALIBRATION_PARAMETERS]),
            jacobian,
            ParameterLayout.of([()], len(recordings)).index(
                len(recordings) - 1, offset_recording=solved.offset_recording
            ),
        )
        size = projector.best_step().size
        step = projector.with_terms(fitted_terms).best_step()[:size]
        covariance = widened_observability(solved).covariance
        return cls(tuple(recordings), solved, projector, fit, calibration, covariance, step)


class AttitudeFitSpace(FitSpace):
    """A fit to reference attitudes and the causes in it.

    The model is linear in gain, biases and lags about a fit, so that no cause hides rates from the
    gain. `relinearised` repeats that fit without the effects of the causes. The noise is that of
    the reference, so that it does not hide a cause of the board.
    """

    needs_held_out_gain = True

    def __init__(
        self,
        at: AttitudeLinearisation,
        effects: CauseEffects | None = None,
        effort: SearchEffort | None = None,
    ) -> None:
        """Use `fit_attitude_space`, and `refit` for causes.

        Args:
            at: the linearisation.
            effects: the fitted causes.
            effort: of the search that made the fit.
        """
        self.effort = SearchEffort() if effort is None else effort
        self.at, self.base, self.fit = at, at.projector, at.fit
        self.terms, self.base_terms = attitude_terms(), at.fit.terms
        contexts = {state.context.recording_index: state.context for state in self.base.states}
        self.recording_names = tuple(contexts[k].recording_name for k in sorted(contexts))
        self.offset_recording = at.solved.offset_recording
        self.duration_s = float(sum(np.ptp(state.edges_s) for state in self.base.states))
        self.fitted_terms = () if effects is None else effects.fitted_terms
        self.convergence = CONVERGED if effects is None else effects.convergence
        self._cost = 0.0 if effects is None else effects.cost  # relative to the base model
        self._projector = self.base.with_terms(self.fitted_terms)
        self.observability = self._projector.analyse_observability()

    def projector(self, typical: bool = False) -> AttitudeProjector:
        """Return the nuisance projector; typical noise levels do not exist here."""
        del typical
        return self._projector

    def projector_without(self, *dropped: int) -> NuisanceProjector:
        """Return the projector without some causes, with their effects added to the residual."""
        return self.base.with_terms(self.terms_without(*dropped))

    def refit(
        self, fitted_terms: Sequence[FittedTerm], max_evaluations: int = MAX_EVALUATIONS
    ) -> Self:
        """Return the fit with these causes."""
        effects = CauseEffects(self.base, fitted_terms, max_evaluations)
        space = type(self)(self.at, effects, self.effort)
        self.effort.add(space)
        return space

    def relinearised(self) -> Self:
        """Return the fit about the point where gain, biases, lags and causes agree.

        This function repeats the fit of gain, biases and lags without the effects of the causes,
        and fits the causes again there, until nothing changes. The noise is that of the residual
        without the causes. With a large cause, the steps can come near the point and then diverge.
        In this case, the fit with the smallest change is returned.
        """
        space, best, smallest, moving = self, self, np.inf, ""
        for _ in range(MAX_LINEARISATIONS):
            before, space = space, space._linearised_again()
            change, name = space._largest_change_sigma(before)
            if change < smallest:
                best, smallest, moving = space, change, name
            if change < CONVERGED_SIGMA or smallest < min(change, SMALL_CHANGE_SIGMA):
                break
        if smallest > MAX_CHANGE_SIGMA:
            best.convergence = replace(
                best.convergence, converged=False, moving=moving, moving_sigma=smallest
            )
        return best

    def _linearised_again(self) -> Self:
        """Repeat the fit of gain, biases and lags without the causes' effects; refit the causes."""
        effects = {
            segment.solver_segment: segment.effect_at_steps(
                total_effect(self.fitted_terms, segment.state), track.begin_s, track.end_s
            )
            for segment in self.base.block_segments
            for track in [self.at.solved.solver.segments[segment.solver_segment].track]
        }
        solved = solve_without_effects(self.at.solved, effects)
        at = AttitudeLinearisation.of(self.at.recordings, solved, self.fitted_terms)
        fitted_effects = CauseEffects(at.projector, self.fitted_terms, MAX_EVALUATIONS)
        return type(self)(at, fitted_effects, self.effort)

    def _largest_change_sigma(self, other: Self) -> tuple[float, str]:
        """Return the largest change of a value from another fit, and its name."""
        std = np.sqrt(
            self.observability.covariance.diagonal()
            + self.observability.unobservable_covariance.diagonal()
        )
        causes = [
            (mine.values - before.values)[mine.free_indices]
            for mine, before in zip(self.fitted_terms, other.fitted_terms, strict=True)
        ]
        change = self.at.calibration.values - other.at.calibration.values
        sigma = np.abs(np.concatenate([change, *causes])) / std
        names = (*CALIBRATION_PARAMETERS, *(n for term in self.fitted_terms for n in term.names))
        return float(np.max(sigma)), names[int(np.argmax(sigma))]

    def negative_log_likelihood(self, noise_of: Self) -> float:
        """Return the negative log-likelihood of the fit, relative to the base model."""
        del noise_of
        return self._cost

    def log_likelihoods(self, models: Sequence[Self]) -> list[float]:
        """Return the log-likelihood of each model, relative to the base model."""
        return [-model.negative_log_likelihood(self) for model in models]

    def reduced_chi2(self) -> float:
        """Return the reduced chi-square of the base model, whose residual gives the noise."""
        return self.fit.reduced_chi2

    def calibration(self) -> CalibrationValues:
        """Return the calibration parameters of the fit, by a step from the linearisation.

        The uncertainty includes that of the causes.
        """
        base = self.at.calibration
        step = self._projector.best_step()[: self.at.step.size] - self.at.step
        shift = base.propagate(step)
        return replace(base, values=base.values + shift, std=base.std * self._std_ratio())

    def summarize(self, warnings: Sequence[str] = ()) -> GyroFit:
        """Return the calibration with the causes of the fit.

        Raises:
            NotConvergedError: the fit with the causes did not converge.
        """
        if not self.fitted_terms:
            return replace(self.fit, warnings=(*self.fit.warnings, *warnings))
        if not self.convergence.converged:
            raise NotConvergedError(self.convergence, REMEDY_WITHOUT_CONVERGENCE)
        pairs = [(recording.samples, recording.reference) for recording in self.at.recordings]
        base = build_outcome(self.at.solved, pairs, self.observability, self.fit.reduced_chi2)
        step = self._projector.best_step()[: self.at.step.size] - self.at.step
        stated_step = step[self.at.calibration.stated]
        layout = ParameterLayout.of([self.fitted_terms], 1)
        causes = [term.values[term.free_indices] for term in self.fitted_terms]
        outcome = replace(
            base,
            estimate=np.concatenate([base.estimate + stated_step, *causes]),
            observability=self._observability_of_calibration(),
            terms=(*base.terms, *dict.fromkeys(term.term.cause for term in self.fitted_terms)),
            names=layout.parameter_names,
            prior_std=layout.prior_std,
            fitted_terms=self.fitted_terms,
            reason_texts={
                **base.reason_texts,
                **{name: term.term.excitation for term in self.fitted_terms for name in term.names},
            },
            warnings=(*base.warnings, *warnings),
        )
        return build_gyro_fit(outcome, [samples for samples, _ in pairs])

    def _observability_of_calibration(self) -> ObservabilityAnalysis:
        """Return the observability of the fit, widened if the fit without causes has more noise.

        The fit without causes can state a larger variance than the projector. The ratio of the two
        widens the variance with causes.
        """
        size = len(CALIBRATION_PARAMETERS)
        without = self.base.analyse_observability()
        projected = np.diag(without.covariance)[:size]
        stated = np.diag(self.at.covariance)
        ratio = np.ones(len(self.observability.covariance))
        known = (projected > 0.0) & (stated > 0.0)
        ratio[:size][known] = np.maximum(stated[known] / projected[known], 1.0)
        return self.observability.widened(np.sqrt(ratio))

    def _std_ratio(self) -> FloatArray:
        """Return the factor by which the causes increase each uncertainty, at least 1, (13,)."""
        without = self.base.analyse_observability()
        jacobian, size = self.at.calibration.jacobian, len(CALIBRATION_PARAMETERS)

        def variance(analysis: ObservabilityAnalysis) -> FloatArray:
            covariance = (analysis.covariance + analysis.unobservable_covariance)[:size, :size]
            return np.asarray(np.diag(jacobian @ covariance @ jacobian.T), np.float64)

        ratio = variance(self.observability) / np.maximum(variance(without), 1e-300)
        return np.sqrt(np.maximum(ratio, 1.0))

    def parameter_shift(self, other: Self) -> FloatArray:
        """Return the change of G and each (b, tau) from this fit to another one, (board,)."""
        size = self.at.step.size
        before, after = (space._projector.best_step()[:size] for space in (self, other))
        return np.asarray(after - before, dtype=np.float64)

    def dependence_tests(self, projector: NuisanceProjector) -> list[DependenceTest]:
        """Test the residual for smooth functions; its variance is that of the reference."""
        families = [*smooth_families(projector.states), *attitude_families()]
        return dependences_on(projector, families, len(families))


def fit_attitude_space(
    recordings: Sequence[AttitudeRecording], keep_sawtooth: bool = False
) -> AttitudeFitSpace:
    """Fit the base model, with scores scaled by their variation.

    Args:
        recordings: recordings of one board; each has its own bias and lag.
        keep_sawtooth: keep the saw-tooth of a clock in the times, so that the search can find it.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    pairs = [(recording.samples, recording.reference) for recording in recordings]
    solved = solve_attitude(pairs, keep_sawtooth=keep_sawtooth)
    return AttitudeFitSpace(AttitudeLinearisation.of(recordings, solved))
