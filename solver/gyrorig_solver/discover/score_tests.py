"""Score tests of every cause of the catalogue on a residual.

The tangent signals of each template of a cause are whitened and projected orthogonally to all
nuisance parameters. With score s and information A, the statistic T = s' A^-1 s of noise is
chi-squared with one degree of freedom per size. The p-value of the best template is multiplied by
the effective number of independent templates (Galwey, Genet. Epidemiol. 33 (2009) 559) and by the
number of tests of the catalogue. A cause that changes the motion law is tested under its own law,
with the position replies and the moves that follow them.

What to use when: `scan_catalogue` in each iteration of a search; `ScoreTest.of` for any signals.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover.template_choice import quick_templates
from gyrorig_solver.estimate import LawStatistics, NuisanceProjector, ScoreStatistics
from gyrorig_solver.model import Term, components_of, value_indices, value_parameters
from gyrorig_solver.numerics import chi2_noncentrality, chi2_quantile, chi2_upper_tail

# Share of recordings without any cause in which the search may name a cause. The tests overlap: 157
# such recordings had three quarters of the false names that the sum of the tests allows. The rest
# of 1 % is for the dependence tests, which need to detect only large effects without a known cause.
FALSE_ALARM_RATE = 0.0075
DETECTION_POWER = 0.8  # power of a test at the smallest detectable size
NEGLIGIBLE_ENERGY = 1e-9  # share of a signal's energy; the fit absorbs a signal with less left
# Signals of one cause that are tested together, so that their correlation counts.
MAX_JOINT_SIGNALS = 48
SIGNALS_PER_BATCH = 24  # signals that are whitened together; more are not faster
MAX_SIGNAL_VALUES = 4_000_000  # of signals that are whitened together, to limit the memory
MAX_SEPARATE_PLACES = 3  # causes with more parts are tested only with all parts together


@cache
def detection_noncentrality(degrees_of_freedom: int, test_count: int) -> float:
    """Return the non-centrality at which a chi-squared test has the power `DETECTION_POWER`.

    Args:
        degrees_of_freedom: of the statistic.
        test_count: tests that share the false alarms (Bonferroni).
    """
    return chi2_noncentrality(
        chi2_quantile(FALSE_ALARM_RATE / test_count, degrees_of_freedom),
        degrees_of_freedom,
        DETECTION_POWER,
    )


@dataclass(frozen=True, slots=True, eq=False)
class ScoreTest:
    """A score test of one or more signals: statistic, degrees of freedom, one-step estimate."""

    statistic: float
    degrees_of_freedom: int
    one_step_sizes: FloatArray  # (d,), the best sizes of the signals to first order

    @property
    def excess(self) -> float:
        """The statistic minus its mean in noise."""
        return self.statistic - self.degrees_of_freedom

    @classmethod
    def of(cls, statistics: ScoreStatistics) -> "ScoreTest":
        """Return the test of signals, without those that the fit absorbs."""
        if statistics.score.size == 1:
            return cls._of_single_signal(statistics)
        energy = np.diag(statistics.information)
        is_strong = energy > NEGLIGIBLE_ENERGY * np.maximum(statistics.energy, 1e-300)
        values = np.zeros(energy.size)
        if not is_strong.any():
            return cls(0.0, 0, values)
        scale = np.sqrt(energy[is_strong])
        correlation = statistics.information[np.ix_(is_strong, is_strong)] / np.outer(scale, scale)
        eigenvalues, eigenvectors = np.linalg.eigh(correlation)
        keep = eigenvalues > 1e-7
        score = eigenvectors.T @ (statistics.score[is_strong] / scale)
        values[is_strong] = eigenvectors[:, keep] @ (score[keep] / eigenvalues[keep]) / scale
        statistic = float(np.sum(score[keep] ** 2 / eigenvalues[keep]))
        return cls(statistic, int(keep.sum()), values)

    @classmethod
    def _of_single_signal(cls, statistics: ScoreStatistics) -> "ScoreTest":
        energy, score = float(statistics.information[0, 0]), float(statistics.score[0])
        if energy <= NEGLIGIBLE_ENERGY * max(float(statistics.energy[0]), 1e-300):
            return cls(0.0, 0, np.zeros(1))
        return cls(score * score / energy, 1, np.array([score / energy]))


@dataclass(frozen=True, slots=True, eq=False)
class DetectableSize:
    """The detectable size of one template, in typical sizes."""

    template_size: float  # of the template; 0 if the effect is taken as linear
    detectable: float  # in the direction with the least information; inf without information
    parameter_shift: FloatArray  # (board,), bias of the fit's parameters by this size


@dataclass(frozen=True, slots=True, eq=False)
class CandidateScore:
    """The score of a cause at one place or at all places, with its best template."""

    term: Term
    place: str | None
    template: FloatArray  # (k,)
    score_test: ScoreTest
    effective_trials: float  # effective number of independent templates
    p_value: float  # with all templates and tests counted
    detectable_sizes: tuple[DetectableSize, ...]  # of every template

    @property
    def detectable_size(self) -> DetectableSize:
        """The size of the smallest detected template; for linear effects, the median size.

        If even the largest template is not detected, `detectable` is infinite.
        """
        if self.detectable_sizes[0].template_size > 0.0:
            sizes = sorted(self.detectable_sizes, key=lambda size: size.template_size)
            detected = [size for size in sizes if size.template_size >= size.detectable]
            if detected:
                return replace(detected[0], detectable=detected[0].template_size)
            return replace(sizes[-1], detectable=np.inf)
        sizes = sorted(self.detectable_sizes, key=lambda size: size.detectable)
        # A lost step has no effect while its axis is at rest: such templates have no information.
        sizes = [size for size in sizes if np.isfinite(size.detectable)] or sizes
        return sizes[(len(sizes) - 1) // 2]


def scan_catalogue(
    projection: NuisanceProjector,
    terms: Iterable[Term],
    tests: int,
    templates: tuple[FloatArray, int] | None = None,
) -> list[CandidateScore]:
    """Return the best score of each cause at each place, the smallest p-value first.

    Args:
        projection: the nuisance projector at the fit.
        terms: the causes to test.
        tests: how many share the false alarms.
        templates: for a single cause, the rows of its bank that are tested instead, and the number
            of scanned rows, from which they were chosen.
    """
    scores: list[CandidateScore] = []
    for term in terms:
        law = projection.law_statistics(term)
        if law is not None:
            scores += _score_law_term(term, law, tests)
            continue
        chosen, scanned = templates or quick_templates(projection, term)
        scores += _scan_term(projection, term, chosen, scanned, tests)
    return sorted(scores, key=lambda score: (score.p_value, -score.score_test.statistic))


def testable_places(term: Term) -> list[tuple[str | None, list[int]]]:
    """Return each place of a cause with its sizes; the place None is all places together."""
    sizes = value_indices(term, role="size")
    testable: list[tuple[str | None, list[int]]] = [(None, list(range(len(sizes))))]
    parts = components_of(term)
    if 1 < len(parts) <= MAX_SEPARATE_PLACES:
        for part in parts:
            part_sizes = value_indices(term, part, "size")
            testable.append((part, [sizes.index(k) for k in part_sizes]))
    return testable


@dataclass(frozen=True, slots=True, eq=False)
class _TestPlace:
    """One place of a cause, and the non-centrality that the test needs to detect it there."""

    place: str | None
    positions: IntArray  # of its sizes among the sizes of the cause
    size_indices: IntArray  # of its sizes among all values of the cause
    typical: FloatArray
    noncentrality: float

    @classmethod
    def of(
        cls, term: Term, place: str | None, positions: Sequence[int], tests: int
    ) -> "_TestPlace":
        """Return a place; `positions`: its sizes; `tests`: how many share the false alarms."""
        parameters, all_sizes = value_parameters(term), value_indices(term, role="size")
        sizes = np.array([all_sizes[k] for k in positions], dtype=np.int64)
        typical = np.array([parameters[k].typical_size for k in sizes])
        required = detection_noncentrality(len(positions), tests)
        return cls(place, np.array(positions, dtype=np.int64), sizes, typical, required)

    def detectable_size(self, template: FloatArray, statistics: ScoreStatistics) -> DetectableSize:
        """Return the detectable size of a template at this place."""
        typical = self.typical
        size = float(np.max(np.abs(template[self.size_indices]) / typical))
        if typical.size == 1:
            least_information, direction = (
                float(statistics.information[0, 0] * typical[0] ** 2),
                typical,
            )
        else:
            values, vectors = np.linalg.eigh(statistics.information * np.outer(typical, typical))
            least_information, direction = float(values[0]), vectors[:, 0] * typical
        if least_information <= NEGLIGIBLE_ENERGY * float(np.max(statistics.energy * typical**2)):
            return DetectableSize(size, np.inf, statistics.absorbed.T @ direction)
        detectable = float(np.sqrt(self.noncentrality / least_information))
        return DetectableSize(size, detectable, statistics.absorbed.T @ (direction * detectable))


def _scan_term(
    projection: NuisanceProjector, term: Term, templates: FloatArray, scanned: int, tests: int
) -> list[CandidateScore]:
    test_places = [
        _TestPlace.of(term, place, at, tests * max(scanned, 1))
        for place, at in testable_places(term)
    ]
    best: dict[str | None, tuple[FloatArray, ScoreTest]] = {}
    sizes: dict[str | None, list[DetectableSize]] = {
        test_place.place: [] for test_place in test_places
    }
    count_trials = (
        1 < len(templates) == scanned
        and len(templates) * test_places[0].positions.size <= MAX_JOINT_SIGNALS
    )
    effective_trials = float(max(scanned, 1))
    for batch, statistics in score_batches(projection, term, templates, count_trials):
        size = statistics.score.size // len(batch)
        if count_trials:
            effective_trials = _count_effective_trials(statistics.information, size)
        for k, template in enumerate(batch):
            for test_place in test_places:
                part = statistics.subset(k * size + test_place.positions)
                test = ScoreTest.of(part)
                sizes[test_place.place].append(test_place.detectable_size(template, part))
                if (
                    test_place.place not in best
                    or test.statistic > best[test_place.place][1].statistic
                ):
                    best[test_place.place] = template, test
    scores = []
    for place, (template, test) in best.items():
        if test.degrees_of_freedom:
            local_p_value = chi2_upper_tail(test.statistic, test.degrees_of_freedom)
            p_value = min(1.0, local_p_value * effective_trials * tests)
            scores.append(
                CandidateScore(
                    term, place, template, test, effective_trials, p_value, tuple(sizes[place])
                )
            )
    return scores


def _score_law_term(term: Term, law: LawStatistics, tests: int) -> list[CandidateScore]:
    """Return the scores of a cause that changes the motion law, at each of its places.

    If the law is far from that of the fit, the effect on the samples has another form than near it.
    The test of samples and replies together can then have less power than that of the replies.

    Args:
        term: the cause.
        law: statistics of its values, under its own law.
        tests: how many share the false alarms.
    """
    parameters = value_parameters(term)
    scores = []
    for place, positions in testable_places(term):
        test_place = _TestPlace.of(term, place, positions, tests)
        part = law.subset(test_place.positions)
        lower = np.array([parameters[k].lower for k in test_place.size_indices])
        p_value, test = min(
            (_test_within_range(statistics, lower) for statistics in (part.together, part.replies)),
            key=lambda result: result[0],
        )
        template = np.zeros(len(parameters))
        template[test_place.size_indices] = part.scale.changes(test.one_step_sizes)
        detectable = test_place.detectable_size(np.zeros(len(parameters)), part.together)
        if np.isfinite(detectable.detectable):
            first_order = detectable.detectable * test_place.typical
            sizes = part.scale.changes(first_order) / test_place.typical
            detectable = replace(detectable, detectable=float(sizes.max()))
        # Two tests were made, so the smaller p-value is doubled.
        p_value = min(1.0, 2.0 * p_value * tests)
        scores.append(CandidateScore(term, place, template, test, 2.0, p_value, (detectable,)))
    return scores


def _test_within_range(statistics: ScoreStatistics, lower: FloatArray) -> tuple[float, ScoreTest]:
    """Return the local p-value of a test, and the test.

    If a size is below its lower bound of zero, the p-value is 1 and the statistic 0.

    Args:
        statistics: of the sizes, (d,).
        lower: their lower bounds, (d,).
    """
    test = ScoreTest.of(statistics)
    if not test.degrees_of_freedom or np.any((lower == 0.0) & (test.one_step_sizes < 0.0)):
        return 1.0, replace(test, statistic=0.0)
    return chi2_upper_tail(test.statistic, test.degrees_of_freedom), test


def score_batches(
    projection: NuisanceProjector, term: Term, templates: FloatArray, at_once: bool = False
) -> Iterator[tuple[list[FloatArray], ScoreStatistics]]:
    """Yield templates with their score statistics, several at a time for speed.

    `at_once`: all templates in one batch.
    """
    sizes = len(value_indices(term, role="size"))
    together = min(SIGNALS_PER_BATCH, MAX_SIGNAL_VALUES // projection.residual.size) // sizes
    count = len(templates) if at_once else max(1, together)
    for first in range(0, len(templates), count):
        batch = list(templates[first : first + count])
        signals = projection.evaluate_together(
            [partial(term.tangent_signals, values=template) for template in batch],
            sizes * len(batch),
            term,
        )
        yield batch, projection.score_statistics(signals)


def _count_effective_trials(information: FloatArray, sizes: int) -> float:
    """Return the effective number of independent templates (Galwey), the largest over the sizes.

    Args:
        information: of the signals of all templates, in the order of the templates.
        sizes: number of signals of a template.
    """
    trials = []
    for k in range(sizes):
        block = information[k::sizes, k::sizes]
        energy = np.diag(block)
        is_strong = energy > 1e-12 * max(float(energy.max()), 1e-300)
        if is_strong.sum() < 2:
            trials.append(1.0)
            continue
        scale = np.sqrt(energy[is_strong])
        correlation = block[np.ix_(is_strong, is_strong)] / np.outer(scale, scale)
        eigenvalues = np.clip(np.linalg.eigvalsh(correlation), 0.0, None)
        trials.append(float(np.sum(np.sqrt(eigenvalues)) ** 2 / np.sum(eigenvalues)))
    return max(trials, default=1.0)
