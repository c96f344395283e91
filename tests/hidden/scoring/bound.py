"""Upper bound on the share of right names, from the best rival of each hidden cause.

A noise-free session is fitted with the term of the hidden cause, and with every rival of the
catalogue at its best values. The residual of the best rival, in units of the true noise, is the
non-centrality l between the two models. With noise the log-likelihood of the true cause exceeds
the rival's by N(l / 2, l) nats (`Bound.chance`). The bound leaves out causes that do not change the
mean (jitter, bias random walk), causes that are counted in the stream, and pairs that are one
entry of the catalogue. It also leaves out effects that the base model absorbs from the unit's
replies, for example a wrong acceleration.

What to use when: `bound_of` for a case whose answer is open.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tests.hidden.completeness import fitted, noise_held
from tests.hidden.scoring.answers import RATES, RECORDING, Answer
from tests.hidden.scoring.goals import TWINS
from tests.hidden.scoring.oracle import number_of_first
from tests.hidden.scoring.possible import Bound

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.score_tests import CandidateScore, scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.discover.testable_terms import count_tests, testable_terms
from gyrorig_solver.estimate import ConvergedFit, NuisanceProjector
from gyrorig_solver.model.catalogue import catalogue

LEAST = 0.3  # minimum share of the true energy that the base model must leave
NEAR = (
    0.3  # share of an effect that a rival must explain to first order before it is fitted exactly
)


def bound_of(case: Path, answer: Answer) -> Bound | None:
    """Compare the hidden cause of a case with its best rival, None where that is impossible.

    Args:
        case: folder, with the rates without noise.
        answer: of the case.
    """
    if len(answer.causes) != 1 or not (case / RATES).exists():
        return None
    (hidden,) = answer.causes
    term = catalogue().get(hidden.cause)
    if hidden.noncentrality is None or term is None or term.kind != "effect":
        return None
    with noise_held():
        projection = NuisanceProjector.at_fit(_without_noise(case))
        terms = testable_terms(projection)
        tests = count_tests(terms)
        own_fit = fit_best_place(
            projection, scan_catalogue(projection, [term], tests, all_templates(projection, term))
        )
        if own_fit is None or own_fit[0].delta_log_likelihood < LEAST * 0.5 * hidden.noncentrality:
            return None
        others = [t for t in terms if not _one_line(t.cause, hidden.cause)]
        name, won = _best(
            projection,
            scan_catalogue(projection, others, tests),
            own_fit[0].delta_log_likelihood,
            tests,
        )
    left = min(max(1.0 - won / own_fit[0].delta_log_likelihood, 0.0), 1.0)
    return Bound(
        answer.seed, hidden.cause, hidden.times, answer.soak_k != 0.0, name, left,
        left * hidden.noncentrality,
    )  # fmt: skip


def _without_noise(case: Path) -> ConvergedFit:
    """Fit the base model to the noise-free rates of a case."""
    recording = read_recording(case / RECORDING)
    (board,) = recording.board_ids
    samples = load_samples(recording, board)
    with np.load(case / RATES) as file:
        rates = np.asarray(file[f"{board}.hidden_rad_s"], dtype=np.float64)
    number = np.asarray(samples.number, dtype=np.int64)
    return fitted(recording, samples, rates[number + number_of_first(samples, rates)])


def _best(
    projection: NuisanceProjector, seen: Sequence[CandidateScore], whole: float, tests: int
) -> tuple[str, float]:
    """Return the rival with the largest log-likelihood gain, and that gain in nats."""
    name, won = "", 0.0
    by_cause: dict[str, list[CandidateScore]] = {}
    for score in seen:
        by_cause.setdefault(score.term.cause, []).append(score)
    for cause, scores in by_cause.items():
        first = 0.5 * max(score.score_test.statistic for score in scores)
        if first > NEAR * whole:
            term = scores[0].term
            rival_fit = fit_best_place(
                projection,
                scan_catalogue(projection, [term], tests, all_templates(projection, term)),
            )
            first = 0.0 if rival_fit is None else rival_fit[0].delta_log_likelihood
        if first > won:
            name, won = cause, first
    return name, won


def _one_line(cause: str, hidden: str) -> bool:
    return cause == hidden or frozenset((cause, hidden)) in TWINS
