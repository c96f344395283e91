"""The state of one board in a fit: gain, causes, noise, and its recordings.

What to use when: `BoardFit.started` for the first fit of a board; `BoardFit.resumed` to continue
from a fit with other causes. `likelihood_fit` iterates over one or more boards.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.fit_objective import residual_decrease
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.initial_guess import solve_shared_gain
from gyrorig_solver.estimate.linear.normal_equations import NormalEquations
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, Sampling
from gyrorig_solver.estimate.noise.residual_spectrum import Spectrum
from gyrorig_solver.estimate.parameter_layout import GAIN_PARAMETERS, ParameterLayout
from gyrorig_solver.estimate.session_fit import SessionFit
from gyrorig_solver.estimate.session_noise import fit_session_noise

OUTLIER_RETEST_SIGMA = 5.0  # a larger step repeats the outlier detection
DERIVATIVE_REFRESH_SIGMA = 50.0  # a larger step repeats the derivatives
NONLINEAR_REFRESH_SIGMA = 3.0  # the same limit if there are causes
MAX_LAG_STEP_S = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """The values after a step that may be rejected."""

    gain: FloatArray
    fitted_terms: tuple[FittedTerm, ...]
    sessions: tuple[SessionFit, ...]
    size_sigma: float


class BoardFit:
    """One board's part of a fit."""

    def __init__(self, sessions: Sequence[SessionFit], fitted_terms: Sequence[FittedTerm]) -> None:
        """Use `started` or `resumed` instead."""
        self.sessions, self.fitted_terms = tuple(sessions), tuple(fitted_terms)
        self.layout = ParameterLayout.of([self.fitted_terms], len(self.sessions))
        self.gain = np.eye(3)
        self.noises: list[NoiseModel] = []
        self.spectra: list[Spectrum] = []
        self.noise_sources: list[str] = []
        self._trial: _Trial | None = None

    @classmethod
    def started(
        cls, sessions: Sequence[SessionFit], fitted_terms: Sequence[FittedTerm] = ()
    ) -> Self:
        """Estimate lags by correlation, then gain and biases by least squares."""
        board = cls(sessions, fitted_terms)
        for session in board.sessions:
            session.estimate_lag()
        board._least_squares(is_first=True)
        board._least_squares(is_first=False)
        board.update_predictions()
        return board

    @classmethod
    def resumed(
        cls,
        previous: ConvergedFit,
        fitted_terms: Sequence[FittedTerm],
        keep_rejected: bool = False,
    ) -> Self:
        """Start at the end of another fit of the same recordings; that fit is not changed.

        `keep_rejected`: outliers of that fit stay outliers.
        """
        board = cls([session.copy() for session in previous.sessions], fitted_terms)
        for session in board.sessions:
            session.keeps_rejected = keep_rejected
        board.gain, board.noises = previous.gain.copy(), list(previous.noises)
        board.update_predictions()
        return board

    @property
    def parameter_count(self) -> int:
        """The number of parameters of one recording's equations: G, b, tau, causes."""
        return self.layout.index(0).size

    def normal_equations(self) -> list[NormalEquations]:
        """Return each recording's normal equations, without the reference's prior."""
        return [
            session.normal_equations(self.gain, noise)
            for session, noise in zip(self.sessions, self.noises, strict=True)
        ]

    def stepped_terms(self, step: FloatArray) -> tuple[FittedTerm, ...]:
        """Return the causes after a step of the board's parameters, within their ranges."""
        return tuple(
            fitted_term.with_step(step[block.positions])
            for fitted_term, block in zip(self.fitted_terms, self.layout.term_blocks(), strict=True)
        )

    def try_step(
        self, step: FloatArray, nuisance_steps: Sequence[FloatArray], size_sigma: float
    ) -> float:
        """Predict all recordings after a step; return the decrease from their residuals, nats.

        Args:
            step: of the board's parameters, in the order of `layout`.
            nuisance_steps: of the unknowns of each recording's reference.
            size_sigma: the largest part of the step, in standard deviations.
        """
        gain = self.gain + step[:GAIN_PARAMETERS].reshape(3, 3)
        fitted_terms = self.stepped_terms(step)
        sessions = []
        decrease = 0.0
        for k, (session, nuisance_step) in enumerate(
            zip(self.sessions, nuisance_steps, strict=True)
        ):
            trial = session.trial_copy()
            _step_session(trial, step[self.layout.index(k)], nuisance_step)
            trial.fitted_terms = fitted_terms
            trial.predict(gain, keep_samples=size_sigma > OUTLIER_RETEST_SIGMA)
            decrease += residual_decrease(session, trial, self.gain, gain)
            sessions.append(trial)
        self._trial = _Trial(gain, fitted_terms, tuple(sessions), size_sigma)
        return decrease

    @property
    def trial_sessions(self) -> tuple[SessionFit, ...]:
        """The recordings after the step that was tried last.

        Raises:
            ValueError: no step was tried.
        """
        if self._trial is None:
            raise ValueError("no step was tried")
        return self._trial.sessions

    def accept(self, new_derivatives: bool) -> None:
        """Continue from the values that were tried last.

        `new_derivatives`: compute them again; a large step always does this.
        """
        if self._trial is None:
            raise ValueError("no step was tried")
        trial, self._trial = self._trial, None
        self.gain = trial.gain
        self.fitted_terms = trial.fitted_terms
        self.sessions = trial.sessions
        # Before convergence, good samples can look like outliers. Causes are rarely linear: the
        # effect of a rounded corner grows as the square of its length.
        refresh_limit = (
            NONLINEAR_REFRESH_SIGMA if self.layout.term_index().size else DERIVATIVE_REFRESH_SIGMA
        )
        for session in self.sessions:
            session.complete_prediction(
                self.gain,
                detect_outliers=trial.size_sigma > OUTLIER_RETEST_SIGMA,
                new_derivatives=new_derivatives or trial.size_sigma > refresh_limit,
            )
        self._fit_noise(is_next_step=True)

    def renew_derivatives(self) -> bool:
        """Discard the derivatives; return False if better ones are not possible.

        If they belong to the current values, the new ones are on a finer grid.
        """
        if all(session.derivatives.are_current for session in self.sessions):
            refined = [session.derivatives.refine() for session in self.sessions]
            return any(refined)
        for session in self.sessions:
            session.derivatives.discard()
        return True

    def apply_step(self, step: FloatArray, nuisance_steps: Sequence[FloatArray]) -> None:
        """Change the board's parameters, and the unknowns of each recording's reference."""
        self.gain = self.gain + step[:GAIN_PARAMETERS].reshape(3, 3)
        self.fitted_terms = self.stepped_terms(step)
        for k, (session, nuisance_step) in enumerate(
            zip(self.sessions, nuisance_steps, strict=True)
        ):
            _step_session(session, step[self.layout.index(k)], nuisance_step)

    def update_predictions(self) -> None:
        """Compute the predictions, outliers, derivatives and noise again."""
        for session in self.sessions:
            session.fitted_terms = self.fitted_terms
            session.update_prediction(self.gain, detect_outliers=True, new_derivatives=True)
        self._fit_noise()

    def update_motion_noise(self) -> bool:
        """Estimate noise in motion and jitter of each recording; return whether weights changed."""
        changed = [
            session.update_motion_noise(self.gain, noise)
            for session, noise in zip(self.sessions, self.noises, strict=True)
        ]
        if any(changed):
            self.update_predictions()
        return any(changed)

    def _least_squares(self, is_first: bool) -> None:
        sums = [
            session.least_squares_sums(
                session.used if is_first else session.inlier_masks(self.gain)
            )
            for session in self.sessions
        ]
        self.gain = solve_shared_gain(sums)
        for session, session_sums in zip(self.sessions, sums, strict=True):
            session.bias_rad_s = session_sums.bias(self.gain)

    def _fit_noise(self, is_next_step: bool = False) -> None:
        previous_levels: list[FloatArray | None] = [noise.levels for noise in self.noises]
        previous_levels = previous_levels or [None] * len(self.sessions)
        fitted = [
            fit_session_noise(session, self.gain, self._sampling(session), levels, is_next_step)
            for session, levels in zip(self.sessions, previous_levels, strict=True)
        ]
        self.noises = [session_noise.noise for session_noise in fitted]
        self.spectra = [session_noise.spectrum for session_noise in fitted]
        self.noise_sources = [session_noise.source for session_noise in fitted]

    def _sampling(self, session: SessionFit) -> Sampling:
        """Return a recording's sampling, with the sensor's true low-pass for the noise."""
        bandwidth_hz = session.sampling.bandwidth_hz
        for fitted_term in self.fitted_terms:
            bandwidth_hz = fitted_term.term.noise_bandwidth_hz(fitted_term.values, bandwidth_hz)
        return replace(session.sampling, bandwidth_hz=bandwidth_hz)


def _step_session(session: SessionFit, step: FloatArray, nuisance_step: FloatArray) -> None:
    """Change one recording's bias, lag and reference by a step of (G, b, tau, causes)."""
    session.bias_rad_s = session.bias_rad_s + step[9:12]
    session.lag_s += float(np.clip(step[12], -MAX_LAG_STEP_S, MAX_LAG_STEP_S))
    session.reference = session.reference.with_step(nuisance_step)
