"""A fitted model on a held-out recording of the same board.

Gain and causes are held at their fitted values. Bias, time offset and the unknowns of the motion
are fitted to the held-out recording. Causes of scope `recording` are left out. The score is the
log-likelihood of the residual, with the noise levels of that recording.

What to use when: `HeldOutRecording.fit_model` for each model; models that are compared must have
the same noise. `held_out_gain.gain_on_recording` compares two fits in this way.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import (
    BASE_PARAMETERS,
    GAIN_PARAMETERS,
    PRIOR_STD,
    ConvergedFit,
    FittedTerm,
    NoiseModel,
    SessionFit,
    marginalise,
    reference_cost,
)
from gyrorig_solver.estimate.board_fit import DERIVATIVE_REFRESH_SIGMA, OUTLIER_RETEST_SIGMA
from gyrorig_solver.estimate.session_noise import fit_session_noise
from gyrorig_solver.estimate.trust_region import CONVERGED_SIGMA
from gyrorig_solver.model import why_not_testable

MAX_ITERATIONS = 12
MAX_LAG_STEP_S = 0.05  # largest change of the time offset in one step


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutFit:
    """One model on a recording that it was not fitted to."""

    session: SessionFit  # at the best bias, time offset and motion
    gain: FloatArray  # (3, 3)
    noise: NoiseModel
    log_likelihood: float  # nats, up to a constant of all models with the same noise
    left_out: tuple[FittedTerm, ...]  # causes of other recordings, or that are not testable here


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutRecording:
    """A recording that no model was fitted to."""

    session: SessionFit
    name: str

    def fit_model(
        self, solution: ConvergedFit, same_noise_as: HeldOutFit | None = None
    ) -> HeldOutFit:
        """Fit bias, time offset and motion with gain and causes held; return the fit.

        Args:
            solution: the fit that gives gain and causes.
            same_noise_as: the fit of another model to this recording. It gives the noise levels and
                the samples that are used.
        """
        applicable, left_out = self._applicable_terms(solution)
        if same_noise_as is None:
            session = self.session.copy()
            session.fitted_terms = applicable
            session.estimate_lag()
            least_squares = session.least_squares_sums(session.inlier_masks(solution.gain))
            session.bias_rad_s = least_squares.bias(solution.gain)
        else:
            session = self.session.started_from(same_noise_as.session)
            session.fitted_terms = applicable
        noise = _fit_nuisances(
            session, solution.gain, None if same_noise_as is None else same_noise_as.noise
        )
        whitened = session.whitened_residuals(solution.gain, noise)
        cost = 0.5 * sum(float(np.sum(residual**2)) for residual in whitened)
        cost += reference_cost(session.reference)
        return HeldOutFit(session, solution.gain, noise, -cost, left_out)

    def _applicable_terms(
        self, solution: ConvergedFit
    ) -> tuple[tuple[FittedTerm, ...], tuple[FittedTerm, ...]]:
        """Return the causes that also act in this recording, held fixed, and the other causes."""
        scenes = [
            self.session.signal_state(series, blocks, solution.gain)
            for series in self.session.series
            for blocks in series.part_slices()
        ]
        applicable: list[FittedTerm] = []
        left_out: list[FittedTerm] = []
        for extension in solution.fitted_terms:
            persists = extension.term.kind == "known" or extension.term.scope != "recording"
            if persists and why_not_testable(extension.term, scenes) is None:
                applicable.append(
                    replace(
                        extension, free_indices=np.zeros(0, dtype=np.int64), other_boards_prior=None
                    )
                )
            else:
                left_out.append(extension)
        return tuple(applicable), tuple(left_out)


def _fit_nuisances(session: SessionFit, gain: FloatArray, noise: NoiseModel | None) -> NoiseModel:
    """Fit bias, time offset and motion to a held model; return the fitted or the given noise."""
    free = slice(GAIN_PARAMETERS, BASE_PARAMETERS)
    prior = np.array([PRIOR_STD["bias"]] * 3 + [PRIOR_STD["time_offset"]]) ** -2.0
    own_noise = noise is None
    session.update_prediction(gain, detect_outliers=own_noise, new_derivatives=True)
    levels = noise or fit_session_noise(session, gain, session.sampling, None).noise
    for _ in range(MAX_ITERATIONS):
        marginal = marginalise(session.normal_equations(gain, levels), session.reference)
        information = marginal.information[free, free] + np.diag(prior)
        step = np.zeros(BASE_PARAMETERS)
        step[free] = np.linalg.solve(information, marginal.score[free])
        session.bias_rad_s = session.bias_rad_s + step[GAIN_PARAMETERS : GAIN_PARAMETERS + 3]
        session.lag_s += float(np.clip(step[BASE_PARAMETERS - 1], -MAX_LAG_STEP_S, MAX_LAG_STEP_S))
        session.reference = session.reference.with_step(marginal.nuisance_step(step))
        sigma = np.sqrt(np.diag(np.linalg.inv(information)))
        size = float(np.max(np.abs(step[free]) / sigma))
        session.update_prediction(
            gain,
            detect_outliers=own_noise and size > OUTLIER_RETEST_SIGMA,
            new_derivatives=size > DERIVATIVE_REFRESH_SIGMA,
        )
        if own_noise:
            levels = fit_session_noise(session, gain, session.sampling, levels.levels).noise
        if size < CONVERGED_SIGMA:
            break
    return levels
