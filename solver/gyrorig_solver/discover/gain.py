"""What an extended model is worth on data that it was not fitted to.

The recording is cut into windows of some moves each. Each in turn is left out: gain, bias,
time offset and causes are fitted to the others, in the window only the motion's own
unknowns (a start of each move) follow, in both models alike.

Or a whole recording is left out: `second` holds the model as it was fitted and follows
with bias, time offset and motion only.

What to use when: `held_out` for the causes of a fit, all together and one by one;
`held_out_by` for a second recording.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.chance import normal_limit
from gyrorig_solver.discover.result import Gain, Interval
from gyrorig_solver.discover.second import Judged, Other
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.samples import GyroSamples

WINDOW_S = 10.0
FOLDS = 8  # windows are dealt out to so many folds: each fit lacks one fold
FEWEST = 4  # windows; less is not worth an interval
SETTLE_S = 0.3  # a move's end that the low-pass still carries


@dataclass(frozen=True, slots=True, eq=False)
class Worth:
    """What a fit's causes are worth on data that they were not fitted to."""

    together: Gain
    each: Mapping[int, Gain]  # by a cause's number in the fit: all others stay


def held_out(after: Projection, causes: Sequence[int]) -> Worth | None:
    """Return what some causes of a fit are worth, None for none of them or too few windows.

    Args:
        after: the space beside the fit, all of its causes in it.
        causes: their numbers in the fit; the others belong to the base model.
    """
    windows = _windows(after)
    count = int(windows.max()) + 1
    if count < FEWEST or not causes:
        return None
    lacking: list[Sequence[int]] = [[], causes]
    if len(causes) > 1:
        lacking += [[k] for k in causes]
    models = [after.without(gone) for gone in lacking]
    whole, *less = after.kept_out(windows % min(FOLDS, count), models)
    how = f"windows of {WINDOW_S:.0f} s left out in turn, {count} of them"
    gains = [_gain(after, windows, how, without, whole) for without in less]
    each = gains[1:] if len(causes) > 1 else gains
    return Worth(gains[0], dict(zip(causes, each, strict=True)))


def held_out_by(
    base: Solution,
    extended: Solution,
    recording: Recording,
    board: str,
    samples: GyroSamples | None = None,
) -> Gain:
    """Return the gain of an extended model on a recording that neither was fitted to.

    Args:
        base: a fit of the base model to other recordings of the board.
        extended: one of the extended model.
        recording: of a unit.
        board: in it.
        samples: taken instead of the recording's own.

    Raises:
        InputError: the board is not there, or too few samples are.
        UsageError: the recording is none of a unit.
    """
    other = Other.of(recording, board, extended, samples)
    after = other.judged(extended)
    before = other.judged(base, like=after)
    there = Projection.of(
        replace(
            extended,
            sessions=(after.session,),
            extensions=after.session.extensions,
            noises=(after.noise,),
        )
    )
    left = [
        there.white([[r[p][None] for p in series.parts()] for series, r in _apart(one)])[0]
        for one in (before, after)
    ]
    how = f"the recording {other.name}, to which bias and time offset alone were fitted"
    gone = ", ".join(one.term.cause for one in after.left_out)
    if gone:
        how += f"; left out there, for what it was in the other recording only: {gone}"
    found = _gain(there, _windows(there), how, *left)
    # How far the motion had to be bent for it counts too.
    nats, seen = after.log_likelihood - before.log_likelihood, found.log_likelihood
    shift = nats - seen.value
    return replace(found, log_likelihood=Interval(nats, seen.low + shift, seen.high + shift))


def _apart(one: Judged) -> Iterator[tuple[Series, FloatArray]]:
    """Yield each series with its residual, (n, 3)."""
    return zip(one.session.series, one.session.residuals(one.gain), strict=True)


def _gain(
    projection: Projection, windows: IntArray, how: str, before: FloatArray, after: FloatArray
) -> Gain:
    """Return the gain of one model over another from their whitened residuals, (all,)."""
    count = int(windows.max()) + 1
    left = (before, after)
    costs = [np.asarray(np.bincount(windows, one**2, count), np.float64) for one in left]
    nats: FloatArray = 0.5 * (costs[0] - costs[1])
    rates = [projection.unwhitened(white) for white in left]
    squares = [_squares(projection, rate) for rate in rates]
    used = sum(int(u.sum()) for s in projection.stretches for u in s.used)
    rms = [float(np.sqrt(sum(np.sum(r**2) for r in rate) / (3 * used))) for rate in rates]
    change = [float(s) for s in squares[1] - squares[0]]
    turns = [_turn_squares(projection, rate) for rate in rates]
    errors = [float(np.sqrt(np.mean(t))) if t.size else float("nan") for t in turns]
    return Gain(
        how=how,
        log_likelihood=_interval(nats, float(np.sum(nats)), float(count)),
        rms_before=rms[0],
        rms_after=rms[1],
        turn_error_before_rad=errors[0],
        turn_error_after_rad=errors[1],
        rms_change=_interval(np.array(change), rms[1] - rms[0], 1.0 / (rms[0] + rms[1])),
        turn_change=_change(turns, errors),
    )


def _change(squares: list[FloatArray], errors: list[float]) -> Interval | None:
    """Return how an rms over moves changes, from their squares and the rms before and after."""
    if squares[0].size < FEWEST:
        return None
    each = squares[1] - squares[0]
    return _interval(each, errors[1] - errors[0], 1.0 / (errors[0] + errors[1]))


def _interval(each: FloatArray, value: float, factor: float) -> Interval:
    """Return a figure with the 95 % interval that its windows' scatter gives it."""
    half = normal_limit(0.025) * float(np.std(each, ddof=1) / np.sqrt(each.size)) * factor
    return Interval(value, value - half, value + half)


def _windows(projection: Projection) -> IntArray:
    """Return to which window each whitened value belongs, counted over all recordings."""
    found, first = [], 0
    for s in projection.stretches:
        for scene, used in zip(s.scenes, s.used, strict=True):
            length = float(scene.edges_s[-1] - scene.edges_s[0])
            many = max(1, round(length / WINDOW_S))
            own = first + np.arange(used.size) * many // used.size
            found.append(np.tile(own, 3))
            first += many
    return np.concatenate(found).astype(np.int64)


def _squares(projection: Projection, rates: list[FloatArray]) -> FloatArray:
    """Return the mean square of each window, (windows,)."""
    windows = _windows(projection)
    flat = np.concatenate([rate.T.ravel() for rate in rates])
    return np.asarray(
        np.bincount(windows, flat**2) / np.maximum(np.bincount(windows), 1), dtype=np.float64
    )


def _turn_squares(projection: Projection, rates: list[FloatArray]) -> FloatArray:
    """Return the square of the residual's integral over each move, rad^2, (moves,)."""
    found, part = [], 0
    for s in projection.stretches:
        for scene, used in zip(s.scenes, s.used, strict=True):
            rate = rates[part]
            part += 1
            step_s = float(scene.edges_s[-1] - scene.edges_s[0]) / used.size
            for _, course in scene.setting.courses:
                first = round((float(course.start_s[0]) - float(scene.edges_s[0])) / step_s)
                last = round((float(course.end_s) + SETTLE_S - float(scene.edges_s[0])) / step_s)
                if 0 <= first < last <= used.size:
                    found.append(np.sum(rate[first:last], axis=0) * step_s)
    return np.sum(np.square(found), axis=1) if found else np.zeros(0)
