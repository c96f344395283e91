"""Initial estimate of the delay of each move, from its counts and the planned profile."""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.reference.unit.move_table import MoveTable
from gyrorig_solver.reference.unit.poll_likelihood import AxisCounts, grouped_median
from gyrorig_solver.reference.unit.trapezoidal_moves import TrapezoidalMoves
from gyrorig_solver.reference.unit.unit_moves import Move

MAX_DELAY_S = 0.3  # largest delay of a command
_DELAY_GRID_S = np.arange(0.0, MAX_DELAY_S, 0.005)
_MAX_ERROR_STEPS = 50.0  # limit of the error of a count


def initial_delays(table: MoveTable, counts: tuple[AxisCounts, AxisCounts]) -> FloatArray:
    """Return the delay that fits the counts of each move best, nan without polls in motion.

    Returns:
        Seconds after the first command, shape (m,).
    """
    delay_s = np.full(len(table.moves), np.nan)
    for axis in (0, 1):
        axis_moves = table.moves_of_axis[axis]
        at_s = counts[axis].base_s + 0.5 * counts[axis].extra_s
        single_moves = axis_moves[table.has_single_command[axis_moves]]
        delay_s[single_moves] = _single_command_delays(
            table, single_moves, axis_moves, at_s, counts[axis].steps
        )
        for k in axis_moves[~table.has_single_command[axis_moves]]:
            delay_s[k] = _search_delay(table.moves[k], at_s, counts[axis].steps)
    return delay_s


def _single_command_delays(
    table: MoveTable,
    single_moves: np.ndarray,
    axis_moves: np.ndarray,
    at_s: FloatArray,
    steps: FloatArray,
) -> FloatArray:
    """Return the median delay of the polls of each move."""
    command_s = table.command_times_s[table.first_command[single_moves]]
    start, end = table.from_steps[single_moves], table.to_steps[single_moves]
    moves = TrapezoidalMoves.of(
        np.abs(end - start),
        table.speed_steps_s[single_moves],
        table.acceleration_steps_s2[single_moves],
        table.base_speed_steps_s[single_moves],
    )
    following_s = np.append(table.command_times_s[table.first_command[axis_moves]], np.inf)[
        np.searchsorted(axis_moves, single_moves) + 1
    ]
    until_s = np.minimum(command_s + moves.end_s + MAX_DELAY_S, following_s)
    move = np.searchsorted(command_s, at_s, side="right") - 1
    polls = np.flatnonzero(move >= 0)
    polls = polls[at_s[polls] <= until_s[move[polls]]]
    move = move[polls]
    moved_steps = np.sign(end - start)[move] * (steps[polls] - start[move])
    is_moving = (moved_steps > 0.0) & (moved_steps < moves.distance[move])
    polls, move, moved_steps = polls[is_moving], move[is_moving], moved_steps[is_moving]
    delay_s = at_s[polls] - command_s[move] - moves.time_at(moved_steps, move)
    medians = grouped_median(delay_s, move, single_moves.size, empty=np.nan)
    return np.clip(medians, 0.0, MAX_DELAY_S)


def _search_delay(move: Move, at_s: FloatArray, steps: FloatArray) -> float:
    """Return the delay that fits the counts of a move with several commands best."""
    command_s = np.array([order.command_time_s for order in move.commands])
    no_change = np.zeros(1 + max(move.speed_classes))
    profile = move.profile(command_s, no_change, 0.0)
    first, last = np.searchsorted(at_s, [move.command_time_s, profile.end_s + MAX_DELAY_S])
    counts = steps[first:last]
    if not np.any((counts != move.from_steps) & (counts != move.to_steps)):
        return float("nan")
    # A delay shifts the whole profile, therefore one profile serves all delays.
    since = at_s[first:last][None, :] - _DELAY_GRID_S[:, None]
    errors = np.abs(counts - profile.position_steps(since))
    return float(
        _DELAY_GRID_S[int(np.argmin(np.sum(np.minimum(errors, _MAX_ERROR_STEPS), axis=1)))]
    )
