"""Errors of the ramps' acceleration, from the fitted accelerations of the reference.

The unit's replies follow its true ramps, and the reference fits each axis' acceleration to them.
The residual therefore shows nothing. The fitted accelerations are compared with the commanded ones.

What to use when: `detect_ramp_error` for the last fit of a search.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.discover.cause_findings import DetectionLimit, FittedValue, NamedCause
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.model.causes.acceleration_error import AccelerationError
from gyrorig_solver.model.causes.base_speed_jump import BaseSpeedJump
from gyrorig_solver.model.value_format import PAN_TILT
from gyrorig_solver.numerics import chi2_upper_tail, normal_quantile
from gyrorig_solver.reference.unit.law_fit import compare_base_speeds
from gyrorig_solver.reference.unit.pan_tilt_reference import PanTiltReference

ACCELERATION_ERROR = AccelerationError.cause
ACTING_SIGMA = 3.0  # an axis this many deviations off is where it acts
DETECTION_POWER = 0.8  # of what is called detectable
CREDIBLE_SET_LEVEL = 0.95  # belief that the stated set holds the cause
BASE_SPEED_GRID_RAD_S = np.geomspace(
    5e-4, 0.2, 14
)  # up to four times a factory setting of 2.9 deg/s


@dataclass(frozen=True, slots=True, eq=False)
class RampResult:
    """The result for the unit's ramps: a named cause, or detection limits."""

    named: NamedCause | None
    detection_limits: tuple[DetectionLimit, ...]


def detect_ramp_error(solution: ConvergedFit, tests: int, alpha: float) -> RampResult:
    """Compare the fitted accelerations with the commanded ones; return a cause or limits.

    Args:
        solution: the last fit of a search; what changes the law of motion is in it.
        tests: how many share the false alarms.
        alpha: rate of false alarms of all of them.
    """
    term = AccelerationError()
    if any(
        fitted_term.term.cause == term.cause and fitted_term.free_indices.size
        for fitted_term in solution.fitted_terms
    ):
        return RampResult(None, ())
    weight, total = np.zeros(2), np.zeros(2)
    for session in solution.sessions:
        if (
            isinstance(session.reference, PanTiltReference)
            and session.reference.move_fit.counts_follow_commands
        ):
            value, std = session.reference.log_acceleration
            finite = np.isfinite(std)
            weight[finite] += std[finite] ** -2.0
            total[finite] += value[finite] * std[finite] ** -2.0
    observed = weight > 0.0
    if not observed.any():
        return RampResult(None, ())
    mean = np.divide(total, weight, out=np.zeros(2), where=observed)
    deviation = np.divide(1.0, np.sqrt(weight), out=np.full(2, np.inf), where=observed)
    statistic = float(np.sum((mean[observed] / deviation[observed]) ** 2))
    p_value = min(1.0, chi2_upper_tail(statistic, float(observed.sum())) * tests)
    parameter = term.parameters[0]
    if p_value >= alpha:
        required_sigma = normal_quantile(alpha / tests / 2.0) + normal_quantile(
            1.0 - DETECTION_POWER
        )
        return RampResult(
            None,
            tuple(
                DetectionLimit(
                    term.cause,
                    place,
                    required_sigma * float(std),
                    parameter.unit,
                    parameter.typical_size,
                    "",
                    0.0,
                )
                for place, std in zip(PAN_TILT, deviation, strict=True)
                if np.isfinite(std)
            ),
        )
    share = np.expm1(mean)
    acts = np.abs(mean) > ACTING_SIGMA * deviation
    acts[int(np.argmax(np.abs(mean) / deviation))] = True
    values = [
        FittedValue(
            f"{parameter.name}.{place}",
            float(size),
            float(std),
            parameter.unit,
            parameter.typical_size,
        )
        for place, size, std in zip(PAN_TILT, share, deviation, strict=True)
    ]
    named = NamedCause(
        term=term,
        where=tuple(place for place, acts_here in zip(PAN_TILT, acts, strict=True) if acts_here),
        extension=FittedTerm(term, share, np.zeros(0, dtype=np.int64)),
        values=tuple(values),
        statistic=statistic,
        degrees_of_freedom=int(observed.sum()),
        p_value=p_value,
        posterior=1.0,
        one_of=(),
        rivals=(),
        changes=(),  # the base model has the ramps as they are
        gain=None,
    )
    return RampResult(_compare_base_speed_jump(named, solution), ())


def without_grid_uncertainty(named: NamedCause | None) -> NamedCause | None:
    """Return a cause as it is stated: a base speed from the grid is a start value for a fit.

    The grid is coarse, so that its standard uncertainty does not hold.
    """
    if named is None or named.term.cause == ACCELERATION_ERROR:
        return named
    return replace(named, values=tuple(replace(value, std=np.inf) for value in named.values))


def _compare_base_speed_jump(named: NamedCause, solution: ConvergedFit) -> NamedCause:
    """Return the cause, or an unknown base speed instead, whichever the polls favour.

    Below the base speed a motor starts without a ramp. With the commanded motion profile such a
    ramp looks steeper; the position counts separate the two.
    """
    term = BaseSpeedJump()
    if any(fitted_term.term.cause == term.cause for fitted_term in solution.fitted_terms):
        return named
    jumps, stds, lead_nats = np.zeros(2), np.full(2, np.inf), 0.0
    for axis, place in enumerate(PAN_TILT):
        if place not in named.where:
            continue
        nats = np.zeros(BASE_SPEED_GRID_RAD_S.size)
        for session in solution.sessions:
            reference = session.reference
            if isinstance(reference, PanTiltReference):
                steps_s = BASE_SPEED_GRID_RAD_S / abs(reference.rad_per_step[axis])
                nats += compare_base_speeds(reference.move_fit, axis, steps_s)
        jumps[axis], stds[axis], best = _parabolic_peak(nats)
        lead_nats += best
    posterior = float(1.0 / (1.0 + np.exp(np.clip(-lead_nats, -700.0, 700.0))))
    if lead_nats <= 0.0:
        one_of = (term.cause,) if 1.0 - posterior < CREDIBLE_SET_LEVEL else ()
        return replace(named, posterior=1.0 - posterior, one_of=one_of)
    parameter = term.parameters[0]
    return replace(
        named,
        term=term,
        extension=FittedTerm(term, jumps, np.zeros(0, dtype=np.int64)),
        values=tuple(
            FittedValue(
                f"{parameter.name}.{place}",
                float(size),
                float(std),
                parameter.unit,
                parameter.typical_size,
            )
            for place, size, std in zip(PAN_TILT, jumps, stds, strict=True)
        ),
        posterior=posterior,
        one_of=(ACCELERATION_ERROR,) if posterior < CREDIBLE_SET_LEVEL else (),
    )


def _parabolic_peak(nats: FloatArray) -> tuple[float, float, float]:
    """Return the peak of the log-likelihood, its uncertainty and its height."""
    best = int(np.clip(np.argmax(nats), 1, nats.size - 2))
    near = slice(best - 1, best + 2)
    curvature, slope, _ = np.polyfit(BASE_SPEED_GRID_RAD_S[near], nats[near], 2)
    if curvature >= 0.0:
        return float(BASE_SPEED_GRID_RAD_S[best]), np.inf, float(nats[best])
    peak = float(
        np.clip(
            -slope / (2.0 * curvature),
            BASE_SPEED_GRID_RAD_S[best - 1],
            BASE_SPEED_GRID_RAD_S[best + 1],
        )
    )
    return peak, float(np.sqrt(-0.5 / curvature)), float(nats.max())
