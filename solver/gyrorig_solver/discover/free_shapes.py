"""Smooth functions of what a residual may hang on, without a form that a cause gives them.

Each family is a set of signals at a sensor, ordered by how fast they change with their
covariate (an angle, a rate, the time, the time since a move began): half waves over its
range. What a free function finds is "depends on X"; a named cause that leaves something
to the free function of its own covariate has the wrong form.

What to use when: `families` for all that a recording can be asked; `swells` for a cause's
own effect, made to grow and shrink with what it must not hang on.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.estimate.stretch import AT_ONCE
from gyrorig_solver.model.terms.protocol import Term
from gyrorig_solver.model.terms.scene import Scene

Covariate = Callable[[Scene], FloatArray]  # to (n,)

# Half waves: a turn of pan has 16 of what comes eight times a turn; a bias' jumps are sharp.
PAN_WAVES, TILT_WAVES, SPEED_WAVES, TIME_WAVES, BIAS_WAVES, POSE_WAVES = 24, 8, 6, 10, 24, 8
ACROSS = 2  # half waves over the other angle
HIGHEST_POWER = 7  # of a rate; the first is the gain's own
EDGE_S, EDGE_WAVES = 4.0, 8  # since a start or a stop: what is left after that is no edge's
SOON_S = 0.1  # from where on the time since an edge counts by ratios: a low-pass' width
SWELLS = 4  # half waves in which an effect may grow and shrink: faster is another effect
LEAST_SPAN = 1e-6  # of a covariate: what does not change, nothing can depend on


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Free functions of one covariate; there may be several of the same."""

    covariate: str
    words: str  # "on pan, as a gain"
    signals: tuple[Callable[[Scene], FloatArray], ...]  # each to (some of k, blocks, 3)
    detail: FloatArray  # (k,), half waves of each signal: 1 is the smoothest

    def white(self, projection: Projection, term: Term | None = None) -> FloatArray:
        """Return its signals in units of the noise, (k, all).

        Args:
            projection: the space beside a fit.
            term: of the scenes as this cause finds them; None: as the unit believes them.
        """
        found = np.empty((self.detail.size, projection.residual.size))
        at = 0
        for signal in self.signals:
            some = projection.signals(signal, term=term)
            found[at : at + len(some)] = some
            at += len(some)
        return found


def families(scenes: Sequence[Scene]) -> Iterator[Family]:
    """Yield the families that recordings can be asked.

    Args:
        scenes: all parts of all recordings that are fitted together.
    """
    time = _span(scenes, _time)
    yield _gain("time", "on the time, as a gain", _time, time, TIME_WAVES)
    yield _bias("bias_time", "on the time, as a bias", [(_time, time, BIAS_WAVES)])
    speed = _span(scenes, _speed)
    if speed is not None:  # a board at rest has no speeds
        yield _of_speed(speed)
        yield _of_rates(scenes)
    if not all(scene.has_angles for scene in scenes):
        return
    spans = _span(scenes, _pan), _span(scenes, _tilt)
    for axis, name, count in ((0, "pan", PAN_WAVES), (1, "tilt", TILT_WAVES)):
        own, other = spans[axis], spans[1 - axis]
        if own is None:
            continue
        yield _gain(f"{name}_angle", f"on {name}, as a gain", _ANGLES[axis], own, count)
        poses = [(_ANGLES[axis], own, POSE_WAVES)]
        if other is not None:
            poses.append((_ANGLES[1 - axis], other, ACROSS))
        yield _bias(f"bias_{name}", f"on {name}, as a bias", poses)
    yield from _of_moves(scenes)


def swells(one: Extension, scenes: Sequence[Scene]) -> Iterator[Family]:
    """Yield a cause's effect, growing and shrinking with what it must not depend on.

    The signals are to be made of the scenes as the cause finds them.

    Args:
        one: the cause as fitted.
        scenes: all parts of all recordings that it was fitted to.
    """
    asked: list[tuple[str, Covariate]] = [("time", _time), ("speed", _speed)]
    if all(scene.has_angles for scene in scenes):
        asked += [("pan_angle", _pan), ("tilt_angle", _tilt)]
    for name, of in asked:
        span = _span(scenes, of)
        if span is not None:
            signal = partial(_swelling, one, of, span)
            yield Family(name, f"on {_WORDS[name]}, in its size", (signal,), _detail(SWELLS))


def _swelling(one: Extension, of: Covariate, span: tuple[float, float], scene: Scene) -> FloatArray:
    waves = _waves(of(scene), span, SWELLS)
    seen = scene.read(np.repeat(waves[:, :, None], 3, axis=2))
    return np.asarray(one.term.effect(scene, one.values) * seen, dtype=np.float64)


def _time(scene: Scene) -> FloatArray:
    return scene.time_s


def _pan(scene: Scene) -> FloatArray:
    return scene.pan_rad


def _tilt(scene: Scene) -> FloatArray:
    return scene.tilt_rad


def _speed(scene: Scene) -> FloatArray:
    return np.asarray(np.linalg.norm(scene.rate_rad_s, axis=1), dtype=np.float64)


_ANGLES: tuple[Covariate, Covariate] = (_pan, _tilt)
_WORDS = {"time": "the time", "speed": "the speed", "pan_angle": "pan", "tilt_angle": "tilt"}


def _span(scenes: Sequence[Scene], of: Covariate) -> tuple[float, float] | None:
    """Return a covariate's range, None where it does not change."""
    values = [v for v in (of(scene)[scene.known] for scene in scenes) if v.size]
    if not values:
        return None
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    return (low, high) if high - low > LEAST_SPAN else None


def _detail(count: int) -> FloatArray:
    return np.arange(1, count + 1, dtype=np.float64)


def _waves(x: FloatArray, span: tuple[float, float], count: int) -> FloatArray:
    """Return 1 to `count` half waves over a range, (count, n)."""
    share = np.clip((x - span[0]) / (span[1] - span[0]), 0.0, 1.0)
    return np.asarray(np.cos(np.pi * _detail(count)[:, None] * share), dtype=np.float64)


def _gain(
    name: str, words: str, of: Covariate, span: tuple[float, float] | None, count: int
) -> Family:
    def signal(scene: Scene) -> FloatArray:
        if span is None:
            return np.zeros((count, scene.blocks, 3))
        return scene.read(_waves(of(scene), span, count)[:, :, None] * scene.filtered_rad_s)

    return Family(name, words, (signal,), _detail(count))


def _bias(
    name: str, words: str, of: Sequence[tuple[Covariate, tuple[float, float] | None, int]]
) -> Family:
    """Return a bias of each axis that is a product of waves over one or two covariates."""
    counts = [count for _, span, count in of if span is not None]
    details = [_detail(count) if k == 0 else np.r_[0.0, _detail(count)] for k, count in
               enumerate(counts)]  # fmt: skip
    detail = details[0]
    for more in details[1:]:
        detail = (detail[:, None] + more).ravel()

    def signal(scene: Scene) -> FloatArray:
        made = np.ones((1, scene.n))
        for k, (covariate, span, count) in enumerate(of):
            if span is None:
                return np.zeros((3 * detail.size, scene.blocks, 3))
            waves = _waves(covariate(scene), span, count)
            if k:
                waves = np.concatenate([np.ones((1, scene.n)), waves])
            made = (made[:, None] * waves).reshape(-1, scene.n)
        return _on_each_axis(scene, made)

    return Family(name, words, (signal,), np.repeat(detail, 3))


def _on_each_axis(scene: Scene, waves: FloatArray) -> FloatArray:
    """Return signals (k, n) as biases of each axis, (3 k, blocks, 3)."""
    seen = scene.read(np.repeat(waves[:, :, None], 3, axis=2))
    found = np.zeros((len(waves), 3, scene.blocks, 3))
    for axis in range(3):
        found[:, axis, :, axis] = seen[:, :, axis]
    return found.reshape(-1, scene.blocks, 3)


def _of_speed(span: tuple[float, float]) -> Family:
    """Return a gain and a delay that depend on how fast the stage turns."""

    def signal(scene: Scene) -> FloatArray:
        waves = _waves(_speed(scene), span, SPEED_WAVES)[:, :, None]
        gain = waves * scene.filtered_rad_s
        return scene.read(np.concatenate([gain, waves * scene.filtered_slope_rad_s2]))

    detail = np.tile(_detail(SPEED_WAVES), 2)
    return Family("speed", "on the speed, as a gain or a delay", (signal,), detail)


def _of_rates(scenes: Sequence[Scene]) -> Family:
    """Return powers of each axis' own rate, and products of two axes' rates."""
    every = [np.abs(scene.filtered_rad_s).max(axis=0) for scene in scenes]
    largest = np.maximum(np.max(every, axis=0), LEAST_SPAN)
    powers = range(2, HIGHEST_POWER + 1)
    pairs = [(i, j) for i in range(3) for j in range(i + 1)]

    def signal(scene: Scene) -> FloatArray:
        share = scene.filtered_rad_s / largest
        made = np.zeros((3 * (len(powers) + len(pairs)), scene.n, 3))
        at = 0
        for power in powers:
            values = np.polynomial.Legendre.basis(power)(share)
            for axis in range(3):
                made[at, :, axis] = values[:, axis]
                at += 1
        for i, j in pairs:
            for axis in range(3):
                made[at, :, axis] = share[:, i] * share[:, j]
                at += 1
        return scene.read(made)

    detail = np.repeat([*(p - 1.0 for p in powers), *(2.0 for _ in pairs)], 3)
    return Family("own_rate", "on the rates about the axes", (signal,), detail)


def _of_moves(scenes: Sequence[Scene]) -> Iterator[Family]:
    """Yield what hangs on the moves: the time since they began or ended, and each alone."""
    courses = scenes[0].setting.courses
    if not courses:
        return
    for axis, name in ((0, "pan"), (1, "tilt")):
        own = [course for moved, course in courses if moved == axis]
        if own:
            begin = np.array([float(c.start_s[0]) for c in own])
            end = np.array([float(c.end_s) for c in own])
            yield Family(
                f"{name}_transient",
                f"on the time since {name} starts or stops",
                (partial(_edges, axis, begin, end),),
                np.tile(_detail(EDGE_WAVES), 3),
            )
    spans = np.array([(float(c.start_s[0]), float(c.end_s)) for _, c in courses])
    for delay, name in ((False, "gain"), (True, "delay")):
        # So many that only a few are there unwhitened at a time.
        each = tuple(
            partial(_by_move, spans[at : at + AT_ONCE], delay)
            for at in range(0, len(spans), AT_ONCE)
        )
        yield Family(f"move_{name}", f"on the move, as a {name}", each, np.ones(len(spans)))
    yield Family(
        "move_gain",
        "on the time since a move began, as a gain",
        (partial(_settling, np.sort(spans[:, 0])),),
        _detail(EDGE_WAVES),
    )


def _settling(begin: FloatArray, scene: Scene) -> FloatArray:
    """Return waves in the time since any axis began to move, as a gain."""
    last = np.searchsorted(begin, scene.time_s, side="right") - 1
    since = np.where(last >= 0, scene.time_s - begin[np.maximum(last, 0)], EDGE_S)
    return scene.read(_since(since)[:, :, None] * scene.filtered_rad_s)


def _since(elapsed_s: FloatArray) -> FloatArray:
    """Return waves in the time since an edge, by ratios of it, that end at zero."""
    share = np.log1p(np.clip(elapsed_s, 0.0, EDGE_S) / SOON_S) / np.log1p(EDGE_S / SOON_S)
    return np.asarray(np.cos(np.pi * (_detail(EDGE_WAVES)[:, None] - 0.5) * share), np.float64)


def _edges(axis: int, begin: FloatArray, end: FloatArray, scene: Scene) -> FloatArray:
    """Return waves in the time since starts and stops, by ratios of it.

    Signed by the move's direction after starts and after stops, and as a gain after starts.
    """
    stage = np.zeros((scene.n, 3))
    if axis == 0:
        stage[:, 1], stage[:, 2] = np.sin(scene.tilt_rad), np.cos(scene.tilt_rad)
    else:
        stage[:, 0] = 1.0
    along = stage @ scene.gain.T
    delta = np.diff(scene.angle_rad[axis])
    found = np.zeros((3, EDGE_WAVES, scene.n, 3))
    for k, (first, last) in enumerate(zip(begin, end, strict=True)):
        inside = slice(*np.searchsorted(scene.time_s, (first, last)))
        sign = float(np.sign(np.sum(delta[inside])))
        until = begin[k + 1] if k + 1 < begin.size else np.inf
        for edge, stop in ((first, until), (last, until)):
            near = slice(*np.searchsorted(scene.time_s, (edge, min(edge + EDGE_S, stop))))
            waves = _since(scene.time_s[near] - edge)[:, :, None]
            found[0 if edge == first else 1, :, near] += sign * waves * along[near]
            if edge == first:
                found[2, :, near] += waves * scene.filtered_rad_s[near]
    return scene.read(found.reshape(-1, scene.n, 3))


def _by_move(spans: FloatArray, delay: bool, scene: Scene) -> FloatArray:
    signal = scene.filtered_slope_rad_s2 if delay else scene.filtered_rad_s
    found = np.zeros((len(spans), scene.n, 3))
    for k, (begin, end) in enumerate(spans):
        near = slice(*np.searchsorted(scene.time_s, (begin, end + 0.1)))
        found[k, near] = signal[near]
    return scene.read(found)
