"""Find the size at which an effect has a wanted visibility, from its noise-free difference.

What to use when: `Sizer` for one rig under one program: `measure_visibility` for given sizes,
`find_size` for the size at a wanted non-centrality. The energy of most effects is proportional to
the square of their size. A secant search in logarithms finds the size of the others.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tests.hidden.truth.detectable import compute_detectable
from tests.hidden.truth.session import BOARD, ORIGIN_NS, Course, ExtraEffects
from tests.hidden.truth.variance import compute_jitter_noncentrality, compute_walk_noncentrality
from tests.support.noncentrality import NuisanceProjector, Visibility

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import InjectionRequest, RigSettings
from gyrorig_daemon.emulator.injection import CAUSES
from gyrorig_daemon.emulator.noise_free_rates import NoiseFreeRates, RigTwin
from gyrorig_daemon.emulator.rig_truth import sample_rig_truth

FloatArray = NDArray[np.float64]

TOLERANCE = 0.02  # of the wanted non-centrality
COUNTED = (
    "lost_samples", "repeated_samples", "corrupt_samples", "axis_swap", "sign_flip",
    "wrong_full_scale",
)  # fmt: skip
IN_VARIANCE = ("sample_jitter", "bias_random_walk")
_MAX_ROUNDS = 16
_SECANT_ROUNDS = 6  # rounds of secants
_MAX_MISS = 0.3  # in logarithms; an effect that begins with a jump has no exact size
_MAX_CACHED = 10  # simulated rates
_MAX_SLOPE = 8.0  # of the energy with size, in logarithms


@dataclass(frozen=True, slots=True)
class VisibleSize:
    """A size and its visibility."""

    size: float
    visibility: Visibility
    detectable: float  # minimal detectable non-centrality

    @property
    def times(self) -> float:
        """The size in minimal detectable sizes."""
        return math.sqrt(max(self.visibility.noncentrality, 0.0) / self.detectable)


class Sizer:
    """Visibility of hidden effects in one rig under one program."""

    def __init__(self, settings: RigSettings, course: Course) -> None:
        """Store the rig and the motion of its axes."""
        self._settings = replace(settings, injections=(), noise_free=True)
        self._course = course
        truth = sample_rig_truth(self._settings)
        self._board = truth.boards[BOARD].to_document()
        self._twin = RigTwin(self._settings, ORIGIN_NS, course.commands, course.end_ns, truth)
        self._cached_rates: dict[tuple[InjectionRequest, ...], NoiseFreeRates] = {}
        self._plain: NoiseFreeRates | None = None
        self._plain_projector: NuisanceProjector | None = None

    def simulate_rates(
        self, *hide: InjectionRequest, extra_effects: ExtraEffects | None = None
    ) -> NoiseFreeRates:
        """Return the rates with and without hidden effects."""
        cached = self._cached_rates.get(hide) if extra_effects is None else None
        if cached is not None:
            return cached
        settings = replace(self._settings, injections=hide)
        rates = self._twin.rates(EmulatedRig(settings, ORIGIN_NS, extra_effects=extra_effects))[
            BOARD
        ]
        if extra_effects is None:
            self._cached_rates[hide] = rates
            if len(self._cached_rates) > _MAX_CACHED:
                del self._cached_rates[next(iter(self._cached_rates))]
        return rates

    def select_projector(self, rates: NoiseFreeRates) -> NuisanceProjector:
        """Return the projector that removes the parameters of a calibration from such rates."""
        if rates.aligned_rad_s is not rates.plain_rad_s:
            return self._make_projector(rates)
        if self._plain_projector is None:
            self._plain_projector = self._make_projector(rates)
        return self._plain_projector

    def measure_visibility(
        self, *hide: InjectionRequest, extra_effects: ExtraEffects | None = None
    ) -> Visibility:
        """Return the visibility of hidden effects."""
        rates = self.simulate_rates(*hide, extra_effects=extra_effects)
        return self.select_projector(rates).visibility(rates)

    def compute_separate_noncentralities(
        self, requests: Sequence[InjectionRequest | None]
    ) -> list[float | None]:
        """Return the non-centrality of each effect after projecting out the other effects."""
        signals: list[FloatArray | None] = []
        for request in requests:
            rates = None if request is None else self.simulate_rates(request)
            signals.append(
                None if rates is None else self.select_projector(rates).projected_effect(rates)
            )
        shares: list[float | None] = []
        for k, signal in enumerate(signals):
            if signal is None:
                shares.append(None)
                continue
            others = [o for j, o in enumerate(signals) if j != k and o is not None]
            separate = signal
            if others:
                basis = np.stack(others, axis=1)
                separate = signal - basis @ np.linalg.lstsq(basis, signal, rcond=None)[0]
            shares.append(float(separate @ separate))
        return shares

    def make_visibility_function(self, name: str, place: str) -> Callable[[float], Visibility]:
        """Return a function that returns the visibility of a cause of a given size."""
        if name == "sample_jitter":
            plain = self._simulate_plain_rates()
            unit_noncentrality = compute_jitter_noncentrality(self.select_projector(plain), plain)
            return lambda size: Visibility(unit_noncentrality * size**4, 0.0)
        if name == "bias_random_walk":
            return lambda size: Visibility(self._compute_walk_noncentrality(place, size), 0.0)
        return lambda size: self.measure_visibility(InjectionRequest(name, place, size))

    def find_size(
        self,
        visibility_at: Callable[[float], Visibility],
        wanted: tuple[float, float],
        start: float,
        most: float,
    ) -> VisibleSize | None:
        """Return the size of an effect that is a wanted multiple of its minimal detectable size.

        Args:
            visibility_at: visibility of a size; it grows with the absolute size.
            wanted: the multiple, and the minimal detectable non-centrality.
            start: first size of the search; the result has the same sign.
            most: largest absolute size.

        Returns:
            None if the effect needs a larger size.
        """
        times, least = wanted
        target = math.log(times**2 * least)
        sign, log_size, top = (
            math.copysign(1.0, start),
            math.log(min(abs(start), most)),
            math.log(most),
        )
        low, high = -math.inf, math.inf
        best: tuple[float, VisibleSize] | None = None
        before: tuple[float, float] | None = None
        for round_ in range(_MAX_ROUNDS):
            visibility = visibility_at(sign * math.exp(log_size))
            log_noncentrality = math.log(max(visibility.noncentrality, 1e-12))
            if best is None or abs(log_noncentrality - target) < best[0]:
                best = (
                    abs(log_noncentrality - target),
                    VisibleSize(sign * math.exp(log_size), visibility, least),
                )
            if best[0] < TOLERANCE or (log_noncentrality < target and log_size >= top - 1e-12):
                break
            low, high = (
                (max(low, log_size), high)
                if log_noncentrality < target
                else (low, min(high, log_size))
            )
            slope = 2.0
            if before is not None and abs(log_size - before[0]) > 1e-9:
                slope = min(
                    max((log_noncentrality - before[1]) / (log_size - before[0]), 0.5), _MAX_SLOPE
                )
            before = log_size, log_noncentrality
            log_size = min(
                log_size + min(max((target - log_noncentrality) / slope, -4.0), 4.0), top
            )
            if not low < log_size < high or (round_ > _SECANT_ROUNDS and math.isfinite(high - low)):
                log_size = 0.5 * (low + high)  # the visibility jumps with the size: bisect
        return best[1] if best is not None and best[0] < _MAX_MISS else None

    def find_cause_size(
        self, name: str, place: str, times: float, sign: float
    ) -> VisibleSize | None:
        """Return the size of a cause that is `times` its minimal detectable size.

        None if the size would be larger than the largest size of the cause. A smaller saturation
        limit is more visible. Lost steps are a whole number.
        """
        cause, visibility_at, least = (
            CAUSES[name],
            self.make_visibility_function(name, place),
            compute_detectable(name),
        )
        if name == "saturation":
            peak = float(np.abs(self._simulate_plain_rates().plain_rad_s).max())
            size = self.find_size(
                lambda x: visibility_at(peak - x), (times, least), 0.05 * peak, 0.8 * peak
            )
            return None if size is None else VisibleSize(peak - size.size, size.visibility, least)
        if cause.is_integer:
            one_step = visibility_at(1.0)
            if one_step.noncentrality <= 0.0:
                return None
            steps = max(round(times / VisibleSize(1.0, one_step, least).times), 1)
            return (
                VisibleSize(sign * steps, visibility_at(sign * steps), least)
                if steps <= cause.sampled_max
                else None
            )
        return self.find_size(
            visibility_at, (times, least), sign * cause.typical, cause.sampled_max
        )

    def _simulate_plain_rates(self) -> NoiseFreeRates:
        if self._plain is None:
            self._plain = self.simulate_rates()
        return self._plain

    def _compute_walk_noncentrality(self, place: str, size: float) -> float:
        request = InjectionRequest("bias_random_walk", place, size)
        settings = replace(self._settings, injections=(request,))
        walk = sample_rig_truth(settings).injected[0].array("walk")
        plain = self._simulate_plain_rates()
        count = int(self.select_projector(plain).inside.sum())
        return compute_walk_noncentrality(self._board, walk, count)

    def _make_projector(self, rates: NoiseFreeRates) -> NuisanceProjector:
        return NuisanceProjector(rates, self._board, self._course.moves_s, self._course.span_s)
