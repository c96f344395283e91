"""Tests whether a residual depends on an angle, a speed, the time or a transient.

Smooth functions of each covariate are projected orthogonally to all nuisance parameters, like a
cause. The tests use the smoothest functions first, then more detail. A significant test that no
cause explains is reported as "unexplained, depends on X". If several covariates are significant, X
is the covariate whose smooth function has the most evidence.

What to use when: `residual_dependence_tests` for all tests, `limited_dependence_tests` if the noise
is not typical, `dependences_on` for chosen functions; `variance_tests` for the variance;
`find_likelier_function` for a function that is more probable than a cause.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.discover.cause_findings import DependenceTest, SignificanceTest
from gyrorig_solver.discover.checks.basis_family import BasisFamily
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
from gyrorig_solver.discover.checks.variance_trend import fit_variance_trend, speed_shapes
from gyrorig_solver.discover.score_tests import NEGLIGIBLE_ENERGY, ScoreTest
from gyrorig_solver.estimate import NuisanceProjector, ScoreStatistics
from gyrorig_solver.model import SignalState
from gyrorig_solver.model.causes.sample_jitter import SampleJitter
from gyrorig_solver.numerics import chi2_upper_tail

ProjectorFunction = Callable[[], NuisanceProjector]

DETAIL_LIMITS = (3.0, 8.0, np.inf)  # half waves of the sets that are tested, coarse to fine
VARIANCE_TESTS = 4  # tests of the variance, which share the false alarms
EXACT_BELOW_P = 1.0  # p-value, with all tests counted, below which the exact signals are tested
REFINE_BELOW_P = 0.05  # p-value below which the test is repeated with fitted noise levels
NO_SCORE_TEST = ScoreTest(0.0, 0, np.zeros(0))
VARIANCE_GRID = np.exp(np.linspace(-4.0, 16.0, 61))  # of a smooth function, relative to the noise


def residual_dependence_tests(projection: NuisanceProjector) -> list[DependenceTest]:
    """Test whether a residual depends on each covariate; the smallest p-value first.

    Args:
        projection: the nuisance projector at the fit.
    """
    families = list(smooth_families(projection.states))
    tests = len(families) + VARIANCE_TESTS
    variances = variance_tests(projection, tests)
    return dependences_on(projection, families, tests, other_tests=variances)


def limited_dependence_tests(
    scenes: Sequence[SignalState],
    typical_projector: ProjectorFunction,
    usual_projector: ProjectorFunction,
) -> list[DependenceTest]:
    """Test a residual with typical noise levels; the smallest p-value first.

    A significant test must also be significant with the fitted levels. A projector is large, so
    that only one of them is in memory at a time.

    Args:
        scenes: all parts of all recordings that are fitted together.
        typical_projector: returns the nuisance projector at the fit with typical noise levels.
        usual_projector: the same with the fitted levels of a usual part.
    """
    families = list(smooth_families(scenes))
    tests = len(families) + VARIANCE_TESTS
    typical = _family_tests(typical_projector(), families, tests)
    projection = usual_projector()
    refined = [_refined(test, projection, family, tests) for family, test in typical]
    return most_significant([*variance_tests(projection, tests), *refined])


def dependences_on(
    projection: NuisanceProjector,
    families: Iterable[BasisFamily],
    tests: int,
    other_tests: Iterable[DependenceTest] = (),
) -> list[DependenceTest]:
    """Return the test of each covariate, the smallest p-value first.

    Args:
        projection: the nuisance projector at the fit.
        families: smooth functions of covariates.
        tests: how many share the false alarms.
        other_tests: of other covariates, to be listed with them.
    """
    of_families = _family_tests(projection, families, tests)
    return most_significant([*other_tests, *(test for _, test in of_families)])


def most_significant(tests: Iterable[DependenceTest]) -> list[DependenceTest]:
    """Return the most significant test of each covariate, the smallest p-value first.

    A covariate of single recordings, such as the time, has one test for each recording.
    """
    best: dict[tuple[str, int | None], DependenceTest] = {}
    for test in tests:
        previous = best.get(test.key)
        if previous is None or test.p_value < previous.p_value:
            best[test.key] = test
    return sorted(best.values(), key=lambda test: (test.p_value, -test.statistic))


def _family_tests(
    projection: NuisanceProjector, families: Iterable[BasisFamily], tests: int
) -> list[tuple[BasisFamily, DependenceTest]]:
    """Return the families that can be tested, each with its test."""
    tested = ((family, _dependence_test(projection, family, tests)) for family in families)
    return [(family, test) for family, test in tested if test is not None]


def _dependence_test(
    projection: NuisanceProjector, family: BasisFamily, tests: int
) -> DependenceTest | None:
    statistics = family.screen(projection) or family.statistics(projection)
    test = choose_detail(statistics, family.detail)
    if test is not None and test.p_value * tests < EXACT_BELOW_P:
        statistics = family.statistics(projection)
        test = choose_detail(statistics, family.detail)
    if test is None:
        return None
    return replace(
        test.on(family.covariate, family.description, tests),
        log_evidence=smooth_function_evidence(statistics, family.detail),
        recording_index=family.recording_index,
    )


def _refined(
    test: DependenceTest, usual_projector: NuisanceProjector, family: BasisFamily, tests: int
) -> DependenceTest:
    """Return the test with fitted noise levels if it is less significant, otherwise `test`."""
    if test.p_value >= REFINE_BELOW_P:
        return test
    usual = choose_detail(family.statistics(usual_projector), family.detail)
    if usual is None or usual.p_value * tests <= test.p_value:
        return test
    return replace(
        test,
        statistic=usual.statistic,
        degrees_of_freedom=usual.degrees_of_freedom,
        p_value=min(1.0, usual.p_value * tests),
    )


def choose_detail(
    statistics: ScoreStatistics, detail: FloatArray, nuisance_count: int = 0
) -> SignificanceTest | None:
    """Return the test at the detail with the smallest p-value; None if no signal is left.

    Each set of signals up to some detail gives a chi-squared statistic in noise. The smallest
    p-value of m sets is multiplied by m (Bonferroni). A smooth function is thus detected with few
    degrees of freedom, and a detailed function costs ln m nats more.

    Args:
        statistics: score statistics of the signals.
        detail: of each signal, half waves.
        nuisance_count: number of nuisance signals that come before these. Their statistic and their
            degrees of freedom are subtracted.
    """
    nuisances = np.arange(nuisance_count)
    nuisance_test = ScoreTest.of(statistics.subset(nuisances)) if nuisance_count else NO_SCORE_TEST
    sets = {
        int((detail <= limit).sum()): np.flatnonzero(detail <= limit) for limit in DETAIL_LIMITS
    }
    best: SignificanceTest | None = None
    for chosen in sets.values():
        if not chosen.size:
            continue
        signal_indices = np.concatenate([nuisances, nuisance_count + chosen])
        score_test = ScoreTest.of(statistics.subset(signal_indices))
        statistic = max(score_test.statistic - nuisance_test.statistic, 0.0)
        degrees = score_test.degrees_of_freedom - nuisance_test.degrees_of_freedom
        if degrees > 0:
            p_value = min(1.0, len(sets) * chi2_upper_tail(statistic, degrees))
            if best is None or p_value < best.p_value:
                best = SignificanceTest(statistic, degrees, p_value)
    return best


def smooth_function_evidence(statistics: ScoreStatistics, detail: FloatArray) -> float:
    """Return the log evidence of a smooth function against none, at its most probable size.

    The prior of the parts of the function is independent and normal. Its variance decreases with
    the square of the detail, like that of Brownian motion over an interval. The common size is that
    with the largest evidence (type II likelihood). The evidence contains the Occam factor of the
    function.

    Source: MacKay, Neural Computation 4 (1992) 415; expansion of Brownian motion: Karhunen and
    Loeve.

    Args:
        statistics: score statistics of the parts.
        detail: of each part, half waves.
    """
    strong_indices = np.flatnonzero(
        np.diag(statistics.information) > NEGLIGIBLE_ENERGY * np.maximum(statistics.energy, 1e-300)
    )
    if not strong_indices.size:
        return 0.0
    prior_width = 1.0 / (
        np.maximum(detail[strong_indices], 1.0) * np.sqrt(statistics.energy[strong_indices])
    )
    information = statistics.information[np.ix_(strong_indices, strong_indices)] * np.outer(
        prior_width, prior_width
    )
    eigenvalues, eigenvectors = np.linalg.eigh(information)
    keep = eigenvalues > NEGLIGIBLE_ENERGY
    kept_eigenvalues = eigenvalues[keep]
    explained = (
        eigenvectors[:, keep].T @ (statistics.score[strong_indices] * prior_width)
    ) ** 2 / kept_eigenvalues
    gain = VARIANCE_GRID[:, None] / float(kept_eigenvalues.max()) * kept_eigenvalues
    nats = 0.5 * np.sum(explained * gain / (1.0 + gain) - np.log1p(gain), axis=1)
    return max(0.0, float(nats.max()))


def find_likelier_function(
    projection: NuisanceProjector,
    families: Iterable[BasisFamily],
    cause_nats: float,
    needed_nats: float,
) -> DependenceTest | None:
    """Return the test that a smooth function is far more probable than a cause; None if none is.

    Its statistic and p-value are those of the odds.

    Args:
        projection: the nuisance projector at the fit without the cause.
        families: smooth functions of covariates; the first one with the needed lead is returned.
        cause_nats: the log evidence of the cause, relative to no cause.
        needed_nats: the lead in log evidence that the function needs.
    """
    for family in families:
        statistics = family.statistics(projection)
        lead_nats = smooth_function_evidence(statistics, family.detail) - cause_nats
        if lead_nats > needed_nats:
            return DependenceTest(
                family.covariate, family.description, 2.0 * lead_nats, 1, float(np.exp(-lead_nats))
            )
    return None


def variance_tests(projection: NuisanceProjector, tests: int) -> list[DependenceTest]:
    """Return the tests of the whitened residual's variance and of spectral lines.

    Args:
        projection: the nuisance projector at the fit.
        tests: how many share the false alarms.
    """
    residual = projection.orthogonal_component(projection.residual)
    results: list[DependenceTest] = []
    moving, jitter, used = _variance_shapes(projection)
    excess = residual**2 - 1.0
    for name, words, shapes in (
        ("moving", "on whether and how fast the stage moves (the scatter changes)", moving),
        ("acceleration_scatter", "on the acceleration (the scatter changes)", jitter),
    ):
        trend = fit_variance_trend(shapes[:, used], excess[used])
        if trend.degrees_of_freedom:
            results.append(trend.on(name, words, tests))
    results.append(_spectral_line_test(projection, residual, tests))
    return results


def _variance_shapes(projection: NuisanceProjector) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return motion shapes, variance by jitter and use, each for all values of the residual."""
    moving, jitter = [], []
    fastest = max(
        (float(np.linalg.norm(model.rate, axis=1).max()) for segment in projection.segments
         for model in segment.models if len(model.rate)), default=0.0
    )  # fmt: skip
    used = np.concatenate(
        [np.tile(model.used, 3) for segment in projection.segments for model in segment.models]
    )
    for scene, (segment, model, _) in zip(
        projection.states, projection.split_parts(projection.residual), strict=True
    ):
        speed = np.linalg.norm(model.rate, axis=1)
        noise_variance = np.mean(segment.noise.dct_variance(model.used.size), axis=0)
        jitter_shape = SampleJitter().added_variance(scene, np.ones(1)).T / noise_variance[:, None]
        if model.relative_std is not None:
            jitter_shape = jitter_shape / model.relative_std.values**2
        moving.append(np.tile(speed_shapes(speed, fastest), (1, 3)))
        jitter.append(jitter_shape.reshape(1, -1))
    return np.concatenate(moving, axis=1) * used, np.concatenate(jitter, axis=1), used


def _spectral_line_test(
    projection: NuisanceProjector, residual: FloatArray, tests: int
) -> DependenceTest:
    """Return the test for a single spectral line on any axis."""
    best, bin_count = (0.0, 0.0), 0
    for segment, _, white in projection.split_parts(residual):
        n = white.shape[1]
        power = np.abs(np.fft.rfft(white, axis=1)[:, 1:-1]) ** 2 / n
        bin_count += power.size
        peak = np.unravel_index(int(np.argmax(power)), power.shape)
        hertz = float(peak[1] + 1) / n * segment.noise.sampling.rate_hz
        best = max(best, (float(power[peak]), hertz))
    p_value = -np.expm1(bin_count * np.log1p(-np.exp(-best[0]))) if bin_count else 1.0
    words = f"on the time: it has a spectral line at {best[1]:.2f} Hz"
    return DependenceTest("line", words, 2.0 * best[0], 2, min(1.0, float(p_value) * tests))
