"""A shared time base of the boards on one CAN bus, from common SYNC edges.

Every board latches a SYNC frame at the same time T_k, regardless of the delays of the sender, the
host and the bus. The map m_b of each board gives this time with the error c_b of the map and the
delay e of the board's interrupt:

    m_b(latch_bk) = T_k + c_b(T_k) + e_bk.

T_k is the mean over the boards that received the edge. The host's timestamps of the edge are not
used; their error is a thousand times that of the interrupts. c_b is a line, in long recordings
a linear spline, fitted with Huber's weights. The mean of all c_b is zero: the shared time is the
mean of the boards' times.

What to use when: `fit_shared_time` for the boards of one recording, then
`TimeCorrection.apply` on the sample times.

Source: Huber, "Robust estimation of a location parameter", 1964, for the weights. Measured
accuracy: docs/clocks.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_lsq_spline
from scipy.sparse.csgraph import connected_components

from gyrorig_solver.data.arrays import FloatArray, IntArray
from gyrorig_solver.data.clocks.lower_envelope import Envelope

MIN_COMMON_EDGES = 30  # of two boards; fewer are less accurate than the arrivals
MAX_LINE_SPAN_S = 120.0  # as for the clock maps
KNOT_SPACING_S = 60.0
MIN_EDGES_PER_PIECE = 5  # edges of a board between two knots
HUBER_THRESHOLD = 1.345  # in standard deviations: 95 % efficient for normal errors
MAX_ITERATIONS = 20
CONVERGENCE_S = 1e-9
MIN_SPREAD_S = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class ClockExchanges:
    """Clock requests to one board, by its own map; one row per exchange."""

    request_ns: IntArray  # (p,), host timestamp, the same for all boards that received the edge
    time_s: FloatArray  # (p,), reception time by the board's map, since `origin_ns`
    origin_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class TimeCorrection:
    """Correction of the times of one board to the shared time."""

    late: Envelope  # over the board's times, since its origin
    board_count: int  # boards that share the time

    @property
    def rms_s(self) -> float:
        """Rms of the correction."""
        return float(np.sqrt(np.mean(self.late.delay_s**2)))

    def apply(self, time_s: FloatArray) -> None:
        """Convert the times of the board to the shared time, in place."""
        time_s -= self.late.delay_at(time_s)


def fit_shared_time(boards: Mapping[str, ClockExchanges]) -> dict[str, TimeCorrection]:
    """Return the corrections of the boards that received common edges.

    Args:
        boards: of one recording; boards without common edges are not in the result.
    """
    if len(boards) < 2:
        return {}
    origin_ns = min(bus.origin_ns for bus in boards.values())
    edge_s = _common_edges(list(boards.values()), origin_ns)
    observed = np.isfinite(edge_s).astype(np.int64)
    # The boards of one bus are a connected component, because each bus has separate edges.
    _, group = connected_components(observed @ observed.T >= MIN_COMMON_EDGES, directed=False)
    names = np.array(list(boards))
    corrections: dict[str, TimeCorrection] = {}
    for bus in np.unique(group):
        members = np.flatnonzero(group == bus)
        if members.size > 1:
            origins_ns = {str(name): boards[str(name)].origin_ns for name in names[members]}
            corrections |= _fit_corrections(origins_ns, edge_s[members], origin_ns)
    return corrections


def _common_edges(boards: Sequence[ClockExchanges], origin_ns: int) -> FloatArray:
    """Return the times of the common edges, (boards, edges), nan if not received."""
    all_stamps = np.concatenate([np.unique(exchanges.request_ns) for exchanges in boards])
    stamps, count = np.unique(all_stamps, return_counts=True)
    stamps = stamps[count >= 2]
    edge_s = np.full((len(boards), stamps.size), np.nan)
    for row, exchanges in zip(edge_s, boards, strict=True):
        is_common = np.isin(exchanges.request_ns, stamps)
        at = np.searchsorted(stamps, exchanges.request_ns[is_common])
        row[at] = exchanges.time_s[is_common] + (exchanges.origin_ns - origin_ns) * 1e-9
    return edge_s


def _fit_corrections(
    origins_ns: Mapping[str, int], edge_s: FloatArray, origin_ns: int
) -> dict[str, TimeCorrection]:
    """Fit the correction of each board.

    Args:
        origins_ns: origins of the boards' times.
        edge_s: (boards, edges); nan if a board missed it.
        origin_ns: of `edge_s`.
    """
    edge_s = edge_s[:, np.sum(np.isfinite(edge_s), axis=0) >= 2]
    boards, edges = edge_s.shape
    if boards < 2 or edges < MIN_COMMON_EDGES:
        return {}
    observed = np.isfinite(edge_s)
    mean_s = np.nanmean(edge_s, axis=0)
    knots_s = _knot_times(mean_s)
    has_enough = [
        np.histogram(mean_s[board_edges], knots_s)[0].min() >= MIN_EDGES_PER_PIECE
        for board_edges in observed
    ]
    if not all(has_enough):  # a board that was absent for long keeps its time
        is_kept = dict(zip(origins_ns, has_enough, strict=True))
        origins_ns = {name: ns for name, ns in origins_ns.items() if is_kept[name]}
        return _fit_corrections(origins_ns, edge_s[np.array(has_enough)], origin_ns)
    late = np.zeros((boards, edges))
    knot_late = np.zeros((boards, knots_s.size))
    spread_s = 0.0
    for _ in range(MAX_ITERATIONS):
        # With missing edges the mean depends on the corrections, therefore iterate.
        mean_s = np.nanmean(edge_s - late, axis=0)
        residual_s = edge_s - mean_s
        spread_s = max(MIN_SPREAD_S, 1.4826 * float(np.nanmedian(np.abs(residual_s - late))))
        previous = knot_late.copy()
        for k in range(boards):
            board_mask = observed[k]
            weight = np.minimum(
                1.0,
                HUBER_THRESHOLD
                * spread_s
                / np.maximum(np.abs(residual_s - late)[k, board_mask], 1e-15),
            )
            knot_late[k] = _fit_linear_spline(
                mean_s[board_mask], residual_s[k, board_mask], weight, knots_s
            )
        knot_late -= knot_late.mean(axis=0)
        late = np.array([np.interp(mean_s, knots_s, values) for values in knot_late])
        if np.max(np.abs(knot_late - previous)) < CONVERGENCE_S:
            break
    return {
        name: TimeCorrection(
            Envelope(knots_s + (origin_ns - board_origin_ns) * 1e-9, knot_late[k]),
            boards,
        )
        for k, (name, board_origin_ns) in enumerate(origins_ns.items())
    }


def _knot_times(time_s: FloatArray) -> FloatArray:
    """Return the knots, with equally many edges in each interval."""
    span_s = float(time_s[-1] - time_s[0])
    pieces = 1 if span_s <= MAX_LINE_SPAN_S else max(1, round(span_s / KNOT_SPACING_S))
    pieces = min(pieces, time_s.size // MIN_COMMON_EDGES)
    return np.asarray(np.quantile(time_s, np.linspace(0.0, 1.0, pieces + 1)), dtype=np.float64)


def _fit_linear_spline(
    x: FloatArray, y: FloatArray, weight: FloatArray, knots_s: FloatArray
) -> FloatArray:
    """Return the knot values of the weighted least-squares linear spline."""
    order = np.argsort(x, kind="stable")
    order = order[(x[order] >= knots_s[0]) & (x[order] <= knots_s[-1])]
    ends = knots_s[[0, *range(knots_s.size), -1]]
    spline = make_lsq_spline(x[order], y[order], ends, k=1, w=np.sqrt(weight[order]))
    return np.asarray(spline(knots_s), dtype=np.float64)
