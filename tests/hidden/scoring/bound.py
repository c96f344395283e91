"""What is the most that any finder could name rightly: how near the best rival comes.

Without noise a hidden cause is fitted by its own term, and by every rival of the catalogue
at its best values. What the best rival leaves of the effect, in units of the true noise, is
the non-centrality between the two stories; with noise the true one is ahead by N(l / 2, l)
nats (`Bound.chance`). Causes without a shape in the mean (jitter, a wandering bias), those counted
in the stream, and what is one line of the catalogue with its rival are left out of it; so is
what the base model takes from the unit's answers, as it does a wrong acceleration.

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
from gyrorig_solver.discover.banks import all_rows
from gyrorig_solver.discover.scores import Sight, sights
from gyrorig_solver.discover.search import best_fit, testable, tests_of
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.samples import load_samples

LEAST = 0.3  # share of the true energy that has to be left beside the base model
NEAR = 0.3  # share of an effect that a rival sees to first order, to be fitted exactly


def bound_of(case: Path, answer: Answer) -> Bound | None:
    """Compare what is hidden in a case with its best rival, None where that cannot be.

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
        projection = Projection.of(_without_noise(case))
        terms = testable(projection)
        tests = tests_of(terms)
        own = best_fit(projection, sights(projection, [term], tests, all_rows(projection, term)))
        if own is None or own[0].won < LEAST * 0.5 * hidden.noncentrality:
            return None
        others = [t for t in terms if not _one_line(t.cause, hidden.cause)]
        name, won = _best(projection, sights(projection, others, tests), own[0].won, tests)
    left = min(max(1.0 - won / own[0].won, 0.0), 1.0)
    return Bound(
        answer.seed, hidden.cause, hidden.times, answer.soak_k != 0.0, name, left,
        left * hidden.noncentrality,
    )  # fmt: skip


def _without_noise(case: Path) -> Solution:
    """Fit the base model to a case's session as it would be without noise."""
    recording = read_recording(case / RECORDING)
    (board,) = recording.board_ids
    samples = load_samples(recording, board)
    with np.load(case / RATES) as file:
        rates = np.asarray(file[f"{board}.hidden_rad_s"], dtype=np.float64)
    number = np.asarray(samples.number, dtype=np.int64)
    return fitted(recording, samples, rates[number + number_of_first(samples, rates)])


def _best(
    projection: Projection, seen: Sequence[Sight], whole: float, tests: int
) -> tuple[str, float]:
    """Return the rival that explains most, and how many nats of it."""
    name, won = "", 0.0
    by_cause: dict[str, list[Sight]] = {}
    for one in seen:
        by_cause.setdefault(one.term.cause, []).append(one)
    for cause, own in by_cause.items():
        first = 0.5 * max(one.seen.statistic for one in own)
        if first > NEAR * whole:
            term = own[0].term
            told = best_fit(
                projection, sights(projection, [term], tests, all_rows(projection, term))
            )
            first = 0.0 if told is None else told[0].won
        if first > won:
            name, won = cause, first
    return name, won


def _one_line(cause: str, hidden: str) -> bool:
    return cause == hidden or frozenset((cause, hidden)) in TWINS
