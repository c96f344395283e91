"""Each cause of a fit compared with its alternatives, with all other causes fitted.

What to use when: `ranking_memory` in a search; `rank_causes` for all causes of a fit,
`rank_against_alternatives` for one cause.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.candidate_fits import fit_leading, fitted_place
from gyrorig_solver.discover.cause_findings import RivalCause
from gyrorig_solver.discover.exact_fit import FittedCandidate, fit_candidate
from gyrorig_solver.discover.extended_fit import extend_fit
from gyrorig_solver.discover.fit_space import FitSpace, Space
from gyrorig_solver.discover.law_candidates import fit_law_cause, judge_law_cause
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE, scan_catalogue
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model import Term, recording_index_of, term_label

CREDIBLE_SET_LEVEL = 0.95  # probability that the stated set contains the cause
# Prior probability that an effect in several recordings of one board has the same cause in each.
SAME_CAUSE_BELIEF = 0.95
MIN_EVIDENCE_LEAD_NATS = 1.0  # lead in log evidence by which a rival replaces a cause
# Share of a cause's statistic that its form may leave unexplained: twice the 0.2 % that were
# measured on sessions without noise.
MODEL_ERROR_SHARE = 0.004
IRRELEVANT_SHARE = 1e-3  # a rival with a smaller posterior probability is not fitted
# Upper bound on the gain of a motion law, relative to the first-order gain of its score test. It
# holds if the law is not significant in addition to the named cause.
FIRST_ORDER_FACTOR = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class RankedCause:
    """A fitted cause with its ranked alternatives, with all other causes fitted."""

    candidate: FittedCandidate
    effective_trials: float
    rivals: tuple[tuple[FittedCandidate, float], ...]  # other causes, with posterior probabilities
    posterior: float
    board_gain_nats: float | None = None  # gain on this board alone; None: no other board shares it
    # Log prior of the cause and of each rival, from the other recordings; () without this prior.
    other_recordings_nats: tuple[float, ...] = ()

    def with_gain_limit(self, gains_by_label: Mapping[str, float]) -> "RankedCause":
        """Return the ranking with at most the gain that a refit without the cause confirms."""
        nats = gains_by_label.get(term_label(self.candidate.extension.term), np.inf)
        return (
            self
            if nats >= self.candidate.delta_log_likelihood
            else replace(self, candidate=replace(self.candidate, delta_log_likelihood=nats))
        )

    def lead_nats(self, rival: int) -> float:
        """Return the log evidence of a rival minus that of the cause, with all recordings."""
        nats = self.rivals[rival][0].log_evidence - self.candidate.log_evidence
        if self.other_recordings_nats:
            nats += self.other_recordings_nats[1 + rival] - self.other_recordings_nats[0]
        return nats

    @property
    def one_of(self) -> tuple[str, ...]:
        """The other causes of the credible set."""
        rivals = ((rival.extension.term.cause, share) for rival, share in self.rivals)
        names = credible_set(self.posterior, rivals)
        equivalent = self.candidate.extension.term.equivalent_causes
        return (*names, *(name for name in equivalent if name not in names))

    @property
    def shares(self) -> tuple[tuple[FittedCandidate, float], ...]:
        """The cause and its rivals with their posterior probabilities."""
        return ((self.candidate, self.posterior), *self.rivals)

    @property
    def statistic(self) -> float:
        """Twice the gain of the log-likelihood on the data of this board."""
        nats = self.board_gain_nats
        return 2.0 * max(self.candidate.delta_log_likelihood if nats is None else nats, 0.0)

    def describe_rivals(self) -> tuple[RivalCause, ...]:
        """Return the rejected alternatives, each with the reason."""
        named = self.candidate
        return tuple(
            RivalCause(
                rival.extension.term.cause,
                rival.delta_log_likelihood - named.delta_log_likelihood,
                posterior,
                _rejection_reason(
                    rival.delta_log_likelihood - named.delta_log_likelihood,
                    rival.log_evidence - named.log_evidence,
                    self.lead_nats(k),
                ),
            )
            for k, (rival, posterior) in enumerate(self.rivals)
        )


def credible_set(posterior: float, rivals: Iterable[tuple[str, float]]) -> tuple[str, ...]:
    """Return the most probable rivals that complete the credible set of a cause.

    Args:
        posterior: probability of the cause.
        rivals: other causes with their probabilities, the most probable first.
    """
    names, total = [], posterior
    for cause, share in rivals:
        if total >= CREDIBLE_SET_LEVEL:
            break
        names.append(cause)
        total += share
    return tuple(names)


def nats_for_sole_name(gain_nats: float) -> float:
    """Return the lead in log evidence over one rival that makes a cause the only name.

    Args:
        gain_nats: gain of the log-likelihood by the cause.
    """
    odds = CREDIBLE_SET_LEVEL / (1.0 - CREDIBLE_SET_LEVEL)
    return float(np.log(odds) * np.hypot(1.0, MODEL_ERROR_SHARE * gain_nats))


def _rejection_reason(
    delta_log_likelihood: float, delta_log_evidence: float, lead_nats: float
) -> str:
    if lead_nats < min(0.0, delta_log_evidence - 1.0):
        return "another recording of the same board shows the named cause, and not the alternative"
    if delta_log_evidence > 0.0:
        return "the alternative fits as well; the data cannot distinguish the two causes"
    if delta_log_likelihood > -1.0:
        return "the alternative fits as well, but with more parameters or an improbable size"
    return (
        f"the best fit of the alternative leaves {-delta_log_likelihood:.1f} nats of "
        "log-likelihood unexplained"
    )


def rank_causes(
    space: Space,
    terms: Sequence[Term],
    tests: int,
    considered: Mapping[str, Set[str]],
    may_fit_laws: Callable[[], bool],
) -> tuple[RankedCause, ...]:
    """Rank each cause of a fit against its alternatives.

    Args:
        space: the fit at the end of a search.
        terms: the testable causes.
        tests: how many share the false alarms.
        considered: by label, the causes that were compared with a cause when it was found.
        may_fit_laws: whether the effort allows further fits of alternatives that change the law.
    """
    ranked_causes: list[RankedCause] = []
    shows_beside = _significance_beside(space, tests)
    for k in space.free_causes:
        term = space.fitted_terms[k].term
        label = term_label(term)
        labels = considered.get(label, set()) | confusable_labels(term, terms)
        candidates = [
            term,
            *(other for other in terms if term_label(other) in labels - {label}),
        ]
        ranked_causes.append(
            rank_against_alternatives(space, k, candidates, tests, shows_beside, may_fit_laws)
        )
    return tuple(_with_other_recordings(ranked, ranked_causes) for ranked in ranked_causes)


def swap_leading_rival(space: Space, ranked_causes: Sequence[RankedCause]) -> Space | None:
    """Return the fit with the first better alternative in place of a cause; None without one."""
    for k, ranked in zip(space.free_causes, ranked_causes, strict=True):
        if ranked.rivals and ranked.lead_nats(0) > MIN_EVIDENCE_LEAD_NATS:
            without = space.refit(space.terms_without(k))
            return extend_fit(without, ranked.rivals[0][0].extension)
    return None


def _with_other_recordings(ranked: RankedCause, all_ranked: Sequence[RankedCause]) -> RankedCause:
    """Return the ranking of a cause of one recording, with a prior from the other recordings.

    Each recording has its own values of such a cause. But one board rarely has two different causes
    with the same effect. A posterior probability p in another recording gives the prior
    b p + (1 - b) / n, with b = `SAME_CAUSE_BELIEF` and n compared causes.
    """
    number = recording_index_of(ranked.candidate.extension.term)
    if number is None:
        return ranked
    causes = [candidate.extension.term.cause for candidate, _ in ranked.shares]
    prior = np.ones(len(causes))
    others: dict[int, list[FloatArray]] = {}
    for other in all_ranked:
        other_number = recording_index_of(other.candidate.extension.term)
        if other_number is None or other_number == number:
            continue
        shares = {candidate.extension.term.cause: share for candidate, share in other.shares}
        others.setdefault(other_number, []).append(
            np.array([shares.get(cause, 0.0) for cause in causes])
        )
    shares_here = np.array([share for _, share in ranked.shares])
    for posteriors in others.values():
        likest = max(posteriors, key=lambda shares: float(shares @ shares_here))
        if float(likest @ shares_here) > 0.0:
            prior *= SAME_CAUSE_BELIEF * likest + (1.0 - SAME_CAUSE_BELIEF) / len(causes)
    if np.all(prior == 1.0):
        return ranked
    belief = shares_here * prior / float(shares_here @ prior)
    nats = np.log(prior)
    order = np.argsort(-belief[1:], kind="stable")
    return replace(
        ranked,
        posterior=float(belief[0]),
        rivals=tuple((ranked.rivals[k][0], float(belief[1 + k])) for k in order),
        other_recordings_nats=(float(nats[0]), *(float(nats[1 + k]) for k in order)),
    )


def _significance_beside(space: FitSpace, tests: int) -> Callable[[Term], bool]:
    """Return a function that tests whether a cause is significant in addition to those of a fit."""
    projectors: list[NuisanceProjector] = []
    answers: dict[str, bool] = {}

    def shows_beside(term: Term) -> bool:
        label = term_label(term)
        if label not in answers:
            if not projectors:
                projectors.append(space.projector())
            scores = scan_catalogue(projectors[0], [term], tests)
            answers[label] = any(score.p_value < FALSE_ALARM_RATE for score in scores)
        return answers[label]

    return shows_beside


def confusable_labels(term: Term, terms: Sequence[Term]) -> set[str]:
    """Return the labels of the causes that are confusable with a cause."""
    recording = recording_index_of(term)
    return {
        term_label(other_term)
        for other_term in terms
        if (other_term.cause in term.confused_with or term.cause in other_term.confused_with)
        and (recording is None or recording_index_of(other_term) in (None, recording))
    }


def rank_against_alternatives(
    space: Space,
    k: int,
    terms: Sequence[Term],
    tests: int,
    shows_beside: Callable[[Term], bool] = lambda _: True,
    may_fit_laws: Callable[[], bool] = lambda: True,
) -> RankedCause:
    """Rank one cause of a fit against the alternatives in its place.

    An alternative that changes the motion law needs a separate fit. The fit is omitted if the
    alternative cannot be a rival: the gain of its score test is small, and it is not significant in
    addition to the named cause.

    Args:
        space: the fit.
        k: index of the cause in the fit.
        terms: the alternatives, and the cause itself.
        tests: how many share the false alarms.
        shows_beside: whether a cause is significant in addition to all causes of the fit.
        may_fit_laws: whether the effort allows further fits of alternatives that change the law.
    """
    extension = space.fitted_terms[k]
    others = space.terms_without(k)
    changes_law = space.changes_law(extension.term)
    without = space.refit(others) if changes_law else space
    if not without.convergence.converged:
        return _unrivalled(space, k, without)
    projector = without.projector() if changes_law else space.projector_without(k)
    own_label = term_label(extension.term)
    other_labels = space.labels - {own_label}
    scores = scan_catalogue(
        projector, [t for t in terms if term_label(t) not in other_labels], tests
    )
    if changes_law:
        refitted: FittedCandidate | None = judge_law_cause(
            space, k, without, fitted_place(extension)
        )
    else:
        refitted = fit_candidate(
            projector,
            extension.term,
            fitted_place(extension),
            [extension.values],
            search_event=True,
        )
    laws: dict[str, FittedCandidate] = {}

    def fit_law(term: Term, needed_nats: float) -> FittedCandidate | None:
        label = term_label(term)
        if label == own_label or not may_fit_laws():
            return None
        replaced_nats = 0.0
        if refitted is not None:
            gain_nats = refitted.delta_log_likelihood
            needed_nats = refitted.log_evidence - _irrelevant_nats(gain_nats)
            first_order = max(
                score.score_test.statistic for score in scores if term_label(score.term) == label
            )
            if 0.5 * FIRST_ORDER_FACTOR * first_order < needed_nats and not shows_beside(term):
                return None
            replaced_nats = 0.0 if changes_law else gain_nats
        law = fit_law_cause(
            without, term, others, needed_nats - replaced_nats, replaced_nats
        ).candidate
        if law is not None:
            laws[label] = law
        return law

    candidates = fit_leading(projector, scores, scores, other_labels, tests, fit_law)
    same_cause = [pair for pair in candidates if term_label(pair[0].extension.term) == own_label]
    if refitted is not None and (
        not same_cause or refitted.log_evidence > same_cause[0][0].log_evidence
    ):
        same_cause = [(refitted, same_cause[0][1] if same_cause else 1.0)]
    best, effective_trials = same_cause[0]
    if not changes_law:
        candidates = [
            (_in_place_of(best, candidate), trials)
            if term_label(candidate.extension.term) in laws
            else (candidate, trials)
            for candidate, trials in candidates
        ]
    alternatives = [
        candidate
        for candidate, _ in candidates
        if term_label(candidate.extension.term) != own_label
    ]
    evidence = np.array(
        [best.log_evidence, *(candidate.log_evidence for candidate in alternatives)]
    )
    posterior = posterior_probabilities(evidence, best.delta_log_likelihood)
    order = np.argsort(-evidence[1:], kind="stable")
    rivals = tuple((alternatives[j], float(posterior[1 + j])) for j in order)
    return RankedCause(best, effective_trials, rivals, float(posterior[0]))


def _irrelevant_nats(best_gain_nats: float) -> float:
    """Return the lag in log evidence at which the odds of a rival are `IRRELEVANT_SHARE`."""
    return float(-np.log(IRRELEVANT_SHARE) * np.hypot(1.0, MODEL_ERROR_SHARE * best_gain_nats))


def _in_place_of(named: FittedCandidate, rival: FittedCandidate) -> FittedCandidate:
    """Return a rival with its gain over the fit without the named cause, not over that with it."""
    nats = named.delta_log_likelihood
    return replace(
        rival,
        delta_log_likelihood=rival.delta_log_likelihood + nats,
        log_evidence=rival.log_evidence + nats,
    )


def _unrivalled(space: Space, k: int, without: Space) -> RankedCause:
    """Return the ranking of a cause if the fit without it, `without`, does not converge."""
    place = fitted_place(space.fitted_terms[k])
    named = judge_law_cause(space, k, without, place)
    excess_nats = without.convergence.remaining_nats
    gain_nats = named.delta_log_likelihood - excess_nats
    candidate = replace(
        named, delta_log_likelihood=gain_nats, log_evidence=named.log_evidence - excess_nats
    )
    return RankedCause(candidate, 1.0, (), 1.0)


def posterior_probabilities(log_evidence: FloatArray, best_gain_nats: float) -> FloatArray:
    """Return the posterior probability of each cause, with an allowance for model error.

    The form of the right cause also leaves a share of a large effect unexplained. A rival that
    leaves a similar share must not be rejected for this reason. Therefore the differences in log
    evidence are divided by the error of the comparison, which grows with the gain. This error has
    two independent parts that add in squares: one nat by noise, and the share `MODEL_ERROR_SHARE`
    of the gain by the form.

    Source: after the coarsened posterior; Miller and Dunson, J. Am. Statist. Assoc. 114
    (2019) 1113.

    Args:
        log_evidence: of each cause, nats, the named cause first.
        best_gain_nats: gain of the log-likelihood by the named cause.
    """
    belief = np.exp(
        (log_evidence - log_evidence.max()) / np.hypot(1.0, MODEL_ERROR_SHARE * best_gain_nats)
    )
    return np.asarray(belief / belief.sum(), dtype=np.float64)
