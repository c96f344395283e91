"""The size at which an effect has a wanted non-centrality in one session.

The energy of most effects goes with the square of their size. A secant in logarithms finds the
size of the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.gyroscope import FULL_SCALE_RAD_S
from tests.bench.rigs.prior_sizes import HiddenCauses
from tests.hidden.independent.causes import COUNTED, IN_VARIANCE, Hiding
from tests.hidden.independent.effects.effect import Effect, OutsideEffect, Site
from tests.hidden.independent.visibility import Visibility
from tests.hidden.truth.detectable import detectable_of

from gyrorig_daemon.emulator.injection import CAUSES

NEAR, ROUGHLY = 0.03, 0.2  # of the wanted non-centrality, in logarithms
ROUNDS = 10
LEAST_SLOPE, MOST_SLOPE = 0.5, 8.0  # of the energy with size, in logarithms
OUTSIDE_STREAM = 0x45464645


@dataclass(frozen=True, slots=True)
class Sized:
    """A size and its non-centrality."""

    size: float
    noncentrality: float


def size_for(
    seen: Callable[[float], float], wanted: float, start: float, most: float
) -> Sized | None:
    """Return the size with a wanted non-centrality; None where it needs more than the most.

    Args:
        seen: the non-centrality, by size; it grows with the size.
        wanted: the non-centrality.
        start: a size to begin with.
        most: the largest size.
    """
    aim, x, top = np.log(wanted), float(np.log(min(start, most))), float(np.log(most))
    best: tuple[float, Sized] | None = None
    before: tuple[float, float] | None = None
    for _ in range(ROUNDS):
        noncentrality = seen(float(np.exp(x)))
        y = float(np.log(max(noncentrality, 1e-12)))
        if best is None or abs(y - aim) < best[0]:
            best = abs(y - aim), Sized(float(np.exp(x)), noncentrality)
        if best[0] < NEAR or (y < aim and x >= top - 1e-12):
            break
        slope = 2.0
        if before is not None and abs(x - before[0]) > 1e-9:
            slope = float(np.clip((y - before[1]) / (x - before[0]), LEAST_SLOPE, MOST_SLOPE))
        before = x, y
        x = min(x + float(np.clip((aim - y) / slope, -3.0, 3.0)), top)
    return best[1] if best is not None and best[0] < ROUGHLY else None


def causes_of(items: Sequence[tuple[Hiding, float]]) -> HiddenCauses:
    """Return several causes with their sizes together."""
    return HiddenCauses(
        {hiding.cause: hiding.values(size, FULL_SCALE_RAD_S) for hiding, size in items}
    )


def cause_noncentrality(visibility: Visibility, hiding: Hiding, size: float) -> float:
    """Return how visible one cause is."""
    if hiding.cause in IN_VARIANCE:
        return visibility.jitter * size**4
    left = cause_difference(visibility, hiding, size)
    return float(left @ left)


def cause_difference(visibility: Visibility, hiding: Hiding, size: float) -> FloatArray:
    """Return the whitened difference of one cause beside a calibration, (3 n - 3,)."""
    causes = causes_of([(hiding, size)])
    if hiding.cause == "clock_skew":
        return visibility.projected(visibility.late(causes))
    return visibility.difference(visibility.scene.rates(causes))


def size_of_cause(visibility: Visibility, hiding: Hiding, times: float) -> Sized | None:
    """Return a cause's size at so many times the minimal detectable size, None above the most."""
    cause, wanted = CAUSES[hiding.cause], times**2 * detectable_of(hiding.cause)

    def seen(size: float) -> float:
        return cause_noncentrality(visibility, hiding, size)

    if hiding.cause in COUNTED:
        return Sized(cause.typical, np.inf)
    if hiding.cause == "saturation":  # a smaller limit shows more
        peak = float(np.abs(visibility.plain.at()).max())
        cut = size_for(lambda x: seen(peak - x), wanted, 0.05 * peak, 0.5 * peak)
        return None if cut is None else Sized(peak - cut.size, cut.noncentrality)
    if cause.is_integer:
        at_one = seen(1.0)
        steps = max(round(float(np.sqrt(wanted / at_one))), 1) if at_one > 0.0 else np.inf
        return Sized(steps, seen(steps)) if steps <= cause.sampled_max else None
    return size_for(seen, wanted, cause.typical, cause.sampled_max)


def effect_of(visibility: Visibility, entry: OutsideEffect, size: float) -> Effect:
    """Return an effect outside the catalogue; its other draws depend on the rig's seed alone."""
    scene = visibility.scene
    rng = np.random.default_rng([scene.parts.seed, OUTSIDE_STREAM])
    return entry.make(Site(size, rng, scene.span_s))


def effect_noncentrality(visibility: Visibility, entry: OutsideEffect, size: float) -> float:
    """Return how visible an effect outside the catalogue is."""
    effect, scene = effect_of(visibility, entry, size), visibility.scene
    if not entry.in_variance:
        return visibility.noncentrality(scene.rates(effect=effect))
    motion = visibility.motion
    amplitude = effect.noise_amplitude(motion, scene.span_s)
    return visibility.scatter(np.interp(visibility.plain.sample_s, motion.middle_s, amplitude))


def size_of_effect(visibility: Visibility, entry: OutsideEffect, times: float) -> Sized | None:
    """Return an effect's size at so many times the minimal detectable size."""
    return size_for(
        lambda size: effect_noncentrality(visibility, entry, size),
        times**2 * detectable_of(entry.name),
        entry.start,
        entry.most,
    )


def beside_others(
    visibility: Visibility, items: Sequence[tuple[Hiding, float]]
) -> list[float | None]:
    """Return each cause's non-centrality with the effects of the other causes projected off."""
    left = [
        None
        if hiding.cause in (*COUNTED, *IN_VARIANCE)
        else cause_difference(visibility, hiding, size)
        for hiding, size in items
    ]
    shares: list[float | None] = []
    for k, signal in enumerate(left):
        others = [o for j, o in enumerate(left) if j != k and o is not None]
        if signal is not None and others:
            basis = np.stack(others, axis=1)
            signal = signal - basis @ np.linalg.lstsq(basis, signal, rcond=None)[0]  # noqa: PLW2901
        shares.append(None if signal is None else float(signal @ signal))
    return shares
