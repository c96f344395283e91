"""One cause fitted exactly beside a fit: sizes, shapes and event, by the real effect.

The base model is followed to first order (it is all but linear near its best), the cause
itself as it is. What is won is the rise of the log likelihood; the evidence weighs it
against how much the cause could have explained (Laplace's approximation, Occam's factor):
sizes are expected about the typical one with long tails (Cauchy), shapes and events
anywhere in their ranges.

What to use when: `refit` for a cause at a place from a few rows of its bank.

Source: MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28;
Levenberg-Marquardt with the scaling of More (1978).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.discover.scores import Seen
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.bound import acts_in
from gyrorig_solver.model.terms.protocol import Term, indices, value_parameters
from gyrorig_solver.model.terms.scene import Scene, Setting
from gyrorig_solver.model.terms.supply_hum import FEWEST_WAVES, waves

ROUNDS = 12
ENOUGH = 1e-2  # nats won by a step: less is no reason for another
NOTHING = 1e-4  # nats that a step promises: a hundredth of a deviation, not worth a look
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e6
LEVELS, PER_LEVEL = 4, 4  # an event is looked for this many times, each so much finer
NEAR_S = 2e-3  # an event known better than this lies on one smooth hill of the likelihood
ABOUT_S = (0.02, 0.07, 0.25)  # an edge of a move, its ramp, a rest
NO_TIME_S = 1e-6  # that an event is known to
LOOKS_PER_SIDE = 20  # times to either side of one that is known worse
SURE = 4.0  # deviations
BEYOND_NATS = 2.0  # won by leaving what is possible, two deviations: it is something else
STAYING = ("mount", "clock")  # links at which an event changes what the fit itself follows


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """A cause at its best beside a fit."""

    extension: Extension  # its sizes and shapes free, its event as found
    place: str | None
    won: float  # nats
    evidence: float  # nats, Occam's factor counted
    std: FloatArray  # (free,)
    taken: FloatArray  # (board,), what its effect makes of the fit's parameters
    impossible: bool  # better still outside what is possible, or a part of what is whole
    event_std: float | None = None  # of its event's time, s; None where it has none


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """The objective about some values."""

    values: FloatArray  # (k,)
    cost: float  # minus the nats won
    curvature: FloatArray  # (f, f), of the data
    slope: FloatArray  # (f,), downhill
    taken: FloatArray  # (board,)


def refit(
    projection: Projection,
    term: Term,
    place: str | None,
    starts: Sequence[FloatArray],
    about: bool = False,
) -> Weighed | None:
    """Fit a cause from each of some rows of its bank; return the best, None if all fail.

    Args:
        projection: the space beside the fit.
        term: the cause.
        place: its sizes at this place alone; None: all.
        starts: values (k,) each; sizes that are not fitted are taken as zero.
        about: look for the event by its exact effect too, which is not smooth in its time.
    """
    sizes = np.array(indices(term, place, "size"), dtype=np.int64)
    shapes = np.array(indices(term, place, "shape"), dtype=np.int64)
    events = indices(term, role="event")
    best: _State | None = None
    timed: _State | None = None
    for start in starts:
        values = _only(term, start, sizes)
        if events:
            values = _timed(projection, term, values, sizes, events[0])
        elif not values[sizes].any():
            values = _sized(projection, term, values, sizes)
        state = _descend(projection, term, values, np.concatenate([sizes, shapes]))
        freed = state
        if events:
            if about:
                state = _about(projection, term, state, np.concatenate([sizes, shapes]), events[0])
            wide = np.concatenate([sizes, shapes, np.array(events, dtype=np.int64)])
            freed = _descend(projection, term, state.values, wide)
            state = _state(projection, term, freed.values, np.concatenate([sizes, shapes]))
        if best is None or state.cost < best.cost:
            best, timed = state, freed
    if best is None or timed is None:
        return None
    weighed = _weighed(projection, term, place, best, sizes, shapes)
    if not events:
        return weighed
    std = _event_std(projection, term, timed, sizes, events[0])
    return replace(
        weighed, event_std=std, evidence=weighed.evidence + _timely(projection, term, std)
    )


def _timely(projection: Projection, term: Term, event_std: float) -> float:
    """Return Occam's factor of an event's time in nats: it could have been at any other."""
    first, last = _during(projection, term)
    return min(
        0.0, float(np.log(np.sqrt(2.0 * np.pi) * max(event_std, NO_TIME_S) / (last - first)))
    )


def _only(term: Term, start: FloatArray, sizes: IntArray) -> FloatArray:
    values = start.copy()
    values[[k for k in indices(term, role="size") if k not in sizes]] = 0.0
    return values


def _sized(projection: Projection, term: Term, values: FloatArray, sizes: IntArray) -> FloatArray:
    """Return values with the sizes that are best to first order."""
    every = indices(term, role="size")
    at = [every.index(k) for k in sizes]
    white = projection.signals(lambda scene: term.directions(scene, values)[at], term=term)
    found = values.copy()
    found[sizes] = Seen.of(projection.look(white)).values
    return _inside(projection, term, found)


def _timed(
    projection: Projection, term: Term, values: FloatArray, sizes: IntArray, event: int
) -> FloatArray:
    """Return values at the best time near the one given, sizes to first order."""
    every = indices(term, role="size")
    at = [every.index(k) for k in sizes]
    setting = _setting(projection, term)
    step_s = (setting.end_s - setting.begin_s) / 60.0
    best, statistic = values, -1.0
    for _ in range(LEVELS):
        middle = float(best[event])
        for shift in np.arange(-PER_LEVEL, PER_LEVEL + 1) / PER_LEVEL:
            trial = values.copy()
            trial[event] = middle + shift * step_s

            def signal(scene: Scene, trial: FloatArray = trial) -> FloatArray:
                return term.directions(scene, trial)[at]

            seen = Seen.of(projection.look(projection.signals(signal, term=term)))
            if seen.statistic > statistic:
                statistic = seen.statistic
                trial[sizes] = seen.values
                best = _inside(projection, term, trial)
        step_s /= PER_LEVEL
    return best


def _about(projection: Projection, term: Term, state: _State, free: IntArray, event: int) -> _State:
    """Return the state with its event where the exact effect fits best, near and less near.

    To first order a large step in the middle of a move is as good as one before it.
    """
    best = state
    for _ in range(LEVELS):
        now = best
        for shift_s in (sign * away for away in ABOUT_S for sign in (-1.0, 1.0)):
            trial = now.values.copy()
            trial[event] += shift_s
            there = _descend(projection, term, _inside(projection, term, trial), free)
            if there.cost < best.cost - ENOUGH:
                best = there
        if best is now:
            break
    return best


def _event_std(
    projection: Projection, term: Term, state: _State, sizes: IntArray, event: int
) -> float:
    """Return the deviation of an event's time, s; `state` has it free, last.

    Where the likelihood is no smooth hill (a small step in noise, a stamp that jumps while
    all is at rest) it is the scatter of the times about, each by its likelihood.
    """
    variance = float(np.linalg.pinv(state.curvature, hermitian=True)[-1, -1])
    if state.curvature[-1, -1] > 0.0 and 0.0 < variance < NEAR_S**2:
        return float(np.sqrt(variance))
    every = indices(term, role="size")
    at = [every.index(k) for k in sizes]
    setting = _setting(projection, term)
    now = float(state.values[event])
    away = np.geomspace(0.5 * NEAR_S, setting.end_s - setting.begin_s, LOOKS_PER_SIDE)
    times = now + np.concatenate([-away[::-1], [0.0], away])
    times = times[(times >= setting.begin_s) & (times <= setting.end_s)]
    statistics = []
    for time_s in times:
        trial = state.values.copy()
        trial[event] = time_s

        def signal(scene: Scene, trial: FloatArray = trial) -> FloatArray:
            return term.directions(scene, trial)[at]

        seen = Seen.of(projection.look(projection.signals(signal, term=term)))
        statistics.append(seen.statistic)
    weight = np.exp(0.5 * (np.array(statistics) - max(statistics))) * np.gradient(times)
    return float(np.sqrt(np.sum(weight * (times - now) ** 2) / np.sum(weight)))


def _inside(projection: Projection, term: Term, values: FloatArray) -> FloatArray:
    own = value_parameters(term)
    low, high = np.array([p.lower for p in own]), np.array([p.upper for p in own])
    for k in indices(term, role="event"):
        low[k], high[k] = _during(projection, term)
    return np.clip(values, low, high)


def _during(projection: Projection, term: Term) -> tuple[float, float]:
    """Return when an event of a cause can be.

    What stays after it is told from what was before: where the gain or the time offset stays
    changed there must be a whole move on either side, or the fit's own follows it as well,
    and at any size.
    """
    setting = _setting(projection, term)
    if term.link in STAYING and len(setting.courses) > 2:
        first = min(float(course.end_s) for _, course in setting.courses)
        last = max(float(course.start_s[0]) for _, course in setting.courses)
        if first < last:
            return first, last
    return setting.begin_s, setting.end_s


def _setting(projection: Projection, term: Term) -> Setting:
    """Return the setting of the first recording that a cause acts in."""
    return next(scene.setting for scene in projection.scenes if acts_in(term, scene))


def _state(projection: Projection, term: Term, values: FloatArray, free: IntArray) -> _State:
    looked = projection.look(projection.fitted(term, values, free))
    f = free.size
    cost = 0.5 * float(looked.information[f, f]) - float(looked.score[f])
    slope = looked.score[:f] - looked.information[:f, f]
    own = value_parameters(term)
    # Shapes that the data say nothing of stay near where real rigs have them.
    held = np.array([_tightness(own[k].role, own[k].prior_std) for k in free])
    begin = np.array([own[k].start for k in free])
    away = values[free] - begin
    return _State(
        values,
        cost + 0.5 * float(held @ away**2),
        looked.information[:f, :f] + np.diag(held),
        slope - held * away,
        looked.taken[f],
    )


def _tightness(role: str, prior_std: float) -> float:
    return prior_std**-2.0 if role == "shape" and np.isfinite(prior_std) else 0.0


def _descend(projection: Projection, term: Term, values: FloatArray, free: IntArray) -> _State:
    now = _state(projection, term, values, free)
    own = value_parameters(term)
    typical = np.array([own[k].typical for k in free])
    damping, refused = FIRST_DAMPING, False
    for _ in range(ROUNDS):
        scale = np.maximum(np.diag(now.curvature), 1e-12 / typical**2)
        moving = ~_held(term, now, free)
        if not moving.any():
            break
        at = np.flatnonzero(moving)
        damped = now.curvature[np.ix_(at, at)] + damping * np.diag(scale[at])
        step = np.zeros(free.size)
        step[at] = np.linalg.lstsq(damped, now.slope[at], rcond=None)[0]
        promised = float(now.slope @ step - 0.5 * step @ now.curvature @ step)
        if promised < (ENOUGH if refused else NOTHING):
            break
        trial = now.values.copy()
        trial[free] += step
        trial = _inside(projection, term, trial)
        if np.array_equal(trial, now.values):
            break
        after = _state(projection, term, trial, free)
        if after.cost < now.cost:
            won = now.cost - after.cost
            now, damping = after, max(damping * 0.1, LEAST_DAMPING)
            refused = False
            if won < ENOUGH:
                break
        else:
            refused = True
            damping *= 10.0
            if damping > MOST_DAMPING:
                break
    return now


def _held(term: Term, state: _State, free: IntArray) -> BoolArray:
    """Return which values lie at a bound that the slope pushes them through."""
    own = value_parameters(term)
    low = np.array([own[k].lower for k in free])
    high = np.array([own[k].upper for k in free])
    value = state.values[free]
    return np.asarray(
        ((value <= low) & (state.slope < 0.0)) | ((value >= high) & (state.slope > 0.0))
    )


def _weighed(
    projection: Projection,
    term: Term,
    place: str | None,
    state: _State,
    sizes: IntArray,
    shapes: IntArray,
) -> Weighed:
    own = value_parameters(term)
    free = np.concatenate([sizes, shapes])
    setting = _setting(projection, term)
    evidence = -state.cost
    width = np.empty(free.size)
    for k, index in enumerate(free):
        p = own[index]
        if p.role == "size":
            width[k] = p.prior_std
            relative = float(state.values[index]) / p.typical
            evidence -= float(np.log(np.pi * p.typical * (1.0 + relative**2)))
        else:
            span = p.upper - p.lower
            width[k] = span if np.isfinite(span) else setting.end_s - setting.begin_s
            evidence -= float(np.log(width[k]))
    inside = state.curvature + np.diag(width**-2.0)
    covariance = np.linalg.pinv(inside, hermitian=True)
    evidence += 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
    held = _held(term, state, free)
    value = state.values[free]
    at_zero = np.array([own[k].role == "size" for k in free]) & (value == 0.0)
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    pushed = np.where(held & ~at_zero, state.slope, 0.0)
    pushed[sizes.size :] = 0.0
    # An estimate scatters: that of a truth near a bound lies beyond it half of the time.
    outside = 0.5 * float(pushed @ covariance @ pushed) > BEYOND_NATS
    return Weighed(
        extension=Extension(term, state.values, free),
        place=place,
        won=-state.cost,
        evidence=evidence,
        std=std,
        taken=state.taken,
        impossible=outside
        or _at_an_end(projection, term, state.values)
        or _parted(term, value, free, std)
        or _drifting(projection, term, state.values),
    )


def _at_an_end(projection: Projection, term: Term, values: FloatArray) -> bool:
    """Return whether an event that would have to stay lies where it would rather be outside."""
    events = indices(term, role="event")
    if term.link not in STAYING or not events:
        return False
    during = _during(projection, term)
    return any(float(values[k]) in during for k in events)


def _drifting(projection: Projection, term: Term, values: FloatArray) -> bool:
    """Return whether a line is so slow where it is folded to that any drift passes for it."""
    if term.cause != "supply_hum":
        return False
    setting = _setting(projection, term)
    rate_hz = projection.stretches[0].noise.sampling.rate_hz
    line = values[indices(term, role="shape")]
    return bool(np.all(waves(line, rate_hz, setting.end_s - setting.begin_s) < FEWEST_WAVES))


def _parted(term: Term, value: FloatArray, free: IntArray, std: FloatArray) -> bool:
    """Return whether a count is surely none: further from 1, 2, 3 ... than it may be off."""
    own = value_parameters(term)
    counts = np.array([own[k].whole for k in free], dtype=np.bool_)
    off = np.abs(value - np.maximum(np.round(np.abs(value)), 1.0) * np.where(value < 0, -1.0, 1.0))
    return bool(np.any(counts & (value != 0.0) & (off > SURE * std)))
