"""Standard uncertainties widened by the reduced chi-square in motion.

If the whitened residual in motion is larger than noise explains, the model is incomplete, and the
uncertainties from noise alone are too small. The covariance is then multiplied by the reduced
chi-square (Birge ratio). The uncertainty of a common time shift has another origin and is not
changed.

Source: R. T. Birge, The Calculation of Errors by the Method of Least Squares, Phys. Rev. 40 (1932).
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.observability import ObservabilityAnalysis
from gyrorig_solver.estimate.session_fit import SessionFit
from gyrorig_solver.numerics import normal_quantile

FALSE_ALARM = 1e-4  # probability of widening without an excess
MIN_EXCESS = 0.05  # a smaller excess changes a standard uncertainty by 2 %
MIN_VALUES = 100
TIME_OFFSET = 12


def reduced_chi2(solution: ConvergedFit) -> float:
    """Return the whitened variance in motion over that at rest, all axes."""
    power, moving, at_rest = _whitened_power(solution)
    if min(moving.sum(), at_rest.sum()) < MIN_VALUES:
        return float(np.mean(power[moving | at_rest]) / 3.0)
    return float(np.mean(power[moving]) / np.mean(power[at_rest]))


def widen_uncertainty(solution: ConvergedFit) -> tuple[ConvergedFit, float]:
    """Return the fit with its covariance multiplied by the chi-square in motion, and the factor.

    The factor is 1 unless the mean squared whitened residual in motion is significantly above 1.
    """
    power, moving, at_rest = _whitened_power(solution)
    counts = 3.0 * np.array([moving.sum(), at_rest.sum()])
    if counts.min() < 3.0 * MIN_VALUES:
        return solution, 1.0
    factor = float(np.mean(power[moving])) / 3.0
    std = float(np.sqrt(2.0 * np.sum(1.0 / counts)))  # the levels also have an uncertainty
    if factor - 1.0 < max(MIN_EXCESS, normal_quantile(FALSE_ALARM) * std):
        return solution, 1.0
    widened = replace(
        solution,
        observability=_multiply(
            solution.observability, solution.sessions[solution.offset_recording], factor
        ),
        session_observability=tuple(
            _multiply(analysis, session, factor)
            for analysis, session in zip(
                solution.session_observability, solution.sessions, strict=True
            )
        ),
    )
    return widened, factor


def _multiply(
    analysis: ObservabilityAnalysis, session: SessionFit, factor: float
) -> ObservabilityAnalysis:
    covariance = factor * analysis.covariance
    if analysis.is_observable(TIME_OFFSET):
        covariance[TIME_OFFSET, TIME_OFFSET] -= (factor - 1.0) * session.common_std_s**2
    # Both parts grow by the same factor, so that the same parameters stay observable.
    return replace(
        analysis,
        covariance=covariance,
        unobservable_covariance=factor * analysis.unobservable_covariance,
    )


def _whitened_power(solution: ConvergedFit) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Return the whitened power of every block, and which used blocks move or rest."""
    power = np.concatenate([np.sum(white**2, axis=1) for white in solution.whitened_residuals()])
    used = np.concatenate(solution.used_blocks())
    in_motion = np.concatenate([moving for s in solution.sessions for moving in s.moving])
    return power, used & in_motion, used & ~in_motion
