"""Explain a board's recordings: what the model of the rig gets wrong, and what that is worth.

What to use when: `explain` from recordings, `explain_fit` from a fit of the base model.
"""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.discover.changes import Board, own_part
from gyrorig_solver.discover.gain import held_out
from gyrorig_solver.discover.groups import signatures
from gyrorig_solver.discover.limits import limits
from gyrorig_solver.discover.name_tests import fillers, kept, without
from gyrorig_solver.discover.outdone import outdone
from gyrorig_solver.discover.ramps import RAMPS, look_for_ramps
from gyrorig_solver.discover.result import (
    Explained,
    Findings,
    Gain,
    NamedCause,
    Signature,
    Unexplained,
    Value,
    Verdict,
    Whose,
)
from gyrorig_solver.discover.rivals import rivals_of
from gyrorig_solver.discover.scatter_names import look_for_jitter
from gyrorig_solver.discover.search import (
    ALPHA,
    Found,
    Standing,
    by_chance,
    search,
    testable,
    tests_of,
)
from gyrorig_solver.discover.walks import look_for_walk
from gyrorig_solver.discover.wandering import beside, is_calm, wandering
from gyrorig_solver.estimate.conclusion import TERMS
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.motion import reduced_chi2
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.bound import label, recording_of
from gyrorig_solver.model.terms.protocol import (
    indices,
    places,
    value_names,
    value_parameters,
)
from gyrorig_solver.on_unit import unit_solution

SCATTERED = ("moving", "acceleration_scatter", "line", "wandering")  # no shape of a mean
GROUPS_ALPHA = 0.001  # as `search.ALPHA`, of what is odd without a name
FILLS = 0.8  # share of what is odd that names must explain, or they would fill a gap
SHARES_OF_GAIN = frozenset({"step_resolution"})
SHOWN_SIGMA = 3.0  # a part this many deviations from zero is where a cause acts


def explain(recordings: Sequence[Recording], board: str) -> Explained:
    """Find what the base model gets wrong for one board on a pan-tilt unit.

    Args:
        recordings: in any order; fitted together.
        board: in each of them.

    Raises:
        InputError: the board is not there, or there is no unit.
        UsageError: recordings that cannot be fitted together.
    """
    begin = time.monotonic()
    return explain_fit(unit_solution(recordings, board), board, begin)


def explain_fit(base: Solution, board: str, begin: float | None = None) -> Explained:
    """Find what a fit of the base model gets wrong.

    Args:
        base: the fit; it is left as it is.
        board: its name.
        begin: when the work began, `time.monotonic`.
    """
    begin = time.monotonic() if begin is None else begin
    return conclude(base, search(base), board, begin)


def conclude(
    base: Solution,
    found: Found,
    board: str,
    begin: float,
    whose: Mapping[str, Whose] | None = None,
) -> Explained:
    """Say what a search has found.

    Args:
        base: the fit of the base model.
        found: where the search ended.
        board: its name.
        begin: when the work began, `time.monotonic`.
        whose: of causes by label, where several boards were searched together.
    """
    found, fallen = kept(base, found)
    if any(unseen := _unseen(found)):
        found = without(base, found, unseen)
    first = Projection.of(base) if found.standings else found.last
    tests = tests_of(testable(found.last))
    jitter = look_for_jitter(found.last, tests, ALPHA)
    fallen += jitter.fallen
    every = _nameless(found.solution, found.last)
    walk = look_for_walk(found.solution, tests, ALPHA, found.doubts)
    if walk is not None:
        # The levels hold it: what is odd beside them is another matter, and comes first.
        beside_it = signatures(Projection.of(found.solution))
        if any(one.p_value < GROUPS_ALPHA for one in beside_it):
            walk = None
        else:
            every = beside_it
    shown = _nameless(base, first) if found.standings else every
    left = jitter.of(every)
    unexplained = _unexplained(found, left, fallen)
    if unexplained is not None and found.standings:
        odd = (unexplained.best, *unexplained.others)
        gone = outdone(found, odd, tests, FILLS)
        if unexplained.named_share < FILLS:
            gone = [a or b for a, b in zip(gone, fillers(found, odd, FILLS), strict=True)]
        if any(gone):
            found = without(base, found, gone)
            jitter = look_for_jitter(found.last, tests, ALPHA)
            left = jitter.of(_nameless(found.solution, found.last) if found.standings else shown)
            unexplained = _unexplained(found, left, fallen) or unexplained
    calibration = Board.of(found.solution)
    fitted = _fitted(found)
    worth = held_out(found.last, [k for k, _ in fitted])
    gains = {} if worth is None else worth.each
    causes = [_named(found.solution, k, s, calibration, tests, gains.get(k)) for k, s in fitted]
    for_whom = whose or {}
    causes = [replace(one, whose=for_whom.get(label(one.term))) for one in causes]
    ramps = look_for_ramps(found.solution, tests, ALPHA)
    causes += [one for one in (jitter.named, ramps.named, walk) if one is not None]
    causes.sort(key=lambda one: (-one.harm_sigma, one.p_value))
    absent, blind = limits(found.last, found.sights, calibration, len(base.sessions))
    absent += () if jitter.absent is None else (jitter.absent,)
    said = {RAMPS} if ramps.named is None else {RAMPS, ramps.named.cause}
    absent = (*(one for one in absent if one.cause not in said), *ramps.absent)
    verdict: Verdict = "explained" if causes else "adequate"
    findings = Findings(
        verdict="unexplained" if unexplained is not None else verdict,
        causes=tuple(causes),
        unexplained=unexplained,
        signatures=tuple(shown),
        absent=absent,
        not_testable=blind,
        base_terms=(*TERMS, "time_offset", *(e.term.cause for e in base.extensions)),
        base_reduced_chi2=reduced_chi2(base),
        base_whiteness_p=shown[0].p_value,
        extended_reduced_chi2=reduced_chi2(found.solution),
        gain=None if worth is None else worth.together,
        changes=calibration.changes(Board.of(base).values),
        seconds=time.monotonic() - begin,
    )
    return Explained(board, findings, base, found.solution)


def _unseen(found: Found) -> list[bool]:
    """Return which names of what the gain takes as well have no size that the data show.

    A share of the steps is a share of the gain: told apart by the answers alone. Such a
    name won before others came in beside it; what is left of it is the gain's.
    """
    unseen: list[bool] = []
    for k, standing in _fitted(found):
        one, std = found.solution.extensions[k], _std(found.solution, k, standing.best.event_std)
        sizes = [j for j in one.free if j in indices(one.term, role="size")]
        shares = one.term.cause in SHARES_OF_GAIN and bool(sizes)
        unseen.append(shares and all(math.isinf(std[j]) for j in sizes))
    return unseen


def _fitted(found: Found) -> list[tuple[int, Standing]]:
    """Return each fitted cause's number in the fit, with its standing."""
    free = [k for k, one in enumerate(found.solution.extensions) if one.free.size]
    return list(zip(free, found.standings, strict=True))


def _named(
    solution: Solution,
    k: int,
    standing: Standing,
    board: Board,
    tests: int,
    gain: Gain | None,
) -> NamedCause:
    one = solution.extensions[k]
    best, term = standing.best, one.term
    sizes = [j for j in one.free if j in indices(term, role="size")]
    left_out = own_part(best.taken, len(solution.sessions))
    statistic = 2.0 * max(best.won, 0.0)
    return NamedCause(
        term=term,
        where=_where(solution, k),
        extension=one,
        values=_values(solution, k, best.event_std),
        statistic=statistic,
        degrees_of_freedom=len(sizes),
        p_value=by_chance(best, standing.looks, tests),
        posterior=standing.posterior,
        one_of=standing.one_of,
        rivals=rivals_of(best, standing.rivals),
        changes=board.changes(board.values + board.moved(left_out)),
        gain=gain,
        recording=_recording(solution, one),
    )


def _recording(solution: Solution, one: Extension) -> str | None:
    """Return the name of the recording that a cause is bound to."""
    number = recording_of(one.term)
    setting = None if number is None else solution.sessions[number].setting
    return None if setting is None else setting.recording


def _std(solution: Solution, k: int, event: float | None = None) -> list[float]:
    """Return the deviation of every value of a cause, inf where it is not fitted or seen.

    Args:
        solution: the fit.
        k: which of its causes.
        event: of the time of an event, which the fit itself holds.
    """
    one: Extension = solution.extensions[k]
    first = solution.estimate.size - sum(e.free.size for e in solution.extensions[k:])
    variance = np.diag(solution.decision.covariance)[first : first + one.free.size]
    found = np.full(one.values.size, np.inf)
    shown = [solution.decision.shows(first + j) for j in range(one.free.size)]
    found[one.free] = np.where(shown, np.sqrt(np.clip(variance, 0.0, None)), np.inf)
    if event is not None:
        found[[j for j in indices(one.term, role="event") if j not in one.free]] = event
    return [float(v) for v in found]


def _values(solution: Solution, k: int, event: float | None) -> tuple[Value, ...]:
    one = solution.extensions[k]
    return tuple(
        Value(name, float(value), std, parameter.unit, parameter.typical)
        for name, value, std, parameter in zip(
            value_names(one.term),
            one.values,
            _std(solution, k, event),
            value_parameters(one.term),
            strict=True,
        )
    )


def _where(solution: Solution, k: int) -> tuple[str, ...]:
    """Return the parts of a cause whose sizes stand out; the foremost where none does."""
    one, std = solution.extensions[k], _std(solution, k)
    strength = {
        place: max(abs(float(one.values[j])) / std[j] for j in indices(one.term, place, "size"))
        for place in places(one.term)
    }
    some = tuple(place for place, sigma in strength.items() if sigma > SHOWN_SIGMA)
    if some or not strength:
        return some
    return (max(strength, key=lambda place: strength[place]),)


def _nameless(solution: Solution, as_found: Projection) -> list[Signature]:
    """Return the nameless tests beside a fit; see `wandering` for what it may take for odd."""
    if is_calm(solution):
        return signatures(as_found)
    bias = wandering(solution)
    found = signatures(beside(solution), None if bias.wild else as_found)
    return sorted([*found, bias.signature], key=lambda one: (one.p_value, -one.statistic))


def _unexplained(
    found: Found, left: Sequence[Signature], fallen: Sequence[Signature]
) -> Unexplained | None:
    some = {one.covariate: one for one in fallen}
    some |= {one.covariate: one for one in left if one.p_value < GROUPS_ALPHA}
    if not some:
        return None
    # What is odd in the mean adds to the scatter too, and is the better lead.
    # Of several that pass for one another the likeliest is, not the least likely by chance.
    odd = tuple(sorted(some.values(), key=lambda one: (one.covariate in SCATTERED, -one.evidence)))
    won = sum(2.0 * max(_won_here(s), 0.0) for s in found.standings)
    rest = max(one.statistic - one.degrees_of_freedom for one in odd)
    return Unexplained(odd[0], odd[1:], won / (won + rest) if won > 0.0 else 0.0)


def _won_here(standing: Standing) -> float:
    return standing.best.won if standing.here is None else standing.here
