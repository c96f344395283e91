"""Boards of a bus have one time: each saw the same edges.

A SYNC frame is latched by every board at one moment T_k, whatever the sender, the host and the
queue of the bus did before. Each board's own map m_b says when that was, wrong by what the
map is wrong there, c_b, and by the delay of the board's interrupt, e:

    m_b(latch_bk) = T_k + c_b(T_k) + e_bk.

T_k is the mean over the boards that saw the edge, so nothing is asked of the host's stamps of
the edge, which err by a thousand times as much as the interrupts. c_b is a line, in long
recordings a chain of lines, fitted with Huber's weights; the mean of all c_b is left as it is:
the time that all share is the mean of their own.

What to use when: `shared_time` for the boards of one recording, then `Moved.off` on sample times.

Source: time synchronisation notes, section 4 (one SYNC frame cancels sender and queue); Huber
1964 for the weights. Figures: docs/clocks.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_lsq_spline
from scipy.sparse.csgraph import connected_components

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.clocks.envelope import Envelope

FEWEST = 30  # edges that two boards have in common: fewer say less than the arrivals
LINE_UP_TO_S = 120.0  # as for the maps themselves
KNOT_SPACING_S = 60.0
FEW_IN_A_PIECE = 5  # edges of a board between two bends
HUBER = 1.345  # times the deviation: 95 % efficient where errors are normal
ROUNDS = 20
SETTLED_S = 1e-9
LEAST_SPREAD_S = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Exchanges:
    """When a board was asked for its clock, by its own map; one row an exchange."""

    asked_ns: IntArray  # (p,), the host's stamp: the same for all boards that saw one edge
    time_s: FloatArray  # (p,), when the board says it was, since `origin_ns`
    origin_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """By how much one board's times are late of the time that all boards share."""

    late: Envelope  # over the board's times, since its own origin
    edges: int
    boards: int  # that share the time
    spread_s: float  # of the edges about it, robust standard deviation

    @property
    def rms_s(self) -> float:
        """How far the times move."""
        return float(np.sqrt(np.mean(self.late.delay_s**2)))

    def off(self, time_s: FloatArray) -> None:
        """Make a board's times those that all share, in place."""
        time_s -= self.late.at(time_s)


def shared_time(boards: Mapping[str, Exchanges]) -> dict[str, Moved]:
    """Return what takes boards' times to one, for those that saw the same edges.

    Args:
        boards: of one recording; those on no bus share no edge, and are not in the result.
    """
    if len(boards) < 2:
        return {}
    origin_ns = min(one.origin_ns for one in boards.values())
    seen_s = _seen(list(boards.values()), origin_ns)
    there = np.isfinite(seen_s).astype(np.int64)
    # Each bus has its own edges, so its boards are a group of their own.
    _, group = connected_components(there @ there.T >= FEWEST, directed=False)
    names = np.array(list(boards))
    found: dict[str, Moved] = {}
    for one in np.unique(group):
        taking = np.flatnonzero(group == one)
        if taking.size > 1:
            origins_ns = {str(name): boards[str(name)].origin_ns for name in names[taking]}
            found |= _apart(origins_ns, seen_s[taking], origin_ns)
    return found


def _seen(boards: Sequence[Exchanges], origin_ns: int) -> FloatArray:
    """Return when each board saw each edge that several saw, (boards, edges), nan where not."""
    every = np.concatenate([np.unique(one.asked_ns) for one in boards])
    stamps, count = np.unique(every, return_counts=True)
    stamps = stamps[count >= 2]
    seen_s = np.full((len(boards), stamps.size), np.nan)
    for row, one in zip(seen_s, boards, strict=True):
        there = np.isin(one.asked_ns, stamps)
        at = np.searchsorted(stamps, one.asked_ns[there])
        row[at] = one.time_s[there] + (one.origin_ns - origin_ns) * 1e-9
    return seen_s


def _apart(origins_ns: Mapping[str, int], seen_s: FloatArray, origin_ns: int) -> dict[str, Moved]:
    """Fit what each board's map is late by.

    Args:
        origins_ns: of each board's own times.
        seen_s: (boards, edges); nan where a board missed one.
        origin_ns: of `seen_s`.
    """
    seen_s = seen_s[:, np.sum(np.isfinite(seen_s), axis=0) >= 2]
    boards, edges = seen_s.shape
    if boards < 2 or edges < FEWEST:
        return {}
    there = np.isfinite(seen_s)
    middle_s = np.nanmean(seen_s, axis=0)
    knots_s = _knots(middle_s)
    most = [np.histogram(middle_s[own], knots_s)[0].min() >= FEW_IN_A_PIECE for own in there]
    if not all(most):  # a board that was away for long keeps its own time
        stay = dict(zip(origins_ns, most, strict=True))
        origins_ns = {name: ns for name, ns in origins_ns.items() if stay[name]}
        return _apart(origins_ns, seen_s[np.array(most)], origin_ns)
    late = np.zeros((boards, edges))
    knot_late = np.zeros((boards, knots_s.size))
    spread_s = 0.0
    for _ in range(ROUNDS):
        # With edges missing, the mean of those that are there leans to them: so by turns.
        middle_s = np.nanmean(seen_s - late, axis=0)
        rest_s = seen_s - middle_s
        spread_s = max(LEAST_SPREAD_S, 1.4826 * float(np.nanmedian(np.abs(rest_s - late))))
        before = knot_late.copy()
        for k in range(boards):
            use = there[k]
            weight = np.minimum(
                1.0, HUBER * spread_s / np.maximum(np.abs(rest_s - late)[k, use], 1e-15)
            )
            knot_late[k] = _chain(middle_s[use], rest_s[k, use], weight, knots_s)
        knot_late -= knot_late.mean(axis=0)
        late = np.array([np.interp(middle_s, knots_s, one) for one in knot_late])
        if np.max(np.abs(knot_late - before)) < SETTLED_S:
            break
    return {
        name: Moved(
            Envelope(knots_s + (origin_ns - own_ns) * 1e-9, knot_late[k]),
            int(there[k].sum()),
            boards,
            spread_s,
        )
        for k, (name, own_ns) in enumerate(origins_ns.items())
    }


def _knots(time_s: FloatArray) -> FloatArray:
    """Return where a chain bends: equally many edges lie between, so none is without."""
    span_s = float(time_s[-1] - time_s[0])
    pieces = 1 if span_s <= LINE_UP_TO_S else max(1, round(span_s / KNOT_SPACING_S))
    pieces = min(pieces, time_s.size // FEWEST)
    return np.asarray(np.quantile(time_s, np.linspace(0.0, 1.0, pieces + 1)), dtype=np.float64)


def _chain(x: FloatArray, y: FloatArray, weight: FloatArray, knots_s: FloatArray) -> FloatArray:
    """Return the values at the knots of the chain of lines with least squares."""
    order = np.argsort(x, kind="stable")
    order = order[(x[order] >= knots_s[0]) & (x[order] <= knots_s[-1])]
    ends = knots_s[[0, *range(knots_s.size), -1]]
    spline = make_lsq_spline(x[order], y[order], ends, k=1, w=np.sqrt(weight[order]))
    return np.asarray(spline(knots_s), dtype=np.float64)
