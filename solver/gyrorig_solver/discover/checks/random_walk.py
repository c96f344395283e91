"""Bias random walk as a named cause, from the noise levels of a fit.

The noise levels contain the random walk, so that the residual does not show it. The check names the
walk under these conditions. An unusual walk is significantly more likely than a typical walk with
flicker of any level. No other test is significant. The bias does not follow the heat of the motors.
The bias has no jumps.

What to use when: `RandomWalkCheck` after a search. Its finding lists the other causes that are
possible, such as a step or a warm-up.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.discover.cause_findings import NamedCause, RivalCause
from gyrorig_solver.discover.cause_ranking import credible_set
from gyrorig_solver.discover.checks.model_check import (
    DEPENDENCE_FALSE_ALARM_RATE,
    JudgedModel,
    Verdict,
)
from gyrorig_solver.discover.checks.motor_heat import motor_heat_families
from gyrorig_solver.discover.checks.residual_dependence import (
    find_likelier_function,
    residual_dependence_tests,
)
from gyrorig_solver.discover.checks.specification_tests import DECISIVE_NATS
from gyrorig_solver.discover.checks.typical_noise import (
    has_typical_noise,
)
from gyrorig_solver.discover.checks.walk_profile import (
    MAX_LOG_LEVEL_SHIFT,
    profile_common_walks,
)
from gyrorig_solver.discover.fit_space import NoiseAlternative
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.named_causes import name_outside_fit
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE
from gyrorig_solver.estimate import (
    ConvergedFit,
)
from gyrorig_solver.model import XYZ
from gyrorig_solver.model.causes.bias_random_walk import BiasRandomWalk
from gyrorig_solver.numerics import chi2_upper_tail

ACTING_NATS = 4.5  # gain of an axis on which the walk acts: three standard deviations
JUMP_AVERAGING_S = (1.0, 2.0, 4.0)  # so long that white noise does not hide a jump
JUMP_KURTOSIS_SIGMA = 3.5
MIN_MEANS = 20  # the kurtosis needs more means than these


class RandomWalkCheck:
    """Names a random walk of the bias if nothing else is significant in addition to it."""

    removes_names = False

    def judge(self, model: JudgedModel[MotionFitSpace]) -> Verdict:
        """Return the named walk, and the tests of the residual with noise levels that contain it.

        If the residual still depends on another covariate, the walk is not named.
        """
        solution = model.space.solution
        walk = detect_random_walk(solution, model.tests, model.result.noise_alternatives)
        if walk is None:
            return Verdict()
        projector = model.space.projector()
        # The noise levels contain the walk. If the bias still follows the motors' heat, it has no
        # random walk.
        heat_families = motor_heat_families(projector.states)
        heat = find_likelier_function(projector, heat_families, 0.0, DECISIVE_NATS)
        if heat is not None:
            return Verdict(rejecting_tests=(heat,))
        tests = residual_dependence_tests(projector)
        if any(test.p_value < DEPENDENCE_FALSE_ALARM_RATE for test in tests):
            return Verdict()
        return Verdict(named=(walk,), dependence_tests=tuple(tests))


def detect_random_walk(
    solution: ConvergedFit,
    tests: int,
    noise_alternatives: Sequence[NoiseAlternative] = (),
) -> NamedCause | None:
    """Return a bias random walk as a named cause; None if it is typical or the bias has jumps.

    Args:
        solution: the last fit of a search.
        tests: how many share the false alarms.
        noise_alternatives: causes that are significant with typical noise levels only.
    """
    if has_typical_noise(solution):
        return None
    walk = profile_common_walks(solution)
    axis_gains = np.array([profile.gain_nats for profile in walk])
    gain = float(axis_gains.sum())
    if _residual_has_jumps(solution, axis_gains > ACTING_NATS):
        return None
    p_value = min(1.0, chi2_upper_tail(2.0 * gain, float(np.sum(axis_gains > 0.0))) * tests)
    if p_value >= FALSE_ALARM_RATE:
        return None
    shares = [
        float(np.exp(min(profile.log_evidence, MAX_LOG_LEVEL_SHIFT)))
        for profile in noise_alternatives
    ]
    posterior = 1.0 / (1.0 + sum(shares))
    rivals = [
        _describe_rival(alternative, share, posterior)
        for alternative, share in sorted(
            zip(noise_alternatives, shares, strict=True), key=lambda pair: -pair[1]
        )
    ]
    acting = np.flatnonzero((axis_gains > ACTING_NATS) | (axis_gains == axis_gains.max()))
    levels, levels_std = np.array([profile.posterior_level() for profile in walk]).T
    return name_outside_fit(
        BiasRandomWalk(),
        levels,
        levels_std,
        tuple(XYZ[k] for k in acting),
        statistic=2.0 * gain,
        degrees_of_freedom=int(np.sum(axis_gains > 0.0)),
        p_value=p_value,
        posterior=posterior,
        one_of=credible_set(posterior, ((rival.cause, rival.posterior) for rival in rivals)),
        rivals=tuple(rivals),
    )


def has_jumps(signal: FloatArray, rate_hz: float) -> bool:
    """Return whether a signal has jumps, by the kurtosis of the differences of its means.

    For n normal differences, the kurtosis has the standard deviation sqrt(24/n) (Kendall and
    Stuart, The Advanced Theory of Statistics, volume 1).

    Args:
        signal: shape (n, k).
        rate_hz: sampling rate of the signal.
    """
    for mean_s in JUMP_AVERAGING_S:
        block = max(1, round(mean_s * rate_hz))
        whole = len(signal) // block
        if whole <= MIN_MEANS:
            continue
        mean = signal[: whole * block].reshape(whole, block, -1).mean(axis=1)
        step = np.diff(mean, axis=0)
        unit = (step - step.mean(axis=0)) / np.maximum(step.std(axis=0), 1e-30)
        kurtosis = np.mean(unit**4, axis=0) - 3.0
        if np.any(kurtosis > JUMP_KURTOSIS_SIGMA * np.sqrt(24.0 / len(step))):
            return True
    return False


def _residual_has_jumps(solution: ConvergedFit, axes: BoolArray) -> bool:
    return any(
        has_jumps(np.where(used[:, None], residual, 0.0)[:, axes], session.sampling.rate_hz)
        for session in solution.sessions
        for residual, used in zip(session.residuals(solution.gain), session.used, strict=True)
    )


def _describe_rival(alternative: NoiseAlternative, share: float, posterior: float) -> RivalCause:
    return RivalCause(
        alternative.candidate.extension.term.cause,
        alternative.likelihood_gain_nats,
        share * posterior,
        "a model with this cause still needs a random walk of the bias"
        if share < 1.0
        else "the alternative fits as well",
    )
