"""Sample-time jitter as a named cause: it changes the variance of a residual, not its mean.

The check names jitter if it is significant, if alternative variance models are clearly less
likely, and if low and high frequencies give the same size.

What to use when: `JitterCheck` after a search.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from gyrorig_solver.discover.cause_findings import (
    DependenceTest,
    DetectionLimit,
    SignificanceTest,
    UntestableCause,
)
from gyrorig_solver.discover.checks.jitter_estimate import JitterEstimate, estimate_jitter
from gyrorig_solver.discover.checks.model_check import JudgedModel, Verdict
from gyrorig_solver.discover.checks.residual_dependence import most_significant
from gyrorig_solver.discover.checks.specification_tests import NEGLIGIBLE_SHARE, REJECTION_LEVEL
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.named_causes import name_outside_fit
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model.causes.sample_jitter import SampleJitter

JITTER_COVARIATES = ("acceleration_scatter", "moving")  # nameless tests that show jitter


class JitterCheck:
    """Names the jitter of the sample times, or states the size that would have been detected."""

    removes_names = False

    def judge(self, model: JudgedModel[MotionFitSpace]) -> Verdict:
        """Return the named jitter, or its detection limit."""
        projector = model.result.projector
        verdict = _detect_jitter(projector, model.tests, with_motion_noise=False)
        has_motion_noise = any(
            part.relative_std is not None
            for segment in projector.segments
            for part in segment.models
        )
        if verdict.named or not has_motion_noise:
            return verdict
        # Scatter that is not jitter is noise in motion, which the fit already contains.
        return _detect_jitter(projector, model.tests, with_motion_noise=True)


def _detect_jitter(projection: NuisanceProjector, tests: int, with_motion_noise: bool) -> Verdict:
    estimate = estimate_jitter(projection, tests, with_motion_noise)
    term = SampleJitter()
    if estimate is None:
        return Verdict(untestable=(UntestableCause(term.cause, None, term.excitation),))
    p_value = min(1.0, estimate.p_value * tests)
    if p_value >= FALSE_ALARM_RATE:
        parameter = term.parameters[0]
        limit = DetectionLimit(
            term.cause,
            None,
            estimate.detectable_s,
            parameter.unit,
            parameter.typical_size,
            "time_offset",
        )
        return Verdict(detection_limits=(limit,))
    # The size of true jitter depends on no covariate.
    modulation = estimate.modulation
    if modulation is not None and _is_relevant(modulation, estimate):
        return Verdict(rejecting_tests=(modulation,))
    # A smooth function of the speed can explain the scatter that jitter does not.
    trend = estimate.remaining_trend
    if _is_relevant(trend, estimate) or not estimate.is_distinct:
        return Verdict()
    named = name_outside_fit(
        term,
        [estimate.deviation_s],
        [estimate.std_s],
        (),
        statistic=estimate.statistic,
        degrees_of_freedom=1,
        p_value=p_value,
        posterior=1.0 / (1.0 + sum(float(np.exp(nats)) for nats in estimate.rival_nats)),
    )
    return Verdict(named=(named,), explain_tests=partial(_explain_tests, trend))


def _explain_tests(
    trend: SignificanceTest, tests: Sequence[DependenceTest]
) -> list[DependenceTest]:
    """Return the dependence tests that jitter does not explain.

    `trend`: the test of the scatter with motion in addition to the jitter.
    """
    remaining = [test for test in tests if test.covariate not in JITTER_COVARIATES]
    remaining += [
        trend.on(test.covariate, test.description, len(tests))
        for test in tests
        if test.covariate == "moving"
    ]
    return most_significant(remaining)


def _is_relevant(test: DependenceTest | SignificanceTest, estimate: JitterEstimate) -> bool:
    """Return whether a test rejects a form of the scatter by more than the error of any form."""
    return test.p_value < REJECTION_LEVEL and test.excess > NEGLIGIBLE_SHARE * estimate.statistic
