"""Standard uncertainties widened by the reduced chi-square in motion.

If the whitened residual in motion is larger than noise explains, the model is incomplete, and the
uncertainties from noise alone are too small. The covariance is then multiplied by the reduced
chi-square (Birge ratio). Of several recordings, the largest chi-square counts, because a parameter
can come from this recording alone. The uncertainty of a common time shift has another origin and is
not changed.

Source: R. T. Birge, The Calculation of Errors by the Method of Least Squares, Phys. Rev. 40 (1932).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
    """Return the whitened variance in motion over that at rest, all axes and recordings."""
    return _join(_whitened_power(solution)).reduced_chi2()


def largest_reduced_chi2(solution: ConvergedFit) -> tuple[float, int | None]:
    """Return the largest reduced chi-square, and the index of its recording, None for all.

    Each of several recordings also counts alone if it has enough samples at rest and in motion.
    """
    powers = _whitened_power(solution)
    candidates: list[tuple[float, int | None]] = [(_join(powers).reduced_chi2(), None)]
    if len(powers) > 1:
        candidates += [(p.reduced_chi2(), k) for k, p in enumerate(powers) if p.is_sufficient]
    return max(candidates, key=lambda candidate: candidate[0])


def widen_uncertainty(solution: ConvergedFit) -> tuple[ConvergedFit, float]:
    """Return the fit with its covariance multiplied by the chi-square in motion, and the factor.

    The factor is 1 unless the mean squared whitened residual in motion of a recording, or of all
    together, is significantly above 1.
    """
    powers = _whitened_power(solution)
    if len(powers) > 1:
        powers.append(_join(powers))
    factor = max(power.significant_factor(FALSE_ALARM / len(powers)) for power in powers)
    if factor == 1.0:
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


@dataclass(frozen=True, slots=True, eq=False)
class _WhitenedPower:
    """Squared whitened residuals, summed over the axes."""

    power: FloatArray  # of each block, (n,)
    moving: BoolArray  # the used blocks in motion, (n,)
    at_rest: BoolArray  # the used blocks at rest, (n,)

    @property
    def is_sufficient(self) -> bool:
        """Whether there are enough blocks at rest and in motion to compare them."""
        return bool(min(self.moving.sum(), self.at_rest.sum()) >= MIN_VALUES)

    def reduced_chi2(self) -> float:
        """Return the variance in motion over that at rest, or over 1 without enough blocks."""
        if not self.is_sufficient:
            return float(np.mean(self.power[self.moving | self.at_rest]) / 3.0)
        return float(np.mean(self.power[self.moving]) / np.mean(self.power[self.at_rest]))

    def significant_factor(self, false_alarm: float) -> float:
        """Return the variance in motion in units of the noise model's, 1 without an excess."""
        if not self.is_sufficient:
            return 1.0
        counts = 3.0 * np.array([self.moving.sum(), self.at_rest.sum()])
        factor = float(np.mean(self.power[self.moving])) / 3.0
        std = float(np.sqrt(2.0 * np.sum(1.0 / counts)))  # the levels also have an uncertainty
        is_excess = factor - 1.0 >= max(MIN_EXCESS, normal_quantile(false_alarm) * std)
        return factor if is_excess else 1.0


def _whitened_power(solution: ConvergedFit) -> list[_WhitenedPower]:
    """Return the whitened power of each recording."""
    powers = []
    for session, noise in zip(solution.sessions, solution.noises, strict=True):
        white = np.concatenate(session.whitened_residuals(solution.gain, noise))
        used, in_motion = np.concatenate(session.used), np.concatenate(session.moving)
        powers.append(_WhitenedPower(np.sum(white**2, axis=1), used & in_motion, used & ~in_motion))
    return powers


def _join(powers: Sequence[_WhitenedPower]) -> _WhitenedPower:
    return _WhitenedPower(
        np.concatenate([power.power for power in powers]),
        np.concatenate([power.moving for power in powers]),
        np.concatenate([power.at_rest for power in powers]),
    )
