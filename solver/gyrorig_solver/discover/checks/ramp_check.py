"""Names an error of the unit's ramps that its replies show: acceleration, or a wrong base speed.

The unit's replies follow its true ramps, and the reference fits the acceleration of each axis to
them. The residual therefore does not show an error of the acceleration. This module compares the
fitted accelerations with the commanded accelerations. A wrong base speed makes every move shorter.
The starts of the moves and the time offset absorb that, but the replies during the ramps show it.

What to use when: `RampCheck` after a search; `detect_ramp_error` for a fit alone.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.cause_findings import DetectionLimit, NamedCause
from gyrorig_solver.discover.cause_ranking import CREDIBLE_SET_LEVEL
from gyrorig_solver.discover.checks.model_check import JudgedModel, Verdict
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.named_causes import ACTING_SIGMA, name_outside_fit
from gyrorig_solver.discover.score_tests import DETECTION_POWER, FALSE_ALARM_RATE
from gyrorig_solver.estimate import ConvergedFit
from gyrorig_solver.model import Stage, term_of_law
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.model.value_format import PAN_TILT
from gyrorig_solver.numerics import chi2_upper_tail, normal_quantile
from gyrorig_solver.reference import PanTiltReference
from gyrorig_solver.reference.unit.law_fit import compare_base_speeds

RAMP_STAGES: tuple[Stage, ...] = ("profile", "motor")
# Up to four times the factory setting of 2.9 deg/s.
BASE_SPEED_GRID_RAD_S = np.geomspace(5e-4, 0.2, 14)


class RampCheck:
    """Names an error of the ramps, or states the size that would have been detected."""

    removes_names = False

    def judge(self, model: JudgedModel[MotionFitSpace]) -> Verdict:
        """Return the named error, or its detection limits."""
        acceleration = term_of_law("acceleration").cause  # always tested by `detect_ramp_error`
        verdict = detect_ramp_error(model.space.solution, model.tests)
        if not verdict.named:
            return replace(verdict, covered_causes=frozenset({acceleration}))
        (named,) = verdict.named
        states = model.result.projector.states
        if any(state.context.is_averaged and not state.is_at_rest for state in states):
            # The replies alone do not distinguish these causes, but exact rates would.
            ramp_causes = [term.cause for term in catalogue().values() if term.stage in RAMP_STAGES]
            others = tuple(cause for cause in ramp_causes if cause != named.cause)
            named = replace(named, one_of=others)
        return Verdict(named=(named,), covered_causes=frozenset({acceleration, named.cause}))


def detect_ramp_error(solution: ConvergedFit, tests: int) -> Verdict:
    """Compare the fitted accelerations with the commanded ones; return a cause or limits.

    Args:
        solution: the last fit of a search, with the causes that change the motion law.
        tests: how many share the false alarms.
    """
    term = term_of_law("acceleration")
    if any(
        fitted_term.term.cause == term.cause and fitted_term.free_indices.size
        for fitted_term in solution.fitted_terms
    ):
        return Verdict()
    mean, deviation = _mean_log_acceleration(solution)
    observed = np.isfinite(deviation)
    if not observed.any():
        return Verdict()
    statistic = float(np.sum((mean[observed] / deviation[observed]) ** 2))
    p_value = min(1.0, chi2_upper_tail(statistic, float(observed.sum())) * tests)
    if p_value >= FALSE_ALARM_RATE:
        parameter = term.parameters[0]
        required_sigma = normal_quantile(FALSE_ALARM_RATE / tests / 2.0) + normal_quantile(
            1.0 - DETECTION_POWER
        )
        limits = tuple(
            DetectionLimit(
                term.cause,
                place,
                required_sigma * float(std),
                parameter.unit,
                parameter.typical_size,
            )
            for place, std in zip(PAN_TILT, deviation, strict=True)
            if np.isfinite(std)
        )
        return Verdict(detection_limits=limits)
    acts = np.abs(mean) > ACTING_SIGMA * deviation
    acts[int(np.argmax(np.abs(mean) / deviation))] = True
    named = name_outside_fit(
        term,
        np.expm1(mean),
        deviation,
        tuple(place for place, acts_here in zip(PAN_TILT, acts, strict=True) if acts_here),
        statistic=statistic,
        degrees_of_freedom=int(observed.sum()),
        p_value=p_value,
    )
    return Verdict(named=(_compare_base_speed_jump(named, solution),))


def _mean_log_acceleration(solution: ConvergedFit) -> tuple[FloatArray, FloatArray]:
    """Return the logarithm of fitted over commanded acceleration of each axis, and its uncertainty.

    Both are means over the recordings, (2,); the uncertainty of an axis without ramps is infinite.
    """
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
    return (
        np.divide(total, weight, out=np.zeros(2), where=observed),
        np.divide(1.0, np.sqrt(weight), out=np.full(2, np.inf), where=observed),
    )


def _compare_base_speed_jump(named: NamedCause, solution: ConvergedFit) -> NamedCause:
    """Return the cause or an unknown base speed, whichever is more likely given the polls.

    Below the base speed a motor starts without a ramp. Compared with the commanded motion profile,
    the whole ramp then looks steeper. The position counts distinguish the two causes. The base
    speed is a start value for a fit: its grid is coarse, so that it has no valid uncertainty.
    """
    term = term_of_law("base_speed")
    if any(fitted_term.term.cause == term.cause for fitted_term in solution.fitted_terms):
        return named
    jumps, lead_nats = np.zeros(2), 0.0
    for axis, place in enumerate(PAN_TILT):
        if place not in named.where:
            continue
        nats = np.zeros(BASE_SPEED_GRID_RAD_S.size)
        for session in solution.sessions:
            reference = session.reference
            if isinstance(reference, PanTiltReference):
                steps_s = BASE_SPEED_GRID_RAD_S / abs(reference.rad_per_step[axis])
                nats += compare_base_speeds(reference.move_fit, axis, steps_s)
        jumps[axis], best = _parabolic_peak(nats)
        lead_nats += best
    posterior = float(1.0 / (1.0 + np.exp(np.clip(-lead_nats, -700.0, 700.0))))
    if lead_nats <= 0.0:
        one_of = (term.cause,) if 1.0 - posterior < CREDIBLE_SET_LEVEL else ()
        return replace(named, posterior=1.0 - posterior, one_of=one_of)
    return name_outside_fit(
        term,
        jumps,
        np.full(2, np.inf),
        named.where,
        statistic=named.statistic,
        degrees_of_freedom=named.degrees_of_freedom,
        p_value=named.p_value,
        posterior=posterior,
        one_of=(named.cause,) if posterior < CREDIBLE_SET_LEVEL else (),
    )


def _parabolic_peak(nats: FloatArray) -> tuple[float, float]:
    """Return the peak of the log-likelihood, and its height."""
    best = int(np.clip(np.argmax(nats), 1, nats.size - 2))
    near = slice(best - 1, best + 2)
    curvature, slope, _ = np.polyfit(BASE_SPEED_GRID_RAD_S[near], nats[near], 2)
    if curvature >= 0.0:
        return float(BASE_SPEED_GRID_RAD_S[best]), float(nats[best])
    lowest, _, highest = BASE_SPEED_GRID_RAD_S[near]
    return float(np.clip(-slope / (2.0 * curvature), lowest, highest)), float(nats.max())
