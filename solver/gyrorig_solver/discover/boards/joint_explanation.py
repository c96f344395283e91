"""Search for causes in several boards on one unit together.

Each board is searched separately first. A cause that may belong to the unit, or may be confused
with a cause of the unit, is then tested on all boards: one common size, or separate sizes
(`scope_hypotheses`). A cause of the unit is fitted to every board with a prior from the other
boards (`joint_projector.prior_from_others`), which equals the joint fit. Finally, all boards
together are searched for causes that no single board shows. If a board shows a cause of the motion
law, the cause is fitted to all boards and to the position replies, which they share (`common_law`).
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.discover.boards.board_search import BoardSearch
from gyrorig_solver.discover.boards.common_law import fit_common_law
from gyrorig_solver.discover.boards.joint_projector import (
    JointProjector,
    LocalQuadratic,
    homogeneity_p_value,
    local_quadratic,
    prior_from_others,
)
from gyrorig_solver.discover.boards.scope_hypotheses import (
    ScopeHypothesis,
    compare_scopes,
    possible_owner,
)
from gyrorig_solver.discover.candidate_fits import MAX_CANDIDATES, global_p_value
from gyrorig_solver.discover.cause_findings import Attribution, FitExplanation
from gyrorig_solver.discover.cause_ranking import (
    RankedCause,
    confusable_labels,
)
from gyrorig_solver.discover.cause_search import search_causes
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.discover.fit_explanation import explain_search
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE, scan_catalogue
from gyrorig_solver.discover.testable_terms import count_tests, testable_terms
from gyrorig_solver.estimate import (
    MIN_HOMOGENEITY_P,
    ConvergedFit,
    FittedTerm,
    NuisanceProjector,
)
from gyrorig_solver.model import Term, term_label

DETECTED_NATS = 4.0  # gain on a board's own data; chance exceeds it once in 200 for one size
MAX_EVIDENCE_LAG_NATS = 30.0  # lag of a rival on one board that all boards together can make up
MAX_MOTION_UNKNOWNS = 4000  # with more, a dense matrix of the unknowns takes too much memory
MAX_JOINT_ONLY_CAUSES = 4  # causes that only all boards together show

CauseByBoard = dict[int, tuple[FittedTerm, RankedCause]]  # causes that may be the same, by board


@dataclass(frozen=True, slots=True, eq=False)
class _CommonSize:
    """A cause with one size on all boards, about which the boards agree."""

    cause: FittedCandidate
    quadratics: Sequence[LocalQuadratic]  # the likelihood of each board about this size
    disagreement_p: float  # p-value of the boards having one size


def explain_jointly(bases: Mapping[str, ConvergedFit]) -> dict[str, FitExplanation]:
    """Search for causes in several boards on one unit together.

    If the motions differ, or consist of thousands of moves, each board is explained separately.

    Args:
        bases: the fit of the base model to each board, for the same recordings.
    """
    start_s = time.monotonic()
    boards = []
    for name, solution in bases.items():
        base = MotionFitSpace(solution)
        result = search_causes(base)
        ranked_causes = list(result.ranked_causes)
        boards.append(BoardSearch(name, base, result, result.space, ranked_causes, {}))
    if len(boards) > 1 and _share_one_motion(list(bases.values())):
        _resolve_law_causes(boards)
        for matched in _match_causes(boards):
            _resolve_cause(boards, matched)
        _find_joint_only_causes(boards)
        _attribute_remaining(boards)
    return {
        board.name: explain_search(
            board.base, board.finish(), board.name, start_s, board.attributions
        )
        for board in boards
    }


def _share_one_motion(bases: Sequence[ConvergedFit]) -> bool:
    """Return whether the fits have the same motion, small enough for a joint fit."""
    sizes = [[session.reference.information.size for session in b.sessions] for b in bases]
    many = sum(local + shared for local, shared in sizes[0])
    return many <= MAX_MOTION_UNKNOWNS and all(size == sizes[0] for size in sizes)


def _resolve_law_causes(boards: Sequence[BoardSearch]) -> None:
    """Fit each cause of the motion law that a board shows to all boards at one common value."""
    causes = {
        term_label(cause.term): cause
        for board in boards
        for cause, _ in board.fitted_causes()
        if board.space.changes_law(cause.term)
    }
    for label, cause in causes.items():
        common = fit_common_law({board.name: board.space for board in boards}, cause)
        if common is None:
            continue
        shown = sum(
            term_label(extension.term) == label
            for board in boards
            for extension, _ in board.fitted_causes()
        )
        attribution = Attribution("unit", shown, len(boards), common.disagreement_p)
        for board in boards:
            board.take_law(common.spaces[board.name], cause.term)
            board.attributions[label] = attribution


def _match_causes(boards: Sequence[BoardSearch]) -> list[CauseByBoard]:
    """Return causes of different boards that may be the same cause, the most significant first.

    A match has at most one cause of each board: the same cause, or one with a common plausible
    rival.
    """
    named_causes = [
        (board_number, extension, s)
        for board_number, board in enumerate(boards)
        for extension, s in board.fitted_causes()
        if not board.space.changes_law(extension.term)
    ]
    named_causes.sort(key=lambda entry: -entry[2].candidate.delta_log_likelihood)
    matches: list[CauseByBoard] = []
    matched_terms: list[FittedTerm] = []
    for board_number, extension, ranked in named_causes:
        if any(extension is other for other in matched_terms):
            continue
        match: CauseByBoard = {board_number: (extension, ranked)}
        names = _plausible_labels(ranked)
        for other_board, other, rival in sorted(
            named_causes, key=lambda e: term_label(e[1].term) != term_label(extension.term)
        ):
            if (
                other_board not in match
                and not any(other is u for u in matched_terms)
                and names & _plausible_labels(rival)
            ):
                match[other_board] = (other, rival)
        matched_terms += [extension for extension, _ in match.values()]
        if any(possible_owner(term) != "board" for term in _candidate_terms(match).values()):
            matches.append(match)
    return matches


def _plausible_labels(ranked: RankedCause) -> set[str]:
    threshold = ranked.candidate.log_evidence - MAX_EVIDENCE_LAG_NATS
    rivals = {term_label(w.extension.term) for w, _ in ranked.rivals if w.log_evidence > threshold}
    return {term_label(ranked.candidate.extension.term), *rivals}


def _candidate_terms(matched: CauseByBoard) -> dict[str, Term]:
    """Return the candidate causes of a match, the most probable first."""
    candidates = [
        candidate
        for _, s in matched.values()
        for candidate in (s.candidate, *(r for r, _ in s.rivals))
    ]
    plausible = set().union(*(_plausible_labels(s) for _, s in matched.values()))
    candidates.sort(key=lambda candidate: -candidate.log_evidence)
    term_by_label = {
        term_label(candidate.extension.term): candidate.extension.term for candidate in candidates
    }
    return {name: term for name, term in term_by_label.items() if name in plausible}


def _resolve_cause(boards: Sequence[BoardSearch], matched: CauseByBoard) -> None:
    """Choose a candidate, and one common size or separate sizes; refit the boards."""
    projectors = [
        board.projector_without(matched[k][0] if k in matched else None)
        for k, board in enumerate(boards)
    ]
    tests = count_tests(testable_terms(projectors[0]))
    fitted_labels = [
        {
            term_label(extension.term)
            for extension in board.space.fitted_terms
            if k not in matched or extension is not matched[k][0]
        }
        for k, board in enumerate(boards)
    ]
    hypotheses = [
        hypothesis
        for name, term in _candidate_terms(matched).items()
        if not any(name in labels for labels in fitted_labels)
        for hypothesis in compare_scopes(projectors, term, tests)
    ]
    if not hypotheses:
        return
    hypotheses.sort(key=lambda hypothesis: -hypothesis.log_evidence)
    if hypotheses[0].log_evidence <= 0.0:
        # All boards show a cause of the unit. An effect on one board with so little evidence is
        # chance.
        for k, (cause, _) in matched.items():
            boards[k].drop_cause(cause)
        return
    common = _agree_on_size(projectors, hypotheses[0].common)
    if common is None:
        _fit_separate_sizes(boards, matched, hypotheses)
    else:
        _fit_common_size(boards, projectors, matched, hypotheses, common)


def _agree_on_size(
    projectors: Sequence[NuisanceProjector], cause: FittedCandidate | None
) -> _CommonSize | None:
    """Return the one size of a cause on all boards; None if the boards disagree about it."""
    if cause is None:
        return None
    quadratics = [local_quadratic(projector, cause) for projector in projectors]
    p_value = homogeneity_p_value(quadratics)
    return _CommonSize(cause, quadratics, p_value) if p_value >= MIN_HOMOGENEITY_P else None


def _fit_common_size(
    boards: Sequence[BoardSearch],
    projectors: Sequence[NuisanceProjector],
    matched: CauseByBoard,
    hypotheses: list[ScopeHypothesis],
    common: _CommonSize,
) -> None:
    joint, quadratics = common.cause, common.quadratics
    attribution = Attribution(
        "unit",
        sum(quadratic.delta_log_likelihood > DETECTED_NATS for quadratic in quadratics),
        len(quadratics),
        common.disagreement_p,
    )
    joint_projector = JointProjector(projectors)
    joint_quadratic = local_quadratic(joint_projector, joint)
    for k, board in enumerate(boards):
        prior = prior_from_others(
            joint.extension.values[joint.extension.free_indices], joint_quadratic, quadratics[k]
        )
        cause = replace(joint.extension, other_boards_prior=prior)
        best = replace(
            joint, extension=cause, absorbed=joint_projector.board_part(k, joint.absorbed)
        )
        board.replace_cause(
            matched[k][0] if k in matched else None,
            cause,
            _rank_hypotheses(best, hypotheses, quadratics[k]),
        )
        board.attributions[term_label(cause.term)] = attribution


def _fit_separate_sizes(
    boards: Sequence[BoardSearch], matched: CauseByBoard, hypotheses: list[ScopeHypothesis]
) -> None:
    for k, board in enumerate(boards):
        best = hypotheses[0].per_board[k]
        if k not in matched or best is None:
            continue
        cause, _ = matched[k]
        if term_label(cause.term) == hypotheses[0].name:
            board.update_ranking(
                cause, _rank_hypotheses(replace(best, extension=cause), hypotheses, None)
            )
        else:
            board.replace_cause(cause, best.extension, _rank_hypotheses(best, hypotheses, None))


def _rank_hypotheses(
    candidate: FittedCandidate, hypotheses: list[ScopeHypothesis], quadratic: LocalQuadratic | None
) -> RankedCause:
    """Return the ranking of the first hypothesis, with the evidence of all boards."""
    first = hypotheses[0]
    evidence = np.array([hypothesis.log_evidence for hypothesis in hypotheses])
    probabilities = np.exp(evidence - evidence.max())
    probabilities /= probabilities.sum()
    shares: dict[str, tuple[FittedCandidate, float]] = {}
    for hypothesis, share in zip(hypotheses[1:], probabilities[1:], strict=True):
        if hypothesis.name == first.name:
            continue
        fitted = hypothesis.common or next(w for w in hypothesis.per_board if w is not None)
        # Gain and evidence of this board's cause, plus the difference over all boards.
        rival = replace(
            fitted,
            delta_log_likelihood=candidate.delta_log_likelihood
            + hypothesis.delta_log_likelihood
            - first.delta_log_likelihood,
            log_evidence=candidate.log_evidence + hypothesis.log_evidence - first.log_evidence,
        )
        previous = shares.get(hypothesis.name, (rival, 0.0))
        shares[hypothesis.name] = previous[0], previous[1] + float(share)
    rivals = tuple(sorted(shares.values(), key=lambda pair: -pair[1]))
    posterior = 1.0 - sum(share for _, share in rivals)
    return RankedCause(
        candidate,
        first.effective_trials,
        rivals,
        posterior,
        None if quadratic is None else quadratic.delta_log_likelihood,
    )


def _find_joint_only_causes(boards: Sequence[BoardSearch]) -> None:
    """Name causes of the unit that only all boards together show."""
    for _ in range(MAX_JOINT_ONLY_CAUSES):
        projectors = [board.projector_without(None) for board in boards]
        joint_projector = JointProjector(projectors)
        terms = testable_terms(joint_projector)
        fitted_labels = frozenset[str]().union(*(board.space.labels for board in boards))
        unfitted = [term for term in terms if term_label(term) not in fitted_labels]
        unit_terms = [term for term in unfitted if possible_owner(term) != "board"]
        tests = count_tests(unit_terms)
        significant = [
            score
            for score in scan_catalogue(joint_projector, unit_terms, tests)
            if score.p_value < FALSE_ALARM_RATE
        ]
        if not significant:
            return
        leading_terms = {
            term_label(score.term): score.term for score in significant[:MAX_CANDIDATES]
        }
        confusable = confusable_labels(significant[0].term, unfitted)
        leading_terms |= {
            term_label(term): term for term in unfitted if term_label(term) in confusable
        }
        hypotheses = [
            hypothesis
            for term in leading_terms.values()
            for hypothesis in compare_scopes(projectors, term, tests)
        ]
        hypotheses.sort(key=lambda hypothesis: -hypothesis.log_evidence)
        common = _agree_on_size(projectors, hypotheses[0].common) if hypotheses else None
        if common is None:
            return
        if global_p_value(common.cause, hypotheses[0].effective_trials, tests) > FALSE_ALARM_RATE:
            return
        _fit_common_size(boards, projectors, {}, hypotheses, common)


def _attribute_remaining(boards: Sequence[BoardSearch]) -> None:
    """Attribute the remaining causes to their boards, and count the boards with each cause."""
    names = [
        [term_label(extension.term) for extension, _ in board.fitted_causes()] for board in boards
    ]
    for board, board_labels in zip(boards, names, strict=True):
        for name in board_labels:
            many = sum(name in other for other in names)
            board.attributions.setdefault(name, Attribution("board", many, len(boards), None))
