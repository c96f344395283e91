"""Smooth basis functions of covariates, as nonparametric alternatives to a cause's form.

Each family is a set of signals of a sensor, ordered by detail: half waves over the range of a
covariate (an angle, a rate, the time, the time since a move started). A significant family means
"depends on X". If the covariate of a named cause explains the residual, the cause has a wrong form.

What to use when: `smooth_families` for all families of a recording; `modulated_effects` for a
cause's own effect, modulated by covariates on which its size must not depend.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.checks.basis_family import BasisFamily, families_by_recording
from gyrorig_solver.discover.checks.windowed_signals import Windows
from gyrorig_solver.estimate import FittedTerm, SignalFunction
from gyrorig_solver.model import AxisBiases, Signals, SignalState, split_axes, zero_signals
from gyrorig_solver.model.signal_arrays import on_all_axes

Covariate = Callable[[SignalState], FloatArray]  # to (n,)

# Half waves. Eight periods per turn are 16 half waves of pan; jumps of a bias need many half waves.
PAN_WAVES, TILT_WAVES, SPEED_WAVES, TIME_WAVES, BIAS_WAVES, POSE_WAVES = 24, 8, 6, 10, 24, 8
MOVE_AFTERMATH_S = 0.1  # after the end of a move, in which the low-pass output contains the move
MOVES_PER_BATCH = 8  # moves whose signals are in memory at a time
CROSS_WAVES = 2  # half waves over the other angle
MAX_RATE_POWER = 7  # largest power of a rate; the first power is the gain
EDGE_WINDOW_S, EDGE_WAVES = 4.0, 8  # after a start or a stop; a later effect has another cause
EDGE_TIME_CONSTANT_S = 0.1  # width of a low-pass; beyond it, the scale of the time is logarithmic
MODULATION_WAVES = 4  # half waves of a change of size; a faster change is another effect
MIN_COVARIATE_SPAN = 1e-6  # nothing can depend on a covariate with a smaller span


def smooth_families(scenes: Sequence[SignalState]) -> Iterator[BasisFamily]:
    """Yield the families that some recordings can test.

    Args:
        scenes: all parts of all recordings that are fitted together.
    """
    yield from families_by_recording(scenes, _time_families)
    speed = _covariate_span(scenes, _speed)
    if speed is not None:  # a board at rest has no speeds
        yield _speed_family(speed)
        yield _rate_family(scenes)
    if any(scene.lacks_angles for scene in scenes):
        return
    spans = _covariate_span(scenes, _pan), _covariate_span(scenes, _tilt)
    for axis, name, count in ((0, "pan", PAN_WAVES), (1, "tilt", TILT_WAVES)):
        span, other_span = spans[axis], spans[1 - axis]
        if span is None:
            continue
        yield _gain_family(
            f"{name}_angle", f"on {name} (the gain changes)", _ANGLES[axis], span, count
        )
        poses = [(_ANGLES[axis], span, POSE_WAVES)]
        if other_span is not None:
            poses.append((_ANGLES[1 - axis], other_span, CROSS_WAVES))
        yield _bias_family(f"bias_{name}", f"on {name} (the bias changes)", poses)
    yield from _move_families(scenes)


def modulated_effects(
    extension: FittedTerm, scenes: Sequence[SignalState]
) -> Iterator[BasisFamily]:
    """Yield a cause's effect, modulated by covariates on which its size must not depend.

    Evaluate the signals at the signal states at the input of the cause.

    Args:
        extension: the cause as fitted.
        scenes: all parts of all recordings that it was fitted to.
    """
    covariates: list[tuple[str, str, Covariate]] = [("speed", "the speed", _speed)]
    if not any(scene.lacks_angles for scene in scenes):
        covariates += [("pan_angle", "pan", _pan), ("tilt_angle", "tilt", _tilt)]

    def families_of_time(of_recording: Sequence[SignalState], text: str) -> list[BasisFamily]:
        return _modulated_families(extension, of_recording, [("time", text, _time)])

    yield from families_by_recording(scenes, families_of_time)
    yield from _modulated_families(extension, scenes, covariates)


def _modulated_families(
    extension: FittedTerm,
    scenes: Sequence[SignalState],
    covariates: Sequence[tuple[str, str, Covariate]],
) -> list[BasisFamily]:
    """Return the effect modulated by covariates; `covariates`: name, text and values of each."""
    spans = [_covariate_span(scenes, covariate) for _, _, covariate in covariates]
    return [
        BasisFamily(
            name,
            f"on {text} (change of its size)",
            (partial(_modulated_effect, extension, covariate, span),),
            _wave_numbers(MODULATION_WAVES),
        )
        for (name, text, covariate), span in zip(covariates, spans, strict=True)
        if span is not None
    ]


def _modulated_effect(
    extension: FittedTerm, covariate: Covariate, span: tuple[float, float], scene: SignalState
) -> FloatArray:
    waves = _cosine_basis(covariate(scene), span, MODULATION_WAVES)
    modulation = scene.sample_output(on_all_axes(waves))
    return np.asarray(extension.term.effect(scene, extension.values) * modulation, dtype=np.float64)


def _time(scene: SignalState) -> FloatArray:
    return scene.time_s


def _pan(scene: SignalState) -> FloatArray:
    return scene.pan_rad


def _tilt(scene: SignalState) -> FloatArray:
    return scene.tilt_rad


def _speed(scene: SignalState) -> FloatArray:
    return np.asarray(np.linalg.norm(scene.rate_rad_s, axis=1), dtype=np.float64)


_ANGLES: tuple[Covariate, Covariate] = (_pan, _tilt)


def _covariate_span(
    scenes: Sequence[SignalState], covariate: Covariate
) -> tuple[float, float] | None:
    """Return a covariate's range; None if it does not change."""
    values = [v for v in (covariate(scene)[scene.motion_known] for scene in scenes) if v.size]
    if not values:
        return None
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    return (low, high) if high - low > MIN_COVARIATE_SPAN else None


def _wave_numbers(count: int) -> FloatArray:
    return np.arange(1, count + 1, dtype=np.float64)


def _cosine_basis(x: FloatArray, span: tuple[float, float], count: int) -> FloatArray:
    """Return a cosine basis of 1 to `count` half waves over a range, (count, n)."""
    share = np.clip((x - span[0]) / (span[1] - span[0]), 0.0, 1.0)
    waves = np.empty((count, x.size))
    waves[0] = np.cos(np.pi * share)
    # Chebyshev polynomials of the first wave, by their recursion.
    for k in range(1, count):
        np.multiply(2.0 * waves[0], waves[k - 1], out=waves[k])
        waves[k] -= waves[k - 2] if k > 1 else 1.0
    return waves


def _time_families(scenes: Sequence[SignalState], text: str) -> Iterator[BasisFamily]:
    span = _covariate_span(scenes, _time)
    yield _gain_family("time", f"on {text} (the gain changes)", _time, span, TIME_WAVES)
    yield _bias_family("bias_time", f"on {text} (the bias changes)", [(_time, span, BIAS_WAVES)])


def _gain_family(
    name: str, description: str, covariate: Covariate, span: tuple[float, float] | None, count: int
) -> BasisFamily:
    def signal(scene: SignalState) -> FloatArray:
        if span is None:
            return zero_signals(count, scene.block_count)
        return scene.sample_output(
            _cosine_basis(covariate(scene), span, count)[:, :, None] * scene.filtered_rad_s
        )

    return BasisFamily(name, description, (signal,), _wave_numbers(count))


def _bias_family(
    name: str,
    description: str,
    covariates: Sequence[tuple[Covariate, tuple[float, float] | None, int]],
) -> BasisFamily:
    """Return a bias of each axis as a product basis over one or two covariates."""
    counts = [count for _, span, count in covariates if span is not None]
    details = [_wave_numbers(count) if k == 0 else np.r_[0.0, _wave_numbers(count)] for k, count in
               enumerate(counts)]  # fmt: skip
    detail = details[0]
    for wave_numbers in details[1:]:
        detail = (detail[:, None] + wave_numbers).ravel()

    def signal(scene: SignalState) -> Signals:
        product = np.ones((1, scene.interval_count))
        for k, (covariate, span, count) in enumerate(covariates):
            if span is None:
                return AxisBiases(np.zeros((detail.size, scene.block_count)))
            waves = _cosine_basis(covariate(scene), span, count)
            if k:
                waves = np.concatenate([np.ones((1, scene.interval_count)), waves])
            product = (product[:, None] * waves).reshape(-1, scene.interval_count)
        return on_each_axis(scene, product)

    return BasisFamily(name, description, (signal,), np.repeat(detail, 3))


def on_each_axis(scene: SignalState, waves: FloatArray) -> AxisBiases:
    """Return signals (k, n) as biases of each axis."""
    return AxisBiases(scene.sample_output(waves[:, :, None])[:, :, 0])


def _speed_family(span: tuple[float, float]) -> BasisFamily:
    """Return a gain and a delay that depend on the speed of the stage."""

    def signal(scene: SignalState) -> FloatArray:
        waves = _cosine_basis(_speed(scene), span, SPEED_WAVES)[:, :, None]
        gain = waves * scene.filtered_rad_s
        return scene.sample_output(np.concatenate([gain, waves * scene.filtered_slope_rad_s2]))

    detail = np.tile(_wave_numbers(SPEED_WAVES), 2)
    return BasisFamily("speed", "on the speed (the gain or the delay changes)", (signal,), detail)


def _rate_family(scenes: Sequence[SignalState]) -> BasisFamily:
    """Return powers of each axis' own rate, and products of two axes' rates."""
    axis_maxima = [np.abs(scene.filtered_rad_s).max(axis=0) for scene in scenes]
    largest = np.maximum(np.max(axis_maxima, axis=0), MIN_COVARIATE_SPAN)
    powers = range(2, MAX_RATE_POWER + 1)
    pairs = [(i, j) for i in range(3) for j in range(i + 1)]

    def power_signals(power: int, scene: SignalState) -> FloatArray:
        values = np.polynomial.Legendre.basis(power)(scene.filtered_rad_s / largest)
        return split_axes(scene.sample_output(values))

    def pair_signals(scene: SignalState) -> Signals:
        share = scene.filtered_rad_s / largest
        return on_each_axis(scene, np.stack([share[:, i] * share[:, j] for i, j in pairs]))

    detail = np.repeat([*(p - 1.0 for p in powers), *(2.0 for _ in pairs)], 3)
    signals: tuple[SignalFunction, ...] = (
        *(partial(power_signals, power) for power in powers),
        pair_signals,
    )
    return BasisFamily("own_rate", "on the rates about the axes", signals, detail)


def _move_families(scenes: Sequence[SignalState]) -> Iterator[BasisFamily]:
    """Yield families of the moves: time since start or stop, and each move separately."""
    moved_axes = {axis for scene in scenes for axis, _ in scene.context.motion_profiles}
    if not moved_axes:
        return
    for axis, name in ((0, "pan"), (1, "tilt")):
        if axis in moved_axes:
            yield BasisFamily(
                f"{name}_transient",
                f"on the time since {name} starts or stops",
                (partial(_edge_transients, axis),),
                np.tile(_wave_numbers(EDGE_WAVES), 3),
            )
    windows = Windows.of_moves(scenes)
    for delay, name in ((False, "gain"), (True, "delay")):
        # The signals are many, so only a few of them are in memory unwhitened at a time.
        each = tuple(
            partial(_per_move_signals, windows[at : at + MOVES_PER_BATCH], delay)
            for at in range(0, len(windows), MOVES_PER_BATCH)
        )
        yield BasisFamily(
            f"move_{name}",
            f"on the move (the {name} changes)",
            each,
            np.ones(len(windows)),
            windows.extended(MOVE_AFTERMATH_S),
            partial(_moves_signal, delay),
        )
    yield BasisFamily(
        "move_gain",
        "on the time since a move began (the gain changes)",
        (partial(_gain_since_move_start, windows),),
        _wave_numbers(EDGE_WAVES),
    )


def _gain_since_move_start(moves: Windows, scene: SignalState) -> FloatArray:
    """Return a gain that depends on the time since an axis started to move."""
    begin = np.sort(moves[moves.in_recording_of(scene)].spans_s[:, 0])
    if not begin.size:
        return zero_signals(EDGE_WAVES, scene.block_count)
    last = np.searchsorted(begin, scene.time_s, side="right") - 1
    since = np.where(last >= 0, scene.time_s - begin[np.maximum(last, 0)], EDGE_WINDOW_S)
    return scene.sample_output(_edge_basis(since)[:, :, None] * scene.filtered_rad_s)


def _edge_basis(elapsed_s: FloatArray) -> FloatArray:
    """Return cosine functions of the logarithmic time since an edge, zero at the window's end."""
    share = np.log1p(np.clip(elapsed_s, 0.0, EDGE_WINDOW_S) / EDGE_TIME_CONSTANT_S) / np.log1p(
        EDGE_WINDOW_S / EDGE_TIME_CONSTANT_S
    )
    return np.asarray(
        np.cos(np.pi * (_wave_numbers(EDGE_WAVES)[:, None] - 0.5) * share), np.float64
    )


def _edge_transients(axis: int, scene: SignalState) -> FloatArray:
    """Return transients of the time since starts and stops, on a logarithmic scale.

    They are rates with the sign of the move after starts and after stops, and a gain after starts.
    """
    stage = zero_signals(scene.interval_count)
    if axis == 0:
        stage[:, 1], stage[:, 2] = np.sin(scene.tilt_rad), np.cos(scene.tilt_rad)
    else:
        stage[:, 0] = 1.0
    along = (scene.gain @ stage.T).T
    delta = np.diff(scene.angle_rad[axis])
    signals = zero_signals(3, EDGE_WAVES, scene.interval_count)
    profiles = [course for moved, course in scene.context.motion_profiles if moved == axis]
    begin = [float(course.start_s[0]) for course in profiles]
    for k, (first, course) in enumerate(zip(begin, profiles, strict=True)):
        last = float(course.end_s)
        inside = slice(*np.searchsorted(scene.time_s, (first, last)))
        sign = float(np.sign(np.sum(delta[inside])))
        until = begin[k + 1] if k + 1 < len(begin) else np.inf
        for edge, stop in ((first, until), (last, until)):
            near = slice(*np.searchsorted(scene.time_s, (edge, min(edge + EDGE_WINDOW_S, stop))))
            waves = _edge_basis(scene.time_s[near] - edge)[:, :, None]
            signals[0 if edge == first else 1, :, near] += sign * waves * along[near]
            if edge == first:
                signals[2, :, near] += waves * scene.filtered_rad_s[near]
    return scene.sample_output(signals.reshape(-1, scene.interval_count, 3, copy=False))


def _per_move_signals(moves: Windows, delay: bool, scene: SignalState) -> FloatArray:
    """Return one signal per move, (moves, blocks, 3)."""
    signal = scene.filtered_slope_rad_s2 if delay else scene.filtered_rad_s
    signals = zero_signals(len(moves), scene.interval_count)
    for k in moves.in_recording_of(scene).tolist():
        begin, end = moves.spans_s[k]
        near = slice(*np.searchsorted(scene.time_s, (begin, end + MOVE_AFTERMATH_S)))
        signals[k, near] = signal[near]
    return scene.sample_output(signals)


def _moves_signal(delay: bool, windows: Windows, scene: SignalState) -> FloatArray:
    """Return the sum of the signals of moves whose windows do not overlap, (1, blocks, 3)."""
    signal = scene.filtered_slope_rad_s2 if delay else scene.filtered_rad_s
    signals = zero_signals(1, scene.interval_count)
    for window_s in windows.spans_s[windows.in_recording_of(scene)]:
        near = slice(*np.searchsorted(scene.time_s, window_s))
        signals[0, near] = signal[near]
    return scene.sample_output(signals)
