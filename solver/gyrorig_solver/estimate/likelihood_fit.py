"""The maximum-likelihood fit of one board to reference motions, in the rate domain.

Trust-region iterations over G, each recording's (b, tau) and each reference's own unknowns. After
each accepted step the noise levels are estimated again from the residual's spectrum. Information
about common parameters is summed over the recordings; the others belong to one recording. All
derivatives are analytic. See `trust_region` for the iteration, `linear.normal_equations` for the
algebra, `noise.noise_model` for the density, `session_fit` for one recording and `observability`
for which values are reported.

What to use when: `fit_likelihood` for a first fit; `refit_with_terms` to fit the same recordings
with other causes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.fit_objective import reference_cost, residual_decrease
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.information import (
    PARAMETER_NAMES,
    MarginalEquations,
    RecordingEquations,
    add_parameter_noise,
)
from gyrorig_solver.estimate.initial_guess import solve_shared_gain
from gyrorig_solver.estimate.linear.normal_equations import NormalEquations
from gyrorig_solver.estimate.noise.noise_model import (
    NoiseModel,
    Sampling,
    Spectrum,
    bin_spectrum,
    fit_noise_levels,
)
from gyrorig_solver.estimate.noise.whitening import BASE_PARAMETERS
from gyrorig_solver.estimate.observability import (
    ObservabilityAnalysis,
    analyse_scaled_observability,
    prior_std,
)
from gyrorig_solver.estimate.session_fit import SessionFit
from gyrorig_solver.estimate.trust_region import Convergence, ProposedStep, minimise

MAX_EVALUATIONS = 40  # of the objective
MAX_MOTION_NOISE_UPDATES = 3  # each followed by another minimisation
OUTLIER_RETEST_SIGMA = 5.0  # a larger step repeats the outlier detection
DERIVATIVE_REFRESH_SIGMA = 50.0  # a larger step repeats the derivatives
NONLINEAR_REFRESH_SIGMA = 3.0  # the same with causes
MAX_LAG_STEP_S = 0.05
GAIN_PARAMETERS = 9
SESSION_PARAMETERS = 4  # bias and time offset
ROTATION_X_GENERATOR = np.array(
    [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
)  # d Rx(z)^T / dz


@dataclass(frozen=True, slots=True, eq=False)
class ConvergedFit:
    """The end of a fit: parameters, their information, and the state of each recording.

    Its values are a result only if `converged` is true.
    """

    names: tuple[str, ...]  # G row by row, b, time offset, then the causes' values
    prior_std: FloatArray  # (p,), prior standard deviation of each
    estimate: FloatArray  # (p,); bias: last recording. Time offset (whole lag): last
    # recording in which it is observable
    observability: ObservabilityAnalysis  # everything else marginalised, the common shift included
    sessions: tuple[SessionFit, ...]
    fitted_terms: tuple[FittedTerm, ...]
    session_observability: tuple[
        ObservabilityAnalysis, ...
    ]  # the same with each recording's b and tau
    noises: tuple[NoiseModel, ...]  # of each recording
    spectra: tuple[Spectrum, ...]
    noise_sources: tuple[str, ...]  # the part of each recording used for the noise
    outliers: int
    convergence: Convergence

    @property
    def converged(self) -> bool:
        """Whether further iterations change nothing."""
        return self.convergence.converged

    @property
    def gain(self) -> FloatArray:
        """G, shape (3, 3)."""
        return self.estimate[:9].reshape(3, 3)

    def residuals(self) -> list[FloatArray]:
        """Return measured minus modelled rates of every series of every recording."""
        return [residual for session in self.sessions for residual in session.residuals(self.gain)]

    def whitened_residuals(self) -> list[FloatArray]:
        """Return the residuals in units of their standard deviation, white."""
        return [
            white
            for session, noise in zip(self.sessions, self.noises, strict=True)
            for white in session.whitened_residuals(self.gain, noise)
        ]

    def used_blocks(self) -> list[BoolArray]:
        """Return which blocks of every series are used."""
        return [used for session in self.sessions for used in session.used]


def fit_likelihood(
    sessions: Sequence[SessionFit], fitted_terms: Sequence[FittedTerm] = ()
) -> ConvergedFit:
    """Fit one board to the reference motions of its recordings.

    Args:
        sessions: in the order of time; bias and offset of the last one are the result's.
        fitted_terms: causes beyond the base model, common to all recordings.

    Raises:
        InputError: no sample has a reference.
    """
    solver = GaussNewtonFit(sessions, fitted_terms)
    solver.initialise()
    return solver.summarize(_minimise(solver, MAX_EVALUATIONS))


def refit_with_terms(
    previous: ConvergedFit,
    fitted_terms: Sequence[FittedTerm],
    max_evaluations: int = MAX_EVALUATIONS,
) -> ConvergedFit:
    """Fit the same recordings with other causes, starting from a previous fit.

    Args:
        previous: is not changed.
        fitted_terms: all causes of the new fit, each with good start values.
        max_evaluations: limit on the evaluations of the objective.
    """
    solver = resume_fit(previous, fitted_terms)
    return solver.summarize(_minimise(solver, max_evaluations))


def resume_fit(previous: ConvergedFit, fitted_terms: Sequence[FittedTerm]) -> "GaussNewtonFit":
    """Return a solver that starts at the end of another fit, which is not changed."""
    solver = GaussNewtonFit([session.copy() for session in previous.sessions], fitted_terms)
    solver.resume(previous.gain, previous.noises)
    return solver


def _minimise(solver: "GaussNewtonFit", max_evaluations: int) -> Convergence:
    convergence = minimise(solver, max_evaluations)
    for _ in range(MAX_MOTION_NOISE_UPDATES):
        # Before convergence a misfit can look like noise.
        if not convergence.converged or not solver.update_motion_noise():
            break
        convergence = minimise(solver, max_evaluations)
    return convergence


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """The values after a step that may be rejected."""

    gain: FloatArray
    fitted_terms: tuple[FittedTerm, ...]
    sessions: tuple[SessionFit, ...]
    size_sigma: float


class GaussNewtonFit:
    """One fit: `initialise` or `resume`, `trust_region.minimise`, then `summarize`."""

    def __init__(self, sessions: Sequence[SessionFit], fitted_terms: Sequence[FittedTerm]) -> None:
        self.sessions, self._fitted_terms = tuple(sessions), tuple(fitted_terms)
        self._gain = np.eye(3)
        self._noises: list[NoiseModel] = []
        self._spectra: list[Spectrum] = []
        self._sources: list[str] = []
        self._equations: Sequence[RecordingEquations] = ()  # at the current values
        self._marginals: Sequence[MarginalEquations] = ()
        self._sigma = np.zeros(0)  # of each parameter
        self._trial: _Trial | None = None

    def initialise(self) -> None:
        """Estimate lags by correlation, then gain and biases by least squares."""
        for session in self.sessions:
            session.estimate_lag()
        self._least_squares(is_first=True)
        self._least_squares(is_first=False)
        self._update_sessions(detect_outliers=True, new_derivatives=True)
        self._fit_noise()

    def resume(self, gain: FloatArray, noises: Sequence[NoiseModel]) -> None:
        """Start at the end of another fit of the same recordings."""
        self._gain, self._noises = gain.copy(), list(noises)
        self._update_sessions(detect_outliers=True, new_derivatives=True)
        self._fit_noise()

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The names of G, each recording's bias and time offset, and the causes' values."""
        session_names = PARAMETER_NAMES[GAIN_PARAMETERS:]
        if len(self.sessions) > 1:
            session_names = tuple(
                f"{name} of recording {number}"
                for number in range(1, len(self.sessions) + 1)
                for name in session_names
            )
        term_names = (name for term in self._fitted_terms for name in term.names)
        return (*PARAMETER_NAMES[:GAIN_PARAMETERS], *session_names, *term_names)

    def propose(self, damping: float) -> ProposedStep:
        """Return the step at the current values; damping 0 gives the full Gauss-Newton step."""
        if not self._equations:
            self._equations = self._recording_equations()
        marginals = [equations.marginalise(damping) for equations in self._equations]
        information, score = self._sum_marginals(marginals)
        analysis = analyse_scaled_observability(information, self.prior_std())
        step = self._bounded_step(analysis.pseudo_inverse @ score, information, score)
        if not damping:
            self._marginals = marginals
            self._sigma = np.sqrt(np.clip(np.diag(analysis.covariance), 0.0, None))
        nuisance_steps = tuple(
            m.nuisance_step(step[self.parameter_index(k)]) for k, m in enumerate(marginals)
        )
        predicted = self._prior_decrease(self._stepped_terms(self._term_step(step)))
        for k, (equations, nuisance_step) in enumerate(
            zip(self._equations, nuisance_steps, strict=True)
        ):
            predicted += equations.predicted_decrease(step[self.parameter_index(k)], nuisance_step)
        sigmas = step / np.where(self._sigma > 0.0, self._sigma, np.inf)
        return ProposedStep(step, nuisance_steps, predicted, sigmas)

    def evaluate(self, proposal: ProposedStep) -> float:
        """Return the decrease of the objective after a step, nats, and keep the trial values."""
        decrease = self.try_step(proposal.step, proposal.nuisance_steps, proposal.size_sigma)
        if self._trial is None:
            return -np.inf
        for session, trial in zip(self.sessions, self._trial.sessions, strict=True):
            decrease += reference_cost(session.reference) - reference_cost(trial.reference)
        return decrease + self._prior_decrease(self._trial.fitted_terms)

    def try_step(
        self, step: FloatArray, nuisance_steps: Sequence[FloatArray], size_sigma: float
    ) -> float:
        """Predict all recordings after a step; return the decrease by their residuals, nats.

        Args:
            step: of all parameters.
            nuisance_steps: of the unknowns of each recording's reference.
            size_sigma: the largest part of the step, in standard deviations.
        """
        gain = self._gain + step[:GAIN_PARAMETERS].reshape(3, 3)
        fitted_terms = self._stepped_terms(self._term_step(step))
        sessions = []
        decrease = 0.0
        for k, (session, nuisance_step) in enumerate(
            zip(self.sessions, nuisance_steps, strict=True)
        ):
            trial = session.trial_copy()
            _step_session(trial, step[self.parameter_index(k)], nuisance_step)
            trial.fitted_terms = fitted_terms
            trial.predict(gain, keep_samples=size_sigma > OUTLIER_RETEST_SIGMA)
            decrease += residual_decrease(session, trial, self._gain, gain)
            sessions.append(trial)
        self._trial = _Trial(gain, fitted_terms, tuple(sessions), size_sigma)
        return decrease

    def accept(self, new_derivatives: bool) -> None:
        """Continue from the values that were evaluated last.

        `new_derivatives`: compute them again; after a large step they always are.
        """
        if self._trial is None:
            raise ValueError("no step was evaluated")
        trial, self._trial, self._equations = self._trial, None, ()
        self._gain, self._fitted_terms, self.sessions = (
            trial.gain,
            trial.fitted_terms,
            trial.sessions,
        )
        # Before convergence good samples can look like outliers. Causes are rarely linear:
        # a rounded corner grows as the square of its length.
        refresh_limit = (
            NONLINEAR_REFRESH_SIGMA if self._term_value_count else DERIVATIVE_REFRESH_SIGMA
        )
        for session in self.sessions:
            session.complete_prediction(
                self._gain,
                detect_outliers=trial.size_sigma > OUTLIER_RETEST_SIGMA,
                new_derivatives=new_derivatives or trial.size_sigma > refresh_limit,
            )
        self._fit_noise()

    def renew_derivatives(self) -> bool:
        """Compute new derivatives at the current values; return False if they are new."""
        if all(session.has_new_derivatives for session in self.sessions):
            return False
        for session in self.sessions:
            session.discard_derivatives()
        self._equations = ()
        return True

    def finish(self, proposal: ProposedStep) -> None:
        """Take a last, negligible step without an evaluation."""
        self.apply_step(proposal.step, proposal.nuisance_steps)

    def apply_step(self, step: FloatArray, reference_steps: Sequence[FloatArray]) -> None:
        """Change all parameters, and the unknowns of each recording's reference."""
        self._gain = self._gain + step[:GAIN_PARAMETERS].reshape(3, 3)
        self._fitted_terms = self._stepped_terms(self._term_step(step))
        for k, (session, reference_step) in enumerate(
            zip(self.sessions, reference_steps, strict=True)
        ):
            _step_session(session, step[self.parameter_index(k)], reference_step)

    def normal_equations(self) -> list[NormalEquations]:
        """Return each recording's normal equations, without the reference's prior."""
        return [
            session.normal_equations(self._gain, noise)
            for session, noise in zip(self.sessions, self._noises, strict=True)
        ]

    def update_predictions(self) -> None:
        """Compute the predictions, outliers and derivatives again."""
        self._update_sessions(detect_outliers=True, new_derivatives=True)
        self._fit_noise()

    def update_motion_noise(self) -> bool:
        """Estimate the noise in motion of each recording; return whether any weights changed."""
        changed = [
            session.update_motion_noise(self._gain, noise)
            for session, noise in zip(self.sessions, self._noises, strict=True)
        ]
        if any(changed):
            self.update_predictions()
            self._equations = ()
        return any(changed)

    def _bounded_step(
        self, step: FloatArray, information: FloatArray, score: FloatArray
    ) -> FloatArray:
        """Clip the Gauss-Newton step to the causes' ranges (active set), and solve the rest again.

        A cause at its bound that is pushed outside stays there.
        """
        if not self._term_value_count:
            return step
        first = step.size - self._term_value_count
        prior_std = self.prior_std()
        fixed = np.zeros(step.size, dtype=np.bool_)
        for _ in range(self._term_value_count):
            old_values = np.concatenate(
                [fitted_term.values[fitted_term.free_indices] for fitted_term in self._fitted_terms]
            )
            stepped = self._stepped_terms(step[first:])
            new_values = np.concatenate(
                [fitted_term.values[fitted_term.free_indices] for fitted_term in stepped]
            )
            at_bound = (new_values == old_values) & (step[first:] != 0.0) & ~fixed[first:]
            if not at_bound.any():
                break
            fixed[first:] |= at_bound
            free_parameters = np.flatnonzero(~fixed)
            inverse = analyse_scaled_observability(
                information[np.ix_(free_parameters, free_parameters)], prior_std[free_parameters]
            ).pseudo_inverse
            step = np.zeros_like(step)
            step[free_parameters] = inverse @ score[free_parameters]
        step[first:] = new_values - old_values
        return step

    def summarize(
        self, convergence: Convergence, joint_information: FloatArray | None = None
    ) -> ConvergedFit:
        """Return the result, with each recording's common shift included in its offset.

        Args:
            convergence: how the iteration ended.
            joint_information: about all parameters, if other boards took part in the fit.
        """
        term_values = [
            fitted_term.values[fitted_term.free_indices] for fitted_term in self._fitted_terms
        ]
        information = (
            self._sum_marginals(self._marginals)[0]
            if joint_information is None
            else joint_information
        )
        for session_index, session in enumerate(self.sessions):
            session.release_equations()
            information = add_parameter_noise(
                information, int(self.parameter_index(session_index)[12]), session.common_std_s
            )
        session_informations = [
            self._session_information(information, session_index)
            for session_index in range(len(self.sessions))
        ]
        unit_std = np.concatenate(
            [
                prior_std(PARAMETER_NAMES),
                *(fitted_term.prior_std for fitted_term in self._fitted_terms),
            ]
        )
        analyses = tuple(
            self._add_tilt_zero_variance(analyse_scaled_observability(fitted_term, unit_std))
            for fitted_term in session_informations
        )
        # A last recording at rest shows the bias, but not the time offset.
        last = len(session_informations) - 1
        last_with_offset = max(
            (
                session_index
                for session_index, fitted_term in enumerate(analyses)
                if fitted_term.is_observable(12)
            ),
            default=last,
        )
        analysis = analyses[last]
        if last_with_offset != last:
            analysis = self._add_tilt_zero_variance(
                analyse_scaled_observability(
                    self._session_information(information, last, last_with_offset), unit_std
                )
            )
        return ConvergedFit(
            names=(
                *PARAMETER_NAMES,
                *(name for fitted_term in self._fitted_terms for name in fitted_term.names),
            ),
            prior_std=unit_std,
            estimate=np.concatenate(
                [
                    self._gain.ravel(),
                    self.sessions[last].bias_rad_s,
                    [self.sessions[last_with_offset].time_offset_s],
                    *term_values,
                ]
            ),
            observability=analysis,
            sessions=self.sessions,
            fitted_terms=self._fitted_terms,
            session_observability=analyses,
            noises=tuple(self._noises),
            spectra=tuple(self._spectra),
            noise_sources=tuple(self._sources),
            outliers=sum(session.outliers for session in self.sessions),
            convergence=convergence,
        )

    def _add_tilt_zero_variance(
        self, observability: ObservabilityAnalysis
    ) -> ObservabilityAnalysis:
        """Add the causes' uncertainty of the tilt zero to the covariance of G.

        A stage that is z higher than commanded rotates the rate by Rx(z)^T: see `tilt_zero`.
        """
        tilt_zero_std = [
            fitted_term.term.tilt_zero_std_rad(fitted_term.values)
            for fitted_term in self._fitted_terms
        ]
        std = float(np.linalg.norm(tilt_zero_std))
        if std == 0.0:
            return observability
        gain_change = np.zeros(observability.covariance.shape[0])
        gain_change[:GAIN_PARAMETERS] = std * (self._gain @ ROTATION_X_GENERATOR).ravel()
        return replace(
            observability, covariance=observability.covariance + np.outer(gain_change, gain_change)
        )

    @property
    def _term_value_count(self) -> int:
        return sum(fitted_term.free_indices.size for fitted_term in self._fitted_terms)

    def prior_std(self) -> FloatArray:
        """Return the prior standard deviations: G, each (b, tau), the causes' values."""
        base_std = prior_std(PARAMETER_NAMES)
        session_std = [base_std[GAIN_PARAMETERS:]] * len(self.sessions)
        return np.concatenate(
            [
                base_std[:GAIN_PARAMETERS],
                *session_std,
                *(fitted_term.prior_std for fitted_term in self._fitted_terms),
            ]
        )

    def parameter_index(self, session_index: int, offset_session: int | None = None) -> IntArray:
        """Return the positions of a recording's parameters: G, b, tau, causes.

        `offset_session`: take the time offset of that recording.
        """
        first = GAIN_PARAMETERS + SESSION_PARAMETERS * session_index
        terms_first = GAIN_PARAMETERS + SESSION_PARAMETERS * len(self.sessions)
        offset = (
            GAIN_PARAMETERS
            + SESSION_PARAMETERS * (session_index if offset_session is None else offset_session)
            + 3
        )
        base = (*range(GAIN_PARAMETERS), *range(first, first + 3), offset)
        return np.array(
            [*base, *range(terms_first, terms_first + self._term_value_count)], dtype=np.int64
        )

    def _stepped_terms(self, step: FloatArray) -> tuple[FittedTerm, ...]:
        stepped, first = [], 0
        for fitted_term in self._fitted_terms:
            stepped.append(
                fitted_term.with_step(step[first : first + fitted_term.free_indices.size])
            )
            first += fitted_term.free_indices.size
        return tuple(stepped)

    def _term_step(self, step: FloatArray) -> FloatArray:
        return step[step.size - self._term_value_count :]

    def _prior_decrease(self, stepped_terms: Sequence[FittedTerm]) -> float:
        """Return the decrease of the cost of the other boards' priors, nats."""
        return sum(
            (before.prior_cost() - after.prior_cost())
            for before, after in zip(self._fitted_terms, stepped_terms, strict=True)
        )

    def _recording_equations(self) -> list[RecordingEquations]:
        count = BASE_PARAMETERS + self._term_value_count
        return [
            RecordingEquations.of(normal, session.reference, count)
            for session, normal in zip(self.sessions, self.normal_equations(), strict=True)
        ]

    def _sum_marginals(
        self, marginals: Sequence[MarginalEquations]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the sum of all recordings' information and score."""
        size = GAIN_PARAMETERS + SESSION_PARAMETERS * len(marginals) + self._term_value_count
        information, score = np.zeros((size, size)), np.zeros(size)
        for k, marginal in enumerate(marginals):
            index = self.parameter_index(k)
            information[np.ix_(index, index)] += marginal.information
            score[index] += marginal.score
        first = GAIN_PARAMETERS + SESSION_PARAMETERS * len(marginals)
        for fitted_term in self._fitted_terms:
            if fitted_term.other_boards_prior is not None:
                term_slice = slice(first, first + fitted_term.free_indices.size)
                information[term_slice, term_slice] += fitted_term.other_boards_prior.information
                score[term_slice] += fitted_term.other_boards_prior.score(
                    fitted_term.values[fitted_term.free_indices]
                )
            first += fitted_term.free_indices.size
        return information, score

    def _session_information(
        self, information: FloatArray, session_index: int, offset_session: int | None = None
    ) -> FloatArray:
        """Return the information of G and one recording, the others eliminated."""
        keep = self.parameter_index(session_index, offset_session)
        drop = np.setdiff1d(np.arange(information.shape[0]), keep)
        if not drop.size:
            return information
        # A weak prior: a recording at rest does not determine its offset.
        prior_std = self.prior_std()[drop]
        dropped_information = information[np.ix_(drop, drop)] + np.diag(1e-6 / prior_std**2)
        cross = information[np.ix_(keep, drop)]
        reduced = information[np.ix_(keep, keep)] - cross @ np.linalg.solve(
            dropped_information, cross.T
        )
        return np.asarray(reduced, dtype=np.float64)

    def _least_squares(self, is_first: bool) -> None:
        sums = [
            s.least_squares_sums(s.used if is_first else s.inlier_masks(self._gain))
            for s in self.sessions
        ]
        self._gain = solve_shared_gain(sums)
        for session, session_sums in zip(self.sessions, sums, strict=True):
            session.bias_rad_s = session_sums.bias(self._gain)

    def _update_sessions(self, detect_outliers: bool, new_derivatives: bool) -> None:
        for session in self.sessions:
            session.fitted_terms = self._fitted_terms
            session.update_prediction(self._gain, detect_outliers, new_derivatives)

    def _fit_noise(self) -> None:
        periodograms = [session.noise_periodograms(self._gain) for session in self.sessions]
        self._spectra = [
            bin_spectrum(session_periodograms) for session_periodograms, _ in periodograms
        ]
        self._sources = [source for _, source in periodograms]
        previous_levels: list[FloatArray | None] = [noise.levels for noise in self._noises]
        previous_levels = previous_levels or [None] * len(self.sessions)
        self._noises = [
            fit_noise_levels(spectrum, self._sampling(session), levels)
            for spectrum, session, levels in zip(
                self._spectra, self.sessions, previous_levels, strict=True
            )
        ]

    def _sampling(self, session: SessionFit) -> Sampling:
        """Return a recording's sampling, with the sensor's true low-pass for the noise."""
        sampling = session.sampling
        bandwidth_ratio = math.prod(
            fitted_term.term.bandwidth_ratio(fitted_term.values)
            for fitted_term in self._fitted_terms
        )
        if sampling.bandwidth_hz is None or bandwidth_ratio == 1.0:
            return sampling
        return replace(sampling, bandwidth_hz=sampling.bandwidth_hz * bandwidth_ratio)


def _step_session(session: SessionFit, step: FloatArray, reference_step: FloatArray) -> None:
    """Change one recording's bias, lag and reference by a step of (G, b, tau, causes)."""
    session.bias_rad_s = session.bias_rad_s + step[9:12]
    session.lag_s += float(np.clip(step[12], -MAX_LAG_STEP_S, MAX_LAG_STEP_S))
    session.reference = session.reference.with_step(reference_step)
