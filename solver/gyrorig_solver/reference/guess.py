"""How late each move began, before any fit: where its counts cross the told course."""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.reference.evidence import AxisCounts, grouped_median
from gyrorig_solver.reference.moves import Move
from gyrorig_solver.reference.table import MoveTable
from gyrorig_solver.reference.trapezoid import Trapezoids

LATEST_S = 0.3  # how late orders may be
_SEARCH_S = np.arange(0.0, LATEST_S, 0.005)
_FAR_STEPS = 50.0  # a count this far off is as wrong as any


def first_guess(table: MoveTable, counts: tuple[AxisCounts, AxisCounts]) -> FloatArray:
    """Return how late each move fits its counts best, nan where no poll saw it on its way.

    Args:
        table: the moves as they were told, m of them.
        counts: of pan and tilt.

    Returns:
        Seconds after the first order was told, shape (m,).
    """
    late = np.full(len(table.moves), np.nan)
    for axis in (0, 1):
        own = table.own[axis]
        at_s = counts[axis].base_s + 0.5 * counts[axis].extra_s
        plain = own[table.plain[own]]
        late[plain] = _plain(table, plain, own, at_s, counts[axis].steps)
        for k in own[~table.plain[own]]:
            late[k] = _search(table.moves[k], at_s, counts[axis].steps)
    return late


def _plain(
    table: MoveTable, plain: np.ndarray, own: np.ndarray, at_s: FloatArray, steps: FloatArray
) -> FloatArray:
    """Return by how much each move's counts are late, the median of its polls."""
    told_s = table.told_s[table.first[plain]]
    start, end = table.from_steps[plain], table.to_steps[plain]
    moves = Trapezoids.of(
        np.abs(end - start), table.speed[plain], table.acceleration[plain], table.base[plain]
    )
    following_s = np.append(table.told_s[table.first[own]], np.inf)[np.searchsorted(own, plain) + 1]
    until_s = np.minimum(told_s + moves.end_s + LATEST_S, following_s)
    move = np.searchsorted(told_s, at_s, side="right") - 1
    near = np.flatnonzero(move >= 0)
    near = near[at_s[near] <= until_s[move[near]]]
    move = move[near]
    gone = np.sign(end - start)[move] * (steps[near] - start[move])
    on_way = (gone > 0.0) & (gone < moves.way[move])
    near, move, gone = near[on_way], move[on_way], gone[on_way]
    late_s = at_s[near] - told_s[move] - moves.passed_s(gone, move)
    found = grouped_median(late_s, move, plain.size, empty=np.nan)
    return np.clip(found, 0.0, LATEST_S)


def _search(move: Move, at_s: FloatArray, steps: FloatArray) -> float:
    """Return the delay under which a move with orders on the way fits its counts best."""
    told_s = np.array([order.told_s for order in move.orders])
    still = np.zeros(1 + max(move.classes))
    course = move.course(told_s, still, 0.0)
    first, last = np.searchsorted(at_s, [move.told_s, course.end_s + LATEST_S])
    counted = steps[first:last]
    if not np.any((counted != move.from_steps) & (counted != move.to_steps)):
        return float("nan")
    # The course shifts as a whole, so one course serves every delay tried.
    since = at_s[first:last][None, :] - _SEARCH_S[:, None]
    off = np.abs(counted - course.position_steps(since))
    return float(_SEARCH_S[int(np.argmin(np.sum(np.minimum(off, _FAR_STEPS), axis=1)))])
