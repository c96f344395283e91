"""Sample-time jitter as a named cause: it shows in the variance of a residual, not in its mean.

Jitter is named if it is significant, if alternative variance models are clearly less likely, and
if low and high frequencies agree on its size.

What to use when: `detect_jitter` for the last fit of a search; `describe_random_walk` for a text.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.discover.cause_findings import (
    DependenceTest,
    DetectionLimit,
    FittedValue,
    NamedCause,
)
from gyrorig_solver.discover.checks.jitter_estimate import JitterEstimate, estimate_jitter
from gyrorig_solver.discover.checks.specification_tests import NEGLIGIBLE_SHARE, REJECTION_LEVEL
from gyrorig_solver.discover.checks.variance_trend import NO_TREND, VarianceTrendTest
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.noise.noise_model import nominal_levels
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector
from gyrorig_solver.model.causes.sample_jitter import SampleJitter
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

JITTER_COVARIATES = ("acceleration_scatter", "moving")  # nameless tests that show jitter
DETECTION_POWER = 0.8  # of what is called detectable


@dataclass(frozen=True, slots=True, eq=False)
class JitterResult:
    """The result for sample-time jitter: a named cause, or its detection limit."""

    named: NamedCause | None
    detection_limit: DetectionLimit | None
    remaining_trend: (
        VarianceTrendTest  # whether the scatter grows with motion, and how fast, in addition to it
    )
    rejecting_tests: tuple[
        DependenceTest, ...
    ] = ()  # what speaks against its name, where it would have one

    def unexplained_tests(self, tests: Sequence[DependenceTest]) -> list[DependenceTest]:
        """Return the dependence tests that a named jitter does not explain."""
        if self.named is None:
            return list(tests)
        other_tests = [test for test in tests if test.covariate not in JITTER_COVARIATES]
        moving = [
            replace(
                test,
                statistic=self.remaining_trend.statistic,
                degrees_of_freedom=self.remaining_trend.degrees_of_freedom,
                p_value=min(1.0, self.remaining_trend.p_value * len(tests)),
            )
            for test in tests
            if test.covariate == "moving"
        ]
        return sorted([*other_tests, *moving], key=lambda test: (test.p_value, -test.statistic))


def detect_jitter(projection: NuisanceProjector, tests: int, alpha: float) -> JitterResult:
    """Return the jitter of the sample times as a named cause, or its detection limit.

    Args:
        projection: the nuisance projector at the last fit.
        tests: how many share the false alarms.
        alpha: rate of false alarms of all of them.
    """
    result = _detect_jitter(projection, tests, alpha, with_motion_noise=False)
    has_motion_noise = any(
        model.relative_std is not None
        for segment in projection.segments
        for model in segment.models
    )
    if result.named is not None or not has_motion_noise:
        return result
    # Scatter that is no jitter is noise in motion, which the fit has already.
    return _detect_jitter(projection, tests, alpha, with_motion_noise=True)


def _detect_jitter(
    projection: NuisanceProjector, tests: int, alpha: float, with_motion_noise: bool
) -> JitterResult:
    estimate = estimate_jitter(projection, tests, alpha, DETECTION_POWER, with_motion_noise)
    if estimate is None:
        return JitterResult(None, None, NO_TREND)
    term = SampleJitter()
    parameter = term.parameters[0]
    p_value = min(1.0, estimate.p_value * tests)
    # A smooth function of the speed can explain the scatter that jitter does not.
    trend_excess = estimate.remaining_trend.statistic - estimate.remaining_trend.degrees_of_freedom
    has_trend = (
        estimate.remaining_trend.p_value < REJECTION_LEVEL
        and trend_excess > NEGLIGIBLE_SHARE * estimate.statistic
    )
    if p_value < alpha and (dependence := _find_dependence(estimate)) is not None:
        return JitterResult(None, None, NO_TREND, (dependence,))
    if p_value >= alpha or has_trend or not estimate.is_distinct:
        size = estimate.detectable_s
        limit = DetectionLimit(
            term.cause, None, size, parameter.unit, parameter.typical_size, "time_offset", 0.0
        )
        return JitterResult(None, limit if p_value >= alpha else None, NO_TREND)
    values = np.array([estimate.deviation_s])
    cause = NamedCause(
        term=term,
        where=(),
        extension=FittedTerm(term, values, np.zeros(0, dtype=np.int64)),
        values=(
            FittedValue(
                parameter.name,
                estimate.deviation_s,
                estimate.std_s,
                parameter.unit,
                parameter.typical_size,
            ),
        ),
        statistic=estimate.statistic,
        degrees_of_freedom=1,
        p_value=p_value,
        posterior=1.0 / (1.0 + sum(float(np.exp(nats)) for _, nats in estimate.rivals)),
        one_of=(),
        rivals=(),
        changes=(),  # it moves no mean: what it spoils are the weights
        gain=None,
    )
    return JitterResult(cause, None, estimate.remaining_trend)


def _find_dependence(estimate: JitterEstimate) -> DependenceTest | None:
    """Return a covariate on which the jitter's size depends, though it must not; None for none."""
    modulation = estimate.modulation
    if modulation is None or modulation.p_value >= REJECTION_LEVEL:
        return None
    if (
        modulation.statistic - modulation.degrees_of_freedom
        <= NEGLIGIBLE_SHARE * estimate.statistic
    ):
        return None
    return DependenceTest(
        modulation.covariate,
        modulation.description,
        modulation.statistic,
        modulation.degrees_of_freedom,
        modulation.p_value,
    )


def describe_random_walk(projection: NuisanceProjector) -> str:
    """Describe each axis' bias random walk, compared with that of a typical part."""
    levels = np.mean([segment.noise.levels for segment in projection.segments], axis=0)
    axis_levels = np.sqrt(levels[:, 2])
    typical = np.sqrt([nominal_levels(float(white))[2] for white in levels[:, 0]])
    ratio = format_list(axis_levels / typical, XYZ, "times that of a typical sensor")
    return (
        "the noise model and all uncertainties include the random walk: "
        f"{format_list(axis_levels / DEG, XYZ, 'deg/s after one second')}, {ratio}"
    )
