"""What the best unbiased estimate could reach, and what it would have said of the same noise.

The information of counts and answers at the true parameters and the true noise: signals
that act everywhere are weighed by the exact covariance (conjugate gradients), those of one
move by the density, derivatives are numeric. An answered count weighs as if its error were
normal: variance 1/12 of its quantum and (speed x instant)^2 of its unknown instant.

What the unit does not tell is estimated along, each held by what is known before:
starts by nothing, speeds and accelerations to 1 %, when a step counts to a step,
where in an exchange's delay the count is taken to a third of it, rests to a detent.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import next_fast_len
from tests.bench.accuracy.board import Board, Counts, factor_slopes, seen, through
from tests.bench.accuracy.noise import Covariance
from tests.bench.accuracy.profile import FloatArray, Path, Trapezoid
from tests.bench.accuracy.unit import DETENT_STEPS, Session

LOG_STD = 1e-2  # of speeds and accelerations before they are seen
BESIDE_STD, LAG_STD = 1.0 / 6.0, 12.0**-0.5  # of a count's offset and lag, steps, as they are drawn
LATE_SHARE_STD = 12.0**-0.5
START_STEP_S, LOG_STEP, REST_STEP = 1e-4, 1e-5, 1e-2  # of numeric derivatives
RISE_S, FALL_S = 0.2, 0.6  # about a move, for its low-pass
ABOUT_S = 3.0  # about a short piece, for its weighing
LONG_S = 12.0  # a piece longer than this is weighed exactly,
EXACT_SAMPLES = 10_000  # where that does not cost too much; else it is 1 % off at most
TAU = 12


@dataclass(frozen=True, slots=True, eq=False)
class Bound:
    """The best covariance of the 13 parameters in the order of `NAMES`, and a best estimate."""

    covariance: FloatArray  # (13, 13)
    error: FloatArray  # (13,), of the linear estimate that reaches it, on this run's noise


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """Derivatives of the stage rate by one unknown, where they are not zero."""

    first: int
    values: FloatArray  # (m, 3), at the sample instants


def bound(board: Board, session: Session, counts: Counts, profile_known: bool) -> Bound:
    """Return the bound of one run.

    Args:
        board: the truth.
        session: the truth of the unit, and what it answered.
        counts: of the board; their noise tells what a best estimate errs by.
        profile_known: the stage's motion is given exactly; answers do not matter.
    """
    begin_s, n = float(counts.time_s[0]), counts.time_s.size
    rate = seen(board, session.path, begin_s, n)
    slope = seen(board, session.path, begin_s, n, slope=True)
    unknowns = [] if profile_known else _unknowns(session)
    pieces = [_piece(board, unknown, begin_s, n) for unknown in unknowns]
    size = 13 + len(pieces)
    information, score = np.zeros((size, size)), np.zeros(size)
    exact = n <= EXACT_SAMPLES
    long = [k for k, p in enumerate(pieces) if exact and len(p.values) > LONG_S * board.rate_hz]
    short = [k for k in range(len(pieces)) if k not in long]
    for axis in range(3):
        row = board.gain[axis]
        cover = Covariance(board.levels[axis], board.bandwidth_hz, board.rate_hz, n)
        parts = [piece.values @ row for piece in pieces]
        columns = np.column_stack([rate, np.ones(n), -slope @ row, np.zeros((n, len(long)))])
        for column, k in enumerate(long, start=5):
            columns[pieces[k].first : pieces[k].first + parts[k].size, column] = parts[k]
        weighed = cover.weigh(columns)
        at = [3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, TAU, *(13 + k for k in long)]
        noise = counts.noise_rad_s[:, axis]
        information[np.ix_(at, at)] += columns.T @ weighed
        score[at] += weighed.T @ noise
        for k in short:
            _add_short(k, short, pieces, parts, cover, at, weighed, noise, information, score)
    common_s = 0.0
    if not profile_known:
        rest = _answers(session, len(pieces))
        information[13:, 13:] += rest[0]
        score[13:] += rest[1]
        common_s = session.least_s / float(np.sqrt(12.0))
    return _concluded(board, session, information, score, common_s)


def _concluded(
    board: Board, session: Session, information: FloatArray, score: FloatArray, common_s: float
) -> Bound:
    # Columns differ by orders of magnitude: scale before the inverse.
    unit = 1.0 / np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information * np.outer(unit, unit)) * np.outer(unit, unit)
    turn = np.zeros((13, 13))
    turn[:3, 9:12] = np.eye(3)
    turn[3:12, :9] = factor_slopes(board.gain)
    turn[12, TAU] = 1.0
    covariance = turn @ inverse[:13, :13] @ turn.T
    error = turn @ (inverse @ score)[:13]
    if common_s:
        covariance[12, 12] += common_s**2
        error[12] += session.common_s
    return Bound(covariance, error)


@dataclass(frozen=True, slots=True, eq=False)
class _Unknown:
    """One unknown of the unit: the path with it a little more and a little less."""

    more: Path
    less: Path
    step: float
    spans_s: tuple[tuple[float, float], ...]  # where that matters, in order
    held: float  # one over the variance known before
    off: float = 0.0  # the truth, minus where it was thought to be before


def _unknowns(session: Session) -> list[_Unknown]:
    """Return starts, rests, speeds, accelerations."""
    path = session.path
    unknowns = []
    for k, move in enumerate(path.moves):
        during = ((move.start_s, move.end_s),)
        pair = [
            _with(path, {k: replace(move, start_s=move.start_s + s * START_STEP_S)})
            for s in (1.0, -1.0)
        ]
        unknowns.append(_Unknown(pair[0], pair[1], START_STEP_S, during, 0.0))
    for axis in (0, 1):
        axis_path = path.of_axis(axis)
        for k in range(len(axis_path) + 1):
            pair = [_rested(path, axis, k, s * REST_STEP) for s in (1.0, -1.0)]
            near = axis_path[max(0, k - 1) : k + 1]
            spans = tuple((move.start_s, move.end_s) for move in near)
            if axis == 1:
                # The tilt turns what pan does, from the move that came to the one that left.
                begin_s = axis_path[k - 1].start_s if k > 0 else 0.0
                spans = ((begin_s, axis_path[k].end_s if k < len(axis_path) else session.end_s),)
            off = float(path.off_steps[axis][k])
            unknowns.append(_Unknown(pair[0], pair[1], REST_STEP, spans, DETENT_STEPS**-2, off))
    for own_class in sorted(set(session.classes)):
        at = [k for k, c in enumerate(session.classes) if c == own_class]
        unknowns.append(_scaled(path, at, "speed_steps_s", session.log_speed[own_class]))
    for axis in (0, 1):
        at = [k for k, move in enumerate(path.moves) if move.axis == axis]
        unknowns.append(_scaled(path, at, "acceleration_steps_s2", session.log_ramp[axis]))
    return unknowns


def _with(path: Path, changed: dict[int, Trapezoid]) -> Path:
    moves = tuple(changed.get(k, move) for k, move in enumerate(path.moves))
    return Path(moves, path.off_steps, path.begin_steps)


def _rested(path: Path, axis: int, k: int, step: float) -> Path:
    off = [path.off_steps[0].copy(), path.off_steps[1].copy()]
    off[axis][k] += step
    return Path(path.moves, (off[0], off[1]), path.begin_steps)


def _scaled(path: Path, at: list[int], what: str, off: float) -> _Unknown:
    pair = []
    for sign in (1.0, -1.0):
        factor = float(np.exp(sign * LOG_STEP))
        changed = {}
        for k in at:
            move = path.moves[k]
            if what == "speed_steps_s":
                changed[k] = replace(move, speed_steps_s=move.speed_steps_s * factor)
            else:
                ramp = move.acceleration_steps_s2 * factor
                changed[k] = replace(move, acceleration_steps_s2=ramp)
        pair.append(_with(path, changed))
    spans = tuple((path.moves[k].start_s, path.moves[k].end_s) for k in at)
    return _Unknown(pair[0], pair[1], LOG_STEP, spans, LOG_STD**-2, off)


def _piece(board: Board, unknown: _Unknown, begin_s: float, count: int) -> _Piece:
    """Return the derivative of the seen stage rate by one unknown."""
    hz = board.rate_hz
    late_s = board.lag_s - begin_s
    windows: list[list[int]] = []
    for begin, end in unknown.spans_s:
        low = int(np.floor((begin + late_s - RISE_S) * hz))
        high = int(np.ceil((end + late_s + FALL_S) * hz))
        if windows and low < windows[-1][1]:
            windows[-1][1] = max(windows[-1][1], high)
        else:
            windows.append([low, high])
    reach = round(ABOUT_S * hz)
    first, last = (windows[0][0] - reach, windows[-1][1] + reach) if windows else (0, 0)
    values = np.zeros((last - first, 3))
    for low, high in windows:
        values[low - first : high - first] = _change(board, unknown, begin_s, low, high)
    low, high = max(0, first), max(0, min(count, last))
    return _Piece(low, values[low - first : max(high, low) - first])


def _change(board: Board, unknown: _Unknown, begin_s: float, first: int, last: int) -> FloatArray:
    """Return the derivative at some samples, outside of which it is zero."""
    hz, over = board.rate_hz, board.oversampling
    m = next_fast_len((last - first) * over, real=True)
    edges = begin_s + first / hz + np.arange(m + 1) / (hz * over)
    change = unknown.more.mean_rate_rad_s(edges) - unknown.less.mean_rate_rad_s(edges)
    change[(last - first) * over :] = 0.0
    return through(board, change / (2.0 * unknown.step), slope=False)[: last - first]


def _add_short(
    k: int,
    short: list[int],
    pieces: list[_Piece],
    parts: list[FloatArray],
    cover: Covariance,
    at: list[int],
    weighed: FloatArray,
    noise: FloatArray,
    information: FloatArray,
    score: FloatArray,
) -> None:
    """Add what one short piece tells on one axis: of itself, of others, of what acts long."""
    first, values = pieces[k].first, parts[k]
    stop = first + values.size
    cross = values @ weighed[first:stop]
    information[13 + k, at] += cross
    information[at, 13 + k] += cross
    weighed_columns = cover.weigh_short(values[:, None])[:, 0]
    score[13 + k] += float(weighed_columns @ noise[first:stop])
    for other in short:
        low = max(first, pieces[other].first)
        high = min(stop, pieces[other].first + parts[other].size)
        if other < k or high <= low:
            continue
        theirs = parts[other][low - pieces[other].first : high - pieces[other].first]
        value = float(weighed_columns[low - first : high - first] @ theirs)
        information[13 + k, 13 + other] += value
        if other != k:
            information[13 + other, 13 + k] += value


def _answers(session: Session, size: int) -> tuple[FloatArray, FloatArray]:
    """Return what the counts tell of the unit's unknowns, with what was known before."""
    unknowns = _unknowns(session)
    answers, path = session.answers, session.path
    extra = answers.hi_s - answers.lo_s - session.least_s
    least_s = session.least_s
    at_s = answers.lo_s + (least_s / 2.0 + session.common_s) + extra / 2.0
    if answers.ticks is not None:  # the counter tells all instants, but one constant
        at_s, extra = answers.instant_s, np.zeros(answers.lo_s.size)
    rows, weights, residuals, tails = [], [], [], []
    for axis in (0, 1):
        is_axis = answers.axis == axis
        time_s, wide = at_s[is_axis], extra[is_axis]
        counted_steps = path.counted_steps(axis, time_s)
        speed = np.zeros(time_s.size)
        edge = np.full(time_s.size, np.inf)
        for move in path.of_axis(axis):
            speed += move.speed_at_steps_s(time_s)
            inside = (time_s > move.start_s) & (time_s < move.end_s)
            gone = move.gone_steps(time_s)
            near = np.minimum(gone, abs(move.end_steps - move.begin_steps) - gone)
            edge = np.where(inside, near, edge)
        use = (speed != 0.0) & (edge > 1.5)
        time_s, wide, speed = time_s[use], wide[use], speed[use]
        residuals.append(answers.steps[is_axis][use] - counted_steps[use])
        weights.append(1.0 / (1.0 / 12.0 + (speed * wide) ** 2 / 12.0))
        columns = np.zeros((time_s.size, size))
        for k, unknown in enumerate(unknowns):
            for begin, end in unknown.spans_s:
                own_times = slice(*(int(np.searchsorted(time_s, edge)) for edge in (begin, end)))
                change = unknown.more.counted_steps(axis, time_s[own_times])
                change -= unknown.less.counted_steps(axis, time_s[own_times])
                columns[own_times, k] = change / (2.0 * unknown.step)
        rows.append(columns)
        tails.append(np.column_stack([np.ones(time_s.size), -np.sign(speed), speed * wide]))
    jacobian = np.concatenate([np.concatenate(rows), np.concatenate(tails)], axis=1)
    weight, residual = np.concatenate(weights), np.concatenate(residuals)
    information = jacobian.T @ (weight[:, None] * jacobian)
    score = jacobian.T @ (weight * residual)
    before = [*(u.held for u in unknowns), BESIDE_STD**-2, LAG_STD**-2, LATE_SHARE_STD**-2]
    information[np.arange(size + 3), np.arange(size + 3)] += before
    # The truth lies off the middle of what was known before by what was drawn.
    score[:size] -= [u.held * u.off for u in unknowns]
    keep, drop = slice(0, size), slice(size, None)
    carry = np.linalg.solve(
        information[drop, drop], np.column_stack([information[drop, keep], score[drop]])
    )
    return (
        information[keep, keep] - information[keep, drop] @ carry[:, :-1],
        score[keep] - information[keep, drop] @ carry[:, -1],
    )
