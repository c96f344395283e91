"""Separation of two causes by a recording: the expected log Bayes factor between them.

One cause with its fitted values is the assumed truth. The other cause, and all parameters of a fit,
explain its noise-free signal as well as possible. Half the squared distance of the residual, in the
metric of the noise, is the expected log Bayes factor. Either cause can be the truth; the smaller of
both results counts. To first order, the distances of several motions add up. The solver chooses a
program with this sum. It evaluates the chosen program with the exact distance and the causes' Occam
factors.

A cause of a board or of a unit has one value in all recordings. A cause of a recording has a
separate value in each, therefore the old recordings do not help to exclude it in the new one.

What to use when: `fitted_pairs` for the causes of a set, `unseen_cause` for a single cause;
`FirstOrder` with the `pair_products` of recordings to choose a program; `expected_nats` for the
reported figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover.candidate_fits import fit_best_place, fitted_place
from gyrorig_solver.discover.checks.typical_noise import has_typical_noise, limit_to_typical
from gyrorig_solver.discover.exact_fit import FittedCandidate, fit_candidate
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.estimate import (
    GAIN_PARAMETERS,
    SESSION_PARAMETERS,
    ConvergedFit,
    FittedTerm,
    NuisanceProjector,
    ParameterLayout,
    join_signals,
)
from gyrorig_solver.estimate.nuisance_space import OtherData
from gyrorig_solver.model import (
    Term,
    form_for,
    recording_index_of,
    start_values,
    value_indices,
    value_parameters,
    why_not_testable,
)
from gyrorig_solver.model.catalogue import catalogue


@dataclass(frozen=True, slots=True, eq=False)
class CausePair:
    """Two causes that may explain the same effect, or one that no recording has shown yet."""

    first: FittedTerm  # with its fitted values; a single cause has its typical size
    second: FittedTerm | None  # with its fitted values; None: the first has no rival
    named: FittedTerm | None  # the cause of the fit that is one of the set

    @property
    def causes(self) -> tuple[str, ...]:
        """The causes' ids."""
        return tuple(member.term.cause for member in self.members)

    @property
    def members(self) -> tuple[FittedTerm, ...]:
        """The causes with their values."""
        return (self.first,) if self.second is None else (self.first, self.second)

    @property
    def both_ways(self) -> tuple[tuple[FittedTerm, FittedTerm | None], ...]:
        """The truth and its rival, for each truth."""
        if self.second is None:
            return ((self.first, None),)
        return (self.first, self.second), (self.second, self.first)

    @property
    def size_count(self) -> int:
        """The number of fitted values of the first cause."""
        return int(self.first.free_indices.size)


@dataclass(frozen=True, slots=True, eq=False)
class PairProducts:
    """Products of the signals of gain, bias, time offset, causes and a pair in one recording.

    The unknowns of the motion are eliminated. The order is: gain; bias and time offset, if they are
    not eliminated; the other causes of the fit; the derivatives and, last, the effect of the first
    and then of the second cause of the pair.
    """

    information: FloatArray  # (n, n)
    session_count: int  # of bias and time offset: 4 per recording, or 0 if eliminated
    first_count: int  # derivatives of the first cause
    second_count: int  # derivatives of the second cause

    def __add__(self, other: "PairProducts") -> "PairProducts":
        """Return the products of two parts of one recording."""
        return replace(self, information=self.information + other.information)

    @property
    def signal_count(self) -> int:
        """The number of signals of the pair."""
        return self.first_count + self.second_count + 2

    def without_session(self, prior_std: FloatArray) -> "PairProducts":
        """Return the products with bias and time offset eliminated; `prior_std`: of these two."""
        session = np.arange(GAIN_PARAMETERS, GAIN_PARAMETERS + self.session_count)
        prior = np.zeros(len(self.information))
        prior[session] = prior_std**-2.0
        reduced = _eliminate(self.information + np.diag(prior), session)
        return replace(self, information=reduced, session_count=0)

    def without_rival(self, rival_is_first: bool) -> "PairProducts":
        """Return the products with a rival fitted, and without information on the pair."""
        first = len(self.information) - self.signal_count
        rival = first + self._derivatives(rival_is_first)
        information = np.zeros_like(self.information)
        remaining = np.setdiff1d(np.arange(len(self.information)), rival)
        curvature = self.information + np.diag(_tiny(self.information))
        information[np.ix_(remaining, remaining)] = _eliminate(curvature, rival)
        information[first:] = information[:, first:] = 0.0
        return replace(self, information=information)

    def gain_nats(self, prior_std: FloatArray) -> float:
        """Return the log-likelihood that the stronger effect gains; `prior_std`: of the others."""
        signals = self._of_signals(prior_std)
        return 0.5 * max(float(signals[self.first_count, self.first_count]), float(signals[-1, -1]))

    def left_nats(
        self, rival_is_first: bool, rival: FittedTerm | None, prior_std: FloatArray
    ) -> float:
        """Return half the squared distance between an effect and the best fit of a rival."""
        signals = self._of_signals(prior_std)
        derivatives = self._derivatives(rival_is_first)
        difference = np.zeros(len(signals))
        difference[self.first_count], difference[-1] = 1.0, -1.0
        product = signals @ difference
        if rival is None:
            return 0.5 * float(difference @ product)
        curvature = signals[np.ix_(derivatives, derivatives)] + np.diag(_prior_precision(rival))
        step = np.linalg.lstsq(curvature, product[derivatives], rcond=None)[0]
        return 0.5 * max(0.0, float(difference @ product - product[derivatives] @ step))

    def _of_signals(self, prior_std: FloatArray) -> FloatArray:
        """Return the products of the pair's signals with everything else eliminated."""
        base = np.arange(len(self.information) - self.signal_count)
        prior = np.zeros(len(self.information))
        prior[base] = prior_std**-2.0
        return _eliminate(self.information + np.diag(prior), base)

    def _derivatives(self, of_first: bool) -> IntArray:
        """Return the positions of a cause's derivatives among the signals."""
        if of_first:
            return np.arange(self.first_count)
        return np.arange(self.first_count + 1, self.first_count + 1 + self.second_count)


def _eliminate(information: FloatArray, positions: IntArray) -> FloatArray:
    """Return the information on the other unknowns with some eliminated (Schur complement)."""
    remaining = np.setdiff1d(np.arange(len(information)), positions)
    cross = information[np.ix_(positions, remaining)]
    solved = np.linalg.solve(information[np.ix_(positions, positions)], cross)
    return np.asarray(
        information[np.ix_(remaining, remaining)] - cross.T @ solved, dtype=np.float64
    )


def _tiny(information: FloatArray) -> FloatArray:
    return 1e-12 * np.diag(information) + np.finfo(np.float64).tiny


def judged_by_typical_noise(solution: ConvergedFit) -> ConvergedFit:
    """Return a fit with the noise levels that a search uses for causes."""
    if has_typical_noise(solution):
        return solution
    return replace(solution, noises=tuple(limit_to_typical(noise) for noise in solution.noises))


def own_recordings(solution: ConvergedFit, cause: FittedTerm | None) -> ConvergedFit:
    """Return a fit with only the recordings in which a cause can act."""
    number = None if cause is None else recording_index_of(cause.term)
    if number is None:
        return solution
    return replace(
        solution, sessions=(solution.sessions[number],), noises=(solution.noises[number],)
    )


def together(solution: ConvergedFit, other: ConvergedFit) -> ConvergedFit:
    """Return one fit with the recordings of two fits that have the same values."""
    return replace(
        solution,
        sessions=(*solution.sessions, *other.sessions),
        noises=(*solution.noises, *other.noises),
    )


def fitted_pairs(
    solution: ConvergedFit, named: FittedTerm, rivals: Sequence[str]
) -> list[CausePair]:
    """Return all pairs of a set of causes, the rivals fitted to the effect of the named cause.

    Args:
        solution: the fit, with the noise levels that a search uses for causes.
        named: the cause of the fit.
        rivals: the others of the set; causes that a motion cannot show are left out.
    """
    solution = own_recordings(solution, named)
    first = replace(
        named, term=_form_in(solution, catalogue()[named.term.cause]), other_boards_prior=None
    )
    projector = NuisanceProjector.of_effect(solution, named, first, solution.noises)
    members = [first]
    for cause in rivals:
        if cause not in catalogue():
            continue
        term = _form_in(solution, catalogue()[cause])
        if term.kind != "effect" or _is_equivalent(term, members):
            continue
        if why_not_testable(term, projector.states) is not None:
            continue
        fitted = _fit_rival(projector, term)
        if fitted is not None:
            members.append(fitted.extension)
    return [
        CausePair(first, second, named) for k, second in enumerate(members) for first in members[:k]
    ]


def unseen_cause(solution: ConvergedFit, cause: str) -> CausePair | None:
    """Return a cause at its typical size, without a rival.

    None if no motion shows it, if it is an event, or if it is in the fit.
    """
    term = _form_in(solution, catalogue()[cause])
    projector = NuisanceProjector.of_effect(solution, None, None, solution.noises)
    is_testable = why_not_testable(term, projector.states) is None
    is_fitted = any(fitted.term.cause == cause for fitted in solution.fitted_terms)
    if term.kind != "effect" or not is_testable or is_fitted or value_indices(term, role="event"):
        return None
    sizes = value_indices(term, role="size")
    values = start_values(term)
    values[sizes] = [value_parameters(term)[k].typical_size for k in sizes]
    return CausePair(FittedTerm(term, values, np.array(sizes, dtype=np.int64)), None, None)


def _form_in(solution: ConvergedFit, term: Term) -> Term:
    """Return the form of a cause for the recordings of a fit."""
    series = (each for session in solution.sessions for each in session.series)
    return form_for(term, any(each.filter_bandwidth_hz is not None for each in series))


def _is_equivalent(term: Term, members: Sequence[FittedTerm]) -> bool:
    """Return whether a cause is the same function on its axis as one of the members."""
    return any(
        term.cause in member.term.equivalent_causes or member.term.cause in term.equivalent_causes
        for member in members
    )


def pair_products(solution: ConvergedFit, pairs: Sequence[CausePair]) -> list[PairProducts]:
    """Return the products of each pair's signals in the recordings of a fit.

    The pairs belong to one cause of the fit. The products contain bias and time offset of all
    recordings.
    """
    named = pairs[0].named
    projector = NuisanceProjector.of_effect(solution, named, None, solution.noises)
    space, board = projector.motion_space(), projector.normal_blocks().board_derivatives
    products = []
    for pair in pairs:
        signals = join_signals(
            [
                projector.term_derivatives(cause.term, cause.values, cause.free_indices)
                for cause in pair.members
            ]
        ).dense()
        if pair.second is None:
            signals = np.vstack([signals, np.zeros((1, signals.shape[1]))])
        nothing = OtherData(
            np.zeros((len(board) + len(signals),) * 2),
            np.zeros((space.shared_count, len(board) + len(signals))),
            np.zeros(len(board) + len(signals)),
        )
        information = space.dense_statistics(np.vstack([board, signals]), nothing).information
        products.append(
            PairProducts(
                information,
                SESSION_PARAMETERS * len(solution.sessions),
                pair.size_count,
                0 if pair.second is None else pair.second.free_indices.size,
            )
        )
    return products


class FirstOrder:
    """The expected log Bayes factors of one pair to first order, for parts of a new recording."""

    def __init__(self, pair: CausePair, solution: ConvergedFit) -> None:
        """Prepare the recordings that exist.

        Args:
            pair: the causes.
            solution: their fit, with the noise levels that a search uses for causes.
        """
        solution = own_recordings(solution, pair.named)
        layout = ParameterLayout.of([[]], 1)
        board_std = solution.prior_std[: layout.size]
        others = [t.prior_std for t in solution.fitted_terms if t is not pair.named]
        self._session_std = board_std[GAIN_PARAMETERS:]
        self._prior_std = np.concatenate([board_std[:GAIN_PARAMETERS], *others])
        self._pair = pair
        (products,) = pair_products(solution, [pair])
        self._old = products.without_session(np.tile(self._session_std, len(solution.sessions)))
        self._old_gain = {is_first: self._old.without_rival(is_first) for is_first in (True, False)}

    def outlook(self, new: PairProducts | None) -> tuple[float, float]:
        """Return the expected nats between the causes, and the log-likelihood that a cause gains.

        `new`: the sum over the parts of the new recording; None for the old recordings alone.
        """
        added = None if new is None else new.without_session(self._session_std)
        total = self._old if added is None else self._old + added
        nats = []
        for truth, rival in self._pair.both_ways:
            data, rival_is_first = total, rival is self._pair.first
            if _is_of_recording(rival or truth):
                if added is None:
                    return 0.0, 0.0
                data = self._old_gain[rival_is_first] + added
            nats.append(data.left_nats(rival_is_first, rival, self._prior_std))
        return min(nats), total.gain_nats(self._prior_std)


def expected_nats(
    pair: CausePair, old: ConvergedFit, new: ConvergedFit
) -> list[tuple[float, float]]:
    """Return the expected log Bayes factor and the log-likelihood gain of each truth.

    Args:
        pair: the causes.
        old: the fit of the recordings that exist.
        new: the simulated recording.
    """
    old = own_recordings(old, pair.named)
    return [
        _expected_nats_of(
            truth,
            rival,
            pair.named,
            new if _is_of_recording(rival or truth) else together(old, new),
        )
        for truth, rival in pair.both_ways
    ]


def _expected_nats_of(
    truth: FittedTerm, rival: FittedTerm | None, named: FittedTerm | None, solution: ConvergedFit
) -> tuple[float, float]:
    """Return the same for one truth, from a fit of the recordings with the named cause."""
    projector = NuisanceProjector.of_effect(solution, named, truth, solution.noises)
    best = fit_candidate(projector, truth.term, fitted_place(truth), [truth.values])
    true_nats = 0.0 if best is None else best.log_evidence
    gain_nats = 0.0 if best is None else best.delta_log_likelihood
    if rival is None:
        return gain_nats, gain_nats
    other = _fit_rival(projector, rival.term)
    return true_nats - (0.0 if other is None else other.log_evidence), gain_nats


def _fit_rival(projector: NuisanceProjector, term: Term) -> FittedCandidate | None:
    """Return the best fit of a rival, even if its optimum is beyond the bounds of its values.

    With noise, the optimum of such a rival can be within its bounds.
    """
    scores = scan_catalogue(projector, [term], 1, all_templates(projector, term))
    best = fit_best_place(projector, scores, with_infeasible=True)
    return None if best is None else best[0]


def _is_of_recording(cause: FittedTerm) -> bool:
    return cause.term.scope == "recording"


def _prior_precision(cause: FittedTerm) -> FloatArray:
    parameters = [value_parameters(cause.term)[k] for k in cause.free_indices]
    return np.array([0.0 if p.role == "size" else p.prior_std**-2.0 for p in parameters])
