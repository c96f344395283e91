"""Upper bound on the share of right names, from the best rival of each hidden cause.

`compute_bound` fits the term of the hidden cause to a noise-free session, and also every rival of
the catalogue at its best values. The residual of the best rival, in units of the true noise, is the
non-centrality l between the two models. With noise the log-likelihood of the true cause exceeds
the rival's by N(l / 2, l) nats (`Bound.chance`). The bound leaves out causes that do not change the
mean (jitter, bias random walk), causes that are counted in the stream, and pairs that are one
entry of the catalogue. It also leaves out effects that the base model absorbs from the unit's
replies, for example a wrong acceleration.

What to use when: `compute_bound` for a case with an open answer.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tests.hidden.completeness import fit_without_noise, fix_noise
from tests.hidden.scoring.answers import RATES, RECORDING, Answer
from tests.hidden.scoring.goals import TWINS
from tests.hidden.scoring.oracle import find_first_number
from tests.hidden.scoring.possible import Bound

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.score_tests import CandidateScore, scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.discover.testable_terms import count_tests, testable_terms
from gyrorig_solver.estimate import ConvergedFit, NuisanceProjector
from gyrorig_solver.model.catalogue import catalogue

MIN_SHARE = 0.3  # minimum share of the true energy that the base model must leave
# Share of an effect that a rival must explain to first order before the exact fit.
MIN_RIVAL_SHARE = 0.3


def compute_bound(case: Path, answer: Answer) -> Bound | None:
    """Compare the hidden cause of a case with its best rival, None if this is impossible.

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
    with fix_noise():
        projection = NuisanceProjector.at_fit(_fit_without_noise(case))
        terms = testable_terms(projection)
        tests = count_tests(terms)
        own_fit = fit_best_place(
            projection, scan_catalogue(projection, [term], tests, all_templates(projection, term))
        )
        if (
            own_fit is None
            or own_fit[0].delta_log_likelihood < MIN_SHARE * 0.5 * hidden.noncentrality
        ):
            return None
        others = [t for t in terms if not _is_same_effect(t.cause, hidden.cause)]
        name, best_gain_nats = _find_best_rival(
            projection,
            scan_catalogue(projection, others, tests),
            own_fit[0].delta_log_likelihood,
            tests,
        )
    left = min(max(1.0 - best_gain_nats / own_fit[0].delta_log_likelihood, 0.0), 1.0)
    return Bound(
        answer.seed, hidden.cause, hidden.times, answer.soak_k != 0.0, name, left,
        left * hidden.noncentrality,
    )  # fmt: skip


def _fit_without_noise(case: Path) -> ConvergedFit:
    """Fit the base model to the noise-free rates of a case."""
    recording = read_recording(case / RECORDING)
    (board,) = recording.board_ids
    samples = load_samples(recording, board)
    with np.load(case / RATES) as file:
        rates = np.asarray(file[f"{board}.hidden_rad_s"], dtype=np.float64)
    number = np.asarray(samples.number, dtype=np.int64)
    return fit_without_noise(recording, samples, rates[number + find_first_number(samples, rates)])


def _find_best_rival(
    projection: NuisanceProjector,
    all_scores: Sequence[CandidateScore],
    own_gain_nats: float,
    tests: int,
) -> tuple[str, float]:
    """Return the rival with the largest log-likelihood gain, and that gain in nats."""
    name, best_gain_nats = "", 0.0
    by_cause: dict[str, list[CandidateScore]] = {}
    for score in all_scores:
        by_cause.setdefault(score.term.cause, []).append(score)
    for cause, scores in by_cause.items():
        gain_nats = 0.5 * max(score.score_test.statistic for score in scores)
        if gain_nats > MIN_RIVAL_SHARE * own_gain_nats:
            term = scores[0].term
            rival_fit = fit_best_place(
                projection,
                scan_catalogue(projection, [term], tests, all_templates(projection, term)),
            )
            gain_nats = 0.0 if rival_fit is None else rival_fit[0].delta_log_likelihood
        if gain_nats > best_gain_nats:
            name, best_gain_nats = cause, gain_nats
    return name, best_gain_nats


def _is_same_effect(cause: str, hidden: str) -> bool:
    return cause == hidden or frozenset((cause, hidden)) in TWINS
