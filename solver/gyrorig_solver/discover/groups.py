"""Nameless tests: does a residual depend on an angle, a speed, the time, a transient?

A smooth function of each covariate, as a sum of hats, is projected off all that a fit can
follow, like a cause. What is significant here and explained by no cause is "unexplained,
depends on X".

What to use when: `signatures` for the mean; `scatter` for what shows in the variance only.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.chance import chi2_tail, normal_tail
from gyrorig_solver.discover.result import Signature
from gyrorig_solver.discover.scores import Seen
from gyrorig_solver.discover.wandering import risen
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.sample_jitter import SampleJitter
from gyrorig_solver.model.terms.scene import Scene, by_axis

PAN_KNOTS, TILT_KNOTS, SPEED_KNOTS, RATE_KNOTS, TIME_KNOTS, FEW_KNOTS = 24, 8, 6, 7, 10, 6
TRANSIENT_S, TRANSIENT_KNOTS = 0.5, 9
LEAST_SPAN = 1e-6  # of a covariate: what does not change, nothing can depend on
SINGLE = 4  # tests of the scatter
WORTH_A_LOOK = 0.05  # by calmed levels


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    covariate: str
    words: str
    signal: Callable[[Scene], FloatArray]


def signatures(projection: Projection, as_found: Projection | None = None) -> list[Signature]:
    """Return all nameless tests of a residual, the least likely by chance first.

    Args:
        projection: the space beside the fit.
        as_found: where its noise levels are calmed, the same with those that were found:
            what passes for odd must make the likelihood rise, the levels found anew.
    """
    groups = list(_groups(projection.scenes))
    tests = len(groups) + SINGLE
    found = scatter(as_found or projection, tests)
    for group in groups:
        white = projection.signals(group.signal)
        seen = Seen.of(projection.look(white))
        if seen.degrees_of_freedom:
            p_value = chi2_tail(seen.statistic, seen.degrees_of_freedom)
            if as_found is not None and p_value * tests < WORTH_A_LOOK:
                rise = 2.0 * max(risen(projection, white, seen.values), 0.0)
                seen = replace(seen, statistic=min(rise, seen.statistic))
                p_value = chi2_tail(seen.statistic, seen.degrees_of_freedom)
            found.append(
                Signature(
                    group.covariate,
                    group.words,
                    seen.statistic,
                    seen.degrees_of_freedom,
                    min(1.0, p_value * tests),
                )
            )
    return sorted(found, key=lambda one: (one.p_value, -one.statistic))


def scatter(projection: Projection, tests: int) -> list[Signature]:
    """Return the tests of the whitened residual's variance and of single lines.

    Args:
        projection: the space beside the fit.
        tests: among which all false alarms are shared.
    """
    left = projection.left(projection.residual)
    found: list[Signature] = []
    moving, jitter, power = _shapes(projection)
    some = power > 0.0
    excess = left**2 - 1.0
    for name, words, shape in (
        ("moving", "on whether the stage moves, in its scatter", moving),
        ("acceleration_scatter", "on the acceleration, in its scatter", jitter),
    ):
        weight = np.where(some, shape, 0.0)
        weight[some] -= weight[some].mean()
        size = float(np.sqrt(2.0 * np.sum(weight**2)))
        if size > 0.0:
            z = float(weight @ excess) / size
            # What a model lacks adds scatter; it takes none away.
            p_value = normal_tail(z)
            found.append(Signature(name, words, max(z, 0.0) ** 2, 1, min(1.0, p_value * tests)))
    found.append(_line(projection, left, tests))
    return found


def _shapes(projection: Projection) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return, as long as the whitened residual: motion, variance by jitter, and use."""
    moving, jitter, use = [], [], []
    for s in projection.stretches:
        for scene, model in zip(s.scenes, s.models, strict=True):
            n = model.used.size
            speed = np.linalg.norm(model.rate, axis=1) > 1e-3
            own = (
                SampleJitter().variance(scene, np.ones(1)).T
                / np.mean(s.noise.variance(n), axis=0)[:, None]
            )
            moving.append(np.tile(speed.astype(np.float64), (3, 1)).ravel())
            jitter.append(own.ravel())
            use.append(np.tile(model.used.astype(np.float64), (3, 1)).ravel())
    return np.concatenate(moving), np.concatenate(jitter), np.concatenate(use)


def _line(projection: Projection, left: FloatArray, tests: int) -> Signature:
    """Return the test for a single line in the spectrum of any axis."""
    best, many, start = (0.0, 0.0), 0, 0
    for s in projection.stretches:
        for used in s.used:
            n = used.size
            white = left[start : start + 3 * n].reshape(3, n)
            start += 3 * n
            power = np.abs(np.fft.rfft(white, axis=1)[:, 1:-1]) ** 2 / n
            many += power.size
            at = np.unravel_index(int(np.argmax(power)), power.shape)
            hertz = float(at[1] + 1) / n * s.noise.sampling.rate_hz
            best = max(best, (float(power[at]), hertz))
    p_value = -np.expm1(many * np.log1p(-np.exp(-best[0]))) if many else 1.0
    words = f"on a line at {best[1]:.2f} Hz"
    return Signature("line", words, 2.0 * best[0], 2, min(1.0, float(p_value) * tests))


def _groups(scenes: list[Scene]) -> Iterator[_Group]:
    angles = all(scene.has_angles for scene in scenes)
    time = _knots(scenes, _time, TIME_KNOTS)
    yield _Group("time", "on the time, as a gain", partial(_gain, _time, time))
    few = _knots(scenes, _time, FEW_KNOTS)
    yield _Group("bias_time", "on the time, as a bias", partial(_bias, _time, few))
    speed = _knots(scenes, _speed, SPEED_KNOTS)
    if speed.size:  # a board at rest has no speeds
        yield _Group("speed", "on the speed, as a gain", partial(_gain, _speed, speed))
    largest = _largest(scenes)
    if float(largest.max()) > LEAST_SPAN:
        yield _Group("own_rate", "on each axis' own rate", partial(_own, largest))
    if not angles:
        return
    for axis, name, knots in ((0, "pan", PAN_KNOTS), (1, "tilt", TILT_KNOTS)):
        of = partial(_angle, axis)
        at = _knots(scenes, of, knots)
        if at.size:
            yield _Group(f"{name}_angle", f"on {name}, as a gain", partial(_gain, of, at))
            few = _knots(scenes, of, FEW_KNOTS)
            yield _Group(f"bias_{name}", f"on {name}, as a bias", partial(_bias, of, few))
    courses = scenes[0].setting.courses
    if not courses:
        return
    for axis, name in ((0, "pan"), (1, "tilt")):
        own = [course for moved, course in courses if moved == axis]
        if own:
            begin = np.array([float(c.start_s[0]) for c in own])
            end = np.array([float(c.end_s) for c in own])
            signal = partial(_transient, axis, begin, end)
            yield _Group(f"{name}_transient", f"on the time since {name} starts or stops", signal)
    spans = np.array([(float(c.start_s[0]), float(c.end_s)) for _, c in courses])
    yield _Group("move_gain", "on the move, as a gain", partial(_by_move, spans, False))
    yield _Group("move_delay", "on the move, as a delay", partial(_by_move, spans, True))


def _time(scene: Scene) -> FloatArray:
    return scene.time_s


def _angle(axis: int, scene: Scene) -> FloatArray:
    return scene.pan_rad if axis == 0 else scene.tilt_rad


def _speed(scene: Scene) -> FloatArray:
    return np.asarray(np.linalg.norm(scene.rate_rad_s, axis=1), dtype=np.float64)


def _knots(scenes: list[Scene], of: Callable[[Scene], FloatArray], count: int) -> FloatArray:
    values = [of(scene)[scene.known] for scene in scenes]
    low = min(float(v.min()) for v in values)
    high = max(float(v.max()) for v in values)
    return np.linspace(low, high, count) if high - low > LEAST_SPAN else np.zeros(0)


def _largest(scenes: list[Scene]) -> FloatArray:
    found = [np.abs(scene.filtered_rad_s).max(axis=0) for scene in scenes]
    return np.asarray(np.max(found, axis=0), dtype=np.float64)


def _hats(x: FloatArray, knots: FloatArray) -> FloatArray:
    """Return hats, 1 at their own knot and 0 at the others, (k, n)."""
    width = knots[1] - knots[0]
    return np.asarray(np.clip(1.0 - np.abs(x - knots[:, None]) / width, 0.0, None), np.float64)


def _gain(of: Callable[[Scene], FloatArray], knots: FloatArray, scene: Scene) -> FloatArray:
    hats = _hats(of(scene), knots)
    return scene.read(hats[:, :, None] * scene.filtered_rad_s)


def _bias(of: Callable[[Scene], FloatArray], knots: FloatArray, scene: Scene) -> FloatArray:
    seen = scene.read(np.repeat(_hats(of(scene), knots)[:, :, None], 3, axis=2))
    return np.concatenate([by_axis(one) for one in seen])


def _own(largest: FloatArray, scene: Scene) -> FloatArray:
    rate = scene.filtered_rad_s
    found = []
    for axis in range(3):
        knots = np.linspace(-largest[axis], largest[axis], RATE_KNOTS)
        if largest[axis] <= LEAST_SPAN:
            continue
        shown = np.zeros((RATE_KNOTS, scene.n, 3))
        shown[:, :, axis] = _hats(rate[:, axis], knots)
        found.append(scene.read(shown))
    return np.concatenate(found)


def _transient(axis: int, begin: FloatArray, end: FloatArray, scene: Scene) -> FloatArray:
    """Return shapes after starts and stops of an axis, signed by its direction."""
    delta = np.diff(scene.angle_rad[axis])
    found = np.zeros((2 * TRANSIENT_KNOTS, scene.n, 3))
    knots = np.linspace(0.0, TRANSIENT_S, TRANSIENT_KNOTS)
    stage = np.zeros((scene.n, 3))
    if axis == 0:
        stage[:, 1], stage[:, 2] = np.sin(scene.tilt_rad), np.cos(scene.tilt_rad)
    else:
        stage[:, 0] = 1.0
    along = stage @ scene.gain.T
    for first, last in zip(begin, end, strict=True):
        inside = slice(*np.searchsorted(scene.time_s, (first, last)))
        sign = float(np.sign(np.sum(delta[inside])))
        for row, edge in ((0, first), (TRANSIENT_KNOTS, last)):
            near = slice(*np.searchsorted(scene.time_s, (edge, edge + TRANSIENT_S)))
            hats = _hats(scene.time_s[near] - edge, knots) * sign
            found[row : row + TRANSIENT_KNOTS, near] += hats[:, :, None] * along[near]
    return scene.read(found)


def _by_move(spans: FloatArray, delay: bool, scene: Scene) -> FloatArray:
    signal = scene.filtered_slope_rad_s2 if delay else scene.filtered_rad_s
    found = np.zeros((len(spans), scene.n, 3))
    for k, (begin, end) in enumerate(spans):
        near = slice(*np.searchsorted(scene.time_s, (begin, end + 0.1)))
        found[k, near] = signal[near]
    return scene.read(found)
