"""Find the size at which an effect has a wanted non-centrality in one session.

The energy of most effects is proportional to the square of their size. A secant search in
logarithms finds the size of the others.
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
from tests.hidden.truth.detectable import compute_detectable

from gyrorig_daemon.emulator.injection import CAUSES

TOLERANCE, MAX_MISS = 0.03, 0.2  # of the wanted non-centrality, in logarithms
MAX_ROUNDS = 10
LEAST_SLOPE, MOST_SLOPE = 0.5, 8.0  # of the energy with size, in logarithms
OUTSIDE_STREAM = 0x45464645


@dataclass(frozen=True, slots=True)
class Sized:
    """A size and its non-centrality."""

    size: float
    noncentrality: float


def find_size(
    noncentrality_at: Callable[[float], float], wanted: float, start: float, most: float
) -> Sized | None:
    """Return the size with a wanted non-centrality, None if it is larger than the largest size.

    Args:
        noncentrality_at: non-centrality of a size; it grows with the size.
        wanted: the wanted non-centrality.
        start: first size of the search.
        most: the largest size.
    """
    target, log_size, log_most = (
        np.log(wanted),
        float(np.log(min(start, most))),
        float(np.log(most)),
    )
    best: tuple[float, Sized] | None = None
    before: tuple[float, float] | None = None
    for _ in range(MAX_ROUNDS):
        noncentrality = noncentrality_at(float(np.exp(log_size)))
        log_noncentrality = float(np.log(max(noncentrality, 1e-12)))
        if best is None or abs(log_noncentrality - target) < best[0]:
            best = abs(log_noncentrality - target), Sized(float(np.exp(log_size)), noncentrality)
        if best[0] < TOLERANCE or (log_noncentrality < target and log_size >= log_most - 1e-12):
            break
        slope = 2.0
        if before is not None and abs(log_size - before[0]) > 1e-9:
            slope = float(
                np.clip(
                    (log_noncentrality - before[1]) / (log_size - before[0]),
                    LEAST_SLOPE,
                    MOST_SLOPE,
                )
            )
        before = log_size, log_noncentrality
        log_size = min(
            log_size + float(np.clip((target - log_noncentrality) / slope, -3.0, 3.0)), log_most
        )
    return best[1] if best is not None and best[0] < MAX_MISS else None


def combine_causes(items: Sequence[tuple[Hiding, float]]) -> HiddenCauses:
    """Return several causes with their sizes in one object."""
    return HiddenCauses(
        {hiding.cause: hiding.make_values(size, FULL_SCALE_RAD_S) for hiding, size in items}
    )


def compute_cause_noncentrality(visibility: Visibility, hiding: Hiding, size: float) -> float:
    """Return the non-centrality of one cause."""
    if hiding.cause in IN_VARIANCE:
        return visibility.jitter_noncentrality * size**4
    difference = compute_cause_difference(visibility, hiding, size)
    return float(difference @ difference)


def compute_cause_difference(visibility: Visibility, hiding: Hiding, size: float) -> FloatArray:
    """Return the whitened difference of one cause after a calibration, (3 n - 3,)."""
    causes = combine_causes([(hiding, size)])
    if hiding.cause == "clock_skew":
        return visibility.project(visibility.compute_skew_difference(causes))
    return visibility.compute_difference(visibility.scene.simulate_rates(causes))


def find_cause_size(visibility: Visibility, hiding: Hiding, times: float) -> Sized | None:
    """Return the size of a cause that is `times` its minimal detectable size, None if too large."""
    cause, wanted = CAUSES[hiding.cause], times**2 * compute_detectable(hiding.cause)

    def compute_noncentrality(size: float) -> float:
        return compute_cause_noncentrality(visibility, hiding, size)

    if hiding.cause in COUNTED:
        return Sized(cause.typical, np.inf)
    if hiding.cause == "saturation":  # a smaller limit is more visible
        peak = float(np.abs(visibility.plain.sample_rates()).max())
        reduction = find_size(
            lambda x: compute_noncentrality(peak - x), wanted, 0.05 * peak, 0.5 * peak
        )
        return None if reduction is None else Sized(peak - reduction.size, reduction.noncentrality)
    if cause.is_integer:
        one_step = compute_noncentrality(1.0)
        steps = max(round(float(np.sqrt(wanted / one_step))), 1) if one_step > 0.0 else np.inf
        return Sized(steps, compute_noncentrality(steps)) if steps <= cause.sampled_max else None
    return find_size(compute_noncentrality, wanted, cause.typical, cause.sampled_max)


def make_effect(visibility: Visibility, entry: OutsideEffect, size: float) -> Effect:
    """Return an effect outside the catalogue; its other draws depend on the rig's seed only."""
    scene = visibility.scene
    rng = np.random.default_rng([scene.parts.seed, OUTSIDE_STREAM])
    return entry.make(Site(size, rng, scene.span_s))


def compute_effect_noncentrality(
    visibility: Visibility, entry: OutsideEffect, size: float
) -> float:
    """Return the non-centrality of an effect outside the catalogue."""
    effect, scene = make_effect(visibility, entry, size), visibility.scene
    if not entry.in_variance:
        return visibility.compute_noncentrality(scene.simulate_rates(effect=effect))
    motion = visibility.motion
    amplitude = effect.noise_amplitude(motion, scene.span_s)
    return visibility.compute_scatter_noncentrality(
        np.interp(visibility.plain.sample_s, motion.middle_s, amplitude)
    )


def find_effect_size(visibility: Visibility, entry: OutsideEffect, times: float) -> Sized | None:
    """Return the size of an effect that is `times` its minimal detectable size."""
    return find_size(
        lambda size: compute_effect_noncentrality(visibility, entry, size),
        times**2 * compute_detectable(entry.name),
        entry.start,
        entry.most,
    )


def compute_separate_noncentralities(
    visibility: Visibility, items: Sequence[tuple[Hiding, float]]
) -> list[float | None]:
    """Return the non-centrality of each cause after projecting out the other causes."""
    signals = [
        None
        if hiding.cause in (*COUNTED, *IN_VARIANCE)
        else compute_cause_difference(visibility, hiding, size)
        for hiding, size in items
    ]
    noncentralities: list[float | None] = []
    for k, signal in enumerate(signals):
        others = [o for j, o in enumerate(signals) if j != k and o is not None]
        if signal is not None and others:
            basis = np.stack(others, axis=1)
            signal = signal - basis @ np.linalg.lstsq(basis, signal, rcond=None)[0]  # noqa: PLW2901
        noncentralities.append(None if signal is None else float(signal @ signal))
    return noncentralities
