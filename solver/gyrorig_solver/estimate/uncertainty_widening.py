"""Standard uncertainties widened by the reduced chi-square in motion.

If the whitened residual in motion is larger than noise explains, the model is incomplete, and the
uncertainties from noise alone are too small. The covariance is then multiplied by the reduced chi-
square (Birge ratio). Of several recordings, the largest chi-square counts, because a parameter can
come from this recording alone. For the same reason, each sensor axis counts alone if its excess is
significant: two good axes would hide two thirds of the excess of a bad one. The uncertainty of a
common time shift has another origin and is not changed.

Source: R. T. Birge, The Calculation of Errors by the Method of Least Squares, Phys. Rev. 40 (1932).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.noise.missing_samples import has_gaps
from gyrorig_solver.estimate.observability import ObservabilityAnalysis
from gyrorig_solver.estimate.session_fit import SessionFit
from gyrorig_solver.numerics import normal_quantile

FALSE_ALARM = 1e-4  # probability of widening without an excess
MIN_EXCESS = 0.05  # a smaller excess changes a standard uncertainty by 2 %
MIN_VALUES = 300  # of all axes together or of one axis, at rest and in motion
AXES = 3
TIME_OFFSET = 12


def reduced_chi2(solution: ConvergedFit) -> float:
    """Return the whitened variance in motion over that at rest, all axes and recordings."""
    return _join(_whitened_power(solution)).reduced_chi2()


def largest_reduced_chi2(solution: ConvergedFit) -> tuple[float, int | None]:
    """Return the largest reduced chi-square, and the index of its recording, None for all.

    Each of several recordings also counts alone if it has enough samples at rest and in motion, and
    each sensor axis if its excess is significant.
    """
    powers = _whitened_power(solution)
    joined = _join(powers)
    candidates: list[tuple[float, int | None]] = [(joined.reduced_chi2(), None)]
    groups: list[tuple[_WhitenedPower, int | None]] = [(joined, None)]
    if len(powers) > 1:
        candidates += [(p.reduced_chi2(), k) for k, p in enumerate(powers) if p.is_sufficient]
        groups += [(power, k) for k, power in enumerate(powers)]
    false_alarm = FALSE_ALARM / (AXES * len(groups))
    # In units of the noise model: rounding hides the noise of a single axis at rest.
    candidates += [
        (factor, k)
        for power, k in groups
        for axis in power.axes
        if (factor := axis.significant_factor(false_alarm)) > 1.0
    ]
    return max(candidates, key=lambda candidate: candidate[0])


def widen_uncertainty(solution: ConvergedFit) -> tuple[ConvergedFit, float]:
    """Return the fit with its covariance multiplied by the chi-square in motion, and the factor.

    The factor is 1 unless the mean squared whitened residual in motion of a recording, of all
    together, or of a sensor axis of them, is significantly above 1.
    """
    powers = _whitened_power(solution)
    if len(powers) > 1:
        powers.append(_join(powers))
    powers += [axis for power in powers for axis in power.axes]
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
    """Squared whitened residuals of some axes."""

    power: FloatArray  # of each block and axis, (n, axes)
    moving: BoolArray  # the used blocks in motion, (n,)
    at_rest: BoolArray  # the used blocks at rest, (n,)

    @property
    def axes(self) -> list["_WhitenedPower"]:
        """The same of each axis alone."""
        return [replace(self, power=column[:, None]) for column in self.power.T]

    @property
    def is_sufficient(self) -> bool:
        """Whether there are enough values at rest and in motion to compare them."""
        return bool(self._counts.min() >= MIN_VALUES)

    @property
    def _counts(self) -> IntArray:
        """The number of values in motion and at rest, (2,)."""
        blocks = np.array([self.moving.sum(), self.at_rest.sum()], dtype=np.int64)
        return np.asarray(self.power.shape[1] * blocks, dtype=np.int64)

    def reduced_chi2(self) -> float:
        """Return the variance in motion over that at rest, or over 1 without enough blocks."""
        if not self.is_sufficient:
            return float(np.mean(self.power[self.moving | self.at_rest]))
        return float(np.mean(self.power[self.moving]) / np.mean(self.power[self.at_rest]))

    def significant_factor(self, false_alarm: float) -> float:
        """Return the variance in motion in units of the noise model's, 1 without an excess."""
        if not self.is_sufficient:
            return 1.0
        factor = float(np.mean(self.power[self.moving]))
        std = float(np.sqrt(2.0 * np.sum(1.0 / self._counts)))  # the levels are uncertain, too
        is_excess = factor - 1.0 >= max(MIN_EXCESS, normal_quantile(false_alarm) * std)
        return factor if is_excess else 1.0


def _whitened_power(solution: ConvergedFit) -> list[_WhitenedPower]:
    """Return the whitened power of each recording."""
    powers = []
    for session, noise in zip(solution.sessions, solution.noises, strict=True):
        power = np.concatenate(session.whitened_residuals(solution.gain, noise)) ** 2
        used, in_motion = np.concatenate(session.used), np.concatenate(session.moving)
        if has_gaps(used):
            # A part of the power of the used blocks is in the blocks that they predict.
            power *= power.sum(axis=0) / np.maximum(power[used].sum(axis=0), 1e-300)
        powers.append(_WhitenedPower(power, used & in_motion, used & ~in_motion))
    return powers


def _join(powers: Sequence[_WhitenedPower]) -> _WhitenedPower:
    return _WhitenedPower(
        np.concatenate([power.power for power in powers]),
        np.concatenate([power.moving for power in powers]),
        np.concatenate([power.at_rest for power in powers]),
    )
